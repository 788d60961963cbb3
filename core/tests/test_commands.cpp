// Commands: kinds, deadlines, guiding by hand, and a stop of all devices.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <span>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.hpp"
#include "rcs/arm.hpp"
#include "rcs/camera.hpp"
#include "rcs/result.hpp"

namespace {

using rcs::CommandKind;
using rcs::kNaN;

const std::vector<double> kTwo{0.5, 0.5}, kSix(6, 0.1);

class TestArm final : public rcs::Arm {
 public:
  explicit TestArm(std::string name = "arm", std::set<CommandKind> more = {}, int built_for = rcs::kInterfaceVersion)
      : Arm(std::move(name), {{-1.0, -2.0}, {1.0, 2.0}, {1.0, 1.0}, {}, {}, {5.0, 5.0}}, std::move(more), built_for) {}
  ~TestArm() override { close(); }
  std::atomic<int> holds = 0;
  std::atomic<bool> fails_to_hold = false;
  std::string calls;
  rcs::ArmState measured{{0.0, 0.0}, {0.0, 0.0}};
  int told = -1;                        // where it writes that it holds
  std::atomic<int>* holding = nullptr;  // how many arms have begun to hold; each waits for two

  bool can_guide() const override { return name() != "stiff"; }

  /// Wait until something is so, far longer than it takes.
  template <typename Condition>
  static bool comes(Condition condition) {
    for (int i = 0; i < 5000 && !condition(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return condition();
  }

 protected:
  rcs::ArmState do_state() override { return measured; }
  void do_command_joints(std::span<const double>) override { calls += "joints "; }
  void do_command_pose(const rcs::Pose&) override { calls += "pose "; }
  void do_command_twist(std::span<const double>) override { calls += "twist "; }
  void do_command_torques(std::span<const double>) override { calls += "torques "; }
  bool do_has_arrived() override { return true; }
  void do_guide() override { calls += "guide "; }
  void do_hold() override {
    ++holds;
    if (told >= 0) CHECK(write(told, "h", 1) == 1);
    if (holding) {
      ++*holding;
      CHECK(comes([this] { return *holding >= 2; }));
    }
    if (fails_to_hold) throw std::runtime_error("no answer");
  }
};

void a_command_ends_when_its_time_is_over() {
  TestArm arm;
  arm.open();
  for (int round = 0; round < 2; ++round) {
    arm.holds = 0;
    arm.command_joints(kTwo, 0.01);
    CHECK(TestArm::comes([&] { return arm.holds >= 1; }));  // twice where the call itself took longer
    CHECK(arm.fault().empty());
  }
}

void the_arm_whose_time_ends_first_is_held_first() {
  TestArm slow("slow"), quick("quick");
  slow.open();
  quick.open();
  slow.command_joints(kTwo, 3600.0);
  quick.command_joints(kTwo, 0.01);
  CHECK(TestArm::comes([&] { return quick.holds >= 1; }));
  CHECK(slow.holds == 0);
}

void arms_whose_times_end_together_are_held_together() {
  std::atomic<int> holding = 0;
  TestArm first("first"), second("second");
  first.holding = second.holding = &holding;  // each holds only when the other has begun to
  first.open();
  second.open();
  first.command_joints(kTwo, 0.3);
  second.command_joints(kTwo, 0.3);
  CHECK(TestArm::comes([&] { return first.holds >= 1 && second.holds >= 1; }));
}

void a_newer_command_takes_the_place_of_a_deadline() {
  TestArm renewed("renewed"), other("other");
  renewed.open();
  other.open();
  renewed.command_joints(kTwo, 0.3);
  renewed.command_joints(kTwo);
  other.command_joints(kTwo, 0.4);
  CHECK(TestArm::comes([&] { return other.holds >= 1; }));
  CHECK(renewed.holds == 0);
}

void a_refused_command_leaves_the_deadline_of_the_one_before() {
  TestArm arm;
  arm.open();
  arm.command_joints(kTwo, 0.05);
  CHECK_THROWS(rcs::InvalidCommand, arm.command_joints(std::vector{9.0, 0.0}));
  for (const double bad : {0.0, -1.0, kNaN}) CHECK_THROWS(rcs::InvalidCommand, arm.command_joints(kTwo, bad));
  CHECK(TestArm::comes([&] { return arm.holds >= 1; }));
}

void an_arm_that_cannot_be_held_at_the_end_of_a_command_is_in_fault() {
  TestArm arm;
  arm.open();
  arm.fails_to_hold = true;
  arm.command_joints(kTwo, 0.01);
  CHECK(TestArm::comes([&] { return arm.fault().find("hold failed: no answer") != std::string::npos; }));
  arm.fails_to_hold = false;
}

void an_arm_takes_the_kinds_that_it_names_and_no_others() {
  TestArm plain, rich("rich", {CommandKind::pose, CommandKind::twist, CommandKind::velocities, CommandKind::torques});
  plain.open();
  rich.open();
  CHECK(plain.commands() == std::set{CommandKind::joints});
  CHECK_THROWS(rcs::InvalidCommand, plain.command_pose({}));
  CHECK_THROWS(rcs::InvalidCommand, plain.command_twist(kSix));
  CHECK_THROWS(rcs::InvalidCommand, plain.command_velocities(kTwo));
  CHECK_THROWS(rcs::InvalidCommand, plain.command_torques(kTwo));
  CHECK(plain.calls.empty());
  rich.command_pose({});
  rich.command_twist(kSix);
  CHECK_THROWS(rcs::InvalidCommand, rich.command_velocities(kTwo));  // named, and not overridden
  rich.command_torques(kTwo);
  CHECK(rich.calls == "pose twist torques ");
  CHECK_THROWS(rcs::InvalidCommand, rich.command_twist(kTwo));
  CHECK_THROWS(rcs::InvalidCommand, rich.command_twist(std::vector(6, kNaN)));
  CHECK_THROWS(rcs::InvalidCommand, rich.command_velocities(std::vector{1.1, 0.0}));
  CHECK_THROWS(rcs::InvalidCommand, rich.command_torques(std::vector{0.0, -5.1}));
}

void a_guided_arm_takes_no_commands_until_it_is_held() {
  TestArm arm;
  CHECK_THROWS(rcs::WrongOrder, arm.guide(true));
  arm.open();
  for (const int way : {0, 1, 2}) {
    arm.guide(true);
    arm.guide(true);
    CHECK(arm.is_guided());
    CHECK_THROWS(rcs::WrongOrder, arm.command_joints(kTwo));
    if (way == 0) arm.guide(false);
    if (way == 1) arm.hold();
    if (way == 2) arm.set_fault("stop");
    CHECK(!arm.is_guided());
    CHECK(arm.holds == 1 + way);
  }
  CHECK(arm.calls == "guide guide guide ");
  TestArm stiff("stiff");
  stiff.open();
  CHECK_THROWS(rcs::InvalidCommand, stiff.guide(true));
}

class Eye final : public rcs::Camera {
 public:
  Eye() : Camera("eye", {1, 1, 30.0, false}) {}

 protected:
  rcs::Frame do_read() override { return {1, 1, rcs::share(std::vector<std::uint8_t>(3))}; }
};

void all_open_devices_that_move_stop_at_once() {
  TestArm first("first"), second("second"), closed("closed"), shut("shut");
  Eye eye;
  first.open();
  second.open();
  shut.open();
  shut.close();
  eye.open();
  std::atomic<int> holding = 0;
  first.holding = second.holding = &holding;  // each holds only when the other has begun to
  std::thread([] { rcs::stop_all("a person came near"); }).join();
  first.holding = second.holding = nullptr;
  for (const TestArm* arm : {&first, &second}) CHECK(arm->fault() == "a person came near");
  CHECK_THROWS(rcs::DeviceFault, first.command_joints(kTwo));
  CHECK(closed.fault().empty() && shut.fault().empty() && eye.fault().empty());
  first.recover();
  first.command_joints(kTwo);
  eye.close();
}

// In a process of its own, which ends.
[[maybe_unused]] void open_devices_hold_before_sigterm_ends_the_program() {
  int ends[2];
  CHECK(pipe(ends) == 0);
  const pid_t child = fork();
  if (child == 0) {
    TestArm arm;
    arm.told = ends[1];
    arm.open();
    CHECK(write(ends[1], "o", 1) == 1);
    while (true) pause();  // it ends with every signal that is handled
  }
  close(ends[1]);
  char told = 0;
  CHECK(read(ends[0], &told, 1) == 1 && told == 'o');
  kill(child, SIGTERM);
  CHECK(read(ends[0], &told, 1) == 1 && told == 'h');
  int status = 0;
  CHECK(waitpid(child, &status, 0) == child);
  CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGTERM);
  close(ends[0]);
}

void a_device_of_another_version_of_the_interfaces_is_refused() {
  try {
    TestArm("old", {}, rcs::kInterfaceVersion - 1);
    CHECK(false);
  } catch (const rcs::InvalidSetup& error) {
    CHECK(std::string(error.what()).find("compile the device anew") != std::string::npos);
  }
}

void what_is_measured_has_times_and_makes_sense() {
  TestArm arm;
  arm.open();
  const double before = rcs::monotonic_time();
  const double time = arm.state().time;
  CHECK(before <= time && time <= rcs::monotonic_time());
  arm.measured = {{0.0, 0.0}, {0.0, 0.0}, 2.5, 7.5, kTwo, kTwo, kSix, "idle"};
  CHECK(arm.state().time == 2.5 && arm.state().wrench == kSix);
  for (auto field : {&rcs::ArmState::commanded_joints, &rcs::ArmState::efforts, &rcs::ArmState::wrench}) {
    for (const std::vector<double>& bad : {std::vector{0.0}, std::vector{0.0, kNaN}}) {
      rcs::ArmState state = arm.measured;
      std::swap(state, arm.measured);
      arm.measured.*field = bad;
      CHECK_THROWS(rcs::DeviceFault, arm.state());
      arm.measured = state;
      arm.recover();
    }
  }
}

}  // namespace

int main() {
  a_command_ends_when_its_time_is_over();
  the_arm_whose_time_ends_first_is_held_first();
  arms_whose_times_end_together_are_held_together();
  a_newer_command_takes_the_place_of_a_deadline();
  a_refused_command_leaves_the_deadline_of_the_one_before();
  an_arm_that_cannot_be_held_at_the_end_of_a_command_is_in_fault();
  an_arm_takes_the_kinds_that_it_names_and_no_others();
  a_guided_arm_takes_no_commands_until_it_is_held();
  all_open_devices_that_move_stop_at_once();
#ifndef __SANITIZE_THREAD__  // which takes neither threads after a fork nor signals while one waits
  open_devices_hold_before_sigterm_ends_the_program();
#endif
  a_device_of_another_version_of_the_interfaces_is_refused();
  what_is_measured_has_times_and_makes_sense();
  return rcs::test::result();
}
