// Faults of arms that a thread leads: what the vendor throws, calls that do not return, ticks that are missed.
#include <cmath>
#include <stdexcept>
#include <string>
#include <thread>

#include "servo.hpp"

namespace {

using namespace rcs::test;
using namespace std::chrono_literals;

void what_the_vendor_throws_is_the_fault_in_its_words() {
  for (const bool is_write : {false, true}) {
    Servo arm(on_a_hand_clock());
    arm.open();
    arm.command_joints(Values{0.2, -0.2, -0.5});
    arm.advance(20);
    (is_write ? arm.refuses : arm.is_lost) = true;
    arm.fails_to_stop = true;
    arm.run_freely();
    await([&] { return !arm.fault().empty(); });
    const char* reason =
        is_write ? "write failed: the controller is in its mode reflex" : "read failed: no answer from the controller";
    CHECK(arm.fault().starts_with(reason) && arm.fault().ends_with("; stop failed: it does not stop"));
    CHECK(arm.stops == 1);
    if (is_write)
      CHECK(arm.state().joints == arm.joints);
    else {
      CHECK_THROWS(rcs::DeviceFault, arm.state());
      CHECK_THROWS(rcs::DeviceFault, arm.hold());  // nobody may believe that it was told
    }
    CHECK_THROWS(rcs::DeviceFault, arm.command_joints(arm.joints));
    const std::size_t before = arm.points.size();
    if (!is_write) {
      CHECK(has(message_of([&] { arm.recover(); }), "recover failed: no answer from the controller"));
      CHECK(arm.fault().starts_with(reason));
    }
    arm.is_lost = false;
    arm.recover();
    CHECK(arm.clears == (is_write ? 1 : 2) && arm.fault().empty() && arm.points.size() == before);
    arm.move_by_hand(0, 0.7);
    await([&] { return arm.state().joints[0] == 0.7; });
    const Values here = arm.state().joints;
    CHECK_NEAR(here[0], 0.7, 0.0);
    arm.command_joints(here);
    await([&] { return arm.starts == 2; });
    arm.fails_to_stop = false;
    arm.close();
    CHECK_NEAR(arm.points[before].position[0], here[0], 0.0);
  }
}

void a_joint_that_does_not_follow_is_a_fault_by_its_number() {
  rcs::StreamOptions options = on_a_hand_clock();
  options.tracking_error = 0.1;
  Servo arm(options);
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  arm.is_blocked = true;
  arm.command_joints(Values{0.1, 0.5, -0.5});
  arm.advance(1000);
  CHECK(arm.fault().starts_with("joint 1 is at -0.2 rad and was led to") && has(arm.fault(), "0.1 rad: it is blocked"));
  CHECK(arm.stops == 1 && arm.points.back().position[1] < -0.09);
}

void too_many_missed_ticks_are_a_fault() {
  rcs::StreamOptions options;
  options.silence = 100.0;
  options.missed_ticks = 100;
  Servo arm(options);
  arm.open();
  CHECK(arm.real_time_advice().empty() || has(arm.real_time_advice(), "/etc/security/limits.conf"));
  arm.sleeps = true;
  std::this_thread::sleep_for(200ms);
  arm.sleeps = false;
  await([&] { return arm.missed_ticks() > 100; });
  CHECK(arm.fault().empty());  // it was not led
  arm.command_joints(arm.state().joints);
  await([&] { return arm.ticks() > 2; });
  arm.sleeps = true;
  std::this_thread::sleep_for(200ms);
  arm.sleeps = false;
  await([&] { return !arm.fault().empty(); });
  CHECK(has(arm.fault(), "ticks too late: this machine is busy") && arm.stops == 1);
}

void a_call_that_does_not_return_is_a_fault_and_does_not_keep_the_arm_from_being_stopped() {
  for (const bool is_found_by_measuring : {false, true}) {
    rcs::StreamOptions options = on_its_own_clock();
    options.silence = 0.2;
    Servo arm(options);
    arm.open();
    arm.command_joints(arm.state().joints);
    await([&] { return arm.ticks() > 2; });
    arm.sleeps = true;
    std::this_thread::sleep_for(250ms);
    if (is_found_by_measuring)
      CHECK(has(message_of([&] { arm.state(); }), "has not answered for 0."));
    else
      arm.hold();
    CHECK(arm.stops == 1 && arm.has_stopped_elsewhere);
    CHECK_THROWS(rcs::DeviceFault, arm.command_joints(Values{0.1, -0.2, -0.5}));
    arm.sleeps = false;
    await([&] { return !arm.fault().empty(); });
    const std::size_t before = arm.points.size();
    std::this_thread::sleep_for(20ms);
    CHECK(arm.points.size() <= before + 1);
    arm.recover();
    CHECK(arm.clears == 1);
    arm.command_joints(arm.state().joints);
    await([&] { return arm.starts == 2; });
  }
}

void a_stop_that_does_not_return_is_a_fault() {
  Servo arm(on_its_own_clock());
  arm.open();
  arm.command_joints(arm.state().joints);
  await([&] { return arm.ticks() > 2; });
  arm.hangs_in_stop = true;
  arm.refuses = true;
  await([&] { return has(message_of([&] { arm.state(); }), "the controller has not answered for"); });
  CHECK(!arm.fault().empty());
  arm.hangs_in_stop = false;
  await([&] { return message_of([&] { arm.recover(); }).empty(); });
}

void a_fault_ends_guiding_before_the_arm_recovers() {
  Servo arm(on_its_own_clock());
  arm.open();
  for (int k = 0; k < 200; ++k) {
    arm.guide(true);
    arm.set_fault("stop");
    arm.recover();
    CHECK(arm.clears == 0 && arm.fault().empty());  // it is led again, and so the controller is well
  }
  arm.close();
}

void an_arm_that_half_starts_or_half_gives_way_is_stopped() {
  rcs::StreamOptions options = on_its_own_clock();
  {
    Servo arm(options);
    arm.open();
    const Values here = arm.state().joints;
    arm.loses_at_start = true;
    arm.command_joints(here);
    await([&] { return !arm.fault().empty(); });
    CHECK(arm.stops == 1);
  }
  {
    Servo arm(options);
    arm.open();
    arm.guide(true);
    arm.fails_to_start = true;
    arm.hold();
    await([&] { return !arm.fault().empty(); });
    CHECK(arm.stops == 1 && has(arm.fault(), "it does not start"));
  }
  {
    Servo arm(options);
    arm.open();
    arm.fails_to_give_way = true;
    CHECK(has(message_of([&] { arm.guide(true); }), "a servo keeps its torque"));
    CHECK(arm.stops == 1);
  }
}

void a_reading_that_is_lost_while_a_person_guides_is_recovered_from() {
  Servo arm(on_its_own_clock());
  arm.open();
  arm.guide(true);
  arm.losses = 1;
  await([&] { return !arm.fault().empty(); });
  arm.recover();
  CHECK(arm.fault().empty());
  arm.command_joints(arm.state().joints);
}

void a_guided_arm_that_hangs_is_stopped_by_who_holds_it() {
  rcs::StreamOptions options = on_its_own_clock();
  options.silence = 0.2;
  Servo arm(options);
  arm.open();
  arm.guide(true);
  arm.sleeps = true;
  std::this_thread::sleep_for(250ms);
  arm.hold();
  CHECK(arm.stops == 1);
  arm.sleeps = false;
  await([&] { return !arm.fault().empty(); });
  std::this_thread::sleep_for(20ms);
  CHECK(arm.starts == 0);
}

void commanded_joints_of_another_arm_are_a_fault() {
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(2);
  arm.commanded = {0.1};  // near the first joint, so that the next one is looked at
  arm.run_freely();
  await([&] { return !arm.fault().empty(); });
  CHECK(has(arm.fault(), "the device measured 1 commanded joints, it has 3"));
  static_cast<void>(arm.has_arrived());
}

void another_thread_holds_and_faults_brake_within_the_limits() {
  Servo arm(on_a_hand_clock());
  arm.open();
  arm.command_joints(arm.joints);
  arm.advance(kTicks);
  arm.command_joints(Values{1.5, 0.5, -2.5});
  arm.advance(150);
  std::thread([&] { arm.hold(); }).join();
  CHECK(!arm.has_arrived());
  arm.advance(600);
  CHECK(arm.has_arrived() && arm.state().joints[0] < 1.0 && arm.stops == 0);
  arm.command_joints(Values{1.5, 0.5, -2.5});
  arm.advance(150);
  std::thread([&] { rcs::stop_all("a person came near"); }).join();
  arm.advance(600);
  CHECK(is_still(arm.points.back()) && arm.stops == 0);
  CHECK_THROWS(rcs::DeviceFault, arm.command_joints(arm.joints));
  arm.run_freely();
  arm.recover();
  arm.command_joints(Values{0.1, -0.2, -0.5});
  std::this_thread::sleep_for(5ms);
  rcs::stop_all("the program ends");
  CHECK(arm.has_arrived());  // it has come to rest: there may be no more ticks
  arm.recover();
  CHECK(arm.clears == 0);  // the controller was well
  arm.command_joints(arm.state().joints);
  arm.close();
  check_within_limits(arm.points);
}

void options_that_make_no_sense_are_refused() {
  rcs::ArmLimits few = figures();
  few.joint_jerk.clear();
  struct Bare final : rcs::StreamedArm {
    using StreamedArm::StreamedArm;
    void read(rcs::ArmState&) override {}
    void write(const rcs::StreamPoint&) override {}
    void stop() override {}
  };
  CHECK(has(message_of([&] { Bare("bare", few); }), "bare: a streamed arm needs limits of acceleration and jerk"));
  const auto refusal = [](auto change) {
    rcs::StreamOptions options;
    change(options);
    return message_of([&] { Bare("bare", figures(), options); });
  };
  CHECK(has(refusal([](auto& o) { o.rate = 5.0; }), "10 to 2000 Hz"));
  CHECK(has(refusal([](auto& o) { o.period = std::nan(""); }), "one tick to 10 s"));
  CHECK(has(refusal([](auto& o) { o.margin = 1.3; }), "margin"));
  CHECK(has(refusal([](auto& o) { o.box = rcs::TcpBox{{0, 0, 0}, {1, 1, 1}, nullptr}; }), "gives the TCP"));
  Bare arm("bare", figures());
  CHECK_THROWS(rcs::InvalidSetup, arm.set_period(0.0));
  CHECK(arm.period() == 1.0 / 30.0);
}

}  // namespace

int main() {
  what_the_vendor_throws_is_the_fault_in_its_words();
  a_joint_that_does_not_follow_is_a_fault_by_its_number();
  too_many_missed_ticks_are_a_fault();
  a_call_that_does_not_return_is_a_fault_and_does_not_keep_the_arm_from_being_stopped();
  a_stop_that_does_not_return_is_a_fault();
  a_fault_ends_guiding_before_the_arm_recovers();
  an_arm_that_half_starts_or_half_gives_way_is_stopped();
  a_reading_that_is_lost_while_a_person_guides_is_recovered_from();
  a_guided_arm_that_hangs_is_stopped_by_who_holds_it();
  commanded_joints_of_another_arm_are_a_fault();
  another_thread_holds_and_faults_brake_within_the_limits();
  options_that_make_no_sense_are_refused();
  return rcs::test::result();
}
