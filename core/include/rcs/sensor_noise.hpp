// Errors of cameras: of colour sensors, and of stereo depth.
#pragma once

#include <cstdint>
#include <span>

namespace rcs {

/// Add noise to colours, in place.
/// `table` has the errors of 256 equally likely cases, `seed` determines which ones come.
void add_colour_noise(std::span<std::uint8_t> rgb, std::span<const std::int8_t> table, std::uint64_t seed);

/// How a stereo camera sees one picture. Its left eye is where the picture is taken from.
struct StereoEyes {
  double focal = 0;       ///< pixels
  double middle = 0;      ///< column of the principal point
  double baseline = 0;    ///< m, from the left eye to the right one
  double half_width = 0;  ///< tangent of half the right eye's field of view along x; 0 for no end
  double nearest = 0;     ///< m, of what can be measured
  double deviation = 0;   ///< pixels, of a disparity
  double steepest = 0;    ///< tangent of the angle between view and normal from which a surface is steep
  double steep_loss = 0;  ///< share of steep pixels without a reading
  double dark = 0;        ///< brightness below which readings get lost
};

/// Replace true depth by what the camera would measure, in place; 0 is no reading.
/// `depth_mm` is height × width, `rgb` height × width × 3. `normal` has quantiles of the standard normal distribution,
/// as many as a power of two, of equally likely cases; `seed` determines which ones come.
void measure_stereo(std::span<std::uint16_t> depth_mm, std::span<const std::uint8_t> rgb, int width,
                    const StereoEyes& eyes, std::span<const float> normal, std::uint64_t seed);

}  // namespace rcs
