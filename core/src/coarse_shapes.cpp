#include "coarse_shapes.hpp"

#include <cmath>

namespace rcs {

namespace {

// The order of the shapes' display lists from `mjrContext::baseBuiltin` on, fixed by MuJoCo's src/render/classic/
// render_context.h. Only these are replaced: boxes are as coarse as they can be, and arrows are never in a picture.
enum ShapeList : unsigned { kSphere, kSphereTop, kSphereBottom, kCylinder, kOpenCylinder };
constexpr int kListCount = 8;

constexpr unsigned kCompile = 0x1300, kTriangles = 0x0004;  // OpenGL's numbers (Khronos registry)

struct Vertex {
  float position[3];
  float normal[3];
};

class Tessellator {
 public:
  Tessellator(const GlContext& gl, int slices) : slices_(slices) {
    find(new_list_, gl, "glNewList");
    find(end_list_, gl, "glEndList");
    find(begin_, gl, "glBegin");
    find(end_, gl, "glEnd");
    find(normal_, gl, "glNormal3fv");
    find(vertex_, gl, "glVertex3fv");
  }

  template <typename Draw>
  void record(unsigned list, Draw draw) {
    new_list_(list, kCompile);
    begin_(kTriangles);  // one batch per shape: each one more costs a pass through the driver
    draw();
    end_();
    end_list_();
  }

  // Rings of the unit sphere from elevation `lower` to `upper` [rad], shifted along z.
  void sphere(double lower, double upper, int stacks, float shift) {
    const auto at = [&](int slice, int stack) {
      const double elevation = lower + (upper - lower) * stack / stacks;
      const auto z = static_cast<float>(std::sin(elevation));
      const auto radius = static_cast<float>(std::cos(elevation));
      const auto [x, y] = circle(slice);
      return Vertex{{radius * x, radius * y, shift + z}, {radius * x, radius * y, z}};
    };
    for (int stack = 0; stack < stacks; ++stack) {
      const bool is_south_pole = stack == 0 && lower < -1.5;
      const bool is_north_pole = stack == stacks - 1 && upper > 1.5;
      for (int slice = 0; slice < slices_; ++slice) {
        if (!is_south_pole) triangle(at(slice, stack), at(slice + 1, stack), at(slice + 1, stack + 1));
        if (!is_north_pole) triangle(at(slice, stack), at(slice + 1, stack + 1), at(slice, stack + 1));
        if (is_south_pole && is_north_pole) return;
      }
    }
  }

  // The wall of the cylinder of radius 1 from z = -1 to 1.
  void wall() {
    const auto at = [&](int slice, float z) {
      const auto [x, y] = circle(slice);
      return Vertex{{x, y, z}, {x, y, 0}};
    };
    for (int slice = 0; slice < slices_; ++slice) {
      triangle(at(slice, -1), at(slice + 1, -1), at(slice + 1, 1));
      triangle(at(slice, -1), at(slice + 1, 1), at(slice, 1));
    }
  }

  // The lid of that cylinder at z = `side`, seen from outside.
  void lid(float side) {
    const auto at = [&](int slice) {
      const auto [x, y] = circle(slice);
      return Vertex{{x, y, side}, {0, 0, side}};
    };
    for (int slice = 1; slice < slices_ - 1; ++slice)
      if (side > 0)
        triangle(at(0), at(slice), at(slice + 1));
      else
        triangle(at(0), at(slice + 1), at(slice));
  }

 private:
  template <typename Function>
  static void find(Function& function, const GlContext& gl, const char* name) {
    function = reinterpret_cast<Function>(gl.function(name));
  }

  std::pair<float, float> circle(int slice) const {
    // The modulus closes the ring exactly, so that the two ends share their vertices.
    const double azimuth = 2 * mjPI * (slice % slices_) / slices_;
    return {static_cast<float>(std::cos(azimuth)), static_cast<float>(std::sin(azimuth))};
  }

  void triangle(const Vertex& a, const Vertex& b, const Vertex& c) {
    for (const Vertex* v : {&a, &b, &c}) {
      normal_(v->normal);
      vertex_(v->position);
    }
  }

  int slices_;
  void (*new_list_)(unsigned, unsigned);
  void (*end_list_)();
  void (*begin_)(unsigned);
  void (*end_)();
  void (*normal_)(const float*);
  void (*vertex_)(const float*);
};

}  // namespace

void use_coarse_shapes(const mjrContext& context, const GlContext& gl, int slices, int stacks) {
  if (context.rangeBuiltin != kListCount) return;  // not the MuJoCo this was written for: its own shapes do
  Tessellator shapes(gl, slices);
  const unsigned base = context.baseBuiltin;
  const double pole = mjPI / 2;
  shapes.record(base + kSphere, [&] { shapes.sphere(-pole, pole, 2 * stacks, 0); });
  shapes.record(base + kSphereTop, [&] { shapes.sphere(0, pole, stacks, 1); });
  shapes.record(base + kSphereBottom, [&] { shapes.sphere(-pole, 0, stacks, -1); });
  shapes.record(base + kOpenCylinder, [&] { shapes.wall(); });
  shapes.record(base + kCylinder, [&] {
    shapes.wall();
    shapes.lid(-1);
    shapes.lid(1);
  });
}

}  // namespace rcs
