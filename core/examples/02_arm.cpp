// An arm of your own: override the `do_` functions, and the checks around them come with the interface.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <span>
#include <vector>

#include "rcs/arm.hpp"
#include "rcs/result.hpp"

namespace {

/// Two joints that run to their target at their largest velocity.
class TurnTable final : public rcs::Arm {
 public:
  TurnTable() : Arm("turn table", {{-3.0, -1.0}, {3.0, 1.0}, {1.0, 0.5}}) {}

  /// Let time pass [s].
  void advance(double seconds) {
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      const double reach = limits().joint_velocity[i] * seconds;
      const double step = std::clamp(target_[i] - joints_[i], -reach, reach);
      joints_[i] += step;
      velocities_[i] = step / seconds;
    }
    time_ += seconds;
  }

 protected:
  rcs::ArmState do_state() override { return {joints_, velocities_, rcs::kNaN, time_}; }
  void do_command_joints(std::span<const double> joints) override { target_.assign(joints.begin(), joints.end()); }
  bool do_has_arrived() override { return joints_ == target_; }
  void do_hold() override { target_ = joints_; }

 private:
  std::vector<double> joints_{0.0, 0.0};      // rad
  std::vector<double> velocities_{0.0, 0.0};  // rad/s
  std::vector<double> target_{0.0, 0.0};      // rad
  double time_ = 0.0;                         // s
};

}  // namespace

int main() {
  TurnTable arm;
  arm.open();

  // A target is set; time passes elsewhere, here by hand.
  const std::vector<double> target{0.5, -0.2};
  arm.command_joints(target);
  while (!arm.has_arrived()) arm.advance(0.01);
  const rcs::ArmState state = arm.state();
  std::printf("arrived at %.2f %.2f rad after %.2f s\n", state.joints[0], state.joints[1], state.device_time);

  // A bad target never reaches the device.
  try {
    const std::vector<double> bad{0.5, std::nan("")};
    arm.command_joints(bad);
  } catch (const rcs::InvalidCommand& error) {
    std::printf("refused:  %s\n", error.what());
  }

  // A fault stops the arm and stays until somebody has looked.
  arm.set_fault("emergency stop");
  try {
    arm.command_joints(target);
  } catch (const rcs::DeviceFault& error) {
    std::printf("refused:  %s\n", error.what());
  }
  arm.recover();
  arm.command_joints(target);
  arm.close();
  return arm.is_open() ? 1 : 0;
}
