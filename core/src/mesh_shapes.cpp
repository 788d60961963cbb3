#include "mesh_shapes.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace rcs {

namespace {

// Cosine of the angle between the normals of a corner and its face from which the corner counts as part of a smooth
// surface, as in MuJoCo's renderer.
constexpr double kSmooth = 0.8;

// Radius of a polygon's corners at which its sides are as far inside the unit circle as its corners are outside.
double outset(int corners) { return 2 / (1 + std::cos(mjPI / corners)); }

std::uint32_t add(Shape& shape, const double (&position)[3], const double (&normal)[3]) {
  shape.position.x.push_back(static_cast<float>(position[0]));
  shape.position.y.push_back(static_cast<float>(position[1]));
  shape.position.z.push_back(static_cast<float>(position[2]));
  const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
  const double scale = length > 0 ? 1 / length : 0;
  shape.normal.x.push_back(static_cast<float>(normal[0] * scale));
  shape.normal.y.push_back(static_cast<float>(normal[1] * scale));
  shape.normal.z.push_back(static_cast<float>(normal[2] * scale));
  return static_cast<std::uint32_t>(shape.size() - 1);
}

void triangle(Shape& shape, std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  shape.corners.insert(shape.corners.end(), {a, b, c});
}

void add_half_ball(Shape& shape, Roundness round, int side) {
  const auto [slices, stacks] = round;
  const double around = outset(slices), along = outset(4 * stacks);
  const auto first = static_cast<std::uint32_t>(shape.size());
  for (int stack = 0; stack < stacks; ++stack) {
    const double elevation = mjPI / 2 * stack / stacks, radius = std::cos(elevation);
    for (int slice = 0; slice < slices; ++slice) {
      const double azimuth = 2 * mjPI * slice / slices;
      const double x = around * radius * std::cos(azimuth), y = around * radius * std::sin(azimuth);
      const double z = side * along * std::sin(elevation);
      add(shape, {x, y, z}, {x, y, z});
    }
  }
  const std::uint32_t pole = add(shape, {0, 0, side * along}, {0, 0, static_cast<double>(side)});
  const auto at = [&](int slice, int stack) {
    return stack == stacks ? pole : first + static_cast<std::uint32_t>(stack * slices + slice % slices);
  };
  for (int stack = 0; stack < stacks; ++stack)
    for (int slice = 0; slice < slices; ++slice) {
      const int left = side > 0 ? slice : slice + 1, right = side > 0 ? slice + 1 : slice;
      triangle(shape, at(left, stack), at(right, stack), at(right, stack + 1));
      if (stack + 1 < stacks) triangle(shape, at(left, stack), at(right, stack + 1), at(left, stack + 1));
    }
}

}  // namespace

Shape box_shape() {
  Shape shape;
  for (int axis = 0; axis < 3; ++axis)
    for (const int side : {-1, 1}) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      std::uint32_t corner[4];
      for (int i = 0; i < 4; ++i) {
        double position[3] = {}, normal[3] = {};
        position[axis] = normal[axis] = side;
        position[u] = i == 1 || i == 2 ? side : -side;
        position[v] = i >= 2 ? 1 : -1;
        corner[i] = add(shape, position, normal);
      }
      triangle(shape, corner[0], corner[1], corner[2]);
      triangle(shape, corner[0], corner[2], corner[3]);
    }
  return shape;
}

Shape plane_shape(int squares) {
  Shape shape;
  for (int row = 0; row <= squares; ++row)
    for (int column = 0; column <= squares; ++column)
      add(shape, {2.0 * column / squares - 1, 2.0 * row / squares - 1, 0}, {0, 0, 1});
  const auto at = [&](int column, int row) { return static_cast<std::uint32_t>(row * (squares + 1) + column); };
  for (int row = 0; row < squares; ++row)
    for (int column = 0; column < squares; ++column) {
      triangle(shape, at(column, row), at(column + 1, row), at(column + 1, row + 1));
      triangle(shape, at(column, row), at(column + 1, row + 1), at(column, row + 1));
    }
  return shape;
}

Shape ball_shape(Roundness round) {
  Shape shape;
  add_half_ball(shape, round, 1);
  add_half_ball(shape, round, -1);
  return shape;
}

Shape half_ball_shape(Roundness round, int side) {
  Shape shape;
  add_half_ball(shape, round, side);
  return shape;
}

Shape cylinder_shape(Roundness round, bool has_lids) {
  const int slices = round.slices;
  const double radius = outset(slices);
  Shape shape;
  const auto ring = [&](double z, bool is_lid) {
    const auto first = static_cast<std::uint32_t>(shape.size());
    for (int slice = 0; slice < slices; ++slice) {
      const double azimuth = 2 * mjPI * slice / slices;
      const double x = radius * std::cos(azimuth), y = radius * std::sin(azimuth);
      add(shape, {x, y, z}, {is_lid ? 0 : x, is_lid ? 0 : y, is_lid ? z : 0});
    }
    return first;
  };
  const std::uint32_t lower = ring(-1, false), upper = ring(1, false);
  for (int i = 0; i < slices; ++i) {
    const auto here = static_cast<std::uint32_t>(i), next = static_cast<std::uint32_t>((i + 1) % slices);
    triangle(shape, lower + here, lower + next, upper + next);
    triangle(shape, lower + here, upper + next, upper + here);
  }
  if (!has_lids) return shape;
  const std::uint32_t floor = ring(-1, true), top = ring(1, true);
  for (int i = 1; i + 1 < slices; ++i) {
    const auto here = static_cast<std::uint32_t>(i);
    triangle(shape, top, top + here, top + here + 1);
    triangle(shape, floor, floor + here + 1, floor + here);
  }
  return shape;
}

Shape mesh_shape(const mjModel& model, int mesh) {
  Shape shape;
  // By the numbers of position and normal, or of position and face where the face's own normal is taken.
  std::map<std::tuple<int, int, bool>, std::uint32_t> known;
  const float* positions = model.mesh_vert + 3 * static_cast<std::ptrdiff_t>(model.mesh_vertadr[mesh]);
  const float* normals = model.mesh_normal + 3 * static_cast<std::ptrdiff_t>(model.mesh_normaladr[mesh]);
  const int first = model.mesh_faceadr[mesh];
  for (int face = first; face < first + model.mesh_facenum[mesh]; ++face) {
    const int* vertices = model.mesh_face + 3 * static_cast<std::ptrdiff_t>(face);
    mjtNum corner[3][3], edge[2][3], own[3];
    for (int i = 0; i < 3; ++i) mju_f2n(corner[i], positions + 3 * static_cast<std::ptrdiff_t>(vertices[i]), 3);
    mju_sub3(edge[0], corner[1], corner[0]);
    mju_sub3(edge[1], corner[2], corner[0]);
    mju_cross(own, edge[0], edge[1]);
    mju_normalize3(own);
    for (int i = 0; i < 3; ++i) {
      const int number = model.mesh_facenormal[3 * face + i];
      mjtNum normal[3];
      mju_f2n(normal, normals + 3 * static_cast<std::ptrdiff_t>(number), 3);
      const bool is_edge = mju_dot3(normal, own) < kSmooth;
      if (is_edge) mju_copy3(normal, own);
      const auto [entry, is_new] =
          known.try_emplace({vertices[i], is_edge ? face : number, is_edge}, static_cast<std::uint32_t>(shape.size()));
      if (is_new) add(shape, corner[i], normal);
      shape.corners.push_back(entry->second);
    }
  }
  return shape;
}

}  // namespace rcs
