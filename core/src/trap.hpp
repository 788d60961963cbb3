// Calls into MuJoCo whose errors become exceptions. Private to the sources.
#pragma once

#include <string>
#include <type_traits>

namespace rcs {

/// Run `work(argument)` and return whether MuJoCo was content. If not, `error` has its words, and `work` was left where
/// it stood: nothing in it may need a destructor while MuJoCo runs. Exceptions of `work` pass through.
///
/// Without a trap, an error of MuJoCo ends the process.
bool trap(void (*work)(void*), void* argument, std::string& error);

/// Throws `SimulationError` with MuJoCo's words after `what`, if there are any.
void trapped(const char* what, void (*work)(void*), void* argument);

/// The same for a lambda that captures by reference.
template <typename F>
void trapped(const char* what, F&& work) {
  trapped(what, [](void* p) { (*static_cast<std::remove_reference_t<F>*>(p))(); }, &work);
}

}  // namespace rcs
