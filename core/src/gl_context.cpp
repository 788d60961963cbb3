#include "rcs/gl_context.hpp"

#include <dlfcn.h>

#include <cstdint>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

#include "gl_library.hpp"

namespace rcs {

namespace {

// OpenGL's numbers (Khronos registry).
constexpr unsigned kRenderer = 0x1F01, kVersion = 0x1F02, kExtensions = 0x1F03, kMaxRenderbufferSize = 0x84E8;

std::mutex g_mutex;    // guards the opened libraries and the choice
std::string g_chosen;  // the backend of this process, once there is one

thread_local GlContext* t_current = nullptr;

// Sets LP_NUM_THREADS to 0 for its own lifetime, unless the user has set it. Mesa reads it when it opens a display,
// OSMesa with its first context.
class RasteriseInCallingThread {
 public:
  RasteriseInCallingThread() : is_ours_(std::getenv(kName) == nullptr) {
    if (is_ours_) setenv(kName, "0", 0);
  }
  ~RasteriseInCallingThread() {
    if (is_ours_) unsetenv(kName);
  }
  RasteriseInCallingThread(const RasteriseInCallingThread&) = delete;
  RasteriseInCallingThread& operator=(const RasteriseInCallingThread&) = delete;

 private:
  static constexpr const char* kName = "LP_NUM_THREADS";
  bool is_ours_;
};

GlLibrary& open_backend(const std::string& backend) {
  // Never freed: a context may outlive every static object when the interpreter exits.
  static auto& opened = *new std::map<std::string, std::unique_ptr<GlLibrary>>();
  std::unique_ptr<GlLibrary>& library = opened[backend];
  if (!library) library = backend == "egl" ? open_egl() : open_osmesa();
  return *library;
}

struct Capabilities {
  std::string description;
  std::string extensions;
  int max_size = 0;
};

// The needs of MuJoCo's renderer are checked before it is made: it ends the process when something is missing.
Capabilities check_capabilities(GlLibrary& library) {
  const auto get_string = reinterpret_cast<const char* (*)(unsigned)>(library.function("glGetString"));
  const auto get_integer = reinterpret_cast<void (*)(unsigned, std::int32_t*)>(library.function("glGetIntegerv"));
  if (get_string == nullptr || get_integer == nullptr || get_string(kVersion) == nullptr)
    throw GlUnavailable("the OpenGL found does not answer");
  const std::string version = get_string(kVersion);
  Capabilities found;
  found.description = std::string(get_string(kRenderer)) + ", OpenGL " + version.substr(0, version.find(' '));
  get_integer(kMaxRenderbufferSize, &found.max_size);
  const char* extensions = get_string(kExtensions);
  found.extensions = " " + std::string(extensions == nullptr ? "" : extensions) + " ";
  for (const char* needed : {"GL_ARB_framebuffer_object", "GL_ARB_vertex_buffer_object"})
    if (found.extensions.find(" " + std::string(needed) + " ") == std::string::npos)
      throw GlUnavailable("the OpenGL found (" + found.description + ") lacks " + needed + ", which MuJoCo needs");
  return found;
}

// Make a context, look at it, and hand it over; or drop it when it will not do.
std::pair<void*, Capabilities> make_context(GlLibrary& library) {
  void* context = library.create();
  try {
    library.make_current(context);
    Capabilities found = check_capabilities(library);
    library.release(context);
    return {context, std::move(found)};
  } catch (...) {
    library.release(context);
    library.destroy(context);
    throw;
  }
}

// The backends to try, in order. libmujoco takes its functions from the first of EGL and OSMesa that another part of
// the process has made global, so drawing with the other one would call into the wrong library.
std::vector<std::string> candidates(const std::string& backend) {
  const bool has_egl = dlsym(RTLD_DEFAULT, "eglGetProcAddress") != nullptr;
  const bool has_osmesa = dlsym(RTLD_DEFAULT, "OSMesaGetProcAddress") != nullptr;
  const std::string settled = !g_chosen.empty() ? g_chosen : has_egl ? "egl" : has_osmesa ? "osmesa" : "";
  if (settled.empty()) return backend == "auto" ? std::vector<std::string>{"egl", "osmesa"} : std::vector{backend};
  if (backend == "auto" || backend == settled) return {settled};
  throw std::invalid_argument("OpenGL backend \"" + backend + "\" was asked for, but this process draws with \"" +
                              settled +
                              "\" already and MuJoCo can use one per process; ask for \"auto\" or start a new process");
}

}  // namespace

void* open_gl_library(std::initializer_list<const char*> names, const char* packages) {
  std::string reason;  // of the first name, the one to install
  for (const char* name : names) {
    if (void* library = dlopen(name, RTLD_NOW | RTLD_LOCAL)) return library;
    if (const char* error = dlerror(); reason.empty()) reason = error == nullptr ? name : error;
  }
  throw GlUnavailable(reason + "; on Debian or Ubuntu: apt-get install " + packages);
}

std::vector<GlProbe> probe_gl() {
  const std::lock_guard lock(g_mutex);
  std::vector<GlProbe> probes;
  for (const char* name : {"egl", "osmesa"}) {
    GlProbe& probe = probes.emplace_back(GlProbe{name, false, ""});
    try {
      const RasteriseInCallingThread setting;
      GlLibrary& library = open_backend(name);
      auto [context, found] = make_context(library);
      library.destroy(context);
      probe.ok = true;
      probe.detail = found.description;
    } catch (const GlUnavailable& error) {
      probe.detail = error.what();
    }
  }
  return probes;
}

GlContext::GlContext(const std::string& backend) {
  if (backend != "auto" && backend != "egl" && backend != "osmesa")
    throw std::invalid_argument("there is no OpenGL backend \"" + backend + "\"; known: auto, egl, osmesa");
  const std::lock_guard lock(g_mutex);
  std::string reasons;
  for (const std::string& name : candidates(backend)) {
    try {
      const RasteriseInCallingThread setting;
      GlLibrary& library = open_backend(name);
      auto [context, found] = make_context(library);
      library.publish();
      g_chosen = name;
      backend_ = name;
      description_ = found.description;
      extensions_ = found.extensions;
      max_size_ = found.max_size;
      library_ = &library;
      handle_ = context;
      return;
    } catch (const GlUnavailable& error) {
      reasons += "\n  " + name + ": " + error.what();
    }
  }
  throw GlUnavailable("No OpenGL to draw with:" + reasons);
}

GlContext::~GlContext() {
  const std::lock_guard lock(g_mutex);
  library_->destroy(handle_);
}

void* GlContext::function(const char* name) const { return library_->function(name); }

GlContext::Current::Current(GlContext& context) : context_(context), outer_(t_current) {
  if (outer_ == &context_) return;
  context_.library_->make_current(context_.handle_);
  t_current = &context_;
}

GlContext::Current::~Current() {
  if (outer_ == &context_) return;
  if (outer_ == nullptr)
    context_.library_->release(context_.handle_);
  else
    outer_->library_->make_current(outer_->handle_);
  t_current = outer_;
}

}  // namespace rcs
