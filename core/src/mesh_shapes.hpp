// Shapes as triangles, for drawing without OpenGL. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <vector>

namespace rcs {

/// Triangles that share vertices. Seen from outside, corners go round anticlockwise.
struct Shape {
  struct Part {
    std::vector<float> x{}, y{}, z{};
  };
  Part position;
  Part normal;                         ///< of length 1
  std::vector<std::uint32_t> corners;  ///< three of each triangle

  std::size_t size() const { return position.x.size(); }
};

/// How round things are drawn, as `use_coarse_shapes` has it: corners around the axis, and from the equator to a pole.
struct Roundness {
  int slices = 12;
  int stacks = 3;
};

/// The cube from -1 to 1.
Shape box_shape();
/// The square from -1 to 1 at z = 0 that faces up, in `squares` × `squares` squares.
Shape plane_shape(int squares);
/// The ball of radius 1.
Shape ball_shape(Roundness round);
/// The cylinder of radius 1 from z = -1 to 1; without lids it is what a capsule has between its ends.
Shape cylinder_shape(Roundness round, bool has_lids);
/// The upper (`side` 1) or lower (-1) half of the ball of radius 1.
Shape half_ball_shape(Roundness round, int side);
/// A mesh of a model.
Shape mesh_shape(const mjModel& model, int mesh);

}  // namespace rcs
