#include "rcs/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "coarse_shapes.hpp"
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
  std::vector<mjvGeom> all;
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
  vis.global.offwidth = env("OFFW", 1);
  vis.global.offheight = env("OFFW", 1);
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
  if (options.quality == Quality::fast && env("COARSE", 1)) use_coarse_shapes(o.context, o.gl, env("CS", 16), env("CT", 3));
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
  o.all.assign(o.scene.geoms, o.scene.geoms + o.scene.ngeom);
  if (env("MATID", 1)) for (auto& g : o.all) if (g.matid >= 0 && o.context.mat_texid[mjNTEXROLE * g.matid + mjTEXROLE_RGB] < 0) g.matid = -1;
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
  if (p.width > o.context.offWidth || p.height > o.context.offHeight)
    mjr_resizeOffscreen(std::max(p.width, o.context.offWidth), std::max(p.height, o.context.offHeight), &o.context);
  static int dm = env("DEPTHFMT", 0), lastw = 0;
  if (dm && lastw != p.width) {
    lastw = p.width;
    auto bindrb = (void(*)(unsigned,unsigned))o.gl.function("glBindRenderbuffer");
    auto store = (void(*)(unsigned,unsigned,int,int))o.gl.function("glRenderbufferStorage");
    auto attach = (void(*)(unsigned,unsigned,unsigned,unsigned))o.gl.function("glFramebufferRenderbuffer");
    auto check = (unsigned(*)(unsigned))o.gl.function("glCheckFramebufferStatus");
    bindrb(0x8D41, o.context.offDepthStencil); store(0x8D41, dm, o.context.offWidth, o.context.offHeight);
    mjr_setBuffer(mjFB_OFFSCREEN, &o.context);
    if (dm == 0x81A5 || dm == 0x81A6 || dm == 0x8CAC) { attach(0x8D40, 0x8D20, 0x8D41, 0); attach(0x8D40, 0x8D00, 0x8D41, o.context.offDepthStencil); }
    printf("%x status %x\n", dm, check(0x8D40));
  }
  {
    const mjvGLCamera& c = o.scene.camera[0];
    double hh = 0.5 * (c.frustum_top - c.frustum_bottom);
    double hw = c.frustum_width ? c.frustum_width : hh * p.width / p.height;
    double right[3]; 
    right[0] = c.forward[1]*c.up[2]-c.forward[2]*c.up[1]; right[1]=c.forward[2]*c.up[0]-c.forward[0]*c.up[2]; right[2]=c.forward[0]*c.up[1]-c.forward[1]*c.up[0];
    double n = c.frustum_near;
    double cy = 0.5 * (c.frustum_top + c.frustum_bottom);
    double kx0 = (c.frustum_center - hw) / n, kx1 = (c.frustum_center + hw) / n, ky0 = (cy - hh) / n, ky1 = (cy + hh) / n;
    int k = 0; static std::vector<std::pair<double,int>> ord; ord.clear();
    for (auto& g : o.all) {
      if (env("CULLF", 1) && g.modelrbound > 0) {
        double v[3] = {g.pos[0]-c.pos[0], g.pos[1]-c.pos[1], g.pos[2]-c.pos[2]};
        double z = mju_dot3(v, std::array<double,3>{c.forward[0],c.forward[1],c.forward[2]}.data());
        double x = mju_dot3(v, right), y = mju_dot3(v, std::array<double,3>{c.up[0],c.up[1],c.up[2]}.data());
        double R = g.modelrbound + 1e-3;
        if (z < n - R || x - kx1*z > R*std::sqrt(1+kx1*kx1) || kx0*z - x > R*std::sqrt(1+kx0*kx0) || y - ky1*z > R*std::sqrt(1+ky1*ky1) || ky0*z - y > R*std::sqrt(1+ky0*ky0)) continue;
      }
      if (env("SORT",0)) { double z=1e9; if (g.modelrbound > 0) z = g.modelrbound > .5 ? 1e8 : -g.modelrbound + (g.pos[0]-c.pos[0])*c.forward[0]+(g.pos[1]-c.pos[1])*c.forward[1]+(g.pos[2]-c.pos[2])*c.forward[2]; ord.push_back({z, int(&g-o.all.data())}); }
      else o.scene.geoms[k++] = g;
    }
    if (env("SORT",0)) { std::stable_sort(ord.begin(), ord.end()); for (auto& e : ord) o.scene.geoms[k++] = o.all[e.second]; }
    o.scene.ngeom = k;
    static int shown = 0; if (env("V",0) && shown++ < 2) printf("%d of %zu\n", k, o.all.size());
  }
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
