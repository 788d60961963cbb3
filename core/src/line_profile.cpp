#include "rcs/line_profile.hpp"

#include <algorithm>
#include <cmath>
#include <ruckig/ruckig.hpp>
#include <string>

#include "rcs/result.hpp"

namespace rcs {

namespace {

// By this share, the fastest speed stays below what rounding might make unreachable.
constexpr double kShy = 1e-6;
// A share of the distance by which rounding may make it too short.
constexpr double kRounding = 1e-9;

void check(const LineLimits& limits) {
  for (const double value : {limits.velocity, limits.acceleration, limits.jerk})
    if (!(value > 0.0) || !std::isfinite(value))
      throw InvalidSetup("line profile: velocity, acceleration and jerk must be positive numbers");
}

}  // namespace

struct LineProfile::Plan {
  ruckig::Trajectory<1> trajectory;
  double duration = 0.0, distance = 0.0, from = 0.0, to = 0.0;
};

LineProfile::LineProfile(double distance, double from_speed, double to_speed, const LineLimits& limits)
    : plan_(std::make_unique<Plan>()) {
  check(limits);
  for (const double speed : {from_speed, to_speed})
    if (!(speed >= 0.0) || speed > limits.velocity * (1.0 + kRounding))
      throw InvalidSetup("line profile: a speed is " + std::to_string(speed) + "; valid is 0 to " +
                         std::to_string(limits.velocity));
  if (!(distance >= 0.0) || shortest(from_speed, to_speed, limits) > distance * (1.0 + 1e-6) + kRounding)
    throw InvalidSetup("line profile: the distance " + std::to_string(distance) +
                       " is too short to get from speed to speed");
  plan_->distance = distance;
  plan_->from = from_speed;
  plan_->to = to_speed;
  if (distance == 0.0) return;
  ruckig::InputParameter<1> input;
  input.current_position = {0.0};
  input.current_velocity = {std::min(from_speed, limits.velocity)};
  input.current_acceleration = {0.0};
  input.target_position = {distance};
  input.target_velocity = {std::min(to_speed, limits.velocity)};
  input.target_acceleration = {0.0};
  input.max_velocity = {limits.velocity};
  input.max_acceleration = {limits.acceleration};
  input.max_jerk = {limits.jerk};
  ruckig::Ruckig<1> solver;
  const ruckig::Result result = solver.calculate(input, plan_->trajectory);
  if (result != ruckig::Result::Working && result != ruckig::Result::Finished)
    throw InvalidSetup("line profile: Ruckig finds none over " + std::to_string(distance) + " from speed " +
                       std::to_string(from_speed) + " to " + std::to_string(to_speed));
  plan_->duration = plan_->trajectory.get_duration();
}

LineProfile::~LineProfile() = default;
LineProfile::LineProfile(LineProfile&&) noexcept = default;

double LineProfile::duration() const { return plan_->duration; }

std::array<double, 4> LineProfile::at(double time) const {
  if (time <= 0.0 && plan_->duration <= 0.0) return {0.0, plan_->from, 0.0, 0.0};
  if (time > plan_->duration) return {plan_->distance, plan_->to, 0.0, 0.0};
  std::array<double, 1> position{}, velocity{}, acceleration{}, jerk{};
  std::size_t section = 0;
  plan_->trajectory.at_time(std::max(0.0, time), position, velocity, acceleration, jerk, section);
  return {position[0], velocity[0], acceleration[0], time < 0.0 ? 0.0 : jerk[0]};
}

double LineProfile::shortest(double from_speed, double to_speed, const LineLimits& limits) {
  const double change = std::abs(to_speed - from_speed), a = limits.acceleration, j = limits.jerk;
  const double time = change * j >= a * a ? change / a + a / j : 2.0 * std::sqrt(change / j);
  return 0.5 * (from_speed + to_speed) * time;
}

double LineProfile::fastest(double from_speed, double distance, const LineLimits& limits) {
  check(limits);
  double low = std::min(from_speed, limits.velocity), high = limits.velocity;
  if (shortest(from_speed, high, limits) <= distance) return high;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (shortest(from_speed, middle, limits) <= distance ? low : high) = middle;
  }
  return std::max(std::min(from_speed, limits.velocity), low * (1.0 - kShy));
}

}  // namespace rcs
