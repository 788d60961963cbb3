#include "rcs/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "drawing_cost.hpp"
#include "pixels.hpp"
#include "rasteriser.hpp"
#include "rcs/result.hpp"
#include "scene_view.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

constexpr int kFullSamples = 4;
constexpr int kMostIds = 65536;
// Side of the shadow map [texels]: half the size, which a model may ask for, takes half the time of a whole picture.
constexpr int kMinShadowSize = 2048, kMaxShadowSize = 4096;
// Parts of MuJoCo's round shapes, which are drawn with others, and of planes: a model may ask for what takes minutes.
constexpr int kMostParts = 64;
// Squares along the half side of a plane, at whose corners its lighting is computed. MuJoCo draws 200 × 200 squares for
// an infinite plane, which takes longer than a robot.
constexpr int kPlaneSquares = 16;

// Whether OpenGL draws on the processor, by the names of Mesa's renderers (GL_RENDERER).
bool is_software(const std::string& renderer) {
  return renderer.starts_with("llvmpipe") || renderer.starts_with("softpipe") || renderer.starts_with("swrast");
}

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
    for (int* parts : {&visual.quality.numslices, &visual.quality.numstacks, &visual.quality.numquads})
      *parts = std::min(*parts, kMostParts);
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

}  // namespace

void check_picture(const mjModel& model, const RenderOptions& options, int camera, const Picture& picture) {
  if (camera < 0 || camera >= model.ncam) {
    std::ostringstream text;
    text << "renderer: there is no camera " << camera << "; ";
    if (model.ncam == 0) text << "the model has none";
    for (int id = 0; id < model.ncam; ++id)
      text << (id == 0 ? "the model has " : ", ") << id << " (" << model.names + model.name_camadr[id] << ")";
    throw std::invalid_argument(text.str());
  }
  if (picture.width < 1 || picture.height < 1 || picture.width > options.max_width ||
      picture.height > options.max_height)
    throw std::invalid_argument("renderer: a picture of " + std::to_string(picture.width) + " x " +
                                std::to_string(picture.height) + " pixels was asked for, valid is 1 x 1 to " +
                                std::to_string(options.max_width) + " x " + std::to_string(options.max_height));
  if (picture.rgb == nullptr) throw std::invalid_argument("renderer: the picture has no place for rgb");
  if (picture.ids != nullptr && model.ngeom + model.nflex + model.nskin + model.ntendon >= kMostIds)
    throw std::invalid_argument("renderer: the model has more parts than a picture of ids has numbers, " +
                                std::to_string(kMostIds - 1));
  if (picture.lens == nullptr) return;
  const Lens& lens = *picture.lens;
  const bool fits = lens.lookup != nullptr ? lens.width >= 1 && lens.height >= 1
                                           : lens.width == picture.width && lens.height == picture.height;
  if (!fits || lens.width > options.max_width || lens.height > options.max_height)
    throw std::invalid_argument("renderer: a lens has a canvas of " + std::to_string(lens.width) + " x " +
                                std::to_string(lens.height) + " pixels, valid is " +
                                (lens.lookup != nullptr ? "1 x 1 to " + std::to_string(options.max_width) + " x " +
                                                              std::to_string(options.max_height)
                                                        : "the size of the picture"));
  if (!(lens.scale_x > 0 && lens.scale_y > 0 && std::isfinite(lens.scale_x + lens.scale_y + lens.cx + lens.cy)))
    throw std::invalid_argument("renderer: a lens must have positive scales and a finite principal point");
  if (model.cam_projection[camera] != mjPROJ_PERSPECTIVE)
    throw std::invalid_argument("renderer: a lens is for a camera with perspective, and this one is orthographic");
}

/// The parts of a renderer until it is closed.
struct Renderer::Open {
  Open(const mjModel* model, const RenderOptions& options) : gl(options.backend), view(model, options) {
    mjr_defaultContext(&context);
  }
  ~Open() {
    mj_deleteData(own_data);
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
  SceneView view;
  mjData* own_data = nullptr;             // of `update_from_state`, made on first use
  Canvas canvas;                          // of the picture at work
  std::vector<std::uint16_t> values;      // of a canvas from which a picture's are looked up
  int slices = 0;                         // of the round shapes in the context
  bool is_rasterised = false;             // colours are drawn without OpenGL
  std::map<int, Rasteriser> rasterisers;  // by the slices of their round shapes, made on first use
  std::vector<Backdrop> backdrops;        // one for each camera
  Sheet sheet;
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
  auto open = std::make_unique<Open>(model, options);
  const int limit = open->gl.max_size();
  if (options.max_width > limit || options.max_height > limit)
    throw std::invalid_argument("renderer: at most " + std::to_string(limit) + " x " + std::to_string(limit) +
                                " pixels can be drawn here");
  description_ = open->gl.backend() + ": " + open->gl.description();
  const DrawnModel drawn(*model, options);
  {
    const GlContext::Current current(open->gl);
    trapped("renderer", [&] {
      mjr_makeContext(&drawn.value, &open->context, mjFONTSCALE_100);
      mjr_setBuffer(mjFB_OFFSCREEN, &open->context);
    });
  }
  open->context.readDepthMap = mjDEPTH_ZEROFAR;
  open->is_rasterised = options.is_rasterised && options.quality == Quality::fast &&
                        is_software(open->gl.description()) && Rasteriser::why_not(*model, options.geom_groups).empty();
  open->backdrops.resize(static_cast<std::size_t>(model->ncam));
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

void Renderer::update(mjData* data) {
  const std::lock_guard lock(mutex_);
  Open& open = require_open("update");
  if (data->signature != model_->signature)
    throw std::invalid_argument("renderer: the data is of another model than the renderer's");
  // Their corners are as old as the last physics step, and the state may have been written since.
  if (model_->nflex > 0) trapped("renderer", [&] { mj_flex(model_, data); });
  open.view.update(model_, data);
}

void Renderer::update(const mjModel* model, mjData* data) {
  const std::lock_guard lock(mutex_);
  Open& open = require_open("update");
  if (model->nflex > 0) trapped("renderer", [&] { mj_flex(model, data); });
  open.view.update(model, data);
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
  open.view.update(model, open.own_data);
}

void Renderer::check(int camera, const Picture& picture) const { check_picture(*model_, options_, camera, picture); }

void Renderer::prepare(Open& open, int width, int height) const {
  const bool is_fast = options_.quality == Quality::fast;
  mjrContext& context = open.context;
  if (width > context.offWidth || height > context.offHeight) {
    // Only as large as the pictures are: clearing a part of a buffer costs more than clearing a whole one.
    trapped("renderer", [&] {
      mjr_resizeOffscreen(std::max(width, context.offWidth), std::max(height, context.offHeight), &context);
    });
    if (is_fast) drop_stencil(context, open.gl);
  }
  if (const Roundness round = roundness(options_.quality, height); open.slices != round.slices) {
    use_coarse_shapes(context, open.gl, round.slices, round.stacks);
    open.slices = round.slices;
  }
  open.canvas.width = width;
  open.canvas.height = height;
}

void Renderer::draw_ids(Open& open, float* depth) const {
  const mjrRect area{0, 0, open.canvas.width, open.canvas.height};
  open.canvas.codes.resize(3 * open.canvas.size());
  trapped("renderer", [&] {
    open.view.scene().flags[mjRND_SEGMENT] = open.view.scene().flags[mjRND_IDCOLOR] = 1;
    mjr_render(area, &open.view.scene(), &open.context);
    open.view.scene().flags[mjRND_SEGMENT] = open.view.scene().flags[mjRND_IDCOLOR] = 0;
    mjr_readPixels(open.canvas.codes.data(), depth, area, &open.context);
  });
}

void Renderer::show(Open& open, int camera, const Picture& picture) const {
  const Lens* lens = picture.lens != nullptr && picture.lens->lookup != nullptr ? picture.lens : nullptr;
  prepare(open, lens != nullptr ? lens->width : picture.width, lens != nullptr ? lens->height : picture.height);
  const mjvGLCamera eye = open.view.look(camera, picture.lens, picture.height, open.canvas.width, open.canvas.height);
  Canvas& canvas = open.canvas;
  const mjrRect area{0, 0, canvas.width, canvas.height};
  if (picture.depth_mm != nullptr) canvas.depth.resize(canvas.size());
  float* depth = picture.depth_mm != nullptr ? canvas.depth.data() : nullptr;
  // Colours of what is transparent leave the depth behind it, and with several samples a pixel, the depth that is read
  // is not that of the pixel's middle. Ids are drawn opaque, with one sample, and so is the depth then.
  bool is_apart = depth != nullptr;
  if (!open.is_rasterised) {
    if (lens != nullptr) canvas.rgb.resize(3 * canvas.size());
    std::uint8_t* rgb = lens != nullptr ? canvas.rgb.data() : picture.rgb;
    trapped("renderer", [&] {
      mjvScene& scene = open.view.scene();
      mjr_render(area, &scene, &open.context);
      is_apart = is_apart && (options_.quality == Quality::full ||
                              std::any_of(scene.geoms, scene.geoms + scene.ngeom,
                                          [](const mjvGeom& geom) { return geom.transparent; }));
      mjr_readPixels(rgb, is_apart ? nullptr : depth, area, &open.context);
    });
    flip_rows(rgb, 3 * canvas.width, canvas.height);
    if (lens != nullptr) look_up(rgb, *lens, picture.width, picture.height, picture.rgb);
  }

  // Values are written where they belong, or first to a canvas of their own and looked up there.
  const auto finish = [&](std::uint16_t* out, auto convert) {
    if (lens == nullptr) return convert(out);
    open.values.resize(canvas.size());
    convert(open.values.data());
    look_up(open.values.data(), *lens, picture.width, picture.height, out);
  };
  if (is_apart) draw_ids(open, depth);
  if (depth != nullptr) finish(picture.depth_mm, [&](std::uint16_t* out) { to_millimetres(canvas, eye, out); });
  if (picture.ids != nullptr) {
    if (!is_apart) draw_ids(open, nullptr);
    finish(picture.ids, [&](std::uint16_t* out) { to_ids(canvas, out); });
  }
}

void Renderer::rasterise(Open& open, int camera, const Picture& picture) const {
  const Lens* lens = picture.lens != nullptr && picture.lens->lookup != nullptr ? picture.lens : nullptr;
  Sheet& sheet = open.sheet;
  sheet.width = lens != nullptr ? lens->width : picture.width;
  sheet.height = lens != nullptr ? lens->height : picture.height;
  const mjvGLCamera eye = open.view.look(camera, picture.lens, picture.height, sheet.width, sheet.height);
  const Roundness round = roundness(options_.quality, sheet.height);
  Rasteriser& rasteriser = open.rasterisers.try_emplace(round.slices, model_, round).first->second;
  const bool is_still = model_->body_weldid[model_->cam_bodyid[camera]] == 0;
  rasteriser.draw(open.view.scene(), eye, sheet,
                  is_still ? &open.backdrops[static_cast<std::size_t>(camera)] : nullptr);
  if (lens != nullptr) open.canvas.rgb.resize(3 * sheet.colours.size());
  std::uint8_t* rgb = lens != nullptr ? open.canvas.rgb.data() : picture.rgb;
  for (std::size_t i = 0; i < sheet.colours.size(); ++i) {
    const std::uint32_t colour = sheet.colours[i];
    rgb[3 * i] = static_cast<std::uint8_t>(colour);
    rgb[3 * i + 1] = static_cast<std::uint8_t>(colour >> 8);
    rgb[3 * i + 2] = static_cast<std::uint8_t>(colour >> 16);
  }
  if (lens != nullptr) look_up(rgb, *lens, picture.width, picture.height, picture.rgb);
}

void Renderer::render(int camera, const Picture& picture) {
  check(camera, picture);
  const std::lock_guard lock(mutex_);
  Open& open = require_open("render");
  if (open.view.is_empty()) throw WrongOrder("renderer: render was called before update; there are no poses to draw");
  if (open.is_rasterised) {
    rasterise(open, camera, picture);
    if (picture.depth_mm == nullptr && picture.ids == nullptr) return;
  }
  const GlContext::Current current(open.gl);
  show(open, camera, picture);
}

}  // namespace rcs
