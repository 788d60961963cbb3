// Grippers, hands and cameras: what is refused, and what measurements have.
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "check.hpp"
#include "rcs/camera.hpp"
#include "rcs/gripper.hpp"
#include "rcs/hand.hpp"
#include "rcs/result.hpp"

namespace {

using rcs::kNaN;
constexpr double kInfinity = rcs::kForever;

class TestGripper final : public rcs::Gripper {
 public:
  TestGripper() : Gripper("gripper", 0.08, 70.0) {}
  double opening = 1.0;
  std::optional<double> force;

 protected:
  rcs::GripperState do_state() override { return {opening}; }
  void do_command_opening(double value, std::optional<double> newtons) override {
    opening = value;
    force = newtons;
  }
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
  CHECK(!gripper.force);
  for (const double bad : {0.0, -1.0, 70.1, kNaN, kInfinity})
    CHECK_THROWS(rcs::InvalidCommand, gripper.command_opening(0.1, bad));
  CHECK(gripper.opening == 1.0);
  gripper.command_opening(0.1, 70.0);
  CHECK(gripper.force == 70.0);
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
  rcs::HandState do_state() override { return {joints}; }
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
  TestCamera() : Camera("camera", {3, 2, 30.0, true}) {}
  rcs::Frame frame{3, 2, rcs::share(std::vector<std::uint8_t>(18, 7)), rcs::share(std::vector<std::uint16_t>(6)), 0};

 protected:
  rcs::Frame do_read() override { return frame; }
};

void a_frame_has_the_size_of_the_mode_and_shares_its_pixels() {
  TestCamera camera;
  CHECK_THROWS(rcs::WrongOrder, camera.read());
  camera.open();
  CHECK(camera.read().rgb == camera.frame.rgb);
  CHECK(!camera.calibration());
  const rcs::Frame good = camera.frame;
  rcs::Frame uncounted = good, early = good;
  uncounted.number = rcs::kUncounted;
  early.time = rcs::monotonic_time() + 3600.0;
  for (const rcs::Frame& bad : {rcs::Frame{}, rcs::Frame{2, 2, good.rgb, good.depth_mm}, rcs::Frame{3, 2, good.rgb},
                                rcs::Frame{3, 2}, uncounted, early}) {
    camera.frame = bad;
    CHECK_THROWS(rcs::DeviceFault, camera.read());
    CHECK_THROWS(rcs::DeviceFault, camera.read());
    camera.recover();
    CHECK(camera.fault().empty());
  }
  camera.close();
}

void a_frame_has_the_time_at_which_its_number_was_first_read() {
  TestCamera camera;
  camera.open();
  const double before = rcs::monotonic_time();
  const double first = camera.read().time;
  CHECK(before <= first && first <= rcs::monotonic_time());
  CHECK(camera.read().time == first);
  camera.frame.number = 1;
  CHECK(camera.read().time > first);
  camera.frame.time = 1.5;
  CHECK(camera.read().time == 1.5);
  camera.close();
}

}  // namespace

int main() {
  a_gripper_takes_openings_from_0_to_1();
  a_hand_takes_normalised_joints();
  a_frame_has_the_size_of_the_mode_and_shares_its_pixels();
  a_frame_has_the_time_at_which_its_number_was_first_read();
  return rcs::test::result();
}
