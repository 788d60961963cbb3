// Faults of a device: what comes of what a driver throws, what recovers, and what other threads see meanwhile.
#include <atomic>
#include <future>
#include <span>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "check.hpp"
#include "plain_arm.hpp"
#include "rcs/arm.hpp"
#include "rcs/result.hpp"

namespace {

using rcs::kNaN;
using rcs::test::kLimits;
using rcs::test::PlainArm;

void a_fault_stays_with_its_first_reason_until_recover() {
  PlainArm arm;
  arm.open();
  const std::vector<double> target{0.5, 0.5};
  arm.command_joints(target);
  arm.set_fault("first");
  arm.set_fault("second");
  CHECK(arm.fault() == "first");
  CHECK(arm.target == arm.measured);
  CHECK_THROWS(rcs::DeviceFault, arm.command_joints(target));
  arm.hold();
  arm.recover();
  CHECK(arm.fault().empty());
  arm.command_joints(target);
  arm.set_fault("");
  CHECK(!arm.fault().empty());
}

// An arm as vendors build them: after a reflex it refuses even to hold, until its own fault state is left.
class ReflexArm final : public rcs::Arm {
 public:
  ReflexArm() : Arm("reflex arm", kLimits) {}
  std::string calls;
  bool has_reflex = false;
  bool is_beyond_recovery = false;
  bool has_new_fault = false;

 protected:
  rcs::ArmState do_state() override { return {{kNaN, 0.0}, {0.0, 0.0}, 0.0}; }
  void do_command_joints(std::span<const double>) override {}
  bool do_has_arrived() override { return true; }
  void do_hold() override {
    calls += "hold ";
    if (has_reflex) throw std::runtime_error("refused in a reflex");
  }
  void do_recover() override {
    calls += "recover ";
    if (is_beyond_recovery) throw std::runtime_error("the brakes are shut");
    has_reflex = false;
    if (has_new_fault) set_fault("an obstacle");
  }
};

template <typename Call>
std::string fault_thrown_by(Call call) {
  try {
    call();
  } catch (const rcs::DeviceFault& error) {
    return error.what();
  }
  return "";
}

void an_arm_that_refuses_to_hold_in_a_reflex_recovers() {
  ReflexArm arm;
  arm.open();
  arm.has_reflex = true;
  arm.set_fault("collision");
  CHECK(arm.fault() == "collision; hold failed: refused in a reflex");
  arm.calls.clear();
  arm.recover();
  CHECK(arm.calls == "recover hold ");
  CHECK(arm.fault().empty());
  arm.command_joints(std::vector<double>{0.0, 0.0});
}

void a_fault_whose_recovery_fails_stays_and_the_error_says_so() {
  ReflexArm arm;
  arm.open();
  arm.set_fault("collision");
  arm.is_beyond_recovery = true;
  CHECK(fault_thrown_by([&] { arm.recover(); }) ==
        "reflex arm: recover failed: the brakes are shut; the fault stays (collision)");
  CHECK(arm.fault() == "collision");
  arm.is_beyond_recovery = false;
  arm.recover();
  CHECK(arm.fault().empty());
}

void a_fault_that_comes_during_recover_is_not_forgotten() {
  ReflexArm arm;
  arm.open();
  arm.set_fault("collision");
  arm.has_new_fault = true;
  CHECK(fault_thrown_by([&] { arm.recover(); }) == "reflex arm: a new fault came during recover (an obstacle)");
  CHECK(arm.fault() == "an obstacle");
}

void a_hold_that_fails_does_not_replace_the_reason_of_a_fault() {
  ReflexArm arm;
  arm.open();
  arm.has_reflex = true;
  const std::string thrown = fault_thrown_by([&] { arm.state(); });
  CHECK(thrown.find("not finite at joint 0") != std::string::npos);
  CHECK(thrown.find("hold failed: refused in a reflex") != std::string::npos);
}

// An arm all of whose calls fail from some moment on, as a vendor's library does without a link.
class LostArm final : public rcs::Arm {
 public:
  LostArm() : Arm("lost arm", kLimits) {}
  std::string calls;
  bool is_lost = false;
  bool sets_fault = false;
  bool refuses = false;

 protected:
  void do_open() override { reach("open "); }
  rcs::ArmState do_state() override {
    reach("state ");
    return {{0.0, 0.0}, {0.0, 0.0}};
  }
  void do_command_joints(std::span<const double>) override {
    if (refuses) throw rcs::InvalidCommand("lost arm: too far");
    reach("command ");
  }
  bool do_has_arrived() override {
    reach("arrived ");
    return true;
  }
  bool can_guide() const override { return true; }
  void do_guide() override { reach("guide "); }
  void do_hold() override {
    calls += "hold ";
    if (is_lost && sets_fault) set_fault("the link is lost");
    if (is_lost && !sets_fault) throw std::out_of_range("index 7");
  }
  void do_close() override { reach("close "); }

 private:
  void reach(const char* call) {
    calls += call;
    if (is_lost) throw std::out_of_range("index 7");
  }
};

void what_a_driver_throws_is_a_fault_in_its_words() {
  using Call = void (*)(LostArm&);
  const std::vector<std::pair<std::string, Call>> all{
      {"state", [](LostArm& arm) { arm.state(); }},
      {"command_joints", [](LostArm& arm) { arm.command_joints(std::vector{0.0, 0.0}, 10.0); }},
      {"has_arrived", [](LostArm& arm) { arm.has_arrived(); }},
      {"guide", [](LostArm& arm) { arm.guide(true); }},
      {"hold", [](LostArm& arm) { arm.hold(); }},
  };
  for (const auto& [name, call] : all) {
    LostArm arm;
    arm.open();
    arm.is_lost = true;
    CHECK(fault_thrown_by([&] { call(arm); }).starts_with("lost arm: " + name + " failed: index 7"));
    CHECK(arm.fault().starts_with(name + " failed: index 7"));
    CHECK(arm.calls.find("hold ") != std::string::npos);
    CHECK(!arm.is_guided());
    arm.close();
    CHECK(arm.calls.ends_with("close "));
  }
}

void a_command_that_the_driver_refuses_is_no_fault() {
  LostArm arm;
  arm.open();
  arm.refuses = true;
  CHECK_THROWS(rcs::InvalidCommand, arm.command_joints(std::vector{0.0, 0.0}));
  CHECK(arm.fault().empty());
  arm.close();
}

void a_hold_that_sets_a_fault_ends() {
  LostArm arm;
  arm.open();
  arm.is_lost = arm.sets_fault = true;
  CHECK(fault_thrown_by([&] { arm.state(); }) == "lost arm: state failed: index 7");
  CHECK(arm.fault() == "state failed: index 7");
  CHECK(arm.calls == "open state hold ");
  arm.close();
}

void what_failed_to_open_is_closed() {
  LostArm arm;
  arm.is_lost = true;
  CHECK(fault_thrown_by([&] { arm.open(); }) == "lost arm: open failed: index 7; close failed: index 7");
  CHECK(!arm.is_open());
  CHECK(arm.calls == "open close ");
  arm.is_lost = false;
  arm.open();
  CHECK(arm.is_open() && arm.fault().empty());
  arm.close();
}

// An arm that stays in its calls until it is let go.
class BlockingArm final : public rcs::Arm {
 public:
  BlockingArm() : Arm("blocking arm", kLimits) {}
  std::promise<void> entered, let_go;
  std::atomic<int> holds = 0;
  std::atomic<bool> is_moving = false;

 protected:
  rcs::ArmState do_state() override {
    block();
    return {{0.0, 0.0}, {0.0, 0.0}, 0.0};
  }
  void do_command_joints(std::span<const double>) override {
    block();
    is_moving = true;
  }
  bool do_has_arrived() override { return true; }
  void do_hold() override {
    ++holds;
    is_moving = false;
  }

 private:
  void block() {
    entered.set_value();
    let_go.get_future().wait();
  }
};

void a_fault_is_set_and_read_while_a_call_of_the_device_blocks() {
  BlockingArm arm;
  arm.open();
  std::jthread measuring([&] { arm.state(); });
  arm.entered.get_future().wait();
  CHECK(arm.is_open());
  CHECK(arm.fault().empty());
  arm.set_fault("watchdog");
  CHECK(arm.fault() == "watchdog");
  CHECK(arm.holds == 1);
  arm.hold();
  CHECK(arm.holds == 2);
  arm.let_go.set_value();
}

void a_command_that_was_under_way_at_a_stop_moves_nothing() {
  for (const bool is_fault : {true, false}) {
    BlockingArm arm;
    arm.open();
    std::string thrown;
    std::jthread commanding(
        [&] { thrown = fault_thrown_by([&] { arm.command_joints(std::vector<double>{0.0, 0.0}); }); });
    arm.entered.get_future().wait();
    is_fault ? arm.set_fault("stop") : arm.hold();
    arm.let_go.set_value();
    commanding.join();
    CHECK(!arm.is_moving);
    CHECK(thrown.empty() != is_fault);
  }
}

void faults_may_be_set_and_read_from_many_threads() {
  BlockingArm arm;
  arm.open();
  {
    std::vector<std::jthread> threads;
    for (int i = 0; i < 4; ++i)
      threads.emplace_back([&arm, i] {
        for (int round = 0; round < 200; ++round) {
          if (i % 2 == 0) arm.set_fault("a reason that is too long to be kept inside of the string itself");
          const std::string fault = arm.fault();
          CHECK(fault.empty() || fault == "a reason that is too long to be kept inside of the string itself");
          CHECK(arm.is_open());
        }
      });
    for (int round = 0; round < 200; ++round) {
      try {
        arm.recover();
      } catch (const rcs::DeviceFault&) {  // a new fault came meanwhile
      }
    }
  }
  arm.recover();
  CHECK(arm.fault().empty());
}

}  // namespace

int main() {
  a_fault_stays_with_its_first_reason_until_recover();
  an_arm_that_refuses_to_hold_in_a_reflex_recovers();
  a_fault_whose_recovery_fails_stays_and_the_error_says_so();
  a_fault_that_comes_during_recover_is_not_forgotten();
  a_hold_that_fails_does_not_replace_the_reason_of_a_fault();
  what_a_driver_throws_is_a_fault_in_its_words();
  a_command_that_the_driver_refuses_is_no_fault();
  a_hold_that_sets_a_fault_ends();
  what_failed_to_open_is_closed();
  a_fault_is_set_and_read_while_a_call_of_the_device_blocks();
  a_command_that_was_under_way_at_a_stop_moves_nothing();
  faults_may_be_set_and_read_from_many_threads();
  return rcs::test::result();
}
