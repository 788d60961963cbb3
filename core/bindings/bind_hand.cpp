// Hand: the interface with many normalised joints.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "overrides.hpp"
#include "rcs/hand.hpp"

using namespace nb::literals;

namespace {

struct PyHand : PyDevice<rcs::Hand> {
  using PyDevice::PyDevice;
  rcs::HandState do_state() override { return call<rcs::HandState>("_state", "a HandState"); }
  void do_command_joints(std::span<const double> joints) override { call<void>("_command_joints", "None", joints); }
  bool do_has_arrived() override { return call<bool>("_has_arrived", "a bool"); }
  void do_hold() override { call<void>("_hold", "None"); }
};

}  // namespace

void bind_hand(nb::module_& m) {
  nb::class_<rcs::HandState>(m, "HandState", "What a hand measures.")
      .def(nb::init<std::vector<double>, double>(), "joints"_a, "time"_a)
      .def_prop_ro(
          "joints", [](const rcs::HandState& s) { return to_array(s.joints); }, nb::rv_policy::move,
          "Normalised joints, 0 … 1.")
      .def_ro("time", &rcs::HandState::time, "When it was measured [s].");
  nb::class_<rcs::Hand, rcs::Device, PyHand>(
      m, "Hand",
      "One multi-fingered hand. Subclasses override `_state`, `_command_joints`, "
      "`_has_arrived`, `_hold` and, where needed, `_open`, `_recover`, `_close`.")
      .def(nb::init<std::string, int>(), "name"_a, "joint_count"_a)
      .def_prop_ro("joint_count", &rcs::Hand::joint_count)
      .def("state", &rcs::Hand::state, WithoutGil())
      .def(
          "command_joints",
          [](rcs::Hand& hand, const Vector& joints) {
            const std::vector<double> target = to_vector(joints);
            const ReleasedGil released;
            hand.command_joints(target);
          },
          "joints"_a, "Set every joint (normalised, 0 … 1) and return at once. Raises as `Arm.command_joints` does.")
      .def("has_arrived", &rcs::Hand::has_arrived, WithoutGil())
      .def("hold", &rcs::Hand::hold, WithoutGil());
}
