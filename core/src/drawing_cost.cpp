#include "drawing_cost.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rcs {

namespace {

// The order of the shapes' display lists from `mjrContext::baseBuiltin` on, set by MuJoCo's render_context.h. Boxes are
// coarse already (`numquads`), and arrows and haze are in no picture that this library draws.
enum ShapeList : unsigned { kSphere, kSphereTop, kSphereBottom, kCylinder, kOpenCylinder };
constexpr int kListCount = 8;

// OpenGL's numbers (Khronos registry).
constexpr unsigned kCompile = 0x1300, kTriangles = 0x0004;
constexpr unsigned kFramebuffer = 0x8D40, kRenderbuffer = 0x8D41, kDepth32f = 0x8CAC;
constexpr unsigned kDepthAttachment = 0x8D00, kStencilAttachment = 0x8D20;

template <typename Function>
void find(Function& function, const GlContext& gl, const char* name) {
  function = reinterpret_cast<Function>(gl.function(name));
}

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
    begin_(kTriangles);  // one batch for the whole shape: each further one is a pass through the driver
    draw();
    end_();
    end_list_();
  }

  // The unit sphere's upper (`side` 1) or lower (-1) half, shifted along z.
  void half_sphere(int side, int stacks, float shift) {
    const auto at = [&](int slice, int stack) {
      const double elevation = mjPI / 2 * stack / stacks;
      const auto [x, y] = circle(side * slice);  // mirrored for the lower half, so that triangles keep facing outwards
      const auto radius = static_cast<float>(std::cos(elevation));
      const auto z = static_cast<float>(side * std::sin(elevation) * outset(4 * stacks));
      return Vertex{{radius * x, radius * y, shift + z}, {radius * x, radius * y, z}};
    };
    for (int stack = 0; stack < stacks; ++stack) {
      for (int slice = 0; slice < slices_; ++slice) {
        triangle(at(slice, stack), at(slice + 1, stack), at(slice + 1, stack + 1));
        if (stack + 1 < stacks) triangle(at(slice, stack), at(slice + 1, stack + 1), at(slice, stack + 1));
      }
    }
  }

  // The wall of the cylinder of radius 1 from z = -1 to 1.
  void wall(int stacks) {
    const auto at = [&](int slice, float z) {
      const auto [x, y] = circle(slice);
      return Vertex{{x, y, z}, {x, y, 0}};
    };
    for (int stack = 0; stack < stacks; ++stack) {
      const float lower = 2.0F * stack / stacks - 1, upper = 2.0F * (stack + 1) / stacks - 1;
      for (int slice = 0; slice < slices_; ++slice) {
        triangle(at(slice, lower), at(slice + 1, lower), at(slice + 1, upper));
        triangle(at(slice, lower), at(slice + 1, upper), at(slice, upper));
      }
    }
  }

  // The lid of that cylinder at z = `side`.
  void lid(int side) {
    const auto z = static_cast<float>(side);
    const auto at = [&](int slice) {
      const auto [x, y] = circle(side * slice);
      return Vertex{{x, y, z}, {0, 0, z}};
    };
    for (int slice = 1; slice + 1 < slices_; ++slice) triangle(at(0), at(slice), at(slice + 1));
  }

 private:
  std::pair<float, float> circle(int slice) const {
    // The modulus closes the ring exactly, so that its ends share their vertices.
    const double azimuth = 2 * mjPI * ((slice + slices_) % slices_) / slices_;
    const double radius = outset(slices_);
    return {static_cast<float>(radius * std::cos(azimuth)), static_cast<float>(radius * std::sin(azimuth))};
  }

  // Radius of a polygon's corners at which its sides are as far inside the unit circle as its corners are outside.
  static double outset(int corners) { return 2 / (1 + std::cos(mjPI / corners)); }

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
  if (context.rangeBuiltin != kListCount) return;  // another order than the one known here: MuJoCo's own shapes do
  Tessellator shapes(gl, slices);
  const unsigned base = context.baseBuiltin;
  const int wall_stacks = std::max(1, stacks / 4);  // light varies little along an axis
  shapes.record(base + kSphere, [&] {
    shapes.half_sphere(1, stacks, 0);
    shapes.half_sphere(-1, stacks, 0);
  });
  // MuJoCo moves a capsule's ends to unit height before it draws them.
  shapes.record(base + kSphereTop, [&] { shapes.half_sphere(1, stacks, 1); });
  shapes.record(base + kSphereBottom, [&] { shapes.half_sphere(-1, stacks, -1); });
  shapes.record(base + kOpenCylinder, [&] { shapes.wall(wall_stacks); });
  shapes.record(base + kCylinder, [&] {
    shapes.wall(wall_stacks);
    shapes.lid(1);
    shapes.lid(-1);
  });
}

void drop_stencil(const mjrContext& context, const GlContext& gl) {
  if (!gl.has_extension("GL_ARB_depth_buffer_float")) return;
  void (*bind_framebuffer)(unsigned, unsigned);
  void (*bind_renderbuffer)(unsigned, unsigned);
  void (*storage)(unsigned, unsigned, int, int);
  void (*attach)(unsigned, unsigned, unsigned, unsigned);
  find(bind_framebuffer, gl, "glBindFramebuffer");
  find(bind_renderbuffer, gl, "glBindRenderbuffer");
  find(storage, gl, "glRenderbufferStorage");
  find(attach, gl, "glFramebufferRenderbuffer");
  bind_framebuffer(kFramebuffer, context.offFBO);
  bind_renderbuffer(kRenderbuffer, context.offDepthStencil);
  storage(kRenderbuffer, kDepth32f, context.offWidth, context.offHeight);
  attach(kFramebuffer, kStencilAttachment, kRenderbuffer, 0);
  attach(kFramebuffer, kDepthAttachment, kRenderbuffer, context.offDepthStencil);
  mjr_restoreBuffer(&context);
}

}  // namespace rcs
