#include "rcs/trajectory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <ruckig/ruckig.hpp>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

// Rows of `dof` numbers in the memory. What is planned follows from the last five and the numbers behind.
enum Row { kTarget, kLast, kStream, kPosition, kVelocity, kAcceleration, kAim, kEnd, kRows };
// After the rows: time since the plan's start; its least duration, or below 0 where it is to brake and no more; and the
// share by which the acceleration is less than its limit; whether each joint goes by itself (1), or all wait for each
// other (0); then the order to hold.
enum Number { kElapsed, kLeast, kSpared, kApart, kHold, kNumbers };
static_assert(Trajectory::size(1) == int{kRows} + int{kNumbers});

// As libfranka, which stays that much below the limits that its robot checks (rate_limiting.h, kLimitEps).
constexpr double kMargin = 1e-3;
// How far a stream that ends abruptly may be overshot [rad], up to this share of the velocity limit; none at twice of
// it.
constexpr double kOvershoot = 0.029;
// What is promised [rad].
constexpr double kPromise = 0.0299;
constexpr double kSlow = 0.5;
// Steps within which a stream of targets is met. Only the first is made before the next target comes: what a noisy
// target asks for is met in part, at a fraction of the acceleration.
constexpr double kHorizon = 2.0;
// In place of a least duration: all joints brake together, or each alone.
constexpr double kTogether = -1.0, kAlone = -2.0;
// Part of the velocity limit at which targets are followed; what is left is for catching up.
constexpr double kCruise = 0.9995;
// Part of its way by which a joint that moves may fall short: it then goes a little slower, not back.
constexpr double kSlack = 0.005;
// Part of the velocity limit below which a target is at rest.
constexpr double kResting = 1e-4;
// By how much a plan may last longer than it must.
constexpr double kDetour = 1.01;
// What rounding makes of the end of a trajectory [rad].
constexpr double kRounding = 1e-6;
// Targets may lead by what an arm needs to stop at this share of its acceleration, so that an arm that spares torque is
// not slowed down.
constexpr double kSparing = 0.5;
// Places that a joint is aimed at, each nearer than the one before, until it could stop; the last is rest.
constexpr int kTries = 5;
// Torque is spared while the joints could stop on this much less of the way.
constexpr double kCareful = 1.1;
// How much nearer, of the way by which it would pass: a nearer place is reached at less speed, too.
constexpr double kNearer = 0.6;
// Halvings until a share of the speed is known: to a thousandth.
constexpr int kHalvings = 10;

// Time [s] from one speed to another, `change` apart, at limited acceleration and jerk.
double changing_time(double change, double acceleration, double jerk) {
  return change * jerk >= acceleration * acceleration ? change / acceleration + acceleration / jerk
                                                      : 2.0 * std::sqrt(change / jerk);
}

// Way [rad] to a stop from a speed: half of what the speed makes in that time.
double braking_distance(double speed, double acceleration, double jerk) {
  return 0.5 * speed * changing_time(speed, acceleration, jerk);
}

// The speed whose braking distance is `distance`.
double braking_speed(double distance, double acceleration, double jerk) {
  if (distance <= 0.0) return 0.0;
  const double lag = acceleration / jerk;
  const double speed = 0.5 * acceleration * (std::sqrt(lag * lag + 8.0 * distance / acceleration) - lag);
  return speed * jerk >= acceleration * acceleration ? speed : std::cbrt(distance * distance * jerk);
}

// Way [rad] to a stop from a speed that changes: what gaining it needs besides, or what has been braked already.
double stopping_distance(double speed, double acceleration, double most, double jerk) {
  const double time = std::abs(acceleration) / jerk;
  const double peak = speed + 0.5 * acceleration * acceleration / jerk;
  if (acceleration >= 0.0)
    return (speed + (0.5 * acceleration - jerk * time / 6.0) * time) * time + braking_distance(peak, most, jerk);
  return braking_distance(peak, most, jerk) - (peak - jerk * time * time / 6.0) * time;
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

std::vector<double> MotionLimits::lead(double period) const {
  if (!(period > 0.0)) throw InvalidSetup("motion limits: the period must be positive");
  std::vector<double> lead(velocity.size());
  for (std::size_t i = 0; i < lead.size(); ++i)
    lead[i] = braking_distance(velocity[i], kSparing * acceleration[i], jerk[i]) + kHorizon * period * velocity[i];
  return lead;
}

// A planned trajectory, and what it was planned for. Another memory, or a restored one, makes it plan anew.
struct Trajectory::Plan {
  explicit Plan(std::size_t dof) : ruckig(dof), input(dof), trajectory(dof), each(dof) {
    for (auto* values : {&position, &velocity, &acceleration, &target, &end, &later, &room, &aim, &speed})
      values->assign(dof, 0.0);
    for (auto& values : from) values.assign(dof, 0.0);
  }

  bool compute() { return is_planned(ruckig.calculate(input, trajectory)); }
  // The plan of one joint by itself.
  bool compute(std::size_t i) {
    one.current_position[0] = input.current_position[i];
    one.current_velocity[0] = input.current_velocity[i];
    one.current_acceleration[0] = input.current_acceleration[i];
    one.target_position[0] = input.target_position[i];
    one.target_velocity[0] = input.target_velocity[i];
    one.max_velocity[0] = input.max_velocity[i];
    one.max_acceleration[0] = input.max_acceleration[i];
    one.max_jerk[0] = input.max_jerk[i];
    return is_planned(single.calculate(one, each[i]));
  }
  static bool is_planned(ruckig::Result result) {
    return result == ruckig::Result::Working || result == ruckig::Result::Finished;
  }
  double duration() const {
    if (is_still) return 0.0;
    if (!is_apart) return trajectory.get_duration();
    double longest = 0.0;
    for (const auto& joint : each) longest = std::max(longest, joint.get_duration());
    return longest;
  }
  double soonest(std::size_t i) const { return each[i].get_independent_min_durations()[0]; }
  void at(double time) {
    if (is_still) {
      position = input.current_position;
      std::ranges::fill(velocity, 0.0);
      std::ranges::fill(acceleration, 0.0);
    } else if (is_apart) {
      for (std::size_t i = 0; i < each.size(); ++i) each[i].at_time(time, position[i], velocity[i], acceleration[i]);
    } else {
      trajectory.at_time(time, position, velocity, acceleration);
    }
  }

  ruckig::Ruckig<ruckig::DynamicDOFs> ruckig;
  ruckig::InputParameter<ruckig::DynamicDOFs> input;
  ruckig::Trajectory<ruckig::DynamicDOFs> trajectory;
  ruckig::Ruckig<1> single;
  ruckig::InputParameter<1> one;
  std::vector<ruckig::Trajectory<1>> each;
  std::vector<double> source;  // the numbers that it was computed from
  std::vector<double> source_before;
  bool is_still = true;   // it starts where it ends
  bool is_apart = false;  // each joint goes by itself
  std::vector<double> position, velocity, acceleration;
  // What the law looks at: the targets, at which velocity they move, how much later the plan is to meet them [s], and
  // how far the range goes on behind them; where the arm is.
  std::vector<double> target, end, later, room;
  std::array<std::vector<double>, 3> from;
  std::vector<double> aim, speed;  // what it comes to: where to, at which velocity
};

Trajectory::Trajectory(MotionLimits limits) : limits_(std::move(limits)) {
  limits_.check(dof());
  plan_ = std::make_unique<Plan>(limits_.lower.size());
  auto& input = plan_->input;
  for (std::size_t i = 0; i < limits_.lower.size(); ++i) {
    input.max_velocity[i] = (1.0 - kMargin) * limits_.velocity[i];
    input.max_acceleration[i] = (1.0 - kMargin) * limits_.acceleration[i];
    input.max_jerk[i] = (1.0 - kMargin) * limits_.jerk[i];
  }
}

Trajectory::~Trajectory() = default;

std::vector<int> Trajectory::position_rows() { return {kTarget, kLast, kPosition, kAim}; }

void Trajectory::stand(std::span<double> memory, std::span<const double> joints) {
  std::ranges::fill(memory, 0.0);
  for (const int row : position_rows()) std::ranges::copy(joints, memory.begin() + row * std::ssize(joints));
}

std::span<const double> Trajectory::position() const { return plan_->position; }
std::span<const double> Trajectory::velocity() const { return plan_->velocity; }
std::span<const double> Trajectory::acceleration() const { return plan_->acceleration; }

// The plan that the memory asks for.
Trajectory::Plan& Trajectory::plan(const double* memory) {
  Plan& plan = *plan_;
  const std::size_t n = limits_.lower.size();
  const double* first = memory + kPosition * n;
  const std::size_t count = (kRows - kPosition) * n;
  const double* numbers = memory + kRows * n;
  const double least = numbers[kLeast], spared = numbers[kSpared], apart = numbers[kApart];
  if (plan.source.size() == count + 3 && std::equal(first, first + count, plan.source.begin()) &&
      std::equal(numbers + kLeast, numbers + kHold, plan.source.begin() + static_cast<std::ptrdiff_t>(count)))
    return plan;
  auto& before = plan.source_before;
  std::swap(before, plan.source);
  const bool was_apart =
      plan.is_apart && !plan.is_still && numbers[kLeast] == before[count] && spared == before[count + 1];
  plan.source.assign(first, first + count);
  plan.source.insert(plan.source.end(), numbers + kLeast, numbers + kHold);
  const auto is_new = [&](std::size_t i) {
    for (std::size_t row = 0; row < count; row += n)
      if (before[row + i] != plan.source[row + i]) return true;
    return false;
  };
  auto& input = plan.input;
  plan.is_still = true;
  for (std::size_t i = 0; i < n; ++i) {
    input.current_position[i] = memory[kPosition * n + i];
    input.current_velocity[i] = memory[kVelocity * n + i];
    input.current_acceleration[i] = memory[kAcceleration * n + i];
    input.target_position[i] = memory[kAim * n + i];
    input.target_velocity[i] = memory[kEnd * n + i];
    input.max_acceleration[i] = (1.0 - kMargin) * (1.0 - spared) * limits_.acceleration[i];
    // The speed that the joint comes to while its acceleration ends: where that is the limit but for rounding, Ruckig
    // would brake.
    const double now = input.current_velocity[i], change = input.current_acceleration[i];
    const double peak = std::abs(now + 0.5 * change * std::abs(change) / limits_.jerk[i]) * (1.0 + kMargin);
    input.max_velocity[i] = std::clamp(peak, (1.0 - kMargin) * limits_.velocity[i], limits_.velocity[i]);
    plan.is_still = plan.is_still && input.current_velocity[i] == 0.0 && input.current_acceleration[i] == 0.0 &&
                    input.target_velocity[i] == 0.0 && input.target_position[i] == input.current_position[i];
  }
  if (plan.is_still) return plan;
  plan.is_apart = apart != 0.0;
  input.synchronization = least == kAlone ? ruckig::Synchronization::None : ruckig::Synchronization::Phase;
  input.control_interface = least < 0.0 ? ruckig::ControlInterface::Velocity : ruckig::ControlInterface::Position;
  if (least > 0.0)
    input.minimum_duration = least;
  else
    input.minimum_duration.reset();
  if (plan.is_apart) {
    for (std::size_t i = 0; i < n; ++i) {
      if (was_apart && !is_new(i)) continue;
      plan.one.control_interface = input.control_interface;
      plan.one.minimum_duration = input.minimum_duration;
      // It need not wait for a time at which it can be there again where it could be there sooner.
      if (plan.compute(i) && plan.each[i].get_duration() <= kDetour * std::max(plan.soonest(i), least)) continue;
      plan.one.minimum_duration.reset();
      if (plan.compute(i)) continue;
      input.target_velocity[i] = 0.0;
      if (plan.compute(i)) continue;
      plan.one.control_interface = ruckig::ControlInterface::Velocity;
      if (!plan.compute(i)) plan.is_still = true;
    }
    return plan;
  }
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

// A joint that is outside its range may stay there, and goes no farther.
double Trajectory::within(std::size_t i, double target, double position) const {
  return std::clamp(target, std::min(limits_.lower[i], position), std::max(limits_.upper[i], position));
}

bool Trajectory::is_asked(const double* memory) {
  const std::size_t n = limits_.lower.size();
  look(memory, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    const double target = within(i, memory[kTarget * n + i], plan_->position[i]);
    if (target != memory[kLast * n + i] || memory[kStream * n + i] != 0.0) return true;
  }
  if (!plan(memory).is_still) return false;
  // A plan that could not be made has ended elsewhere.
  for (std::size_t i = 0; i < n; ++i)
    if (memory[kAim * n + i] != memory[kLast * n + i]) return true;
  return false;
}

// The time [s] by which all joints stay behind their targets at a share of the targets' speed, to be able to stop.
double Trajectory::stay_behind(double share) {
  const auto& input = plan_->input;
  double behind = 0.0;
  for (std::size_t i = 0; i < plan_->end.size(); ++i) {
    const double speed = share * std::abs(plan_->end[i]);
    if (speed == 0.0) continue;
    const double fast = speed / (kSlow * input.max_velocity[i]);
    const double overshoot = std::min(kOvershoot * std::clamp(2.0 - fast, 0.0, 1.0), plan_->room[i]);
    const double distance = braking_distance(speed, input.max_acceleration[i], input.max_jerk[i]);
    behind = std::max(behind, (distance - overshoot) / speed);
  }
  return behind;
}

// How far a joint is from where it may have a share of its target's speed, less the way that it takes to come to that
// speed; what is below 0 makes it go back.
double Trajectory::spare_way(std::size_t i, double share, double behind, double horizon) const {
  const Plan& plan = *plan_;
  const double sign = plan.end[i] < 0.0 ? -1.0 : 1.0;
  const double lead = sign * (plan.target[i] + plan.end[i] * plan.later[i] - plan.from[0][i]);
  const double now = sign * plan.from[1][i], speed = sign * share * plan.end[i];
  if (lead <= kRounding) return 0.0;  // it is to go back
  const double least = changing_time(std::abs(speed - now), plan.input.max_acceleration[i], plan.input.max_jerk[i]);
  double way = 0.5 * least * (speed + now);
  if (now < speed) {
    // An arm that needs little of the time for that may go on a little slower for a while.
    const double spare = std::max(horizon - least, 0.0);
    way += 0.5 * spare * (speed + now - std::clamp(now, 0.0, speed));
  }
  return lead - speed * behind - way;
}

// Have a joint that goes away from its target, or is too fast to have the target's speed there, come to rest at it.
void Trajectory::let_go(std::size_t i, double behind, double horizon) {
  Plan& plan = *plan_;
  if (plan.end[i] == 0.0) return;
  const double now = plan.end[i] < 0.0 ? -plan.from[1][i] : plan.from[1][i];
  const bool goes_away =
      now < -0.5 * horizon * plan.input.max_acceleration[i] && (plan.target[i] - plan.from[0][i]) * plan.end[i] > 0.0;
  const bool is_too_fast = now > std::abs(plan.end[i]) && spare_way(i, 1.0, behind, horizon) < -kRounding;
  if (goes_away || is_too_fast) plan.end[i] = 0.0;
}

// The share of the targets' speed at which joints can aim without going back: the place where they may have that speed
// must be at least as far as they come until they have it.
double Trajectory::gained_share(std::size_t first, std::size_t count, double horizon) {
  const auto slack = [&](std::size_t i) {
    const double now = plan_->end[i] < 0.0 ? -plan_->from[1][i] : plan_->from[1][i];
    return kSlack * std::max(now, 0.0) * horizon;
  };
  const auto can = [&](double share) {
    const double behind = stay_behind(share);
    if (behind == 0.0 && share == 1.0) return true;
    for (std::size_t i = first; i < first + count; ++i)
      if (plan_->end[i] != 0.0 && spare_way(i, share, behind, horizon) < -kRounding - slack(i)) return false;
    return true;
  };
  if (can(1.0)) return 1.0;
  double low = 0.0, high = 1.0;
  for (int k = 0; k < kHalvings; ++k) {
    const double middle = 0.5 * (low + high);
    (can(middle) ? low : high) = middle;
  }
  return low;
}

void Trajectory::follow(double* memory, const Step& step, double share) {
  const std::size_t n = limits_.lower.size();
  Plan& plan = this->plan(memory);
  plan.at(memory[kRows * n + kElapsed]);
  double *target = memory + kTarget * n, *last = memory + kLast * n, *stream = memory + kStream * n;
  // Torque is spared only as far as the joints can still stop at the target.
  for (std::size_t i = 0; i < n && share < 1.0; ++i) {
    const double way = within(i, target[i], plan.position[i]) - plan.position[i];
    if (way * plan.velocity[i] <= 0.0) continue;
    const double sign = way < 0.0 ? -1.0 : 1.0;
    const double distance = stopping_distance(sign * plan.velocity[i], sign * plan.acceleration[i],
                                              limits_.acceleration[i], limits_.jerk[i]);
    share = std::clamp(kCareful * distance / std::abs(way), share, 1.0);
  }
  for (std::size_t i = 0; i < n; ++i)
    plan.input.max_acceleration[i] = (1.0 - kMargin) * share * limits_.acceleration[i];
  double most = 1.0;  // of the velocity limit
  for (std::size_t i = 0; i < n; ++i) {
    target[i] = within(i, target[i], plan.position[i]);
    const double velocity = step.is_synchronous ? 0.0 : (target[i] - last[i]) / step.period;
    plan.end[i] = minmod(velocity, stream[i]);
    most = std::max(most, std::abs(plan.end[i]) / (kCruise * plan.input.max_velocity[i]));
    stream[i] = velocity;
    last[i] = target[i];
  }
  for (std::size_t i = 0; i < n; ++i) {
    plan.end[i] = std::abs(plan.end[i]) < kResting * limits_.velocity[i] ? 0.0 : plan.end[i] / most;
    plan.room[i] = std::max(plan.end[i] > 0.0 ? limits_.upper[i] - target[i] : target[i] - limits_.lower[i], 0.0);
    const double allowed = braking_speed(plan.room[i], plan.input.max_acceleration[i], plan.input.max_jerk[i]);
    if (std::abs(plan.end[i]) <= allowed) continue;
    // The target is about to stop at the end of the range: a joint that can stop at the target does so.
    const double sign = plan.end[i] < 0.0 ? -1.0 : 1.0, now = sign * plan.velocity[i];
    const double distance = stopping_distance(std::max(now, 0.0), sign * plan.acceleration[i],
                                              plan.input.max_acceleration[i], plan.input.max_jerk[i]);
    plan.end[i] = distance <= sign * (target[i] - plan.position[i]) ? 0.0 : sign * allowed;
  }
  const double horizon = step.is_synchronous ? 0.0 : (kHorizon - 1.0) * step.period;
  const double soonest = step.is_synchronous ? 0.0 : -step.rest, planned = step.duration + horizon;
  std::ranges::fill(plan.later, soonest + horizon);
  std::ranges::copy(std::span(target, n), plan.target.begin());
  std::ranges::copy(plan.position, plan.from[0].begin());
  std::ranges::copy(plan.velocity, plan.from[1].begin());
  std::ranges::copy(plan.acceleration, plan.from[2].begin());
  double* numbers = memory + kRows * n;
  const bool is_stream = std::ranges::any_of(plan.end, [](double speed) { return speed != 0.0; });
  const auto aim = [&](std::size_t first, std::size_t count) {
    const double all_behind = stay_behind(1.0);
    for (std::size_t i = first; i < first + count; ++i) let_go(i, all_behind, planned);
    const double gained = gained_share(first, count, planned), behind = stay_behind(gained);
    for (std::size_t i = first; i < first + count; ++i) {
      plan.aim[i] = target[i] + (gained > 0.0 ? plan.end[i] * (plan.later[i] - gained * behind) : 0.0);
      plan.speed[i] = gained * plan.end[i];
    }
  };
  aim(0, n);
  if (numbers[kSpared] == 1.0 - share && numbers[kLeast] >= 0.0 && (numbers[kApart] != 0.0 || !is_stream) &&
      std::equal(plan.aim.begin(), plan.aim.end(), memory + kAim * n) &&
      std::equal(plan.speed.begin(), plan.speed.end(), memory + kEnd * n))
    return;
  std::ranges::copy(plan.from[0], memory + kPosition * n);
  std::ranges::copy(plan.from[1], memory + kVelocity * n);
  std::ranges::copy(plan.from[2], memory + kAcceleration * n);
  std::ranges::copy(plan.aim, memory + kAim * n);
  std::ranges::copy(plan.speed, memory + kEnd * n);
  numbers[kElapsed] = 0.0;
  numbers[kLeast] = step.is_synchronous ? 0.0 : planned;
  numbers[kSpared] = 1.0 - share;
  numbers[kApart] = is_stream ? 1.0 : 0.0;
  if (!is_stream) {
    // Nor are all to wait for a time at which one of them, which could be there sooner, can be there again.
    if (step.is_synchronous || this->plan(memory).is_still) return;
    const auto& durations = plan.trajectory.get_independent_min_durations();
    if (plan.duration() > kDetour * std::max(*std::ranges::max_element(durations), planned)) numbers[kApart] = 1.0;
    return;
  }
  // The plan is made for the end of the step after this one, were the target to go on like this. Where a joint that is
  // too fast could not stop at its target then, it is made for a nearer place; and where it cannot at all, for rest.
  for (std::size_t i = 0; i < n; ++i) {
    for (int k = 0; k < kTries && plan.speed[i] != 0.0; ++k) {
      this->plan(memory).at(step.duration);
      const double sign = plan.speed[i] < 0.0 ? -1.0 : 1.0, speed = sign * plan.velocity[i];
      if (speed <= 0.0) break;
      const double way =
          stopping_distance(speed, sign * plan.acceleration[i], plan.input.max_acceleration[i], plan.input.max_jerk[i]);
      const double past = sign * (plan.position[i] - target[i]) + way - std::min(kPromise, plan.room[i]);
      if (past <= kRounding) break;
      plan.later[i] =
          k + 2 < kTries ? std::max(plan.later[i] - kNearer * past / std::abs(plan.end[i]), soonest) : soonest;
      if (k + 1 == kTries) plan.end[i] = 0.0;
      aim(i, 1);
      memory[kAim * n + i] = plan.aim[i];
      memory[kEnd * n + i] = plan.speed[i];
    }
  }
}

void Trajectory::put(double* memory, std::span<const double> joints, std::span<const double> velocities) {
  const std::size_t n = limits_.lower.size();
  stand({memory, static_cast<std::size_t>(size(dof()))}, joints);
  for (std::size_t i = 0; i < n; ++i)
    memory[kVelocity * n + i] = std::clamp(velocities[i], -limits_.velocity[i], limits_.velocity[i]);
  memory[kRows * n + kLeast] = kTogether;
}

void Trajectory::brake(double* memory, double share) {
  const std::size_t n = limits_.lower.size();
  double& least = memory[kRows * n + kLeast];
  const bool is_braking = least < 0.0 && memory[kRows * n + kElapsed] > 0.0;
  if (!is_braking) {
    look(memory, 0.0);
    std::ranges::copy(plan_->position, memory + kPosition * n);
    std::ranges::copy(plan_->velocity, memory + kVelocity * n);
    std::ranges::copy(plan_->acceleration, memory + kAcceleration * n);
    std::ranges::copy(plan_->position, memory + kAim * n);
    std::fill_n(memory + kEnd * n, n, 0.0);
    std::fill_n(memory + kStream * n, n, 0.0);
    memory[kRows * n + kElapsed] = memory[kRows * n + kApart] = 0.0;
    memory[kRows * n + kSpared] = 1.0 - share;
    least = kTogether;
  }
  memory[kRows * n + kHold] = 0.0;
  // Where a joint would leave its range while it waits for the others, each brakes as hard as it can.
  for (;;) {
    Plan& plan = this->plan(memory);
    plan.at(plan.duration());
    bool is_inside = true;
    for (std::size_t i = 0; i < n; ++i) {
      const double end = within(i, plan.position[i], memory[kPosition * n + i]);
      is_inside = is_inside && end == plan.position[i];
      memory[kTarget * n + i] = memory[kLast * n + i] = end;
    }
    if (is_inside || is_braking || least == kAlone) return;
    least = kAlone;
  }
}

void Trajectory::advance(double* memory, double time) {
  const std::size_t n = limits_.lower.size();
  Plan& now = plan(memory);
  if (now.is_still) return now.at(0.0);
  double& elapsed = memory[kRows * n + kElapsed];
  elapsed += time;
  now.at(elapsed);
  bool is_over = elapsed >= now.duration();
  for (std::size_t i = 0; i < n; ++i) is_over = is_over && std::abs(now.velocity[i]) < kResting * limits_.velocity[i];
  if (!is_over) return;
  // From here on it stands still: where the trajectory was to end, not where rounding has led it.
  for (std::size_t i = 0; i < n; ++i) {
    const double target = memory[kLast * n + i];
    const double position = std::abs(target - now.position[i]) < kRounding ? target : now.position[i];
    memory[kPosition * n + i] = memory[kAim * n + i] = position;
    memory[kVelocity * n + i] = memory[kAcceleration * n + i] = memory[kEnd * n + i] = 0.0;
  }
  std::fill_n(memory + kRows * n, std::size_t{kHold}, 0.0);
  plan(memory);
}

void Trajectory::look(const double* memory, double ahead) {
  Plan& now = plan(memory);
  now.at(memory[kRows * limits_.lower.size() + kElapsed] + ahead);
}

double Trajectory::remaining(const double* memory) {
  return std::max(plan(memory).duration() - memory[kRows * limits_.lower.size() + kElapsed], 0.0);
}

bool Trajectory::is_still(const double* memory) { return plan(memory).is_still; }

}  // namespace rcs
