#include "rcs/trajectory.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "braking.hpp"
#include "trajectory_plan.hpp"

namespace rcs {

namespace {

// How far a stream that ends abruptly may be overshot [rad], up to this share of the velocity limit; none at twice of
// it.
constexpr double kOvershoot = 0.029;
// The overshoot that is promised [rad].
constexpr double kPromise = 0.0299;
constexpr double kSlow = 0.5;
// Part of the velocity limit at which targets are followed; what is left is for catching up.
constexpr double kCruise = 0.9995;
// Part of its way by which a joint that moves may fall short: it then goes a little slower, not back.
constexpr double kSlack = 0.005;
// Part of the velocity limit below which a target is at rest.
constexpr double kResting = 1e-4;
// The effect of rounding at the end of a trajectory [rad].
constexpr double kRounding = 1e-6;
// Places that a joint is aimed at, each nearer than the one before, until it could stop; the last is rest.
constexpr int kTries = 5;
// Torque is spared while the joints could stop on this much less of the way.
constexpr double kCareful = 1.1;
// How much nearer, of the way by which it would pass: a nearer place is reached at less speed, too.
constexpr double kNearer = 0.6;
// Halvings until a share of the speed is known: to a thousandth.
constexpr int kHalvings = 10;

// The smaller of two numbers of the same sign, else 0.
double minmod(double a, double b) {
  if (a > 0.0 && b > 0.0) return std::min(a, b);
  if (a < 0.0 && b < 0.0) return std::max(a, b);
  return 0.0;
}

}  // namespace

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
