// The geoms, lights and cameras of a scene as MuJoCo lays them out for drawing, without OpenGL. Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <vector>

#include "rcs/renderer.hpp"

namespace rcs {

/// Takes over poses once for all cameras; then gives each camera what it may see.
class SceneView {
 public:
  /// Throws `SimulationError` with MuJoCo's words, like all that follows.
  SceneView(const mjModel* model, const RenderOptions& options);
  ~SceneView() { mjv_freeScene(&scene_); }
  SceneView(const SceneView&) = delete;
  SceneView& operator=(const SceneView&) = delete;

  /// Take over the poses in `data` with the looks of `model`, which has the sizes of the view's own.
  void update(const mjModel* model, mjData* data);
  bool is_empty() const { return cameras_.empty(); }
  /// Have the scene as a camera sees it on a canvas, and return the camera, which is between MuJoCo's two, for stereo.
  mjvGLCamera look(int camera, const Lens* lens, int picture_height, int canvas_width, int canvas_height);

  mjvScene& scene() { return scene_; }

 private:
  bool is_fast_;
  mjvScene scene_;
  mjvOption option_;
  std::vector<mjvGeom> geoms_;                       // of the last update; the scene gets those that a camera may see
  std::vector<std::array<mjvGLCamera, 2>> cameras_;  // of the last update, for the left and right eye
};

}  // namespace rcs
