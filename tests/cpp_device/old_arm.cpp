// A module that was compiled for another version of the device interfaces: its import fails.
#include <nanobind/nanobind.h>

#include "rcs/interface.hpp"

NB_MODULE(old_arm, m) {
  m.doc() = "Not to be imported.";
  rcs::require_interface();
}
