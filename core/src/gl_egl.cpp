#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <span>
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

// A display that gives OpenGL contexts, and how many there are now.
struct Screen {
  Display display = nullptr;
  Config config = nullptr;
  Surface surface = nullptr;  // only where contexts cannot do without
  int contexts = 0;
};

struct Handle {
  Screen* screen;
  Context context;
};

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
    open_screens();
  }

  void* create() override {
    const auto fewer = [](const auto& a, const auto& b) { return a->contexts < b->contexts; };
    Screen& screen = **std::min_element(screens_.begin(), screens_.end(), fewer);
    bind_api_(kOpenGlApi);  // a setting of the calling thread
    const Context context = create_context_(screen.display, screen.config, nullptr, nullptr);
    if (context == nullptr) throw GlUnavailable("EGL makes no OpenGL context (error " + error() + ")");
    ++screen.contexts;
    return new Handle{&screen, context};
  }

  void destroy(void* handle) override {
    const std::unique_ptr<Handle> owned(static_cast<Handle*>(handle));
    destroy_context_(owned->screen->display, owned->context);
    --owned->screen->contexts;
  }

  void make_current(void* handle) override {
    const auto [screen, context] = *static_cast<Handle*>(handle);
    bind_api_(kOpenGlApi);
    if (!make_current_(screen->display, screen->surface, screen->surface, context))
      throw GlUnavailable("eglMakeCurrent failed (error " + error() + "): is the context in use by another thread?");
  }

  void release(void* handle) override {
    make_current_(static_cast<Handle*>(handle)->screen->display, nullptr, nullptr, nullptr);
  }

  void* function(const char* name) const override { return get_proc_(name); }
  void publish() override { dlopen(kName, RTLD_NOW | RTLD_GLOBAL); }

 private:
  template <typename Function>
  void find(Function& function, const char* name) {
    function = reinterpret_cast<Function>(dlsym(library_, name));
    if (function == nullptr) throw GlUnavailable(std::string(kName) + " has no function " + name);
  }

  // Displays that need no window system: graphics cards, then software; the default one, an X server's, comes last.
  // Displays are shared with other users of EGL in the process, so none is ever terminated.
  void open_screens() {
    const char* client = query_string_(nullptr, kExtensions);
    const auto platform_display =
        reinterpret_cast<Display (*)(unsigned, void*, const Int*)>(get_proc_("eglGetPlatformDisplayEXT"));
    const auto query_devices = reinterpret_cast<unsigned (*)(Int, Device*, Int*)>(get_proc_("eglQueryDevicesEXT"));
    const auto query_device = reinterpret_cast<const char* (*)(Device, Int)>(get_proc_("eglQueryDeviceStringEXT"));
    std::array<Device, 16> devices{};
    Int count = 0;
    if (platform_display != nullptr && query_devices != nullptr && query_device != nullptr &&
        has_extension(client, "EGL_EXT_platform_device"))
      query_devices(static_cast<Int>(devices.size()), devices.data(), &count);
    std::vector<Display> cards, software;
    for (const Device device : std::span(devices).first(static_cast<std::size_t>(count))) {
      const bool is_software = has_extension(query_device(device, kExtensions), "EGL_MESA_device_software");
      (is_software ? software : cards).push_back(platform_display(kPlatformDevice, device, nullptr));
    }
    if (platform_display != nullptr && has_extension(client, "EGL_MESA_platform_surfaceless"))
      software.push_back(platform_display(kPlatformSurfaceless, nullptr, nullptr));

    std::string reason = "it has no display";
    for (const Display card : cards)
      if (open_screen(card, reason)) return;
    // Mesa's software renderer rasterises one picture at a time per display: two threads on one display gain 30 to 50
    // %, on two displays 100 %. So contexts are spread over both that it has. With a card about, the surfaceless
    // display may be the card's, and pictures must not depend on the thread that draws them.
    for (const Display display : software)
      if (open_screen(display, reason) && !cards.empty()) return;
    if (!screens_.empty() || open_screen(get_display_(nullptr), reason)) return;
    throw GlUnavailable(std::string(kName) + " is there, but " + reason + "; on Debian or Ubuntu: apt-get install " +
                        kPackages);
  }

  // Keep this display if it gives OpenGL contexts; else say why not.
  bool open_screen(Display display, std::string& reason) {
    if (display == nullptr || !initialize_(display, nullptr, nullptr)) {
      reason = "no display without a window system can be initialised (error " + error() + ")";
      return false;
    }
    auto screen = std::make_unique<Screen>(Screen{.display = display});
    const std::array wanted{kSurfaceType, kPbufferBit, kRenderableType, kOpenGlBit, kNone};
    Int count = 0;
    if (!choose_config_(display, wanted.data(), &screen->config, 1, &count) || count == 0) {
      reason = "no display offers OpenGL off screen (error " + error() + ")";
      return false;
    }
    bind_api_(kOpenGlApi);
    const Context trial = create_context_(display, screen->config, nullptr, nullptr);
    if (trial == nullptr) {
      reason = "no display makes an OpenGL context (error " + error() + ")";
      return false;
    }
    destroy_context_(display, trial);
    if (!has_extension(query_string_(display, kExtensions), "EGL_KHR_surfaceless_context")) {
      const std::array size{kWidth, 16, kHeight, 16, kNone};
      screen->surface = create_pbuffer_(display, screen->config, size.data());
    }
    screens_.push_back(std::move(screen));
    return true;
  }

  std::string error() const {
    std::array<char, 16> text{};
    std::snprintf(text.data(), text.size(), "0x%x", static_cast<unsigned>(get_error_()));
    return text.data();
  }

  void* library_;
  std::vector<std::unique_ptr<Screen>> screens_;
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
