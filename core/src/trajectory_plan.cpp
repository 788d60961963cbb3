#include "trajectory_plan.hpp"

#include <algorithm>
#include <cmath>

namespace rcs {

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

}  // namespace rcs
