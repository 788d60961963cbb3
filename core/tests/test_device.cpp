// The life of a device: what is refused when, and what `close` leaves behind.
#include <string>
#include <vector>

#include "check.hpp"
#include "plain_arm.hpp"
#include "rcs/arm.hpp"
#include "rcs/result.hpp"

namespace {

using rcs::kNaN;
using rcs::test::PlainArm;
constexpr double kInfinity = rcs::kForever;

void a_closed_arm_refuses_every_call() {
  PlainArm arm;
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
  PlainArm arm;
  arm.close();
  arm.open();
  arm.open();
  arm.close();
  arm.close();
  CHECK(arm.calls == "open hold close ");
}

void an_arm_that_fails_to_hold_is_let_go_of() {
  PlainArm arm;
  arm.open();
  arm.fails_to_hold = true;
  CHECK_THROWS(rcs::DeviceFault, arm.close());
  CHECK(!arm.is_open());
  CHECK(arm.fault() == "hold failed: no answer");
  CHECK(arm.calls == "open hold close ");
}

void an_arm_whose_fault_is_known_closes_without_a_word() {
  PlainArm arm;
  arm.open();
  arm.fails_to_hold = true;
  arm.set_fault("the link is lost");
  CHECK(arm.fault() == "the link is lost; hold failed: no answer");
  arm.close();
  CHECK(!arm.is_open());
  CHECK(arm.calls == "open hold hold close ");
}

void bad_targets_are_refused_and_the_target_stays() {
  PlainArm arm;
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
  PlainArm arm;
  arm.open();
  try {
    const std::vector<double> bad{0.0, 2.5};
    arm.command_joints(bad);
    CHECK(false);
  } catch (const rcs::InvalidCommand& error) {
    CHECK(std::string(error.what()) == "arm: joints[1] is 2.5, valid is -2 to 2");
  }
}

void measurements_that_make_no_sense_are_faults() {
  for (const std::vector<double>& bad :
       std::vector<std::vector<double>>{{0.0}, {0.0, 0.0, 0.0}, {kNaN, 0.0}, {0.0, kInfinity}}) {
    PlainArm arm;
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
    CHECK_THROWS(rcs::InvalidSetup, PlainArm(bad));
}

}  // namespace

int main() {
  a_closed_arm_refuses_every_call();
  opening_and_closing_twice_reaches_the_device_once();
  an_arm_that_fails_to_hold_is_let_go_of();
  an_arm_whose_fault_is_known_closes_without_a_word();
  bad_targets_are_refused_and_the_target_stays();
  a_message_names_the_joint_what_came_and_what_is_valid();
  measurements_that_make_no_sense_are_faults();
  limits_that_make_no_sense_are_refused();
  return rcs::test::result();
}
