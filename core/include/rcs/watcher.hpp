// A watcher looks at a copy of a world after its step, in the thread that stepped it.
#pragma once

#include <mujoco/mujoco.h>

namespace rcs {

/// Sees the data of copies and changes no state. Called by several threads at once, for different copies.
class Watcher {
 public:
  virtual ~Watcher() = default;
  /// See a copy at the end of its step: poses of bodies, geoms and sites are current.
  virtual void see_step(const mjModel* model, mjData* data, int copy) = 0;
  /// See a copy because a call asked the world to show it.
  virtual void see(const mjModel* model, mjData* data, int copy) = 0;
  /// Throws `InvalidSetup` if it was made for another model or for fewer copies.
  virtual void check(const mjModel* model, int copies) const = 0;
};

}  // namespace rcs
