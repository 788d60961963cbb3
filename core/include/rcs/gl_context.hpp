// OpenGL without a window, from a library found at run time: EGL where there is one, else OSMesa.
//
// libmujoco keeps one table of OpenGL functions per process, so all contexts of a process share one backend: the first
// context chooses it. A context is current in at most one thread at a time; `GlContext::Current` brackets each use.
//
// Mesa's software renderer rasterises in the thread that draws, unless the environment sets LP_NUM_THREADS:
// handing small pictures to its own threads costs up to half of the speed, and the cores belong to the render threads.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

namespace rcs {

/// The result of a look at one backend.
struct GlProbe {
  std::string name;    ///< "egl" or "osmesa"
  bool ok = false;     ///< whether a context could be made that MuJoCo can draw with
  std::string detail;  ///< renderer and version, or why not and what to do
};

/// There is no usable OpenGL; the message has the reason and the remedy for each backend.
struct GlUnavailable : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Look at every backend by making a context and dropping it. Chooses none: any may be asked for afterwards.
std::vector<GlProbe> probe_gl();

class GlLibrary;

/// One OpenGL context that draws to its own framebuffers. Any thread may make one; one thread at a time may use it.
class GlContext {
 public:
  /// `backend` is "auto" (what this process draws with already, else EGL, else OSMesa), "egl" or "osmesa".
  /// Throws `std::invalid_argument` for another name or a second backend, `GlUnavailable` when there is no OpenGL.
  explicit GlContext(const std::string& backend = "auto");
  ~GlContext();
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  const std::string& backend() const { return backend_; }
  /// Renderer and version, such as "llvmpipe (LLVM 15.0.6, 256 bits), OpenGL 4.5".
  const std::string& description() const { return description_; }
  /// Largest width and height of a framebuffer [pixels].
  int max_size() const { return max_size_; }
  bool has_extension(const std::string& name) const { return extensions_.find(" " + name + " ") != std::string::npos; }
  /// Address of an OpenGL function, null when there is none.
  void* function(const char* name) const;

  /// Makes a context current in this thread for its own lifetime; inside another one of the same context, does nothing.
  class Current {
   public:
    explicit Current(GlContext& context);
    ~Current();
    Current(const Current&) = delete;
    Current& operator=(const Current&) = delete;

   private:
    GlContext& context_;
    GlContext* outer_;
  };

 private:
  std::string backend_;
  std::string description_;
  std::string extensions_;  // each between two spaces
  int max_size_ = 0;
  GlLibrary* library_ = nullptr;
  void* handle_ = nullptr;
};

}  // namespace rcs
