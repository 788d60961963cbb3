// Device: what arms, grippers, hands and cameras share.
#include <nanobind/nanobind.h>

#include <unordered_set>

#include "overrides.hpp"
#include "rcs/device.hpp"

using namespace nb::literals;

namespace {

/// Keep a device alive while it is open: nobody could stop one that is gone.
void keep(nb::handle device, bool is_open) {
  static auto* kept = new std::unordered_set<PyObject*>;  // never destroyed: the end of Python comes first
  if (is_open ? kept->insert(device.ptr()).second : kept->erase(device.ptr()) > 0)
    is_open ? device.inc_ref() : device.dec_ref();
}

void call_and_keep(nb::handle_t<rcs::Device> self, void (rcs::Device::*call)()) {
  auto& device = nb::cast<rcs::Device&>(self);
  const nb::object alive = nb::borrow(self);
  struct Keep {
    nb::handle self;
    rcs::Device& device;
    ~Keep() { keep(self, device.is_open()); }
  } const afterwards{self, device};
  const ReleasedGil released;
  (device.*call)();
}

void open_device(nb::handle_t<rcs::Device> self) {
  call_and_keep(self, &rcs::Device::open);
  if (nb::cast<rcs::Device&>(self).moves()) nb::module_::import_("rcs.devices.ending").attr("hold_at_the_end")();
}
void close_device(nb::handle_t<rcs::Device> self) { call_and_keep(self, &rcs::Device::close); }

}  // namespace

void bind_device(nb::module_& m) {
  nb::class_<rcs::Device>(
      m, "Device",
      "Base class of all devices: a name, a connection, and a fault that stays until `recover`.\n\n`name`, `is_open`, "
      "`is_guided`, `fault`, `hold` and `set_fault` may be used from any thread at any time, also while\nanother call "
      "is under way. All other calls are for one thread at a time. No call keeps other threads from running. An\nopen "
      "device stays alive until it is closed; `with device:` opens and closes it.\n\nAn error that a function of "
      "a driver raises is the device's fault, in its words, and reaches the caller as DeviceFault.\nErrors of "
      "`rcs.errors` pass as they are; a DeviceFault that a driver raises says the fault.\n\nWhen the program ends, by "
      "SIGTERM, by an exception or without a `close`, every open device that moves holds.")
      .def_prop_ro("name", &rcs::Device::name)
      .def_prop_ro("is_open", &rcs::Device::is_open, "Whether the device is connected.")
      .def_prop_ro("fault", &rcs::Device::fault, "The reason of the fault state, empty when there is none.")
      .def_prop_ro("can_guide", &rcs::Device::can_guide, WithoutGil(), "Whether a person can move it by hand.")
      .def_prop_ro("is_guided", &rcs::Device::is_guided, "Whether a person may move it by hand now.")
      // An optional override must exist in the base class: nanobind takes a name that it finds nowhere for an error.
      .def(
          "_open", [](rcs::Device&) {},
          "Connect, and energise nothing; nothing unless overridden. After a failure follows `_close`.")
      .def(
          "_can_guide", [](rcs::Device&) { return false; },
          "Whether a person can move it by hand; no unless overridden.")
      .def(
          "_guide", [](rcs::Device&) {}, "Give way to a person's hand until `_hold`; nothing unless overridden.")
      .def(
          "_recover", [](rcs::Device&) {},
          "Leave the device's own fault state, in which it may refuse to hold; nothing unless overridden.")
      .def(
          "_close", [](rcs::Device&) {},
          "Let go of all that `_open` took, or of the part that it had when it failed; nothing unless overridden.")
      .def("open", &open_device,
           "Connect, and read what the device is and where.\n\nNothing is energised and nothing moves: the first "
           "command does that, from the measured state. When it fails, the\ndevice is closed again. Opening an open "
           "device does nothing.")
      .def("hold", &rcs::Device::hold, WithoutGil(),
           "Stop where the device is now and stay there.\n\nOne that no command has energised stays as it is. Allowed "
           "in the fault state.")
      .def("has_arrived", &rcs::Device::has_arrived, WithoutGil(),
           "Whether the last target is reached and the device stands still.")
      .def("guide", &rcs::Device::guide, WithoutGil(), "on"_a,
           "Let a person move the device by hand, or hold it again.\n\nWhile it is guided, commands raise WrongOrder; "
           "`hold`, a fault and `close` end it. Raises InvalidAction when the device\ncannot be guided.")
      .def(
          "set_fault", &rcs::Device::set_fault, WithoutGil(), "reason"_a,
          "Enter the fault state and hold: commands are refused until `recover`.\n\nThe first reason stays; if holding "
          "fails, the fault says that too, and nothing is raised. A driver that looks for\nfaults reads the "
          "controller's mode, not its error flags: those may be clear while it still refuses to move.")
      .def("recover", &rcs::Device::recover, WithoutGil(),
           "Have the device leave its own fault state, hold where it is now, and only then forget the fault.\n\nRaises "
           "DeviceFault if one of these fails or a new fault comes meanwhile; the device is then in the fault state.")
      .def("close", &close_device,
           "Hold and let go of the device. Closing twice is harmless.\n\nA failure is a fault and is raised when all "
           "is done; nothing is raised in the fault state, which is known.")
      .def(
          "__enter__",
          [](nb::handle_t<rcs::Device> self) {
            open_device(self);
            return nb::borrow(self);
          },
          nb::sig("def __enter__(self) -> typing.Self"))
      .def(
          "__exit__", [](nb::handle_t<rcs::Device> self, nb::args) { close_device(self); },
          nb::sig("def __exit__(self, *error: object) -> None"));
  m.def("stop_all", &rcs::stop_all, WithoutGil(), "reason"_a,
        "Have every open device of this process that moves enter its fault state and hold, all at once.\n\nFrom any "
        "thread, but not from inside of a `_hold`. All refuse commands before the first one is held.");
}
