#include "rcs/motion.hpp"

#include <algorithm>
#include <cmath>
#include <ruckig/ruckig.hpp>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

// Rows of `dof` numbers in the user data of a copy. What is planned follows from the last five and the numbers behind.
enum Row { kTarget, kLast, kStream, kPosition, kVelocity, kAcceleration, kAim, kEnd, kRows };
// After the rows: time since the plan's start, and its least duration.
enum Number { kElapsed, kLeast };

// As libfranka, which stays that much below the limits that its robot checks (rate_limiting.h, kLimitEps).
constexpr double kMargin = 1e-3;
// How far a stream that ends abruptly may be overshot [rad], up to this share of the velocity limit; none at twice of
// it.
constexpr double kOvershoot = 0.03;
constexpr double kSlow = 0.5;
// Steps within which a stream of targets is met. Only the first is made before the next target comes: what a noisy
// target asks for is met in part, at a fraction of the acceleration.
constexpr double kHorizon = 2.0;
// What rounding makes of the end of a trajectory [rad].
constexpr double kRounding = 1e-6;
// At rest, for arrival: ten times below what a person sees, ten times above what a servo jitters.
constexpr double kPositionTolerance = 1e-3;  // rad
constexpr double kVelocityTolerance = 1e-2;  // rad/s

// Way [rad] to a stop from a speed, at limited acceleration and jerk: half of what the speed makes in that time.
double braking_distance(double speed, double acceleration, double jerk) {
  const double time = speed * jerk >= acceleration * acceleration ? speed / acceleration + acceleration / jerk
                                                                  : 2.0 * std::sqrt(speed / jerk);
  return 0.5 * speed * time;
}

// The speed whose braking distance is `distance`.
double braking_speed(double distance, double acceleration, double jerk) {
  if (distance <= 0.0) return 0.0;
  const double lag = acceleration / jerk;
  const double speed = 0.5 * acceleration * (std::sqrt(lag * lag + 8.0 * distance / acceleration) - lag);
  return speed * jerk >= acceleration * acceleration ? speed : std::cbrt(distance * distance * jerk);
}

// The smaller of two numbers of the same sign, else 0.
double minmod(double a, double b) {
  if (a > 0.0 && b > 0.0) return std::min(a, b);
  if (a < 0.0 && b < 0.0) return std::max(a, b);
  return 0.0;
}

}  // namespace

void MotionLimits::check(int dof) const {
  const auto n = static_cast<std::size_t>(dof);
  for (const auto* values : {&lower, &upper, &velocity, &acceleration, &jerk})
    if (values->size() != n)
      throw InvalidSetup("motion limits: each needs one value per joint, " + std::to_string(n) + ", not " +
                         std::to_string(values->size()));
  for (std::size_t i = 0; i < n; ++i)
    if (!(lower[i] < upper[i])) throw InvalidSetup("motion limits: every lower limit must be below the upper one");
  for (const auto* values : {&velocity, &acceleration, &jerk})
    for (const double value : *values)
      if (!(value > 0.0)) throw InvalidSetup("motion limits: velocity, acceleration and jerk must be positive");
}

// A planned trajectory, and what it was planned for. Another copy's state, or a restored one, makes it plan anew.
struct Motion::Plan {
  explicit Plan(int dof)
      : ruckig(static_cast<std::size_t>(dof)),
        input(static_cast<std::size_t>(dof)),
        trajectory(static_cast<std::size_t>(dof)) {
    const auto n = static_cast<std::size_t>(dof);
    for (auto* values : {&position, &velocity, &acceleration, &lag, &gain, &aim, &end}) values->assign(n, 0.0);
  }

  bool compute() {
    const ruckig::Result result = ruckig.calculate(input, trajectory);
    return result == ruckig::Result::Working || result == ruckig::Result::Finished;
  }
  double duration() const { return is_still ? 0.0 : trajectory.get_duration(); }
  void at(double time) {
    if (is_still) {
      position = input.current_position;
      std::ranges::fill(velocity, 0.0);
      std::ranges::fill(acceleration, 0.0);
    } else {
      trajectory.at_time(time, position, velocity, acceleration);
    }
  }

  ruckig::Ruckig<ruckig::DynamicDOFs> ruckig;
  ruckig::InputParameter<ruckig::DynamicDOFs> input;
  ruckig::Trajectory<ruckig::DynamicDOFs> trajectory;
  std::vector<double> source;  // the numbers that it was computed from
  bool is_still = true;        // it starts where it ends
  std::vector<double> position, velocity, acceleration;
  std::vector<double> lag;       // of the servo [s]
  std::vector<double> gain;      // of the servo [Nm/rad]
  std::vector<double> force;     // that the acceleration takes [Nm], of all degrees of freedom of the model
  std::vector<double> wanted;    // acceleration, of all degrees of freedom
  std::vector<double> aim, end;  // where to, at which velocity
};

Motion::Motion(std::vector<int> joints, std::vector<int> actuators, int address, MotionLimits limits, int copies)
    : joints_(std::move(joints)), actuators_(std::move(actuators)), address_(address), limits_(std::move(limits)) {
  if (joints_.empty() || joints_.size() != actuators_.size())
    throw InvalidSetup("motion: each joint needs its actuator; there are " + std::to_string(joints_.size()) +
                       " joints and " + std::to_string(actuators_.size()) + " actuators");
  if (copies < 1) throw InvalidSetup("motion: copies must be at least 1, not " + std::to_string(copies));
  limits_.check(dof());
  for (int copy = 0; copy < copies; ++copy) {
    plans_.push_back(std::make_unique<Plan>(dof()));
    auto& input = plans_.back()->input;
    input.synchronization = ruckig::Synchronization::Phase;
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      input.max_velocity[i] = (1.0 - kMargin) * limits_.velocity[i];
      input.max_acceleration[i] = (1.0 - kMargin) * limits_.acceleration[i];
      input.max_jerk[i] = (1.0 - kMargin) * limits_.jerk[i];
    }
  }
}

Motion::~Motion() = default;

void Motion::stand(std::span<double> user, std::span<const double> joints) {
  std::ranges::fill(user, 0.0);
  for (const int row : position_rows()) std::ranges::copy(joints, user.begin() + row * std::ssize(joints));
}

std::vector<int> Motion::position_rows() { return {kTarget, kLast, kPosition, kAim}; }

void Motion::check(const mjModel* model, int copies) const {
  if (static_cast<std::size_t>(copies) > plans_.size())
    throw InvalidSetup("motion: it is for " + std::to_string(plans_.size()) + " copies, the world has " +
                       std::to_string(copies));
  if (address_ < 0 || address_ + size(dof()) > model->nuserdata)
    throw InvalidSetup("motion: it needs the user data " + std::to_string(address_) + " to " +
                       std::to_string(address_ + size(dof())) + ", the model has " + std::to_string(model->nuserdata) +
                       " numbers of it");
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    if (joints_[i] < 0 || joints_[i] >= model->njnt || actuators_[i] < 0 || actuators_[i] >= model->nu)
      throw InvalidSetup("motion: a joint or an actuator is not in the model");
    const int type = model->jnt_type[joints_[i]];
    if (type != mjJNT_HINGE && type != mjJNT_SLIDE)
      throw InvalidSetup("motion: joint " + std::to_string(joints_[i]) + " is neither a hinge nor a slide");
    if (!(model->actuator_biasprm[actuators_[i] * mjNBIAS + 1] < 0.0))
      throw InvalidSetup("motion: actuator " + std::to_string(actuators_[i]) + " is no position servo");
  }
}

// The trajectory that the user data of a copy ask for.
Motion::Plan& Motion::plan(const double* user, int copy) {
  Plan& plan = *plans_[static_cast<std::size_t>(copy)];
  const std::size_t n = joints_.size();
  const double* first = user + kPosition * n;
  const std::size_t count = (kRows - kPosition) * n;
  const double least = user[kRows * n + kLeast];
  if (plan.source.size() == count + 1 && std::equal(first, first + count, plan.source.begin()) &&
      plan.source.back() == least)
    return plan;
  plan.source.assign(first, first + count);
  plan.source.push_back(least);
  auto& input = plan.input;
  plan.is_still = true;
  for (std::size_t i = 0; i < n; ++i) {
    input.current_position[i] = user[kPosition * n + i];
    input.current_velocity[i] = user[kVelocity * n + i];
    input.current_acceleration[i] = user[kAcceleration * n + i];
    input.target_position[i] = user[kAim * n + i];
    input.target_velocity[i] = user[kEnd * n + i];
    plan.is_still = plan.is_still && input.current_velocity[i] == 0.0 && input.current_acceleration[i] == 0.0 &&
                    input.target_velocity[i] == 0.0 && input.target_position[i] == input.current_position[i];
  }
  if (plan.is_still) return plan;
  input.control_interface = ruckig::ControlInterface::Position;
  if (least > 0.0)
    input.minimum_duration = least;
  else
    input.minimum_duration.reset();
  if (plan.compute()) return plan;
  // Rounding may leave no trajectory of that duration, or to that speed: what is always left is to come to rest.
  input.minimum_duration.reset();
  if (plan.compute()) return plan;
  std::ranges::fill(input.target_velocity, 0.0);
  if (plan.compute()) return plan;
  input.control_interface = ruckig::ControlInterface::Velocity;
  if (!plan.compute()) plan.is_still = true;
  return plan;
}

// Begin a new plan at the present point of the old one, as evaluated.
void Motion::start(double* user, const Plan& plan) const {
  const std::size_t n = joints_.size();
  std::ranges::copy(plan.position, user + kPosition * n);
  std::ranges::copy(plan.velocity, user + kVelocity * n);
  std::ranges::copy(plan.acceleration, user + kAcceleration * n);
  user[kRows * n + kElapsed] = user[kRows * n + kLeast] = 0.0;
}

void Motion::follow(double* user, const Step& step, Plan& plan) {
  const std::size_t n = joints_.size();
  double *target = user + kTarget * n, *last = user + kLast * n, *stream = user + kStream * n;
  double most = 1.0;  // of the velocity limit
  for (std::size_t i = 0; i < n; ++i) {
    target[i] = std::clamp(target[i], limits_.lower[i], limits_.upper[i]);
    const double velocity = step.is_synchronous ? 0.0 : (target[i] - last[i]) / step.period;
    plan.end[i] = minmod(velocity, stream[i]);
    most = std::max(most, std::abs(plan.end[i]) / plan.input.max_velocity[i]);
    stream[i] = velocity;
    last[i] = target[i];
  }
  double lag = step.is_synchronous ? 0.0 : step.rest;
  double behind = 0.0;  // the time by which all joints stay behind
  for (std::size_t i = 0; i < n; ++i) {
    plan.end[i] /= most;
    const double acceleration = plan.input.max_acceleration[i], jerk = plan.input.max_jerk[i];
    const double room = plan.end[i] > 0.0 ? limits_.upper[i] - target[i] : target[i] - limits_.lower[i];
    const double speed = std::min(std::abs(plan.end[i]), braking_speed(room, acceleration, jerk));
    plan.end[i] = std::copysign(speed, plan.end[i]);
    if (speed == 0.0) continue;
    const double fast = speed / (kSlow * plan.input.max_velocity[i]);
    const double overshoot = kOvershoot * std::clamp(2.0 - fast, 0.0, 1.0);
    behind = std::max(behind, (braking_distance(speed, acceleration, jerk) - overshoot) / speed);
  }
  const double ahead = step.is_synchronous ? 0.0 : (kHorizon - 1.0) * step.period;
  bool is_same = true;
  for (std::size_t i = 0; i < n; ++i) {
    plan.aim[i] = target[i] + plan.end[i] * (ahead - behind - lag);
    is_same = is_same && plan.aim[i] == user[kAim * n + i] && plan.end[i] == user[kEnd * n + i];
  }
  if (is_same) return;
  start(user, plan);
  std::ranges::copy(plan.aim, user + kAim * n);
  std::ranges::copy(plan.end, user + kEnd * n);
  user[kRows * n + kLeast] = step.is_synchronous ? 0.0 : step.duration + ahead;
}

void Motion::begin(const mjModel* model, mjData* data, int copy, const Step& step) {
  double* user = data->userdata + address_;
  const std::size_t n = joints_.size();
  bool is_new = false;
  for (std::size_t i = 0; i < n; ++i)
    is_new = is_new || user[kTarget * n + i] != user[kLast * n + i] || user[kStream * n + i] != 0.0;
  Plan& now = plan(user, copy);
  // A plan that could not be made has ended elsewhere.
  for (std::size_t i = 0; i < n && now.is_still; ++i) is_new = is_new || user[kAim * n + i] != user[kTarget * n + i];
  if (is_new) {
    now.at(user[kRows * n + kElapsed]);
    follow(user, step, now);
    plan(user, copy);
  }
  for (std::size_t i = 0; i < n; ++i) {
    const int actuator = actuators_[i];
    const double* bias = model->actuator_biasprm + actuator * mjNBIAS;
    now.gain[i] = -bias[1];
    now.lag[i] = (model->dof_damping[model->jnt_dofadr[joints_[i]]] - bias[2]) / now.gain[i];
  }
  if (now.is_still) return;
  now.wanted.assign(static_cast<std::size_t>(model->nv), 0.0);
  now.force.resize(static_cast<std::size_t>(model->nv));
  // The inertia matrix that is there may be of another copy.
  mj_kinematics(model, data);
  mj_comPos(model, data);
  mj_makeM(model, data);
}

void Motion::advance(const mjModel* model, mjData* data, int copy) {
  double* user = data->userdata + address_;
  const std::size_t n = joints_.size();
  Plan& now = *plans_[static_cast<std::size_t>(copy)];
  if (now.is_still) {
    for (std::size_t i = 0; i < n; ++i) data->ctrl[actuators_[i]] = now.input.current_position[i];
    return;
  }
  double& elapsed = user[kRows * n + kElapsed];
  elapsed += model->opt.timestep;
  now.at(elapsed);
  bool is_over = elapsed >= now.trajectory.get_duration();
  for (std::size_t i = 0; i < n; ++i) now.wanted[model->jnt_dofadr[joints_[i]]] = now.acceleration[i];
  mj_mulM(model, data, now.force.data(), now.wanted.data());
  for (std::size_t i = 0; i < n; ++i) {
    const double position = std::clamp(now.position[i], limits_.lower[i], limits_.upper[i]);
    const double force = now.force[model->jnt_dofadr[joints_[i]]];
    data->ctrl[actuators_[i]] = position + now.lag[i] * now.velocity[i] + force / now.gain[i];
    is_over = is_over && now.input.target_velocity[i] == 0.0;
  }
  if (!is_over) return;
  // From here on it stands still: where the trajectory was to end, not where rounding has led it.
  for (std::size_t i = 0; i < n; ++i) {
    const double target = user[kTarget * n + i];
    const double position = std::abs(target - now.position[i]) < kRounding ? target : now.position[i];
    user[kPosition * n + i] = user[kAim * n + i] = position;
    user[kVelocity * n + i] = user[kAcceleration * n + i] = user[kEnd * n + i] = 0.0;
  }
  user[kRows * n + kElapsed] = user[kRows * n + kLeast] = 0.0;
  plan(user, copy);
}

std::vector<double> Motion::state(const mjData* data, int copy) {
  const double* user = data->userdata + address_;
  Plan& now = plan(user, copy);
  now.at(user[kRows * joints_.size() + kElapsed]);
  std::vector<double> all = now.position;
  all.insert(all.end(), now.velocity.begin(), now.velocity.end());
  all.insert(all.end(), now.acceleration.begin(), now.acceleration.end());
  return all;
}

double Motion::remaining(const mjData* data, int copy) {
  const double* user = data->userdata + address_;
  const Plan& now = plan(user, copy);
  return std::max(now.duration() - user[kRows * joints_.size() + kElapsed], 0.0);
}

bool Motion::call(const StepView& view) {
  const double* user = view.data->userdata + address_;
  if (!plans_[static_cast<std::size_t>(view.copy)]->is_still) return false;
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const double position = view.data->qpos[view.model->jnt_qposadr[joints_[i]]];
    const double velocity = view.data->qvel[view.model->jnt_dofadr[joints_[i]]];
    if (!(std::abs(position - user[kTarget * joints_.size() + i]) <= kPositionTolerance)) return false;
    if (std::abs(velocity) > kVelocityTolerance) return false;
  }
  return true;
}

}  // namespace rcs
