// How fast to go along a line: the quickest way from one speed to another over a distance, at limited acceleration and
// jerk.
#pragma once

#include <array>
#include <memory>

namespace rcs {

/// Limits of a motion along a line, whose unit is that of the distance.
struct LineLimits {
  double velocity, acceleration, jerk;
};

/// The quickest motion over a distance from speed to speed, without acceleration at either end (Ruckig: Berscheid and
/// Kröger, "Jerk-limited real-time trajectory generation with arbitrary target states", 2021).
class LineProfile {
 public:
  /// Throws `InvalidSetup` for limits that are not positive, speeds outside 0 … velocity, a distance below 0, or one
  /// too short to get from speed to speed.
  LineProfile(double distance, double from_speed, double to_speed, const LineLimits& limits);
  ~LineProfile();
  LineProfile(LineProfile&&) noexcept;

  double duration() const;  ///< s
  /// Way, velocity, acceleration and jerk at a time [s] after the start; before and after, those of the ends.
  std::array<double, 4> at(double time) const;

  /// The shortest distance over which one speed becomes the other.
  static double shortest(double from_speed, double to_speed, const LineLimits& limits);
  /// The highest speed up to `limits.velocity` that can be reached from a speed over a distance.
  static double fastest(double from_speed, double distance, const LineLimits& limits);

 private:
  struct Plan;
  std::unique_ptr<Plan> plan_;
};

}  // namespace rcs
