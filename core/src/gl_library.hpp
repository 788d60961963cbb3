// The interface of a backend of `GlContext`. Private to the sources.
#pragma once

#include <initializer_list>
#include <memory>

#include "rcs/gl_context.hpp"

namespace rcs {

/// The library of one backend: opened once per process and kept, for drivers do not like being unloaded.
class GlLibrary {
 public:
  virtual ~GlLibrary() = default;
  /// One call at a time of these two, the others from any thread.
  virtual void* create() = 0;
  virtual void destroy(void* context) = 0;
  virtual void make_current(void* context) = 0;
  virtual void release(void* context) = 0;
  virtual void* function(const char* name) const = 0;
  /// Make the library's symbols global: there libmujoco looks for its OpenGL functions.
  virtual void publish() = 0;
};

/// Open a backend. Throws `GlUnavailable` with the reason and the remedy.
std::unique_ptr<GlLibrary> open_egl();
std::unique_ptr<GlLibrary> open_osmesa();

/// Handle of the first of `names` that can be opened, symbols kept local. Throws `GlUnavailable` naming the `packages`.
void* open_gl_library(std::initializer_list<const char*> names, const char* packages);

}  // namespace rcs
