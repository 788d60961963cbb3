#include <dlfcn.h>

#include <array>
#include <cstdint>
#include <string>

#include "gl_library.hpp"

namespace rcs {

namespace {

// libOSMesa.so.8 is Mesa's name since 2012, libOSMesa.so.6 that of some older or renamed packages.
constexpr const char* kName = "libOSMesa.so.8";
constexpr const char* kOldName = "libOSMesa.so.6";
constexpr unsigned kRgba = 0x1908, kUnsignedByte = 0x1401;  // OpenGL's numbers (Khronos registry)
constexpr int kWindow = 16;

class Osmesa final : public GlLibrary {
 public:
  Osmesa() : library_(open_gl_library({kName, kOldName}, "libosmesa6")) {
    find(create_, "OSMesaCreateContextExt");
    find(destroy_, "OSMesaDestroyContext");
    find(make_current_, "OSMesaMakeCurrent");
    find(get_proc_, "OSMesaGetProcAddress");
  }

  void* create() override {
    void* context = create_(kRgba, 24, 8, 0, nullptr);
    if (context == nullptr) throw GlUnavailable("OSMesa makes no OpenGL context");
    return context;
  }

  void destroy(void* context) override { destroy_(context); }

  void make_current(void* context) override {
    // A stand-in for a window: everything is drawn to framebuffer objects, so nobody reads it.
    if (!make_current_(context, window_.data(), kUnsignedByte, kWindow, kWindow))
      throw GlUnavailable("OSMesaMakeCurrent failed");
  }

  void release(void*) override { make_current_(nullptr, nullptr, kUnsignedByte, 0, 0); }
  void* function(const char* name) const override { return get_proc_(name); }

  void publish() override {
    if (dlopen(kName, RTLD_NOW | RTLD_GLOBAL) == nullptr) dlopen(kOldName, RTLD_NOW | RTLD_GLOBAL);
  }

 private:
  template <typename Function>
  void find(Function& function, const char* name) {
    function = reinterpret_cast<Function>(dlsym(library_, name));
    if (function == nullptr) throw GlUnavailable(std::string("libOSMesa has no function ") + name);
  }

  void* library_;
  std::array<std::uint8_t, 4 * kWindow * kWindow> window_{};
  void* (*create_)(unsigned, int, int, int, void*) = nullptr;
  void (*destroy_)(void*) = nullptr;
  unsigned char (*make_current_)(void*, void*, unsigned, int, int) = nullptr;
  void* (*get_proc_)(const char*) = nullptr;
};

}  // namespace

std::unique_ptr<GlLibrary> open_osmesa() { return std::make_unique<Osmesa>(); }

}  // namespace rcs
