#include "pixels.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rcs {

void flip_rows(std::uint8_t* image, int row, int rows) {
  std::vector<std::uint8_t> spare(static_cast<std::size_t>(row));
  for (int y = 0; y < rows / 2; ++y) {
    std::uint8_t* upper = image + static_cast<std::ptrdiff_t>(row) * y;
    std::uint8_t* lower = image + static_cast<std::ptrdiff_t>(row) * (rows - 1 - y);
    std::memcpy(spare.data(), upper, spare.size());
    std::memcpy(upper, lower, spare.size());
    std::memcpy(lower, spare.data(), spare.size());
  }
}

// The buffer is linear in the reciprocal distance. Rounding in single precision is below 0.01 mm at 65 m.
void to_millimetres(const Canvas& canvas, const mjvGLCamera& camera, std::uint16_t* out) {
  const float near = 1000 * camera.frustum_near, far = 1000 * camera.frustum_far;
  const auto convert = [&](auto distance) {
    for (int y = 0; y < canvas.height; ++y) {
      const float* row = canvas.depth.data() + canvas.at(0, y);
      std::uint16_t* line = out + static_cast<std::size_t>(y) * canvas.width;
      for (int x = 0; x < canvas.width; ++x) {
        const float rounded = row[x] > 0 ? distance(row[x]) + 0.5F : 0.0F;
        line[x] = static_cast<std::uint16_t>(static_cast<int>(rounded < 65536.0F ? rounded : 0.0F));
      }
    }
  };
  if (camera.orthographic)
    convert([=](float depth) { return far - depth * (far - near); });
  else
    convert([=](float depth) { return near * far / (near + depth * (far - near)); });
}

void to_ids(const Canvas& canvas, std::uint16_t* out) {
  for (int y = 0; y < canvas.height; ++y) {
    const std::uint8_t* row = canvas.codes.data() + 3 * canvas.at(0, y);
    std::uint16_t* line = out + static_cast<std::size_t>(y) * canvas.width;
    for (int x = 0; x < canvas.width; ++x) line[x] = static_cast<std::uint16_t>(row[3 * x] | row[3 * x + 1] << 8);
  }
}

void look_up(const std::uint8_t* canvas, const Lens& lens, int width, int height, std::uint8_t* out) {
  const std::size_t size = static_cast<std::size_t>(width) * height;
  for (std::size_t i = 0; i < size; ++i) {
    // In this order, so that NaN becomes 0.
    const float x = std::min(std::max(0.0F, lens.lookup[2 * i]), static_cast<float>(lens.width - 1));
    const float y = std::min(std::max(0.0F, lens.lookup[2 * i + 1]), static_cast<float>(lens.height - 1));
    const int left = static_cast<int>(x), top = static_cast<int>(y);
    const float right_part = x - static_cast<float>(left), lower_part = y - static_cast<float>(top);
    const std::uint8_t* corner = canvas + 3 * (static_cast<std::size_t>(top) * lens.width + left);
    const std::size_t right = left + 1 < lens.width ? 3 : 0;
    const std::size_t below = top + 1 < lens.height ? 3 * static_cast<std::size_t>(lens.width) : 0;
    for (int channel = 0; channel < 3; ++channel) {
      const std::uint8_t* pixel = corner + channel;
      const float upper =
          static_cast<float>(pixel[0]) * (1 - right_part) + static_cast<float>(pixel[right]) * right_part;
      const float lower =
          static_cast<float>(pixel[below]) * (1 - right_part) + static_cast<float>(pixel[below + right]) * right_part;
      out[3 * i + channel] = static_cast<std::uint8_t>(upper * (1 - lower_part) + lower * lower_part + 0.5F);
    }
  }
}

void look_up(const std::uint16_t* canvas, const Lens& lens, int width, int height, std::uint16_t* out) {
  const std::size_t size = static_cast<std::size_t>(width) * height;
  for (std::size_t i = 0; i < size; ++i) {
    const int x = std::clamp(static_cast<int>(std::lround(lens.lookup[2 * i])), 0, lens.width - 1);
    const int y = std::clamp(static_cast<int>(std::lround(lens.lookup[2 * i + 1])), 0, lens.height - 1);
    out[i] = canvas[static_cast<std::size_t>(y) * lens.width + x];
  }
}

}  // namespace rcs
