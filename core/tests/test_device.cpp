// The life of a device: what is refused when, what a fault does, and what `close` leaves behind.
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "check.hpp"
#include "rcs/arm.hpp"
#include "rcs/camera.hpp"
#include "rcs/gripper.hpp"
#include "rcs/hand.hpp"
#include "rcs/result.hpp"

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

const rcs::ArmLimits kLimits{{-1.0, -2.0}, {1.0, 2.0}, {1.0, 1.0}};

class TestArm final : public rcs::Arm {
 public:
  explicit TestArm(rcs::ArmLimits limits = kLimits) : Arm("arm", std::move(limits)) {}
  std::vector<double> measured{0.0, 0.0};
  std::vector<double> target{0.0, 0.0};
  std::string calls;
  bool fails_to_hold = false;

 protected:
  void do_open() override { calls += "open "; }
  rcs::ArmState do_state() override { return {measured, std::vector<double>(measured.size(), 0.0), 1.0}; }
  void do_command_joints(std::span<const double> joints) override { target.assign(joints.begin(), joints.end()); }
  bool do_has_arrived() override { return target == measured; }
  void do_hold() override {
    calls += "hold ";
    if (fails_to_hold) throw std::runtime_error("no answer");
    target = measured;
  }
  void do_recover() override { calls += "recover "; }
  void do_close() override { calls += "close "; }
};

void a_closed_arm_refuses_every_call() {
  TestArm arm;
  const std::vector<double> target{0.1, 0.1};
  for (int round = 0; round < 2; ++round) {
    CHECK(!arm.is_open());
    CHECK_THROWS(rcs::WrongOrder, arm.state());
    CHECK_THROWS(rcs::WrongOrder, arm.command_joints(target));
    CHECK_THROWS(rcs::WrongOrder, arm.has_arrived());
    CHECK_THROWS(rcs::WrongOrder, arm.hold());
    CHECK_THROWS(rcs::WrongOrder, arm.recover());
    arm.open();
    arm.close();
  }
}

void opening_and_closing_twice_reaches_the_device_once() {
  TestArm arm;
  arm.close();
  arm.open();
  arm.open();
  arm.close();
  arm.close();
  CHECK(arm.calls == "open hold close ");
}

void an_arm_that_fails_to_hold_is_let_go_of() {
  TestArm arm;
  arm.open();
  arm.fails_to_hold = true;
  CHECK_THROWS(std::runtime_error, arm.close());
  CHECK(!arm.is_open());
  CHECK(arm.calls == "open hold close ");
}

void bad_targets_are_refused_and_the_target_stays() {
  TestArm arm;
  arm.open();
  for (const std::vector<double>& bad : std::vector<std::vector<double>>{
           {}, {0.0}, {0.0, 0.0, 0.0}, {kNaN, 0.0}, {0.0, kInfinity}, {0.0, -kInfinity}, {1.01, 0.0}, {0.0, -2.01}})
    CHECK_THROWS(rcs::InvalidCommand, arm.command_joints(bad));
  CHECK(arm.target == std::vector<double>({0.0, 0.0}));
  CHECK(arm.fault().empty());
  // A limit that went through float32 is off by up to 1e-7 of its value.
  const std::vector<double> edge{1.0 + 1e-7, -2.0 - 2e-7};
  arm.command_joints(edge);
  CHECK(!arm.has_arrived());
}

void a_message_names_the_joint_what_came_and_what_is_valid() {
  TestArm arm;
  arm.open();
  try {
    const std::vector<double> bad{0.0, 2.5};
    arm.command_joints(bad);
    CHECK(false);
  } catch (const rcs::InvalidCommand& error) {
    CHECK(std::string(error.what()) == "arm: joints[1] is 2.5, valid is -2 to 2");
  }
}

void a_fault_stays_with_its_first_reason_until_recover() {
  TestArm arm;
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

void measurements_that_make_no_sense_are_faults() {
  for (const std::vector<double>& bad :
       std::vector<std::vector<double>>{{0.0}, {0.0, 0.0, 0.0}, {kNaN, 0.0}, {0.0, kInfinity}}) {
    TestArm arm;
    arm.open();
    arm.measured = bad;
    CHECK_THROWS(rcs::DeviceFault, arm.state());
    CHECK(!arm.fault().empty());
  }
}

void limits_that_make_no_sense_are_refused() {
  for (const rcs::ArmLimits& bad :
       {rcs::ArmLimits{}, rcs::ArmLimits{{0.0}, {1.0, 1.0}, {1.0}}, rcs::ArmLimits{{0.0}, {1.0}, {}},
        rcs::ArmLimits{{1.0}, {0.0}, {1.0}}, rcs::ArmLimits{{0.0}, {1.0}, {0.0}}, rcs::ArmLimits{{kNaN}, {1.0}, {1.0}}})
    CHECK_THROWS(rcs::InvalidSetup, TestArm(bad));
}

class TestGripper final : public rcs::Gripper {
 public:
  TestGripper() : Gripper("gripper", 0.08, 70.0) {}
  double opening = 1.0;

 protected:
  rcs::GripperState do_state() override { return {opening, 0.0, 0.0}; }
  void do_command_opening(double value) override { opening = value; }
  bool do_has_arrived() override { return true; }
  void do_hold() override {}
};

void a_gripper_takes_openings_from_0_to_1() {
  TestGripper gripper;
  CHECK_THROWS(rcs::WrongOrder, gripper.command_opening(0.5));
  gripper.open();
  for (const double bad : {-0.01, 1.01, kNaN, kInfinity})
    CHECK_THROWS(rcs::InvalidCommand, gripper.command_opening(bad));
  CHECK(gripper.opening == 1.0);
  for (const double good : {0.0, 0.3, 1.0}) {
    gripper.command_opening(good);
    CHECK(gripper.state().opening == good);
  }
  gripper.opening = kNaN;
  CHECK_THROWS(rcs::DeviceFault, gripper.state());
  gripper.close();
  gripper.close();
}

class TestHand final : public rcs::Hand {
 public:
  TestHand() : Hand("hand", 2) {}
  std::vector<double> joints{0.0, 0.0};

 protected:
  rcs::HandState do_state() override { return {joints, 0.0}; }
  void do_command_joints(std::span<const double> values) override { joints.assign(values.begin(), values.end()); }
  bool do_has_arrived() override { return true; }
  void do_hold() override {}
};

void a_hand_takes_normalised_joints() {
  TestHand hand;
  const std::vector<double> good{0.0, 1.0};
  CHECK_THROWS(rcs::WrongOrder, hand.command_joints(good));
  hand.open();
  hand.command_joints(good);
  for (const std::vector<double>& bad : std::vector<std::vector<double>>{{0.0}, {0.0, 1.1}, {kNaN, 0.0}})
    CHECK_THROWS(rcs::InvalidCommand, hand.command_joints(bad));
  CHECK(hand.state().joints == good);
  hand.close();
}

class TestCamera final : public rcs::Camera {
 public:
  explicit TestCamera(std::size_t pixels) : Camera("camera", {3, 2, 30.0, true}), pixels_(pixels) {}

 protected:
  rcs::Frame do_read() override {
    return {std::vector<std::uint8_t>(3 * pixels_), std::vector<std::uint16_t>(pixels_), 0.0, 0};
  }

 private:
  std::size_t pixels_;
};

void a_frame_has_the_size_of_the_mode() {
  TestCamera good(6), bad(5);
  CHECK_THROWS(rcs::WrongOrder, good.read());
  good.open();
  CHECK(good.read().rgb.size() == 18);
  bad.open();
  CHECK_THROWS(rcs::DeviceFault, bad.read());
  CHECK_THROWS(rcs::DeviceFault, bad.read());
  bad.recover();
  CHECK(bad.fault().empty());
}

}  // namespace

int main() {
  a_closed_arm_refuses_every_call();
  opening_and_closing_twice_reaches_the_device_once();
  an_arm_that_fails_to_hold_is_let_go_of();
  bad_targets_are_refused_and_the_target_stays();
  a_message_names_the_joint_what_came_and_what_is_valid();
  a_fault_stays_with_its_first_reason_until_recover();
  measurements_that_make_no_sense_are_faults();
  limits_that_make_no_sense_are_refused();
  a_gripper_takes_openings_from_0_to_1();
  a_hand_takes_normalised_joints();
  a_frame_has_the_size_of_the_mode();
  return rcs::test::result();
}
