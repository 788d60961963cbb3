// Draws the geoms of a scene without OpenGL: for small pictures, of which a driver takes its time per geom, not per
// pixel. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "mesh_shapes.hpp"

// Loops over vertices and pixels are compiled for vectors of eight, too, and the processor decides when the library is
// loaded. The bits are the same: neither way contracts a product and a sum.
#if defined(__x86_64__) && defined(__ELF__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define RCS_WIDE_VECTORS __attribute__((target_clones("avx2", "default")))
#else
#define RCS_WIDE_VECTORS
#endif

namespace rcs {

/// The picture that is drawn, rows from the top.
struct Sheet {
  int width = 0;
  int height = 0;
  std::vector<std::uint32_t> colours{};  ///< red in the lowest byte, then green and blue
  std::vector<float> nearness{};         ///< reciprocal distance along the optical axis [1/m], 0 where nothing is

  void clear(int new_width, int new_height);
};

/// The view of what never moves by a camera that stands still: kept as long as it stays the same.
struct Backdrop {
  std::vector<mjvGeom> geoms{};
  std::vector<mjvLight> lights{};
  mjvGLCamera eye{};
  Sheet sheet{};
};

/// Draws as MuJoCo's OpenGL does at quality `fast`: light is computed at the corners of triangles and mixed between
/// them; no textures, no shadows. Only rounding differs: edges of shapes by less than a pixel, colours by a few parts
/// in 255.
class Rasteriser {
 public:
  explicit Rasteriser(const mjModel* model, Roundness round = {});

  /// Draw the scene's geoms as `eye` sees them. The sheet is cleared before. With a backdrop, what never moves is drawn
  /// first, or taken from there.
  void draw(const mjvScene& scene, const mjvGLCamera& eye, Sheet& sheet, Backdrop* backdrop = nullptr);

  /// The part of a model that cannot be drawn, for a message; empty if all can.
  static std::string why_not(const mjModel& model, std::span<const bool> groups);

 private:
  /// Arrays of vertices, as long as the longest shape.
  struct Vertices {
    std::vector<float> x, y, z;      // in the camera's frame [m]: right, down, forward
    std::vector<float> column, row;  // on the sheet [pixels]
    std::vector<float> nearness;     // 1 / z
    std::vector<float> red, green, blue;
    void resize(std::size_t size);
  };
  struct Corner {
    float column, row, nearness, red, green, blue;
  };
  struct Light {
    bool is_everywhere;               // directional
    float position[3], direction[3];  // in the camera's frame; the direction points to the light
    float attenuation[3];
    float cutoff;  // cosine; -1 for none
    float exponent;
    float ambient[3], diffuse[3], specular[3];
  };
  struct View {  // from the camera's frame to the sheet
    float axes[3][3];
    double position[3];
    float column_scale, column_shift, row_scale, row_shift;
    float near, far;
  };

  void place_lights(const mjvScene& scene);
  void draw_all(std::span<const mjvGeom* const> geoms, Sheet& sheet);
  void draw_geom(const mjvGeom& geom, Sheet& sheet);
  void draw_shape(const Shape& shape, const mjvGeom& geom, const float* scale, const float* shift, Sheet& sheet);
  void shade(const mjvGeom& geom, const Shape& shape, const float (&turned)[3][3], const float* scale);
  void draw_triangle(const Corner (&corners)[3], float alpha, Sheet& sheet) const;
  void draw_clipped(const std::uint32_t* corners, float alpha, Sheet& sheet) const;
  Corner project(const float* place, const float* colour) const;

  static constexpr float kGuard = 4;  // sheets to each side of the sheet that need no clipping

  std::vector<Shape> meshes_;  // of the model, filled when first drawn
  const mjModel* model_;
  Shape box_, plane_, ball_, cylinder_, tube_, cap_, cup_;
  View view_{};
  std::vector<Light> lights_;
  float unlit_ = 0;  // share of its colour that everything has by itself
  Vertices vertices_;
  std::vector<std::uint32_t> used_;  // vertices of visible triangles
  std::vector<std::uint8_t> is_used_;
  std::vector<std::uint32_t> visible_;  // first corners of visible triangles
  std::vector<const mjvGeom*> still_, moving_, transparent_;
  struct Lit {
    std::vector<float> x, y, z, nx, ny, nz, red, green, blue;
    void resize(std::size_t size);
  } lit_;
};

}  // namespace rcs
