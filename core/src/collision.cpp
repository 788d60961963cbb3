#include "rcs/collision.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

CollisionReaction::CollisionReaction(ArmBody arm, CollisionLimits limits, int copies)
    : arm_(std::move(arm)), limits_(std::move(limits)) {
  if (copies < 1) throw InvalidSetup("CollisionReaction: copies must be at least 1, not " + std::to_string(copies));
  if (limits_.torques.size() != static_cast<std::size_t>(arm_.dof()))
    throw InvalidSetup("CollisionReaction: there are " + std::to_string(limits_.torques.size()) +
                       " limits of torques for " + std::to_string(arm_.dof()) + " joints");
  for (std::size_t i = 0; i < size(); ++i)
    if (!(limit(i) > 0.0)) throw InvalidSetup("CollisionReaction: every limit must be above 0");
  if (!(limits_.time_constant >= 0.0 && limits_.duration >= 0.0))
    throw InvalidSetup("CollisionReaction: the time constant and the duration must be at least 0");
  if (limits_.time_constant > 0.0) share_ = -std::expm1(-arm_.timestep() / limits_.time_constant);
  memory_.resize(static_cast<std::size_t>(copies) * width());
  for (int copy = 0; copy < copies; ++copy) reset(copy);
}

void CollisionReaction::check(const mjModel* model, int copies) const {
  arm_.check(model);
  if (memory_.size() < static_cast<std::size_t>(copies) * width())
    throw InvalidSetup("CollisionReaction: it was made for " + std::to_string(memory_.size() / width()) +
                       " copies, the world has " + std::to_string(copies));
}

std::span<double> CollisionReaction::memory(int copy) {
  return std::span(memory_).subspan(static_cast<std::size_t>(copy) * width(), width());
}

void CollisionReaction::reset(int copy) {
  const std::span<double> own = memory(copy);
  std::ranges::fill(own, 0.0);
  own[2 * size()] = -1.0;
}

CollisionReaction::Cause CollisionReaction::cause(int copy) const {
  const auto copies = memory_.size() / width();
  if (copy < 0 || static_cast<std::size_t>(copy) >= copies)
    throw InvalidSetup("CollisionReaction: there is no copy " + std::to_string(copy) + ", valid is 0 to " +
                       std::to_string(copies - 1));
  const double* own = memory_.data() + static_cast<std::size_t>(copy) * width() + 2 * size();
  return {static_cast<int>(own[0]), own[1]};
}

bool CollisionReaction::call(const StepView& view) {
  const std::size_t n = size(), dof = limits_.torques.size();
  const std::span<double> own = memory(view.copy);
  double loads[ArmBody::kMostJoints + 6], on_tool[6];
  const std::span<double> torques(loads, dof);
  const bool is_pressed = arm_.outer_loads(view.model, view.data, torques, std::span<double, 6>(on_tool),
                                           std::span<double, 6>(loads + dof, 6));
  // Most of the time nothing touches the arm. Its observer forgets what has become less than it could tell from 0.
  if (limits_.is_of_drives)
    arm_.drive_torques(view.model, view.data, torques);
  else if (!is_pressed && own[2 * n + 2] == 0.0)
    return false;
  const double step = view.model->opt.timestep;
  bool is_collision = false;
  double largest = 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    double& load = own[i];
    double& above = own[n + i];
    load += share_ * (loads[i] - load);
    largest = std::max(largest, std::abs(load) / limit(i));
    if (std::abs(load) <= limit(i)) {
      above = 0.0;
      continue;
    }
    above += step;
    if (above < limits_.duration) continue;
    if (!is_collision) {
      own[2 * n] = static_cast<double>(i);
      own[2 * n + 1] = load;
    }
    is_collision = true;
  }
  constexpr double kNothing = 1e-9;  // of a limit
  own[2 * n + 2] = is_pressed || largest > kNothing ? 1.0 : 0.0;
  if (own[2 * n + 2] == 0.0) std::ranges::fill(own.first(2 * n), 0.0);
  return is_collision;
}

}  // namespace rcs
