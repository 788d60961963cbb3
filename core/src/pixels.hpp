// From OpenGL's buffers to the arrays of a picture. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

#include "rcs/lens.hpp"

namespace rcs {

/// A drawn picture, in OpenGL's order: the first row is the bottom one.
struct Canvas {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgb{};
  std::vector<float> depth{};         ///< 1 at the near plane, 0 at the far one and where nothing is
  std::vector<std::uint8_t> codes{};  ///< × 3: ids of what is seen as colours, red the lowest byte

  std::size_t size() const { return static_cast<std::size_t>(width) * height; }
  std::size_t at(int x, int y) const { return static_cast<std::size_t>(height - 1 - y) * width + x; }  // y from the top
};

/// Turn the rows of a picture around, in place. `row` is the length of a row in bytes.
void flip_rows(std::uint8_t* image, int row, int rows);

/// Fill `out` (height × width of the canvas, from the top) with millimetres, 0 where nothing is or beyond 65.535 m.
void to_millimetres(const Canvas& canvas, const mjvGLCamera& camera, std::uint16_t* out);

/// Fill `out` (height × width of the canvas, from the top) with ids.
void to_ids(const Canvas& canvas, std::uint16_t* out);

/// Look a picture's colours up between the four nearest pixels of a canvas. `canvas` and `out` have their rows from the
/// top.
void look_up(const std::uint8_t* canvas, const Lens& lens, int width, int height, std::uint8_t* out);

/// The same for values that must not be mixed: that of the nearest pixel.
void look_up(const std::uint16_t* canvas, const Lens& lens, int width, int height, std::uint16_t* out);

}  // namespace rcs
