// Spheres, capsules and cylinders with few triangles. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include "rcs/gl_context.hpp"

namespace rcs {

/// Replace the round shapes of `context`, made for a scene in the current OpenGL context, by coarse ones.
///
/// MuJoCo divides a cylinder along its axis and its lids along the radius as finely as a sphere, 480 triangles at 16
/// slices where 60 look the same, and on a CPU the time of a small picture is the number of triangles.
void use_coarse_shapes(const mjrContext& context, const GlContext& gl, int slices, int stacks);

}  // namespace rcs
