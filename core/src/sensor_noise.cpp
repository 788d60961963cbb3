#include "rcs/sensor_noise.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

namespace rcs {

namespace {

constexpr float kFarthest = 65.535F;  // m, what 16 bits of millimetres can tell

// The number of a counter-based generator: SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number
// generators", 2014).
std::uint64_t random_bits(std::uint64_t seed, std::uint64_t number) {
  std::uint64_t z = seed + (number + 1) * 0x9E3779B97F4A7C15ULL;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return z ^ (z >> 31);
}

/// One row of the left eye's picture.
class Row {
 public:
  explicit Row(int width)
      : width_(width), disparity_(width), hidden_(width), nearest_(2 * static_cast<std::size_t>(width) + 1) {}

  // Find which pixels the right eye does not see, as something nearer is before them.
  void look(const std::uint16_t* depth_mm, float product) {
    std::fill(nearest_.begin(), nearest_.end(), 0.0F);
    for (int x = 0; x < width_; ++x) {
      // A pixel without depth counts as the farthest.
      disparity_[x] = product / (depth_mm[x] > 0 ? 1e-3F * static_cast<float>(depth_mm[x]) : kFarthest);
      float* place = &nearest_[place_of(x)];
      // In two columns: a surface has no gaps where its pixels are more than a column apart.
      place[0] = std::max(place[0], disparity_[x]);
      place[1] = std::max(place[1], disparity_[x]);
    }
    // Neighbours on one surface differ by less than a pixel, or the right eye does not see it.
    for (int x = 0; x < width_; ++x) hidden_[x] = nearest_[place_of(x)] > disparity_[x] + 1.0F;
  }

  float disparity(int x) const { return disparity_[x]; }
  float in_right(int x) const { return static_cast<float>(x) - disparity_[x]; }
  bool is_hidden(int x) const { return hidden_[x] != 0; }

 private:
  // A point farther out than a picture's width is in neither picture.
  std::size_t place_of(int x) const {
    const float column = std::max(in_right(x), -static_cast<float>(width_));
    return static_cast<std::size_t>(column + static_cast<float>(width_));
  }

  int width_;
  std::vector<float> disparity_;
  std::vector<char> hidden_;
  std::vector<float> nearest_;
};

// Which pixels are beside an edge or on a surface that is seen at a grazing angle.
std::vector<char> steep_pixels(std::span<const std::uint16_t> depth_mm, std::size_t width, float per_depth) {
  std::vector<char> steep(depth_mm.size());
  const auto compare = [&](std::size_t i, std::size_t j) {
    const int a = depth_mm[i], b = depth_mm[j];
    if (static_cast<float>(std::abs(a - b)) > per_depth * static_cast<float>(std::min(a, b))) steep[i] = steep[j] = 1;
  };
  for (std::size_t i = 0; i < depth_mm.size(); ++i) {
    if ((i + 1) % width != 0) compare(i, i + 1);
    if (i + width < depth_mm.size()) compare(i, i + width);
  }
  return steep;
}

}  // namespace

void add_colour_noise(std::span<std::uint8_t> rgb, std::span<const std::int8_t> table, std::uint64_t seed) {
  if (table.size() != 256) throw std::invalid_argument("colour noise: the table must have 256 errors");
  for (std::size_t i = 0; i < rgb.size(); i += 8) {
    std::uint64_t bits = random_bits(seed, i / 8);
    const std::size_t end = std::min(i + 8, rgb.size());
    for (std::size_t j = i; j < end; ++j, bits >>= 8)
      rgb[j] = static_cast<std::uint8_t>(std::clamp(rgb[j] + table[bits & 0xFF], 0, 255));
  }
}

void measure_stereo(std::span<std::uint16_t> depth_mm, std::span<const std::uint8_t> rgb, int width,
                    const StereoEyes& eyes, std::span<const float> normal, std::uint64_t seed) {
  if (width < 1 || depth_mm.size() % static_cast<std::size_t>(width) != 0 || rgb.size() != 3 * depth_mm.size())
    throw std::invalid_argument("stereo: depth and rgb must be of one size");
  if (normal.empty() || (normal.size() & (normal.size() - 1)) != 0)
    throw std::invalid_argument("stereo: the number of quantiles must be a power of two");
  const auto focal = static_cast<float>(eyes.focal), product = static_cast<float>(eyes.focal * eyes.baseline);
  const auto nearest = static_cast<float>(eyes.nearest), deviation = static_cast<float>(eyes.deviation);
  const auto steep_loss = static_cast<float>(eyes.steep_loss), dark = static_cast<float>(eyes.dark);
  const float first_column =
      eyes.half_width > 0 ? static_cast<float>(eyes.middle - eyes.focal * eyes.half_width) : -HUGE_VALF;
  const std::vector<char> steep =
      steep_pixels(depth_mm, static_cast<std::size_t>(width), static_cast<float>(eyes.steepest) / focal);
  Row row(width);
  for (std::size_t first = 0; first < depth_mm.size(); first += static_cast<std::size_t>(width)) {
    row.look(&depth_mm[first], product);
    for (int x = 0; x < width; ++x) {
      const std::size_t i = first + static_cast<std::size_t>(x);
      const std::uint64_t bits = random_bits(seed, i);
      const float chance = static_cast<float>(bits >> 40) * 0x1p-24F;
      const std::uint8_t* colour = &rgb[3 * i];
      const auto brightness = static_cast<float>(std::max({colour[0], colour[1], colour[2]}));
      const bool is_lost = row.is_hidden(x) || row.in_right(x) < first_column || brightness < dark * chance ||
                           (steep[i] != 0 && chance < steep_loss);
      const float depth = 1e-3F * static_cast<float>(depth_mm[i]);
      const float error = deviation * normal[bits & (normal.size() - 1)];
      const float measured = depth + depth * error / row.disparity(x);
      const bool is_valid = depth > 0 && !is_lost && measured >= nearest && measured <= kFarthest;
      depth_mm[i] = is_valid ? static_cast<std::uint16_t>(1000 * measured + 0.5F) : std::uint16_t{0};
    }
  }
}

}  // namespace rcs
