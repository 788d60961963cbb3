#include "rcs/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "rcs/result.hpp"

namespace rcs {

namespace {

constexpr unsigned kPackInvert = 0x8758;  // GL_PACK_INVERT_MESA

int env(const char* name, int fallback) { const char* v = getenv(name); return v ? atoi(v) : fallback; }

}  // namespace

/// Everything that a closed renderer no longer has.
struct Renderer::Open {
  explicit Open(const std::string& backend) : gl(backend) {}

  GlContext gl;
  mjrContext context{};
  mjvScene scene{};
  mjvOption option{};
  std::vector<std::array<mjvGLCamera, 2>> cameras;
  mjData* data = nullptr;
  std::vector<float> depth;
  std::vector<uint32_t> rgba;
  bool is_current = false;
  void (*pixel_store)(unsigned, int);
  void (*read_pixels)(int,int,int,int,unsigned,unsigned,void*);
};

Renderer::Renderer(const mjModel* model, const RenderOptions& options)
    : model_(model), options_(options), state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  open_ = std::make_unique<Open>(options.backend);
  Open& o = *open_;
  mjModel copy = *model;
  mjVisual& vis = copy.vis;
  vis.global.offwidth = options.max_width;
  vis.global.offheight = options.max_height;
  std::vector<mjtNum> sizes(model->geom_size, model->geom_size + 3 * model->ngeom);
  if (options.quality == Quality::fast) {
    vis.quality.offsamples = env("SAMPLES", 0);
    vis.quality.numslices = env("SLICES", 16);
    vis.quality.numstacks = env("STACKS", 8);
    vis.quality.numquads = env("QUADS", 1);
    vis.quality.shadowsize = env("SHADOWSIZE", 0);
    if (env("PLANE", 1)) {
    for (int i = 0; i < model->ngeom; ++i) {
      if (model->geom_type[i] != mjGEOM_PLANE) continue;
      mjtNum* s = &sizes[3 * i];
      for (int k = 0; k < 2; ++k) if (s[k] <= 0) s[k] = 1.1 * vis.map.zfar * model->stat.extent;
      s[2] = std::max({s[2], s[0] / env("PLANEGRID", 8), s[1] / env("PLANEGRID", 8)});
    }
    copy.geom_size = sizes.data();
    }
  } else {
    vis.quality.offsamples = 4;
    vis.quality.shadowsize = std::clamp(vis.quality.shadowsize, 2048, 4096);
  }
  const GlContext::Current current(o.gl);
  mjr_defaultContext(&o.context);
  mjr_makeContext(&copy, &o.context, mjFONTSCALE_100);
  mjr_setBuffer(mjFB_OFFSCREEN, &o.context);
  o.context.readDepthMap = mjDEPTH_ZEROFAR;
  mjv_defaultScene(&o.scene);
  mjv_makeScene(model, &o.scene, model->ngeom + 100);
  mjv_defaultOption(&o.option);
  for (int i = 0; i < mjNGROUP; ++i) { o.option.geomgroup[i] = options.geom_groups[i]; o.option.sitegroup[i] = 0; }
  if (options.quality == Quality::fast) {
    o.scene.flags[mjRND_SHADOW] = env("SHADOW", 0);
    o.scene.flags[mjRND_REFLECTION] = env("REFLECT", 0);
    o.scene.flags[mjRND_SKYBOX] = env("SKY", 0);
    o.scene.flags[mjRND_HAZE] = env("SKY", 0);
    o.scene.flags[mjRND_FOG] = 0;
    o.scene.flags[mjRND_CULL_FACE] = env("CULL", 1);
  }
  o.cameras.resize(model->ncam);
  o.pixel_store = (void (*)(unsigned, int))o.gl.function("glPixelStorei");
  o.read_pixels = (void (*)(int,int,int,int,unsigned,unsigned,void*))o.gl.function("glReadPixels");
  if (env("INVERT", 0)) o.pixel_store(kPackInvert, 1);
  o.data = mj_makeData(model);
}

Renderer::~Renderer() { close(); }

void Renderer::close() {
  if (!open_) return;
  {
    const GlContext::Current current(open_->gl);
    mjr_freeContext(&open_->context);
  }
  mjv_freeScene(&open_->scene);
  mj_deleteData(open_->data);
  open_.reset();
}

void Renderer::update(mjData* data) {
  Open& o = *open_;
  mjvCamera camera;
  mjv_defaultCamera(&camera);
  mjv_updateScene(model_, data, &o.option, nullptr, &camera, mjCAT_STATIC|mjCAT_DYNAMIC, &o.scene);
  camera.type = mjCAMERA_FIXED;
  for (int i = 0; i < model_->ncam; ++i) {
    camera.fixedcamid = i;
    mjv_updateCamera(model_, data, &camera, &o.scene);
    o.cameras[i] = {o.scene.camera[0], o.scene.camera[1]};
  }
}

void Renderer::update_from_state(std::span<const double> state) {
  Open& o = *open_;
  mj_setState(model_, o.data, state.data(), mjSTATE_INTEGRATION);
  mj_kinematics(model_, o.data);
  mj_comPos(model_, o.data);
  mj_camlight(model_, o.data);
  update(o.data);
}

void Renderer::render(int camera, const Picture& p) {
  Open& o = *open_;
  const GlContext::Current current(o.gl);
  o.scene.camera[0] = o.cameras[camera][0];
  o.scene.camera[1] = o.cameras[camera][1];
  const mjrRect r{0, 0, p.width, p.height};
  mjr_render(r, &o.scene, &o.context);
  static int mode = env("READ", 0);
  if (mode == 0) {
    mjr_readPixels(p.rgb, nullptr, r, &o.context);
    if (!env("INVERT", 0))
    for (int y = 0; y < p.height / 2; ++y)
      std::swap_ranges(p.rgb + 3 * p.width * y, p.rgb + 3 * p.width * (y + 1), p.rgb + 3 * p.width * (p.height - 1 - y));
  } else if (mode == 1) {
    o.rgba.resize(p.width * p.height);
    o.read_pixels(0, 0, p.width, p.height, 0x1908, 0x1401, o.rgba.data());
    for (int y = 0; y < p.height; ++y) {
      const uint8_t* s = (const uint8_t*)(o.rgba.data() + (p.height - 1 - y) * p.width);
      uint8_t* d = p.rgb + 3 * p.width * y;
      for (int x = 0; x < p.width; ++x) { d[3*x] = s[4*x]; d[3*x+1] = s[4*x+1]; d[3*x+2] = s[4*x+2]; }
    }
  }
}
}  // namespace rcs
