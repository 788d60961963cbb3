#include "rcs/sim_devices.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

namespace rcs {

namespace {

// At rest, for has_arrived: ten times below what a person sees, ten times above what a servo jitters.
constexpr double kPositionTolerance = 1e-3;  // rad
constexpr double kVelocityTolerance = 1e-2;  // rad/s or m/s
// Fingers that stand still away from their target have met an object, unless they were commanded a moment ago.
constexpr double kOpeningTolerance = 0.02;
constexpr double kStartTime = 0.05;  // s

double* row(World& world, int which, int copy) {
  int size = 0;
  return world.component(which, &size) + static_cast<std::ptrdiff_t>(copy) * world.row_stride();
}

void check_ids(const World& world, const std::string& name, int copy, const std::vector<int>& joints,
               const std::vector<int>& actuators) {
  const mjModel* model = world.model();
  bool is_valid = copy >= 0 && copy < world.copies();
  for (const int joint : joints) is_valid = is_valid && joint >= 0 && joint < model->njnt;
  for (const int actuator : actuators) is_valid = is_valid && actuator >= 0 && actuator < model->nu;
  if (!is_valid) throw InvalidSetup(name + ": the copy, a joint or an actuator is not in the world");
}

}  // namespace

SimArm::SimArm(std::string name, ArmLimits limits, std::shared_ptr<World> world, int copy,
               std::shared_ptr<Motion> motion)
    : Arm(std::move(name), std::move(limits)), world_(std::move(world)), copy_(copy) {
  if (!motion || motion->dof() != dof())
    throw InvalidSetup(this->name() + ": its motion needs one joint per joint of the limits, " + std::to_string(dof()));
  check_ids(*world_, this->name(), copy_, motion->joints(), {});
  motion_ = world_->add_motion(std::move(motion));
}

double* SimArm::target() const { return row(*world_, mjSTATE_USERDATA, copy_) + motion_->address(); }

ArmState SimArm::do_state() {
  const double* qpos = row(*world_, mjSTATE_QPOS, copy_);
  const double* qvel = row(*world_, mjSTATE_QVEL, copy_);
  ArmState state;
  for (const int joint : motion_->joints()) {
    state.joints.push_back(qpos[world_->model()->jnt_qposadr[joint]]);
    state.joint_velocities.push_back(qvel[world_->model()->jnt_dofadr[joint]]);
  }
  state.commanded_joints.assign(target(), target() + dof());
  state.device_time = *row(*world_, mjSTATE_TIME, copy_);
  return state;
}

void SimArm::do_command_joints(std::span<const double> joints) {
  for (std::size_t i = 0; i < joints.size(); ++i)
    target()[i] = std::clamp(joints[i], limits().joint_lower[i], limits().joint_upper[i]);
  target()[Trajectory::size(dof()) - 1] = 0.0;
}

bool SimArm::do_has_arrived() {
  const ArmState state = do_state();
  if (motion_->gives_way() && !motion_->has_ended(target(), copy_)) return false;
  const double tolerance = motion_->gives_way() ? kForever : kPositionTolerance;
  for (std::size_t i = 0; i < state.joints.size(); ++i)
    if (std::abs(state.joints[i] - state.commanded_joints[i]) > tolerance ||
        std::abs(state.joint_velocities[i]) > kVelocityTolerance)
      return false;
  return true;
}

void SimArm::do_hold() {
  std::ranges::copy(do_state().joints, target());
  target()[Trajectory::size(dof()) - 1] = 1.0;
}

SimGripper::SimGripper(std::string name, double max_width, double max_force, std::shared_ptr<World> world, int copy,
                       std::vector<int> joints, int actuator, GripperMap map)
    : Gripper(std::move(name), max_width, max_force),
      world_(std::move(world)),
      copy_(copy),
      joints_(std::move(joints)),
      actuator_(actuator),
      map_(map) {
  check_ids(*world_, this->name(), copy_, joints_, {actuator_});
  if (joints_.empty() || map_.joint_open == map_.joint_closed)
    throw InvalidSetup(this->name() + ": a gripper needs a finger joint that moves");
  if (map_.ctrl_open == map_.ctrl_closed)
    throw InvalidSetup(this->name() + ": a gripper needs a control that differs between open and closed");
  commanded_at_ = time();
}

double SimGripper::opening() const {
  const double* qpos = row(*world_, mjSTATE_QPOS, copy_);
  double mean = 0.0;
  for (const int joint : joints_) mean += qpos[world_->model()->jnt_qposadr[joint]];
  mean /= static_cast<double>(joints_.size());
  return std::clamp((mean - map_.joint_closed) / (map_.joint_open - map_.joint_closed), 0.0, 1.0);
}

double SimGripper::target() const {
  return (row(*world_, mjSTATE_CTRL, copy_)[actuator_] - map_.ctrl_closed) / (map_.ctrl_open - map_.ctrl_closed);
}

double SimGripper::time() const { return *row(*world_, mjSTATE_TIME, copy_); }

GripperState SimGripper::do_state() { return {opening(), kNaN, kNaN, time()}; }

void SimGripper::do_command_opening(double opening, std::optional<double>) { set_opening(opening); }

void SimGripper::set_opening(double opening) {
  opening = std::clamp(opening, 0.0, 1.0);
  row(*world_, mjSTATE_CTRL, copy_)[actuator_] = map_.ctrl_closed + opening * (map_.ctrl_open - map_.ctrl_closed);
  commanded_at_ = time();
}

bool SimGripper::do_has_arrived() {
  const double* qvel = row(*world_, mjSTATE_QVEL, copy_);
  for (const int joint : joints_)
    if (std::abs(qvel[world_->model()->jnt_dofadr[joint]]) > kVelocityTolerance) return false;
  if (std::abs(opening() - target()) < kOpeningTolerance) return true;
  const double passed = time() - commanded_at_;
  return passed < 0.0 || passed >= kStartTime;  // negative: the world was reset since
}

void SimGripper::do_hold() {
  // Fingers that press on an object go on pressing: letting it fall is not holding.
  if (!do_has_arrived()) set_opening(opening());
}

}  // namespace rcs
