#include "rcs/collision.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

constexpr std::size_t kMostLoads = 64;  // kept on the stack of each step

}  // namespace

CollisionReaction::CollisionReaction(ArmBody arm, CollisionLimits limits, int copies)
    : arm_(std::move(arm)), limits_(std::move(limits)) {
  if (copies < 1) throw InvalidSetup("CollisionReaction: copies must be at least 1, not " + std::to_string(copies));
  if (limits_.torques.size() != static_cast<std::size_t>(arm_.dof()))
    throw InvalidSetup("CollisionReaction: there are " + std::to_string(limits_.torques.size()) +
                       " limits of torques for " + std::to_string(arm_.dof()) + " joints");
  if (size() > kMostLoads) throw InvalidSetup("CollisionReaction: an arm has at most 58 joints");
  for (std::size_t i = 0; i < size(); ++i)
    if (!(limit(i) > 0.0)) throw InvalidSetup("CollisionReaction: every limit must be above 0");
  if (!(limits_.time_constant >= 0.0 && limits_.duration >= 0.0))
    throw InvalidSetup("CollisionReaction: the time constant and the duration must be at least 0");
  memory_.resize(static_cast<std::size_t>(copies) * (2 * size() + 2));
  for (int copy = 0; copy < copies; ++copy) reset(copy);
}

void CollisionReaction::check(const mjModel* model, int copies) const {
  arm_.check(model);
  if (memory_.size() < static_cast<std::size_t>(copies) * (2 * size() + 2))
    throw InvalidSetup("CollisionReaction: it was made for " + std::to_string(memory_.size() / (2 * size() + 2)) +
                       " copies, the world has " + std::to_string(copies));
}

std::span<double> CollisionReaction::memory(int copy) {
  return std::span(memory_).subspan(static_cast<std::size_t>(copy) * (2 * size() + 2), 2 * size() + 2);
}

void CollisionReaction::reset(int copy) {
  const std::span<double> own = memory(copy);
  std::ranges::fill(own, 0.0);
  own[2 * size()] = -1.0;
}

CollisionReaction::Cause CollisionReaction::cause(int copy) const {
  const double* own = memory_.data() + static_cast<std::size_t>(copy) * (2 * size() + 2) + 2 * size();
  return {static_cast<int>(own[0]), own[1]};
}

bool CollisionReaction::call(const StepView& view) {
  const std::size_t n = size(), dof = limits_.torques.size();
  const std::span<double> own = memory(view.copy);
  double loads[kMostLoads], on_tool[6];
  const std::span<double> torques(loads, dof);
  arm_.outer_loads(view.model, view.data, torques, std::span<double, 6>(on_tool), std::span<double, 6>(loads + dof, 6));
  if (limits_.is_of_drives) arm_.drive_torques(view.model, view.data, torques);
  const double step = view.model->opt.timestep;
  const double share = limits_.time_constant > 0.0 ? -std::expm1(-step / limits_.time_constant) : 1.0;
  bool is_collision = false;
  for (std::size_t i = 0; i < n; ++i) {
    double& load = own[i];
    double& above = own[n + i];
    load += share * (loads[i] - load);
    above = std::abs(load) > limit(i) ? above + step : 0.0;
    if (above == 0.0 || above < limits_.duration) continue;
    if (!is_collision) {
      own[2 * n] = static_cast<double>(i);
      own[2 * n + 1] = load;
    }
    is_collision = true;
  }
  return is_collision;
}

}  // namespace rcs
