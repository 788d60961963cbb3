// Measurements after a step, and the reaction to collisions that is built on them.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "mujoco_objects.hpp"
#include "rcs/collision.hpp"
#include "rcs/measurement.hpp"

using namespace nb::literals;

void bind_measurement(nb::module_& m) {
  nb::class_<rcs::ArmBody>(m, "ArmBody",
                           "A serial arm in a model, and what presses on it from outside: contacts with anything but "
                           "the arm and its tool, and the forces of `xfrc_applied`.")
      .def(
          "__init__",
          [](rcs::ArmBody* self, const PyModel& model, std::vector<int> joints, int tcp_site, int frame_body) {
            new (self) rcs::ArmBody(model.get(), std::move(joints), tcp_site, frame_body);
          },
          "model"_a, "joints"_a, "tcp_site"_a, "frame_body"_a,
          "Joint ids from base to tip, the TCP's site, and the body whose axes wrenches have.");
  nb::class_<rcs::Measurement>(m, "Measurement", "Values that a world reads out of every copy after each step.")
      .def_prop_ro("size", &rcs::Measurement::size, "Number of values.");
  nb::class_<rcs::ArmLoads, rcs::Measurement>(m, "ArmLoads",
                                              "The torques of an arm's drives [Nm], then force [N] and moment about "
                                              "the TCP [Nm] of what presses on its tool, in "
                                              "the axes of the frame body.")
      .def(nb::init<rcs::ArmBody>(), "arm"_a);
  nb::class_<rcs::FingerContacts, rcs::Measurement>(
      m, "FingerContacts",
      "Which fingers touch something with at least a force [N] (1 or 0 each), then whether two of them touch the same "
      "object.")
      .def(
          "__init__",
          [](rcs::FingerContacts* self, const PyModel& model, const std::vector<Flags>& fingers, const Flags& own,
             double force) {
            std::vector<std::vector<std::uint8_t>> flags;
            for (const Flags& finger : fingers) flags.push_back(to_flags(finger));
            new (self) rcs::FingerContacts(model.get(), flags, to_flags(own), force);
          },
          "model"_a, "fingers"_a, "own"_a, "force"_a,
          "One uint8 flag per geom for each finger, and for the robot's own geoms, which do not count as touched.");
  nb::class_<rcs::FreeBodyVelocity, rcs::Measurement>(
      m, "FreeBodyVelocity",
      "Velocity [m/s] of the origin of a body with a free joint, then its angular velocity [rad/s], in the axes of a "
      "frame body that stands still.")
      .def(
          "__init__",
          [](rcs::FreeBodyVelocity* self, const PyModel& model, int joint, int frame_body) {
            new (self) rcs::FreeBodyVelocity(model.get(), joint, frame_body);
          },
          "model"_a, "joint"_a, "frame_body"_a, "The ids of the joint and of the body whose axes the values have.");
  nb::class_<rcs::CollisionReaction, rcs::StepCallback>(m, "CollisionReaction",
                                                        "True when what presses on an arm is more than a limit.")
      .def(
          "__init__",
          [](rcs::CollisionReaction* self, rcs::ArmBody arm, std::vector<double> torques, std::array<double, 6> wrench,
             bool is_of_drives, double time_constant, double duration, int copies) {
            new (self) rcs::CollisionReaction(
                std::move(arm), {std::move(torques), wrench, is_of_drives, time_constant, duration}, copies);
          },
          "arm"_a, "torques"_a, "wrench"_a, "is_of_drives"_a, "time_constant"_a, "duration"_a, "copies"_a,
          "Limits per joint [Nm] and of force and moment [N, Nm]; the filter's time constant and how long a limit must "
          "be exceeded [s].")
      .def(
          "cause",
          [](const rcs::CollisionReaction& self, int copy) {
            const auto cause = self.cause(copy);
            return std::pair(cause.index, cause.load);
          },
          "copy"_a, "Which limit was exceeded (joints, then the wrench's six), or -1, and by which load.");
}
