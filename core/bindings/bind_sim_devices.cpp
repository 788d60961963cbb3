// SimArm and SimGripper: the devices of one copy of a world.
#include <nanobind/nanobind.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "rcs/sim_devices.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_sim_devices(nb::module_& m) {
  nb::class_<rcs::SimArm, rcs::Arm>(m, "SimArm", "The arm of one copy of a world. Time passes only in `World.advance`.")
      .def(nb::init<std::string, rcs::ArmLimits, std::shared_ptr<rcs::World>, int, std::shared_ptr<rcs::Motion>>(),
           "name"_a, "limits"_a, "world"_a, "copy"_a, "motion"_a,
           "The motion leads the joints to their target; it is added to the world.");
  nb::class_<rcs::GripperMap>(m, "GripperMap", "How the opening of a gripper relates to its model.")
      .def(nb::init<double, double, double, double>(), "joint_closed"_a, "joint_open"_a, "ctrl_closed"_a,
           "ctrl_open"_a);
  nb::class_<rcs::SimGripper, rcs::Gripper>(m, "SimGripper", "The gripper of one copy of a world.")
      .def(nb::init<std::string, double, double, std::shared_ptr<rcs::World>, int, std::vector<int>, int,
                    rcs::GripperMap>(),
           "name"_a, "max_width"_a, "max_force"_a, "world"_a, "copy"_a, "joints"_a, "actuator"_a, "map"_a);
}
