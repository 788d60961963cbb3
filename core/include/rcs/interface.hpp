// The version of the device interfaces, and what makes their classes visible from one library to another.
#pragma once

/// Counts the changes after which a device has to be compiled anew, or hosts and programs would misread each other.
#ifndef RCS_INTERFACE_VERSION
#define RCS_INTERFACE_VERSION 5
#endif

#define RCS_API __attribute__((visibility("default")))

namespace rcs {

inline constexpr int kInterfaceVersion = RCS_INTERFACE_VERSION;

/// Throw `InvalidSetup` when the caller was compiled for another version of the interfaces than this library.
///
/// The caller's version is that of the headers it was compiled with, through the default value. Every device checks it
/// when it is made; a Python module calls this first, so that its import fails.
RCS_API void require_interface(int built_for = RCS_INTERFACE_VERSION);

}  // namespace rcs
