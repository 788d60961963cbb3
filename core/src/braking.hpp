// Time and way of a joint that changes its speed at limited acceleration and jerk, and how soon a stream is met.
#pragma once

#include <cmath>

namespace rcs {

// Steps within which a stream of targets is met. Only the first is made before the next target comes: what a noisy
// target asks for is met in part, at a fraction of the acceleration.
inline constexpr double kHorizon = 2.0;

// Time [s] from one speed to another, `change` apart, at limited acceleration and jerk.
inline double changing_time(double change, double acceleration, double jerk) {
  return change * jerk >= acceleration * acceleration ? change / acceleration + acceleration / jerk
                                                      : 2.0 * std::sqrt(change / jerk);
}

// Way [rad] to a stop from a speed: half of what the speed makes in that time.
inline double braking_distance(double speed, double acceleration, double jerk) {
  return 0.5 * speed * changing_time(speed, acceleration, jerk);
}

// The speed whose braking distance is `distance`.
inline double braking_speed(double distance, double acceleration, double jerk) {
  if (distance <= 0.0) return 0.0;
  const double lag = acceleration / jerk;
  const double speed = 0.5 * acceleration * (std::sqrt(lag * lag + 8.0 * distance / acceleration) - lag);
  return speed * jerk >= acceleration * acceleration ? speed : std::cbrt(distance * distance * jerk);
}

// Way [rad] to a stop from a speed that changes: what gaining it needs besides, or what has been braked already.
inline double stopping_distance(double speed, double acceleration, double most, double jerk) {
  const double time = std::abs(acceleration) / jerk;
  const double peak = speed + 0.5 * acceleration * acceleration / jerk;
  if (acceleration >= 0.0)
    return (speed + (0.5 * acceleration - jerk * time / 6.0) * time) * time + braking_distance(peak, most, jerk);
  return braking_distance(peak, most, jerk) - (peak - jerk * time * time / 6.0) * time;
}

}  // namespace rcs
