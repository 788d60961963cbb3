#include "rcs/rows.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "rcs/result.hpp"

namespace rcs {

template <typename T>
bool clip_rows(std::span<const T> values, std::span<const T> lower, std::span<const T> upper, double tolerance,
               std::span<T> clipped) {
  const std::size_t width = lower.size();
  const T slack = static_cast<T>(tolerance);
  for (std::size_t i = 0, c = 0; i < values.size(); ++i, c = c + 1 == width ? 0 : c + 1) {
    const T value = values[i];
    // Written so that NaN, for which every comparison is false, is refused.
    if (!(value >= lower[c] - slack && value <= upper[c] + slack)) return false;
    clipped[i] = std::min(std::max(value, lower[c]), upper[c]);
  }
  return true;
}

template bool clip_rows<double>(std::span<const double>, std::span<const double>, std::span<const double>, double,
                                std::span<double>);
template bool clip_rows<float>(std::span<const float>, std::span<const float>, std::span<const float>, double,
                               std::span<float>);

bool limit_rows(std::span<const double> asked, std::span<const double> last, std::span<const double> measured,
                const StepLimits& limits, double rounding, std::span<double> target, std::span<bool> is_cut) {
  const auto& [max_step, max_lead, lower, upper, max_return] = limits;
  const std::size_t width = max_step.size();
  // Written so that NaN, for which every comparison is false, is refused.
  for (const double step : max_step)
    if (!(step >= 0.0))
      throw InvalidSetup("limit_rows: max_step must not be negative or NaN, one is " + std::to_string(step));
  for (const double lead : max_lead)
    if (!(lead >= 0.0))
      throw InvalidSetup("limit_rows: max_lead must not be negative or NaN, one is " + std::to_string(lead));
  if (!(max_return > 0.0))
    throw InvalidSetup("limit_rows: max_return must be positive, it is " + std::to_string(max_return));
  bool is_any = false;
  for (std::size_t row = 0; row < is_cut.size(); ++row) {
    // From where the last target is: or as far back towards the measured joint as it is asked for, which takes no
    // limit; or where it has to go first when the arm was pushed away: within the lead again, or as far towards it as a
    // step goes. From there, all joints go the same share of the way, so that the path is not bent.
    double share = 1.0;
    for (std::size_t c = 0; c < width; ++c) {
      const std::size_t i = row * width + c;
      const bool is_outside = last[i] < lower[c] || last[i] > upper[c];
      const double step = is_outside ? std::min(max_step[c], max_return) : max_step[c];
      const bool is_pushed = std::abs(measured[i] - last[i]) > max_lead[c] + max_step[c];
      const double back = std::clamp(asked[i], std::min(last[i], measured[i]), std::max(last[i], measured[i]));
      const double held = std::clamp(last[i], measured[i] - max_lead[c], measured[i] + max_lead[c]);
      const double base = is_pushed                                                     ? last[i]
                          : std::abs(back - measured[i]) < std::abs(held - measured[i]) ? back
                                                                                        : held;
      const double low = std::max(base - step, measured[i] - max_lead[c]);
      const double high = std::min(base + step, measured[i] + max_lead[c]);
      const double from = is_pushed ? std::clamp(measured[i], last[i] - max_step[c], last[i] + max_step[c]) : base;
      target[i] = from;
      const double way = asked[i] - from;
      if (std::abs(way) <= rounding) continue;
      const double room = is_pushed ? 0.0 : way > 0.0 ? high - from : from - low;
      share = std::min(share, std::max(room, 0.0) / std::abs(way));
    }
    bool is_row = false;
    for (std::size_t c = 0; c < width; ++c) {
      const std::size_t i = row * width + c;
      target[i] = share < 1.0 ? target[i] + share * (asked[i] - target[i]) : asked[i];
      is_row = is_row || std::abs(target[i] - asked[i]) > rounding;
    }
    // A row that counts as not cut keeps its bits, always: a copy must not depend on what happens to another.
    if (!is_row) std::copy_n(asked.begin() + row * width, width, target.begin() + row * width);
    is_cut[row] = is_row;
    is_any = is_any || is_row;
  }
  return is_any;
}

}  // namespace rcs
