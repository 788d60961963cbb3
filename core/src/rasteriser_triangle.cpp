// From the corners of a triangle to pixels.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "rasteriser.hpp"

namespace rcs {

namespace {

constexpr float kEdge = 1e-3F;      // pixels²: neighbours overlap by rounding, and never leave a gap
constexpr float kMostEdge = 0.05F;  // of a share: of the narrowest triangles no more
constexpr int kWide = 8;            // pixels from which a row is worth whole vectors

inline std::uint32_t packed(float red, float green, float blue) {
  const auto byte = [](float value) {
    const float scaled = value * 255.0F + 0.5F;
    const float low = scaled > 0.0F ? scaled : 0.0F;
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(low < 255.0F ? low : 255.0F));
  };
  return byte(red) | byte(green) << 8 | byte(blue) << 16;
}

inline std::uint32_t mixed(std::uint32_t over, std::uint32_t under, float alpha) {
  std::uint32_t result = 0;
  for (int shift = 0; shift < 24; shift += 8) {
    const auto a = static_cast<float>(over >> shift & 255), b = static_cast<float>(under >> shift & 255);
    result |= static_cast<std::uint32_t>(a * alpha + b * (1.0F - alpha) + 0.5F) << shift;
  }
  return result;
}

}  // namespace

Rasteriser::Corner Rasteriser::project(const float* place, const float* colour) const {
  const float nearness = 1.0F / place[2];
  return {view_.column_scale * place[0] * nearness + view_.column_shift,
          view_.row_scale * place[1] * nearness + view_.row_shift,
          nearness,
          colour[0],
          colour[1],
          colour[2]};
}

// Parts before the near plane, behind the far plane or far beside the picture are cut off (Sutherland and Hodgman,
// 1974).
void Rasteriser::draw_clipped(const std::uint32_t* corners, float alpha, Sheet& sheet) const {
  struct Point {
    float at[3], colour[3];
  };
  constexpr int kMost = 9;  // each of six planes adds one corner at most
  Point points[kMost], kept[kMost];
  int count = 3;
  for (int i = 0; i < 3; ++i) {
    const std::uint32_t n = corners[i];
    points[i] = {{vertices_.x[n], vertices_.y[n], vertices_.z[n]},
                 {vertices_.red[n], vertices_.green[n], vertices_.blue[n]}};
  }
  const float slope_x = 0.5F * static_cast<float>(sheet.width) * kGuard / view_.column_scale;
  const float slope_y = 0.5F * static_cast<float>(sheet.height) * kGuard / view_.row_scale;
  const float planes[6][4] = {{0, 0, 1, -view_.near}, {0, 0, -1, view_.far}, {1, 0, slope_x, 0},
                              {-1, 0, slope_x, 0},    {0, 1, slope_y, 0},    {0, -1, slope_y, 0}};
  for (const auto& plane : planes) {
    const auto inside = [&](const Point& p) {
      return plane[0] * p.at[0] + plane[1] * p.at[1] + plane[2] * p.at[2] + plane[3];
    };
    int found = 0;
    for (int i = 0; i < count; ++i) {
      const Point &here = points[i], &next = points[(i + 1) % count];
      const float a = inside(here), b = inside(next);
      if (a >= 0.0F) kept[found++] = here;
      if ((a >= 0.0F) != (b >= 0.0F)) {
        const float t = a / (a - b);
        Point& cut = kept[found++];
        for (int k = 0; k < 3; ++k) {
          cut.at[k] = here.at[k] + t * (next.at[k] - here.at[k]);
          cut.colour[k] = here.colour[k] + t * (next.colour[k] - here.colour[k]);
        }
      }
    }
    if (found < 3) return;
    count = found;
    std::copy_n(kept, count, points);
  }
  Corner triangle[3] = {project(points[0].at, points[0].colour), {}, {}};
  for (int i = 1; i + 1 < count; ++i) {
    triangle[1] = project(points[i].at, points[i].colour);
    triangle[2] = project(points[i + 1].at, points[i + 1].colour);
    draw_triangle(triangle, alpha, sheet);
  }
}

RCS_WIDE_VECTORS
void Rasteriser::draw_triangle(const Corner (&corners)[3], float alpha, Sheet& sheet) const {
  const Corner &a = corners[0], &b = corners[1], &c = corners[2];
  const auto first = [](float value) { return static_cast<int>(std::ceil(std::max(value - 0.5F, -1.0F))); };
  const int left = std::max(0, first(std::min({a.column, b.column, c.column})));
  const int top = std::max(0, first(std::min({a.row, b.row, c.row})));
  const auto last = [](float value, int size) {
    return static_cast<int>(std::floor(std::clamp(value - 0.5F, -1.0F, static_cast<float>(size - 1))));
  };
  const int right = last(std::max({a.column, b.column, c.column}), sheet.width);
  const int bottom = last(std::max({a.row, b.row, c.row}), sheet.height);
  if (left > right || top > bottom) return;
  const float bx = b.column - a.column, by = b.row - a.row, cx = c.column - a.column, cy = c.row - a.row;
  const float area = bx * cy - cx * by;  // negative: the row counts downwards
  if (!(area < 0.0F)) return;
  const float scale = 1.0F / area;
  // Everything is linear on the sheet: the shares of b and c, the nearness, and colours times nearness.
  const float share_b_dx = cy * scale, share_b_dy = -cx * scale, share_c_dx = -by * scale, share_c_dy = bx * scale;
  const float edge = std::min(-kEdge * scale, kMostEdge);
  struct Ramp {
    float start, dx, dy;
  };
  const auto ramp = [&](float at_a, float at_b, float at_c) {
    const float to_b = at_b - at_a, to_c = at_c - at_a;
    return Ramp{at_a, to_b * share_b_dx + to_c * share_c_dx, to_b * share_b_dy + to_c * share_c_dy};
  };
  const Ramp near = ramp(a.nearness, b.nearness, c.nearness);
  const Ramp red = ramp(a.red * a.nearness, b.red * b.nearness, c.red * c.nearness);
  const Ramp green = ramp(a.green * a.nearness, b.green * b.nearness, c.green * c.nearness);
  const Ramp blue = ramp(a.blue * a.nearness, b.blue * b.nearness, c.blue * c.nearness);
  const float origin_x = static_cast<float>(left) + 0.5F - a.column;
  const int width = right - left + 1;
  for (int y = top; y <= bottom; ++y) {
    const float dy = static_cast<float>(y) + 0.5F - a.row;
    const auto at_left = [&](const Ramp& one) { return one.start + origin_x * one.dx + dy * one.dy; };
    const float b_left = origin_x * share_b_dx + dy * share_b_dy, c_left = origin_x * share_c_dx + dy * share_c_dy;
    const float near_left = at_left(near), red_left = at_left(red), green_left = at_left(green),
                blue_left = at_left(blue);
    const std::size_t offset = static_cast<std::size_t>(y) * sheet.width + left;
    float* const nearness = sheet.nearness.data() + offset;
    std::uint32_t* const colours = sheet.colours.data() + offset;
    const auto colour = [&](float x, float here) {
      const float distance = 1.0F / here;
      return packed((red_left + x * red.dx) * distance, (green_left + x * green.dx) * distance,
                    (blue_left + x * blue.dx) * distance);
    };
    if (width < kWide || alpha < 1.0F) {
      for (int i = 0; i < width; ++i) {
        const auto x = static_cast<float>(i);
        const float share_b = b_left + x * share_b_dx, share_c = c_left + x * share_c_dx;
        const float least = std::min(1.0F - share_b - share_c, std::min(share_b, share_c));
        const float here = near_left + x * near.dx;
        if (!(least >= (alpha < 1.0F ? 0.0F : -edge) && here > nearness[i])) continue;
        if (alpha < 1.0F) {
          if (share_b == 0.0F) continue;  // the neighbour's: what two triangles share is mixed in once
          colours[i] = mixed(colour(x, here), colours[i], alpha);
        } else {
          nearness[i] = here;
          colours[i] = colour(x, here);
        }
      }
      continue;
    }
    // For a wide triangle, the part of the row that is inside; then whole vectors of pixels.
    float start = 0.0F, stop = static_cast<float>(width - 1);
    const auto cut = [&](float at_left, float dx) {  // where at_left + x dx is at least -edge
      const float bound = (-edge - at_left) / dx;
      if (dx > 0.0F)
        start = std::max(start, bound);
      else if (dx < 0.0F)
        stop = std::min(stop, bound);
      else if (at_left < -edge)
        stop = -1.0F;
    };
    cut(b_left, share_b_dx);
    cut(c_left, share_c_dx);
    cut(1.0F - b_left - c_left, -share_b_dx - share_c_dx);
    if (!(start <= stop)) continue;
    const int begin = static_cast<int>(std::ceil(start)), end = static_cast<int>(stop) + 1;
#pragma GCC ivdep
    for (int i = begin; i < end; ++i) {
      const auto x = static_cast<float>(i);
      const float here = near_left + x * near.dx;
      const float before = nearness[i];
      const std::uint32_t mask = here > before ? 0xFFFFFFFFU : 0U;  // arithmetic in place of branches
      nearness[i] = before < here ? here : before;
      colours[i] = (colour(x, here) & mask) | (colours[i] & ~mask);
    }
  }
}

}  // namespace rcs
