// Makes two copies of a scene and a pose, and prints them.
#include <mujoco/mujoco.h>

#include <cstdio>

#include "rcs/pose.hpp"
#include "rcs/world.hpp"

int main() {
  char error[256] = "";
  mjSpec* spec =
      mj_parseXMLString("<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>", nullptr,
                        error, sizeof(error));
  mjModel* model = spec ? mj_compile(spec, nullptr) : nullptr;
  if (!model) return std::puts(error), 1;
  {
    const rcs::World world(model, 2, 1, {});
    const rcs::Pose pose = rcs::Pose({0.0, 0.0, 1.0}) * rcs::Pose({0.0, 0.0, 0.5});
    std::printf("%d copies, %.1f m, MuJoCo %d\n", world.copies(), pose.translation()[2], mj_version());
  }
  mj_deleteModel(model);
  mj_deleteSpec(spec);
}
