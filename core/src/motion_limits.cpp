#include <string>

#include "braking.hpp"
#include "rcs/result.hpp"
#include "rcs/trajectory.hpp"

namespace rcs {

namespace {

// Targets may lead by what an arm needs to stop at this share of its acceleration, so that an arm that spares torque is
// not slowed down.
constexpr double kSparing = 0.5;

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

}  // namespace rcs
