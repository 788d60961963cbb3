// Device: what arms, grippers, hands and cameras share.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include "overrides.hpp"
#include "rcs/device.hpp"

using namespace nb::literals;

void bind_device(nb::module_& m) {
  nb::class_<rcs::Device>(
      m, "Device",
      "What all devices share: a name, a connection, and a fault that stays until `recover`.\n\n`name`, `is_open`, "
      "`fault`, `hold` (where there is one) and `set_fault` may be used from any thread at any\ntime, also while "
      "another "
      "call is under way. All other calls are for one thread at a time. No call keeps other\nthreads from running.")
      .def_prop_ro("name", &rcs::Device::name)
      .def_prop_ro("is_open", &rcs::Device::is_open, "Whether the device is connected.")
      .def_prop_ro("fault", &rcs::Device::fault, "The reason of the fault state, empty when there is none.")
      // An optional override must exist in the base class: nanobind takes a name that it finds nowhere for an error.
      .def(
          "_open", [](rcs::Device&) {}, "Connect; nothing unless overridden.")
      .def(
          "_recover", [](rcs::Device&) {},
          "Leave the device's own fault state, in which it may refuse to hold; nothing unless overridden.")
      .def(
          "_close", [](rcs::Device&) {}, "Let go of the device; nothing unless overridden.")
      .def("open", &rcs::Device::open, WithoutGil(), "Connect. Nothing moves. Opening an open device does nothing.")
      .def(
          "set_fault", &rcs::Device::set_fault, WithoutGil(), "reason"_a,
          "Enter the fault state and hold: commands are refused until `recover`.\n\nThe first reason stays; if holding "
          "fails, the fault says that too, and nothing is raised. A driver that looks for\nfaults reads the "
          "controller's mode, not its error flags: those may be clear while it still refuses to move.")
      .def("recover", &rcs::Device::recover, WithoutGil(),
           "Have the device leave its own fault state, hold where it is now, and only then forget the fault.\n\nRaises "
           "DeviceFault if one of these fails or a new fault comes meanwhile; the device is then in the fault state.")
      .def("close", &rcs::Device::close, WithoutGil(), "Hold and let go of the device. Closing twice is harmless.");
}
