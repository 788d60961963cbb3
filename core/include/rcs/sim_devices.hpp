// An arm and a gripper in one copy of a world, behind the same interfaces as hardware.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "rcs/arm.hpp"
#include "rcs/gripper.hpp"
#include "rcs/world.hpp"

namespace rcs {

/// The arm of one copy of a world. Commands set targets; time passes only in `World::advance`.
class SimArm final : public Arm {
 public:
  /// `motion` leads the joints to their target; it is added to the world.
  SimArm(std::string name, ArmLimits limits, std::shared_ptr<World> world, int copy, std::shared_ptr<Motion> motion);

 protected:
  ArmState do_state() override;
  void do_command_joints(std::span<const double> joints) override;
  bool do_has_arrived() override;
  void do_hold() override;

 private:
  double* target() const;

  std::shared_ptr<World> world_;
  int copy_;
  std::shared_ptr<Motion> motion_;
};

/// How the opening of a gripper relates to its model.
struct GripperMap {
  double joint_closed = 0.0;  ///< rad or m, of the first finger joint at opening 0
  double joint_open = 0.0;    ///< rad or m, at opening 1
  double ctrl_closed = 0.0;   ///< control of the actuator at opening 0
  double ctrl_open = 0.0;     ///< control of the actuator at opening 1
};

/// The gripper of one copy of a world. It has the force of its model: one in a command changes nothing.
class SimGripper final : public Gripper {
 public:
  SimGripper(std::string name, double max_width, double max_force, std::shared_ptr<World> world, int copy,
             std::vector<int> joints, int actuator, GripperMap map);

 protected:
  GripperState do_state() override;
  void do_command_opening(double opening, std::optional<double> force) override;
  bool do_has_arrived() override;
  void do_hold() override;

 private:
  void set_opening(double opening);
  double opening() const;
  double target() const;
  double time() const;

  std::shared_ptr<World> world_;
  int copy_;
  std::vector<int> joints_;
  int actuator_;
  GripperMap map_;
  double commanded_at_;  // s, simulated time of the last command
};

}  // namespace rcs
