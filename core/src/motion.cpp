#include "rcs/motion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "rcs/result.hpp"
#include "tcp_springs.hpp"

namespace rcs {

namespace {

// At rest, for arrival: ten times below what a person sees, ten times above what a servo jitters.
constexpr double kPositionTolerance = 1e-3;  // rad
constexpr double kVelocityTolerance = 1e-2;  // rad/s
// An arm that is farther from where it is led to is kept from following [rad]: a servo of ours lags by less than a
// tenth.
constexpr double kAstray = 0.2;
// The same for an arm that gives way [rad].
constexpr double kPushedAway = 1.0;
// An arm that holds, and is this far from where it was led to, was pushed, or is blocked [rad].
constexpr double kPushed = 0.03;
// Places of a motion at which torques are looked at: of one that is to be gone to its end, and of others.
constexpr int kPlaces = 12, kFewPlaces = 4;
// Part of the torque that motions may ask for; the rest is for the servos to correct with.
constexpr double kUsable = 0.9;
// A motion whose accelerations take less than this part of the torque is not looked at closely: gravity leaves more.
constexpr double kHarmless = 0.2;
// The least share of the acceleration, where gravity alone takes all the torque.
constexpr double kLeastShare = 0.1;

}  // namespace

struct Motion::Copy {
  explicit Copy(const MotionLimits& limits)
      : trajectory(limits),
        gain(limits.lower.size()),
        lag(limits.lower.size()),
        measured(2 * limits.lower.size()),
        led(2 * limits.lower.size()),
        torques(limits.lower.size()) {}

  Trajectory trajectory;
  std::vector<double> gain;      // of the servo [Nm/rad]
  std::vector<double> lag;       // of the servo [s]
  std::vector<double> force;     // that the acceleration takes [Nm], of all degrees of freedom of the model
  std::vector<double> wanted;    // acceleration, of all degrees of freedom
  std::vector<double> measured;  // positions, then velocities, of the joints
  std::vector<double> memory;    // of a plan that is tried
  std::vector<double> qpos, qvel, speed, bias, still;  // of the model, while a motion is looked at
  std::vector<double> led, torques;                    // as `measured`, and of the joints [Nm]
  std::unique_ptr<TcpSprings> springs;
};

Motion::Motion(std::vector<int> joints, std::vector<int> actuators, int address, MotionLimits limits, int copies,
               std::optional<Springs> springs)
    : joints_(std::move(joints)),
      actuators_(std::move(actuators)),
      address_(address),
      limits_(std::move(limits)),
      springs_(std::move(springs)) {
  if (joints_.empty() || joints_.size() != actuators_.size())
    throw InvalidSetup("motion: each joint needs its actuator; there are " + std::to_string(joints_.size()) +
                       " joints and " + std::to_string(actuators_.size()) + " actuators");
  if (copies < 1) throw InvalidSetup("motion: copies must be at least 1, not " + std::to_string(copies));
  limits_.check(dof());
  if (springs_ && !TcpSprings::are_valid(*springs_))
    throw InvalidSetup("motion: the springs of a TCP need six numbers above 0 each, or none");
  for (int copy = 0; copy < copies; ++copy) copies_.push_back(std::make_unique<Copy>(limits_));
}

Motion::~Motion() = default;

void Motion::check(const mjModel* model, int copies) const {
  if (static_cast<std::size_t>(copies) > copies_.size())
    throw InvalidSetup("motion: it is for " + std::to_string(copies_.size()) + " copies, the world has " +
                       std::to_string(copies));
  if (address_ < 0 || address_ + Trajectory::size(dof()) > model->nuserdata)
    throw InvalidSetup("motion: it needs the user data " + std::to_string(address_) + " to " +
                       std::to_string(address_ + Trajectory::size(dof())) + ", the model has " +
                       std::to_string(model->nuserdata) + " numbers of it");
  if (is_of_tcp() && (springs_->tcp_site >= model->nsite || springs_->base_body >= model->nbody))
    throw InvalidSetup("motion: the TCP or the base is not in the model");
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    if (joints_[i] < 0 || joints_[i] >= model->njnt || actuators_[i] < 0 || actuators_[i] >= model->nu)
      throw InvalidSetup("motion: a joint or an actuator is not in the model");
    const int type = model->jnt_type[joints_[i]];
    if (type != mjJNT_HINGE && type != mjJNT_SLIDE)
      throw InvalidSetup("motion: joint " + std::to_string(joints_[i]) + " is neither a hinge nor a slide");
    if (is_of_tcp() && model->actuator_biastype[actuators_[i]] != mjBIAS_NONE)
      throw InvalidSetup("motion: actuator " + std::to_string(actuators_[i]) + " is no motor");
    if (!is_of_tcp() && !(model->actuator_biasprm[actuators_[i] * mjNBIAS + 1] < 0.0))
      throw InvalidSetup("motion: actuator " + std::to_string(actuators_[i]) + " is no position servo");
  }
}

namespace {

// Torque that a joint's motor has [Nm]; infinite where the model has no limit.
double torque_limit(const mjModel* model, int joint, int actuator) {
  double limit = std::numeric_limits<double>::infinity();
  if (model->jnt_actfrclimited[joint])
    limit = std::min(-model->jnt_actfrcrange[2 * joint], model->jnt_actfrcrange[2 * joint + 1]);
  if (model->actuator_forcelimited[actuator])
    limit = std::min({limit, -model->actuator_forcerange[2 * actuator], model->actuator_forcerange[2 * actuator + 1]});
  return limit;
}

}  // namespace

// Forces at the present speeds in `bias`, and at rest in `still` [Nm], of all degrees of freedom; leaves the data at
// rest, with the speeds that it had in `speed`.
void Motion::know_forces(const mjModel* model, mjData* data, Copy& copy) {
  const auto nv = static_cast<std::size_t>(model->nv);
  copy.bias.resize(nv);
  copy.still.resize(nv);
  copy.speed.assign(data->qvel, data->qvel + nv);
  mj_comVel(model, data);
  mj_rne(model, data, 0, copy.bias.data());
  std::fill_n(data->qvel, nv, 0.0);
  mj_comVel(model, data);
  mj_rne(model, data, 0, copy.still.data());
}

// The torques of the motors beside those for accelerations [Nm], of all degrees of freedom: against the forces of
// speed, and against gravity, that of a load included.
void Motion::know_bias(const mjModel* model, mjData* data, Copy& copy) {
  know_forces(model, data, copy);
  mj_passive(model, data);
  std::ranges::copy(copy.speed, data->qvel);
  for (std::size_t k = 0; k < copy.bias.size(); ++k) copy.bias[k] += data->qfrc_gravcomp[k] - copy.still[k];
}

// Forces of Coriolis and of centrifuges [Nm], of all degrees of freedom, in `bias`.
void Motion::know_speed_forces(const mjModel* model, mjData* data, Copy& copy) {
  know_forces(model, data, copy);
  std::ranges::copy(copy.speed, data->qvel);
  for (std::size_t k = 0; k < copy.bias.size(); ++k) copy.bias[k] -= copy.still[k];
}

// The share of its acceleration that the planned motion may have, by inverse dynamics. A motion that goes far before it
// is planned anew is looked at where it leads; others with the inertia that the arm has where it is.
double Motion::share_of_acceleration(const mjModel* model, mjData* data, const double* memory, Copy& copy,
                                     bool is_far) {
  const std::size_t n = joints_.size();
  const double duration = copy.trajectory.remaining(memory);
  double share = 1.0;
  bool is_known = false;
  if (is_far) {
    copy.qpos.assign(data->qpos, data->qpos + model->nq);
    copy.qvel.assign(data->qvel, data->qvel + model->nv);
  }
  const int places = is_far ? kPlaces : kFewPlaces;
  for (int place = 0; place <= places; ++place) {
    copy.trajectory.look(memory, duration * place / places);
    for (std::size_t i = 0; i < n; ++i)
      copy.wanted[static_cast<std::size_t>(model->jnt_dofadr[joints_[i]])] = copy.trajectory.acceleration()[i];
    if (is_far) {
      put_joints(model, data, copy.trajectory);
      is_known = false;
    }
    mj_mulM(model, data, copy.force.data(), copy.wanted.data());
    for (std::size_t i = 0; i < n; ++i) {
      const auto dof = static_cast<std::size_t>(model->jnt_dofadr[joints_[i]]);
      const double limit = kUsable * torque_limit(model, joints_[i], actuators_[i]), force = copy.force[dof];
      if (std::abs(force) <= kHarmless * limit) continue;
      if (!is_known) know_bias(model, data, copy);
      is_known = true;
      const double speed = copy.trajectory.velocity()[i];
      const double friction = speed == 0.0 ? 0.0 : std::copysign(model->dof_frictionloss[dof], speed);
      const double other = copy.bias[dof] + model->dof_damping[dof] * speed + friction;
      share = std::min(share, (limit - std::copysign(1.0, force) * other) / std::abs(force));
    }
  }
  if (is_far) {
    std::ranges::copy(copy.qpos, data->qpos);
    std::ranges::copy(copy.qvel, data->qvel);
    look_at_inertia(model, data);
  }
  return std::max(share, kLeastShare);
}

// Put the joints where a trajectory is that has been looked at.
void Motion::put_joints(const mjModel* model, mjData* data, const Trajectory& trajectory) {
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    data->qpos[model->jnt_qposadr[joints_[i]]] = trajectory.position()[i];
    data->qvel[model->jnt_dofadr[joints_[i]]] = trajectory.velocity()[i];
  }
  look_at_inertia(model, data);
}

// The inertia matrix that is there may be of another copy.
void Motion::look_at_inertia(const mjModel* model, mjData* data) {
  mj_kinematics(model, data);
  mj_comPos(model, data);
  mj_makeM(model, data);
}

// Plan a step, within the torques of the motors.
void Motion::plan(const mjModel* model, mjData* data, double* memory, Copy& copy, const Step& step) {
  Trajectory& trajectory = copy.trajectory;
  const std::size_t n = joints_.size();
  copy.wanted.assign(static_cast<std::size_t>(model->nv), 0.0);
  copy.force.resize(static_cast<std::size_t>(model->nv));
  if (trajectory.is_told_to_hold(memory)) {
    const std::span<const double> measured(copy.measured);
    const double far = springs_ ? kPushedAway : kPushed;  // springs stay as they are: else a push would go on and on
    if (is_astray(model, data, memory, copy, far)) trajectory.put(memory, measured.first(n), measured.last(n));
    look_at_inertia(model, data);
    return brake(model, data, memory, copy);
  }
  const bool is_asked = trajectory.is_asked(memory);
  if (is_asked) {
    if (const double far = springs_ ? kPushedAway : kAstray; is_astray(model, data, memory, copy, far)) {
      copy.memory.assign(memory, memory + n);  // the target
      for (std::size_t i = 0; i < n; ++i)      // where the servos go on pressing
        copy.measured[i] = std::clamp(trajectory.position()[i], copy.measured[i] - far, copy.measured[i] + far);
      const std::span<const double> measured(copy.measured);
      Trajectory::stand({memory, static_cast<std::size_t>(Trajectory::size(dof()))}, measured.first(n));
      std::ranges::copy(copy.memory, memory);
    }
    copy.memory.assign(memory, memory + Trajectory::size(dof()));
    trajectory.follow(memory, step, 1.0);
  }
  if (trajectory.is_still(memory)) return;
  look_at_inertia(model, data);
  if (!is_asked) return;
  const double share = share_of_acceleration(model, data, memory, copy, step.is_synchronous);
  if (share == 1.0) return;
  std::ranges::copy(copy.memory, memory);
  trajectory.follow(memory, step, share);
}

// Brake within the torques of the motors; the inertia of the present place has been looked at.
void Motion::brake(const mjModel* model, mjData* data, double* memory, Copy& copy) {
  copy.memory.assign(memory, memory + Trajectory::size(dof()));
  copy.trajectory.brake(memory, 1.0);
  const double share = share_of_acceleration(model, data, memory, copy, false);
  if (share == 1.0) return;
  std::ranges::copy(copy.memory, memory);
  copy.trajectory.brake(memory, share);
}

// Whether the joints, whose positions and velocities are written to `measured`, are elsewhere than they were led to.
bool Motion::is_astray(const mjModel* model, const mjData* data, const double* memory, Copy& copy,
                       double tolerance) const {
  const std::size_t n = joints_.size();
  copy.trajectory.look(memory, 0.0);
  bool is_astray = false;
  for (std::size_t i = 0; i < n; ++i) {
    copy.measured[i] = data->qpos[model->jnt_qposadr[joints_[i]]];
    copy.measured[n + i] = data->qvel[model->jnt_dofadr[joints_[i]]];
    is_astray = is_astray || std::abs(copy.measured[i] - copy.trajectory.position()[i]) > tolerance;
  }
  return is_astray;
}

void Motion::begin(const mjModel* model, mjData* data, int copy, const Step& step) {
  Copy& now = *copies_[static_cast<std::size_t>(copy)];
  plan(model, data, data->userdata + address_, now, step);
  if (springs_) look_at_inertia(model, data);
  if (is_of_tcp()) {
    if (!now.springs) now.springs = std::make_unique<TcpSprings>(model, joints_, *springs_);
    return;
  }
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const int actuator = actuators_[i];
    const double* bias = model->actuator_biasprm + actuator * mjNBIAS;
    now.gain[i] = -bias[1];
    now.lag[i] = (model->dof_damping[model->jnt_dofadr[joints_[i]]] - bias[2]) / now.gain[i];
  }
}

void Motion::advance(const mjModel* model, mjData* data, int copy) {
  Copy& now = *copies_[static_cast<std::size_t>(copy)];
  Trajectory& trajectory = now.trajectory;
  double* memory = data->userdata + address_;
  if (trajectory.is_told_to_hold(memory)) plan(model, data, memory, now, {});  // by another thread, during this step
  const bool was_still = trajectory.is_still(memory);
  trajectory.advance(memory, model->opt.timestep);
  if (springs_) return give_way(model, data, now, was_still);
  const std::size_t n = joints_.size();
  if (was_still) {
    for (std::size_t i = 0; i < n; ++i) data->ctrl[actuators_[i]] = trajectory.position()[i];
    return;
  }
  for (std::size_t i = 0; i < n; ++i) now.wanted[model->jnt_dofadr[joints_[i]]] = trajectory.acceleration()[i];
  mj_mulM(model, data, now.force.data(), now.wanted.data());
  for (std::size_t i = 0; i < n; ++i) {
    const double position = std::clamp(trajectory.position()[i], limits_.lower[i], limits_.upper[i]);
    const double force = now.force[model->jnt_dofadr[joints_[i]]];
    data->ctrl[actuators_[i]] = position + now.lag[i] * trajectory.velocity()[i] + force / now.gain[i];
  }
}

// The forces of acceleration and speed, and springs. Inertia and places are those of the last physics step.
void Motion::give_way(const mjModel* model, mjData* data, Copy& copy, bool was_still) {
  const std::size_t n = joints_.size();
  const Trajectory& trajectory = copy.trajectory;
  for (std::size_t i = 0; i < n; ++i) {
    copy.wanted[static_cast<std::size_t>(model->jnt_dofadr[joints_[i]])] = trajectory.acceleration()[i];
    const double led = trajectory.position()[i];
    copy.led[i] = was_still ? led : std::clamp(led, limits_.lower[i], limits_.upper[i]);
    copy.led[n + i] = trajectory.velocity()[i];
    copy.measured[i] = data->qpos[model->jnt_qposadr[joints_[i]]];
    copy.measured[n + i] = data->qvel[model->jnt_dofadr[joints_[i]]];
  }
  mj_mulM(model, data, copy.force.data(), copy.wanted.data());
  know_speed_forces(model, data, copy);
  for (std::size_t i = 0; i < n; ++i) {
    const auto dof = static_cast<std::size_t>(model->jnt_dofadr[joints_[i]]);
    copy.torques[i] = copy.force[dof] + copy.bias[dof];
  }
  if (copy.springs) {
    // Where the joints are led to is where they are to be a physics step after the place that is measured.
    const double step = model->opt.timestep;
    for (std::size_t i = 0; i < n; ++i) {
      copy.led[i] -= step * copy.led[n + i];
      copy.led[n + i] -= step * trajectory.acceleration()[i];
    }
    copy.springs->add(copy.measured, copy.led, copy.torques);
  }
  for (std::size_t i = 0; i < n; ++i)
    data->ctrl[actuators_[i]] =
        copy.springs ? copy.torques[i] : copy.led[i] + copy.lag[i] * copy.led[n + i] + copy.torques[i] / copy.gain[i];
}

std::vector<double> Motion::preview(const mjModel* model, mjData* data, int copy, const Step& step,
                                    std::span<const double> target, double tick) {
  Copy& now = *copies_[static_cast<std::size_t>(copy)];
  Trajectory& trajectory = now.trajectory;
  const double* memory = data->userdata + address_;
  std::vector<double> tried(memory, memory + Trajectory::size(dof()));
  std::ranges::copy(target, tried.begin());
  tried.back() = target.empty() ? 1.0 : 0.0;
  plan(model, data, tried.data(), now, step);
  std::vector<double> positions;
  const auto add = [&](int first, double until, double pace) {
    const int last = static_cast<int>(std::ceil(until / pace - 1e-9));
    for (int k = first; k <= last; ++k) {
      trajectory.look(tried.data(), k * pace);
      positions.insert(positions.end(), trajectory.position().begin(), trajectory.position().end());
    }
  };
  if (step.is_synchronous) {
    add(0, trajectory.remaining(tried.data()), tick);
    return positions;
  }
  const double pace = step.duration / std::ceil(step.duration / tick);  // the same for all motions
  add(0, step.duration, pace);
  // In the same physics steps: rounding decides whether joints that go straight can brake straight.
  for (double left = step.duration; left > 0.5 * model->opt.timestep; left -= model->opt.timestep)
    trajectory.advance(tried.data(), model->opt.timestep);
  // The torques that braking may take depend on where, and how fast, the arm will be then.
  now.qpos.assign(data->qpos, data->qpos + model->nq);
  now.qvel.assign(data->qvel, data->qvel + model->nv);
  trajectory.look(tried.data(), 0.0);
  put_joints(model, data, trajectory);
  brake(model, data, tried.data(), now);
  std::ranges::copy(now.qpos, data->qpos);
  std::ranges::copy(now.qvel, data->qvel);
  look_at_inertia(model, data);
  add(1, trajectory.remaining(tried.data()), pace);
  return positions;
}

std::vector<double> Motion::state(const mjData* data, int copy) {
  Trajectory& trajectory = copies_[static_cast<std::size_t>(copy)]->trajectory;
  trajectory.look(data->userdata + address_, 0.0);
  std::vector<double> all;
  for (const auto values : {trajectory.position(), trajectory.velocity(), trajectory.acceleration()})
    all.insert(all.end(), values.begin(), values.end());
  return all;
}

double Motion::remaining(const mjData* data, int copy) {
  return copies_[static_cast<std::size_t>(copy)]->trajectory.remaining(data->userdata + address_);
}

bool Motion::has_ended(const double* memory, int copy) {
  Trajectory& trajectory = copies_[static_cast<std::size_t>(copy)]->trajectory;
  return trajectory.is_still(memory) && !trajectory.is_asked(memory);
}

bool Motion::call(const StepView& view) {
  const double* memory = view.data->userdata + address_;
  if (!copies_[static_cast<std::size_t>(view.copy)]->trajectory.is_still(memory)) return false;
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const double position = view.data->qpos[view.model->jnt_qposadr[joints_[i]]];
    const double velocity = view.data->qvel[view.model->jnt_dofadr[joints_[i]]];
    if (!springs_ && !(std::abs(position - memory[i]) <= kPositionTolerance)) return false;
    if (std::abs(velocity) > kVelocityTolerance) return false;
  }
  return true;
}

}  // namespace rcs
