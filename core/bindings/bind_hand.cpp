// Hand: the interface with many normalised joints.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>
#include <nanobind/trampoline.h>

#include "arrays.hpp"
#include "rcs/hand.hpp"

using namespace nb::literals;

namespace {

struct PyHand : rcs::Hand {
  NB_TRAMPOLINE(rcs::Hand);
  void do_open() override { NB_OVERRIDE_NAME("_open", do_open); }
  rcs::HandState do_state() override { NB_OVERRIDE_PURE_NAME("_state", do_state); }
  void do_command_joints(std::span<const double> joints) override {
    nb::detail::ticket ticket(nb_trampoline, "_command_joints", nb::detail::str_hash("_command_joints"), true);
    nb_trampoline.base().attr(ticket.key)(to_array(joints));
  }
  bool do_has_arrived() override { NB_OVERRIDE_PURE_NAME("_has_arrived", do_has_arrived); }
  void do_hold() override { NB_OVERRIDE_PURE_NAME("_hold", do_hold); }
  void do_recover() override { NB_OVERRIDE_NAME("_recover", do_recover); }
  void do_close() override { NB_OVERRIDE_NAME("_close", do_close); }
};

}  // namespace

void bind_hand(nb::module_& m) {
  nb::class_<rcs::HandState>(m, "HandState", "What a hand measures.")
      .def(nb::init<std::vector<double>, double>(), "joints"_a, "time"_a)
      .def_prop_ro(
          "joints", [](const rcs::HandState& s) { return to_array(s.joints); }, nb::rv_policy::move,
          "Normalised joints, 0 … 1.")
      .def_ro("time", &rcs::HandState::time, "When it was measured [s].");
  nb::class_<rcs::Hand, PyHand>(m, "Hand",
                                "One multi-fingered hand. Subclasses override `_state`, `_command_joints`, "
                                "`_has_arrived`, `_hold` and, where needed, `_open`, `_recover`, `_close`.")
      .def(nb::init<std::string, int>(), "name"_a, "joint_count"_a)
      .def_prop_ro("name", &rcs::Hand::name)
      .def_prop_ro("joint_count", &rcs::Hand::joint_count)
      .def_prop_ro("is_open", &rcs::Hand::is_open)
      .def_prop_ro("fault", &rcs::Hand::fault)
      .def(
          "_open", [](rcs::Hand&) {}, "Connect; nothing unless overridden.")
      .def(
          "_recover", [](rcs::Hand&) {}, "Leave the device's own fault state; nothing unless overridden.")
      .def(
          "_close", [](rcs::Hand&) {}, "Let go of the device; nothing unless overridden.")
      .def("open", &rcs::Hand::open, "Connect. Nothing moves.")
      .def("state", &rcs::Hand::state)
      .def(
          "command_joints", [](rcs::Hand& hand, Vector joints) { hand.command_joints(to_span(joints)); }, "joints"_a,
          "Set every joint (normalised, 0 … 1) and return at once. Raises as `Arm.command_joints` does.")
      .def("has_arrived", &rcs::Hand::has_arrived)
      .def("hold", &rcs::Hand::hold)
      .def("set_fault", &rcs::Hand::set_fault, "reason"_a)
      .def("recover", &rcs::Hand::recover)
      .def("close", &rcs::Hand::close, "Hold and let go of the device. Closing twice is harmless.");
}
