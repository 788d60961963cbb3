// Checks and limits on rows of numbers: one row per copy of an environment, in the time that numpy needs to start.
#pragma once

#include <cstddef>
#include <span>

namespace rcs {

/// Write `values` to `clipped`, each cut to its bounds; return false, with `clipped` unusable, if one is not finite or
/// farther out than `tolerance`. Rows have the length of the bounds.
template <typename T>
bool clip_rows(std::span<const T> values, std::span<const T> lower, std::span<const T> upper, double tolerance,
               std::span<T> clipped);

/// The bounds of the targets of joints, one value per joint.
struct StepLimits {
  std::span<const double> max_step;  ///< rad
  std::span<const double> max_lead;  ///< rad
  std::span<const double> lower;     ///< rad
  std::span<const double> upper;     ///< rad
  double max_return;                 ///< rad, in place of `max_step` for a joint whose last target is out of its range
};

/// Cut `asked` to at most `max_step` from `last` and `max_lead` from `measured`: all joints of a row go the same share
/// of the way from `last`. A joint that was pushed out of its lead goes back towards it first, by a step at most; one
/// that is asked for less of its lead, or for the other side of the measured joint, drops it at once.
///
/// Rows have the length of the limits; `is_cut` has one flag per row, for changes above `rounding`. Returns whether any
/// is set. Throws `InvalidSetup` for limits that are negative or NaN.
bool limit_rows(std::span<const double> asked, std::span<const double> last, std::span<const double> measured,
                const StepLimits& limits, double rounding, std::span<double> target, std::span<bool> is_cut);

}  // namespace rcs
