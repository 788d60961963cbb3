#include "scene_view.hpp"

#include <algorithm>

#include "frustum.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

constexpr int kMaxGeomsBeyondModel = 1000;  // tendon segments, flexes, skins

// The id of a geom of the scene in a picture of ids: one more than its number among geoms, flexes, skins and tendons,
// in this order; 0 for a geom that has none.
int id_of(const mjvGeom& geom, const mjModel& model) {
  const auto first = [&](mjtSize before) { return static_cast<int>(before) + geom.objid + 1; };
  switch (geom.objtype) {
    case mjOBJ_GEOM:
      return first(0);
    case mjOBJ_FLEX:
      return first(model.ngeom);
    case mjOBJ_SKIN:
      return first(model.ngeom + model.nflex);
    case mjOBJ_TENDON:
      return first(model.ngeom + model.nflex + model.nskin);
    default:
      return 0;
  }
}

}  // namespace

SceneView::SceneView(const mjModel* model, const RenderOptions& options) : is_fast_(options.quality == Quality::fast) {
  mjv_defaultScene(&scene_);
  mjv_defaultOption(&option_);
  trapped("renderer", [&] { mjv_makeScene(model, &scene_, static_cast<int>(model->ngeom) + kMaxGeomsBeyondModel); });
  for (int group = 0; group < mjNGROUP; ++group) {
    option_.geomgroup[group] = options.geom_groups[static_cast<std::size_t>(group)];
    option_.sitegroup[group] = 0;
  }
  if (is_fast_)
    for (const int effect : {mjRND_SHADOW, mjRND_REFLECTION, mjRND_SKYBOX, mjRND_FOG, mjRND_HAZE})
      scene_.flags[effect] = 0;
}

void SceneView::update(const mjModel* model, mjData* data) {
  mjvCamera camera;
  mjv_defaultFreeCamera(model, &camera);
  // Infinite planes are laid around the camera that the scene has when its geoms are made: not that of the last
  // picture.
  trapped("renderer", [&] {
    mjv_updateCamera(model, data, &camera, &scene_);
    mjv_updateScene(model, data, &option_, nullptr, &camera, mjCAT_STATIC | mjCAT_DYNAMIC, &scene_);
  });
  geoms_.assign(scene_.geoms, scene_.geoms + scene_.ngeom);
  for (mjvGeom& geom : geoms_) geom.segid = id_of(geom, *model) - 1;  // MuJoCo draws one more
  // Floors last, so that the pixels under everything else are not shaded first.
  std::stable_partition(geoms_.begin(), geoms_.end(), [](const mjvGeom& g) { return g.type != mjGEOM_PLANE; });
  camera.type = mjCAMERA_FIXED;
  cameras_.resize(static_cast<std::size_t>(model->ncam));
  trapped("renderer", [&] {
    for (int id = 0; id < model->ncam; ++id) {
      camera.fixedcamid = id;
      mjv_updateCamera(model, data, &camera, &scene_);
      cameras_[static_cast<std::size_t>(id)] = {scene_.camera[0], scene_.camera[1]};
    }
  });
}

mjvGLCamera SceneView::look(int camera, const Lens* lens, int picture_height, int canvas_width, int canvas_height) {
  scene_.camera[0] = cameras_[static_cast<std::size_t>(camera)][0];
  scene_.camera[1] = cameras_[static_cast<std::size_t>(camera)][1];
  if (lens != nullptr)
    for (mjvGLCamera& eye : scene_.camera) aim(eye, *lens, picture_height);
  const mjvGLCamera eye = mjv_averageCamera(scene_.camera, scene_.camera + 1);
  if (scene_.nlight > 0 && scene_.lights[0].headlight) {
    std::copy_n(eye.pos, 3, scene_.lights[0].pos);
    std::copy_n(eye.forward, 3, scene_.lights[0].dir);
  }
  scene_.ngeom = 0;
  const Frustum frustum(eye, static_cast<double>(canvas_width) / canvas_height);
  for (const mjvGeom& geom : geoms_)
    // A geom outside may still throw a shadow into the picture or be mirrored in it.
    if (!is_fast_ || frustum.may_show(geom)) scene_.geoms[scene_.ngeom++] = geom;
  return eye;
}

}  // namespace rcs
