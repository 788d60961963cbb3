// An arm of your own: say how its controller is read, sent a point and stopped. The thread that leads it from command
// to command, its limits and all checks come with the interface.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>
#include <vector>

#include "rcs/result.hpp"
#include "rcs/streamed_arm.hpp"

namespace {

/// Stands for a vendor's library: a connection that is read from and written to. This one is a turn table that follows
/// within some milliseconds.
class Controller {
 public:
  void enable() { is_enabled_ = true; }
  void disable() { is_enabled_ = false; }
  const std::vector<double>& angles() const { return angles_; }
  void send(const std::vector<double>& target) {
    for (std::size_t i = 0; i < angles_.size() && is_enabled_; ++i) angles_[i] += 0.2 * (target[i] - angles_[i]);
  }

 private:
  bool is_enabled_ = false;
  std::vector<double> angles_{0.0, 0.0};  // rad
};

rcs::ArmLimits figures() {
  rcs::ArmLimits limits;
  limits.joint_lower = {-3.0, -1.0};        // rad
  limits.joint_upper = {3.0, 1.0};          // rad
  limits.joint_velocity = {2.0, 1.0};       // rad/s
  limits.joint_acceleration = {10.0, 8.0};  // rad/s²
  limits.joint_jerk = {500.0, 500.0};       // rad/s³
  return limits;
}

class TurnTable final : public rcs::StreamedArm {
 public:
  TurnTable() : StreamedArm("turn table", figures(), {.rate = 500.0, .missed_ticks = 500}) {}
  ~TurnTable() override { close(); }

 protected:
  void read(rcs::ArmState& state) override {
    state.joint_velocities.assign(2, 0.0);  // it has no tachometers
    state.joints = controller_.angles();
  }
  void start() override { controller_.enable(); }
  void write(const rcs::StreamPoint& point) override { controller_.send(point.position); }
  void stop() override { controller_.disable(); }

 private:
  Controller controller_;
};

void lead(TurnTable& arm, const std::vector<double>& target) {
  arm.command_joints(target);
  while (!arm.has_arrived()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  std::printf("arrived:  %.2f %.2f rad after %.0f points\n", arm.state().joints[0], arm.state().joints[1],
              static_cast<double>(arm.ticks()));
}

/// Prints why a command was refused.
void try_to_lead(TurnTable& arm, const std::vector<double>& target) {
  try {
    lead(arm, target);
  } catch (const std::exception& error) {
    std::printf("refused:  %s\n", error.what());
  }
}

}  // namespace

int main() {
  TurnTable arm;
  arm.open();  // connected, and nothing is switched on

  try_to_lead(arm, {0.5, -0.2});  // the first target must be near the arm …
  lead(arm, {0.1, 0.0});          // … from then on the arm is led
  lead(arm, {0.5, -0.2});

  try_to_lead(arm, {0.5, std::nan("")});  // a bad target never reaches the controller

  // A fault brakes the arm and stays until somebody has looked.
  arm.set_fault("emergency stop");
  try_to_lead(arm, {0.1, 0.0});
  arm.recover();
  lead(arm, {0.1, 0.0});

  arm.close();  // brakes, stops, and lets go
  return arm.is_open() ? 1 : 0;
}
