#include <dlfcn.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "gl_library.hpp"

namespace rcs {

namespace {

constexpr const char* kName = "libEGL.so.1";
constexpr const char* kPackages = "libegl1 libegl-mesa0 libgl1-mesa-dri";

// Types and numbers of the stable ABI (Khronos EGL registry); with them no EGL header is needed to build.
using Display = void*;
using Config = void*;
using Surface = void*;
using Context = void*;
using Device = void*;
using Int = std::int32_t;
constexpr Int kNone = 0x3038, kSurfaceType = 0x3033, kPbufferBit = 0x1, kRenderableType = 0x3040, kOpenGlBit = 0x8;
constexpr Int kExtensions = 0x3055, kHeight = 0x3056, kWidth = 0x3057;
constexpr unsigned kOpenGlApi = 0x30A2, kPlatformDevice = 0x313F, kPlatformSurfaceless = 0x31DD;

bool has_extension(const char* extensions, const std::string& name) {
  return extensions != nullptr && (" " + std::string(extensions) + " ").find(" " + name + " ") != std::string::npos;
}

class Egl final : public GlLibrary {
 public:
  Egl() : library_(open_gl_library({kName}, kPackages)) {
    find(get_error_, "eglGetError");
    find(query_string_, "eglQueryString");
    find(get_display_, "eglGetDisplay");
    find(initialize_, "eglInitialize");
    find(choose_config_, "eglChooseConfig");
    find(create_pbuffer_, "eglCreatePbufferSurface");
    find(bind_api_, "eglBindAPI");
    find(create_context_, "eglCreateContext");
    find(destroy_context_, "eglDestroyContext");
    find(make_current_, "eglMakeCurrent");
    find(get_proc_, "eglGetProcAddress");
    std::string reason = "no display";
    for (const Display display : displays()) { reason = open_display(display); if (getenv("ONED") && screens_.size()==1) break; }
    if (!screens_.empty()) return;
    throw GlUnavailable(std::string(kName) + " is there, but " + reason + "; on Debian or Ubuntu: apt-get install " +
                        kPackages);
  }

  void* create() override {
    bind_api_(kOpenGlApi);  // a setting of the calling thread
    Screen* s = screens_[n_++ % screens_.size()].get();
    const Context context = create_context_(s->display, s->config, nullptr, nullptr);
    if (context == nullptr) throw GlUnavailable("EGL makes no OpenGL context (error " + error() + ")");
    return new Handle{s, context};
  }

  void destroy(void* context) override { Handle* h=(Handle*)context; destroy_context_(h->screen->display, h->context); }

  void make_current(void* context) override {
    bind_api_(kOpenGlApi);
    Handle* h=(Handle*)context;
    if (!make_current_(h->screen->display, h->screen->surface, h->screen->surface, h->context))
      throw GlUnavailable("eglMakeCurrent failed (error " + error() + "): is the context in use by another thread?");
  }

  void release() override { make_current_(screens_[0]->display, nullptr, nullptr, nullptr); }
  void* function(const char* name) const override { return get_proc_(name); }
  void publish() override { dlopen(kName, RTLD_NOW | RTLD_GLOBAL); }

 private:
  struct Screen { Display display=nullptr; Config config=nullptr; Surface surface=nullptr; };
  struct Handle { Screen* screen; Context context; };
  std::vector<std::unique_ptr<Screen>> screens_; int n_=0;
  template <typename Function>
  void find(Function& function, const char* name) {
    function = reinterpret_cast<Function>(dlsym(library_, name));
    if (function == nullptr) throw GlUnavailable(std::string(kName) + " has no function " + name);
  }

  // Displays that need no window system: graphics cards first, software next, the default one (an X server) last.
  std::vector<Display> displays() const {
    std::vector<Display> found;
    const char* client = query_string_(nullptr, kExtensions);
    const auto platform_display =
        reinterpret_cast<Display (*)(unsigned, void*, const Int*)>(get_proc_("eglGetPlatformDisplayEXT"));
    const auto query_devices = reinterpret_cast<unsigned (*)(Int, Device*, Int*)>(get_proc_("eglQueryDevicesEXT"));
    const auto query_device = reinterpret_cast<const char* (*)(Device, Int)>(get_proc_("eglQueryDeviceStringEXT"));
    if (platform_display != nullptr && has_extension(client, "EGL_EXT_platform_base")) {
      std::array<Device, 16> devices{};
      Int count = 0;
      if (query_devices != nullptr && query_device != nullptr && has_extension(client, "EGL_EXT_platform_device"))
        query_devices(static_cast<Int>(devices.size()), devices.data(), &count);
      for (Int i = 0; i < count; ++i)
        if (!has_extension(query_device(devices[i], kExtensions), "EGL_MESA_device_software"))
          found.push_back(platform_display(kPlatformDevice, devices[i], nullptr));
      if (has_extension(client, "EGL_MESA_platform_surfaceless"))
        found.push_back(platform_display(kPlatformSurfaceless, nullptr, nullptr));
      for (Int i = 0; i < count; ++i)
        if (has_extension(query_device(devices[i], kExtensions), "EGL_MESA_device_software"))
          found.push_back(platform_display(kPlatformDevice, devices[i], nullptr));
    }
    found.push_back(get_display_(nullptr));
    return found;
  }

  std::string open_display(Display display) {
    auto sc = std::make_unique<Screen>(); sc->display = display;
    if (display == nullptr || !initialize_(display, nullptr, nullptr)) return "x";
    const std::array wanted{kSurfaceType, kPbufferBit, kRenderableType, kOpenGlBit, kNone};
    Int count = 0;
    if (!choose_config_(display, wanted.data(), &sc->config, 1, &count) || count == 0) return "y";
    bind_api_(kOpenGlApi);
    const Context trial = create_context_(display, sc->config, nullptr, nullptr);
    if (trial == nullptr) return "z";
    destroy_context_(display, trial);
    screens_.push_back(std::move(sc));
    printf("screen %zu\n", screens_.size());
    return "";
  }

  std::string error() const {
    std::array<char, 16> text{};
    std::snprintf(text.data(), text.size(), "0x%x", static_cast<unsigned>(get_error_()));
    return text.data();
  }

  void* library_;
  Display display_ = nullptr;
  Config config_ = nullptr;
  Surface surface_ = nullptr;
  Int (*get_error_)() = nullptr;
  const char* (*query_string_)(Display, Int) = nullptr;
  Display (*get_display_)(void*) = nullptr;
  unsigned (*initialize_)(Display, Int*, Int*) = nullptr;
  unsigned (*choose_config_)(Display, const Int*, Config*, Int, Int*) = nullptr;
  Surface (*create_pbuffer_)(Display, Config, const Int*) = nullptr;
  unsigned (*bind_api_)(unsigned) = nullptr;
  Context (*create_context_)(Display, Config, Context, const Int*) = nullptr;
  unsigned (*destroy_context_)(Display, Context) = nullptr;
  unsigned (*make_current_)(Display, Surface, Surface, Context) = nullptr;
  void* (*get_proc_)(const char*) = nullptr;
};

}  // namespace

std::unique_ptr<GlLibrary> open_egl() { return std::make_unique<Egl>(); }

}  // namespace rcs
