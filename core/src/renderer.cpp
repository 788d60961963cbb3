#include "rcs/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "drawing_cost.hpp"
#include "rcs/result.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

constexpr int kMaxGeomsBeyondModel = 1000;  // tendon segments, flexes, skins
constexpr int kFullSamples = 4;
// Side of the shadow map [texels]: half the size, which a model may ask for, takes half the time of a whole picture.
constexpr int kMinShadowSize = 2048, kMaxShadowSize = 4096;
// Squares along the half side of a plane, at whose corners its lighting is computed. MuJoCo draws 200 × 200 squares for
// an infinite plane, which takes longer than a robot.
constexpr int kPlaneSquares = 16;

// Corners of round shapes: around the axis, and from the equator to a pole.
struct Roundness {
  int slices;
  int stacks;
};

Roundness roundness(Quality quality, int picture_height) {
  if (quality == Quality::full) return {32, 8};
  return picture_height > 128 ? Roundness{16, 3} : Roundness{12, 3};  // at few pixels fewer corners look the same
}

// A copy of the model's struct, not of its arrays, with what quality `fast` or `full` wants while MuJoCo makes its
// OpenGL objects. The model itself may be in use by other threads and is not touched.
struct DrawnModel {
  DrawnModel(const mjModel& model, const RenderOptions& options) : value(model) {
    mjVisual& visual = value.vis;
    visual.global.offwidth = visual.global.offheight = 1;  // grows with the first picture
    if (options.quality == Quality::full) {
      visual.quality.offsamples = std::max(visual.quality.offsamples, kFullSamples);
      visual.quality.shadowsize = std::clamp(visual.quality.shadowsize, kMinShadowSize, kMaxShadowSize);
      return;
    }
    visual.quality.offsamples = 0;
    visual.quality.shadowsize = 0;
    visual.quality.numquads = 1;
    geom_size.assign(model.geom_size, model.geom_size + 3 * model.ngeom);
    for (int geom = 0; geom < model.ngeom; ++geom) {
      if (model.geom_type[geom] != mjGEOM_PLANE) continue;
      mjtNum* size = &geom_size[3 * geom];  // half lengths, and the distance of grid lines
      for (int axis = 0; axis < 2; ++axis)
        if (size[axis] <= 0) size[axis] = 1.2 * visual.map.zfar * model.stat.extent;
      size[2] = std::max({size[2], size[0] / kPlaneSquares, size[1] / kPlaneSquares});
    }
    value.geom_size = geom_size.data();
  }

  mjModel value;
  std::vector<mjtNum> geom_size;
};

// What a camera can see: a pyramid from its position, in camera axes (x right, y up, z forward).
class Frustum {
 public:
  Frustum(const mjvGLCamera& camera, const Picture& picture) : camera_(camera) {
    mju_f2n(forward_, camera.forward, 3);
    mju_f2n(up_, camera.up, 3);
    mju_cross(right_, forward_, up_);
    const double half_height = 0.5 * (camera.frustum_top - camera.frustum_bottom);
    const double half_width =
        camera.frustum_width > 0 ? camera.frustum_width : half_height * picture.width / picture.height;
    const double scale = camera.orthographic ? 1.0 : camera.frustum_near;
    left_ = (camera.frustum_center - half_width) / scale;
    right_end_ = (camera.frustum_center + half_width) / scale;
    bottom_ = camera.frustum_bottom / scale;
    top_ = camera.frustum_top / scale;
  }

  // Whether a ball around the geom, which has no known size when its radius is 0, can be in the picture.
  bool may_show(const mjvGeom& geom) const {
    if (geom.modelrbound <= 0) return true;
    const double radius = 1.001 * geom.modelrbound;
    const mjtNum offset[3] = {geom.pos[0] - camera_.pos[0], geom.pos[1] - camera_.pos[1], geom.pos[2] - camera_.pos[2]};
    const double x = mju_dot3(offset, right_), y = mju_dot3(offset, up_), z = mju_dot3(offset, forward_);
    if (z < camera_.frustum_near - radius) return false;
    const auto is_outside = [&](double coordinate, double slope) {
      if (camera_.orthographic) return coordinate - slope > radius;
      return coordinate - slope * z > radius * std::sqrt(1 + slope * slope);
    };
    return !is_outside(x, right_end_) && !is_outside(-x, -left_) && !is_outside(y, top_) && !is_outside(-y, -bottom_);
  }

 private:
  const mjvGLCamera& camera_;
  mjtNum forward_[3], up_[3], right_[3];
  double left_, right_end_, bottom_, top_;
};

// OpenGL's first row is the bottom one.
template <typename Pixel>
void flip_rows(Pixel* image, int row, int rows) {
  std::vector<Pixel> spare(static_cast<std::size_t>(row));
  const std::size_t bytes = spare.size() * sizeof(Pixel);
  for (int y = 0; y < rows / 2; ++y) {
    Pixel* upper = image + static_cast<std::ptrdiff_t>(row) * y;
    Pixel* lower = image + static_cast<std::ptrdiff_t>(row) * (rows - 1 - y);
    std::memcpy(spare.data(), upper, bytes);
    std::memcpy(upper, lower, bytes);
    std::memcpy(lower, spare.data(), bytes);
  }
}

// The depth buffer holds 1 at the near plane, 0 at the far one and where nothing is, linear in the reciprocal distance.
// Rounding in single precision is below 0.01 mm at 65 m.
void to_millimetres(const std::vector<float>& buffer, const mjvGLCamera& camera, const Picture& picture) {
  const float near = 1000 * camera.frustum_near, far = 1000 * camera.frustum_far;
  const auto convert = [&](auto distance) {
    for (int y = 0; y < picture.height; ++y) {
      const float* row = buffer.data() + static_cast<std::size_t>(picture.height - 1 - y) * picture.width;
      std::uint16_t* out = picture.depth_mm + static_cast<std::size_t>(y) * picture.width;
      for (int x = 0; x < picture.width; ++x) {
        const float rounded = row[x] > 0 ? distance(row[x]) + 0.5F : 0.0F;
        out[x] = static_cast<std::uint16_t>(static_cast<int>(rounded < 65536.0F ? rounded : 0.0F));
      }
    }
  };
  if (camera.orthographic)
    convert([=](float depth) { return far - depth * (far - near); });
  else
    convert([=](float depth) { return near * far / (near + depth * (far - near)); });
}

}  // namespace

/// What a renderer has until it is closed.
struct Renderer::Open {
  explicit Open(const std::string& backend) : gl(backend) {
    mjr_defaultContext(&context);
    mjv_defaultScene(&scene);
    mjv_defaultOption(&option);
  }
  ~Open() {
    mj_deleteData(own_data);
    mjv_freeScene(&scene);
    try {
      const GlContext::Current current(gl);
      mjr_freeContext(&context);
    } catch (const GlUnavailable&) {
      // Another user of the display has ended it, as MuJoCo's Python package does at exit, and all in it is gone
      // already.
    }
  }

  GlContext gl;
  mjrContext context;
  mjvScene scene;
  mjvOption option;
  mjData* own_data = nullptr;                       // of `update_from_state`, made on first use
  std::vector<mjvGeom> geoms;                       // of the last update; the scene gets those that a camera may see
  std::vector<std::array<mjvGLCamera, 2>> cameras;  // of the last update, for the left and right eye
  std::vector<float> depth;
  int slices = 0;  // of the round shapes in the context
};

Renderer::Renderer(const mjModel* model, const RenderOptions& options)
    : model_(model), options_(options), state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  if (options.max_width < 1 || options.max_height < 1)
    throw std::invalid_argument("renderer: pictures of at most " + std::to_string(options.max_width) + " x " +
                                std::to_string(options.max_height) +
                                " pixels were asked for, at least 1 x 1 is needed");
  if (model->vis.map.znear * model->stat.extent < mjMINVAL)
    throw std::invalid_argument(
        "renderer: the model's near plane (visual/map znear × statistic extent) must be positive");
  auto open = std::make_unique<Open>(options.backend);
  const int limit = open->gl.max_size();
  if (options.max_width > limit || options.max_height > limit)
    throw std::invalid_argument("renderer: at most " + std::to_string(limit) + " x " + std::to_string(limit) +
                                " pixels can be drawn here");
  description_ = open->gl.backend() + ": " + open->gl.description();
  trapped("renderer",
          [&] { mjv_makeScene(model, &open->scene, static_cast<int>(model->ngeom) + kMaxGeomsBeyondModel); });
  for (int group = 0; group < mjNGROUP; ++group) {
    open->option.geomgroup[group] = options.geom_groups[group];
    open->option.sitegroup[group] = 0;
  }
  if (options.quality == Quality::fast)
    for (const int effect : {mjRND_SHADOW, mjRND_REFLECTION, mjRND_SKYBOX, mjRND_FOG, mjRND_HAZE})
      open->scene.flags[effect] = 0;
  const DrawnModel drawn(*model, options);
  {
    const GlContext::Current current(open->gl);
    trapped("renderer", [&] {
      mjr_makeContext(&drawn.value, &open->context, mjFONTSCALE_100);
      mjr_setBuffer(mjFB_OFFSCREEN, &open->context);
    });
  }
  open->context.readDepthMap = mjDEPTH_ZEROFAR;
  open_ = std::move(open);
}

Renderer::~Renderer() = default;

void Renderer::close() {
  const std::lock_guard lock(mutex_);
  is_open_ = false;
  open_.reset();
}

Renderer::Open& Renderer::require_open(const char* call) const {
  if (!open_) throw WrongOrder(std::string("renderer: ") + call + " was called after close(); make a new renderer");
  return *open_;
}

void Renderer::take_over(Open& open, const mjModel* model, mjData* data) const {
  mjvCamera camera;
  mjv_defaultFreeCamera(model, &camera);
  // Infinite planes are laid around the camera that the scene has when its geoms are made: not that of the last
  // picture.
  trapped("renderer", [&] {
    mjv_updateCamera(model, data, &camera, &open.scene);
    mjv_updateScene(model, data, &open.option, nullptr, &camera, mjCAT_STATIC | mjCAT_DYNAMIC, &open.scene);
  });
  open.geoms.assign(open.scene.geoms, open.scene.geoms + open.scene.ngeom);
  // Floors last, so that the pixels under everything else are not shaded first.
  std::stable_partition(open.geoms.begin(), open.geoms.end(), [](const mjvGeom& g) { return g.type != mjGEOM_PLANE; });
  camera.type = mjCAMERA_FIXED;
  open.cameras.resize(static_cast<std::size_t>(model->ncam));
  trapped("renderer", [&] {
    for (int id = 0; id < model->ncam; ++id) {
      camera.fixedcamid = id;
      mjv_updateCamera(model, data, &camera, &open.scene);
      open.cameras[id] = {open.scene.camera[0], open.scene.camera[1]};
    }
  });
}

void Renderer::update(mjData* data) {
  const std::lock_guard lock(mutex_);
  Open& open = require_open("update");
  if (data->signature != model_->signature)
    throw std::invalid_argument("renderer: the data is of another model than the renderer's");
  // Their corners are as old as the last physics step, and the state may have been written since.
  if (model_->nflex > 0) trapped("renderer", [&] { mj_flex(model_, data); });
  take_over(open, model_, data);
}

void Renderer::update_from_state(std::span<const double> state) { update_from_state(state, model_); }

void Renderer::update_from_state(std::span<const double> state, const mjModel* model) {
  if (state.size() != static_cast<std::size_t>(state_size_))
    throw std::invalid_argument("renderer: a state of " + std::to_string(state.size()) +
                                " numbers was given, this model's has " + std::to_string(state_size_));
  const std::lock_guard lock(mutex_);
  Open& open = require_open("update_from_state");
  trapped("renderer", [&] {
    if (open.own_data == nullptr) open.own_data = mj_makeData(model_);
    mjData* data = open.own_data;
    mj_setState(model, data, state.data(), mjSTATE_INTEGRATION);
    mj_kinematics(model, data);
    mj_comPos(model, data);
    mj_camlight(model, data);
    if (model->nflex > 0) mj_flex(model, data);
    if (model->ntendon > 0) mj_tendon(model, data);
  });
  take_over(open, model, open.own_data);
}

void Renderer::check(int camera, const Picture& picture) const {
  if (camera < 0 || camera >= model_->ncam) {
    std::ostringstream text;
    text << "renderer: there is no camera " << camera << "; ";
    if (model_->ncam == 0) text << "the model has none";
    for (int id = 0; id < model_->ncam; ++id)
      text << (id == 0 ? "the model has " : ", ") << id << " (" << model_->names + model_->name_camadr[id] << ")";
    throw std::invalid_argument(text.str());
  }
  if (picture.width < 1 || picture.height < 1 || picture.width > options_.max_width ||
      picture.height > options_.max_height)
    throw std::invalid_argument("renderer: a picture of " + std::to_string(picture.width) + " x " +
                                std::to_string(picture.height) + " pixels was asked for, valid is 1 x 1 to " +
                                std::to_string(options_.max_width) + " x " + std::to_string(options_.max_height));
  if (picture.rgb == nullptr) throw std::invalid_argument("renderer: the picture has no place for rgb");
}

void Renderer::show(Open& open, int camera, const Picture& picture) const {
  const bool is_fast = options_.quality == Quality::fast;
  mjrContext& context = open.context;
  if (picture.width > context.offWidth || picture.height > context.offHeight) {
    // Only as large as the pictures are: clearing a part of a buffer costs more than clearing a whole one.
    trapped("renderer", [&] {
      mjr_resizeOffscreen(std::max(picture.width, context.offWidth), std::max(picture.height, context.offHeight),
                          &context);
    });
    if (is_fast) drop_stencil(context, open.gl);
  }
  if (const Roundness round = roundness(options_.quality, picture.height); open.slices != round.slices) {
    use_coarse_shapes(context, open.gl, round.slices, round.stacks);
    open.slices = round.slices;
  }

  mjvScene& scene = open.scene;
  scene.camera[0] = open.cameras[camera][0];
  scene.camera[1] = open.cameras[camera][1];
  const mjvGLCamera eye = mjv_averageCamera(scene.camera, scene.camera + 1);  // between MuJoCo's two, for stereo
  if (scene.nlight > 0 && scene.lights[0].headlight) {
    std::copy_n(eye.pos, 3, scene.lights[0].pos);
    std::copy_n(eye.forward, 3, scene.lights[0].dir);
  }
  scene.ngeom = 0;
  const Frustum frustum(eye, picture);
  for (const mjvGeom& geom : open.geoms)
    // What is outside may still throw a shadow into the picture or be mirrored in it.
    if (!is_fast || frustum.may_show(geom)) scene.geoms[scene.ngeom++] = geom;

  const mjrRect area{0, 0, picture.width, picture.height};
  if (picture.depth_mm != nullptr) open.depth.resize(static_cast<std::size_t>(picture.width) * picture.height);
  trapped("renderer", [&] {
    mjr_render(area, &scene, &context);
    mjr_readPixels(picture.rgb, picture.depth_mm != nullptr ? open.depth.data() : nullptr, area, &context);
  });
  flip_rows(picture.rgb, 3 * picture.width, picture.height);
  if (picture.depth_mm != nullptr) to_millimetres(open.depth, eye, picture);
}

void Renderer::render(int camera, const Picture& picture) {
  check(camera, picture);
  const std::lock_guard lock(mutex_);
  Open& open = require_open("render");
  if (open.cameras.empty()) throw WrongOrder("renderer: render was called before update; there are no poses to draw");
  const GlContext::Current current(open.gl);
  show(open, camera, picture);
}

}  // namespace rcs
