// Callbacks that a world calls while it steps, and the view that they are given.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "arrays.hpp"
#include "gil.hpp"
#include "mujoco_objects.hpp"
#include "overrides.hpp"
#include "rcs/callback.hpp"
#include "rcs/motion.hpp"
#include "rcs/result.hpp"

using namespace nb::literals;

namespace {

/// A `StepView` for Python, where it may be kept beyond the call.
struct PyStepView {
  const rcs::StepView* now;  // null after the call
  const rcs::StepView& get() const {
    if (!now)
      throw rcs::WrongOrder(
          "step view: it was used after the call that it was made for; copy what you need during the call");
    return *now;
  }
};

struct PyStepCallback : rcs::StepCallback {
  NB_TRAMPOLINE(rcs::StepCallback);
  bool call(const rcs::StepView& view) override {
    const HeldGil gil;
    const nb::detail::ticket ticket = require_override(nb_trampoline, "call");
    const nb::object given = nb::cast(PyStepView{&view});
    struct Expiry {
      PyStepView& view;
      ~Expiry() { view.now = nullptr; }
    } const expiry{*nb::inst_ptr<PyStepView>(given)};
    const nb::object answer = call_python([&] { return nb_trampoline.base().attr(ticket.key)(given); });
    const int is_true = PyObject_IsTrue(answer.ptr());
    if (is_true < 0) nb::raise_python_error();
    return is_true != 0;
  }
  void reset(int copy) override {
    if (has_override(nb_trampoline, "reset")) call_override<void>(nb_trampoline, "reset", "None", copy);
  }
};

// A view of MuJoCo's memory during a callback.
View<double> data_view(const PyStepView& given, double* mjData::* first, mjtSize mjModel::* size,
                       std::size_t width = 0) {
  const rcs::StepView& view = given.get();
  const std::size_t shape[2] = {static_cast<std::size_t>(view.model->*size), width};
  return View<double>(view.data->*first, width ? 2 : 1, shape, keeper(*view.memory));
}

using Memory = In<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

double* memory_of(const rcs::Trajectory& trajectory, const Memory& memory) {
  if (memory.shape(0) != static_cast<std::size_t>(rcs::Trajectory::size(trajectory.dof())))
    throw rcs::InvalidSetup("trajectory: the memory has " + std::to_string(memory.shape(0)) + " numbers, valid are " +
                            std::to_string(rcs::Trajectory::size(trajectory.dof())));
  return memory.data();
}

void bind_trajectory(nb::module_& m) {
  nb::class_<rcs::Trajectory>(m, "Trajectory",
                              "The law of motion of an arm, in memory of the caller: what its joints do between one "
                              "target and the next. The first `dof` numbers of the memory are the target [rad].")
      .def(nb::init<rcs::MotionLimits>(), "limits"_a)
      .def_static("size", &rcs::Trajectory::size, "dof"_a, "Numbers that so many joints take.")
      .def_prop_ro_static(
          "POSITION_ROWS", [](nb::handle) { return rcs::Trajectory::position_rows(); },
          "Rows of `dof` numbers that are joint positions; where the arm stands still, all are equal and the rest is "
          "0.")
      .def_prop_ro("dof", &rcs::Trajectory::dof)
      .def(
          "follow",
          [](rcs::Trajectory& t, const Memory& memory, double period, bool is_synchronous, double share) {
            double* numbers = memory_of(t, memory);
            if (!(period > 0.0) || !(share > 0.0 && share <= 1.0))
              throw rcs::InvalidSetup("trajectory: valid are a period above 0 and a share of the acceleration up to 1");
            if (t.is_asked(numbers)) t.follow(numbers, {period, period, 0.0, is_synchronous}, share);
          },
          "memory"_a.noconvert(), "period"_a, "is_synchronous"_a = false, "share"_a = 1.0,
          "Plan the motion of a step that lasts `period` [s], or until the target is reached, with a share of the "
          "acceleration.")
      .def(
          "brake", [](rcs::Trajectory& t, const Memory& memory) { t.brake(memory_of(t, memory), 1.0); },
          "memory"_a.noconvert(), "Brake to rest, all joints together on a straight line where they can.")
      .def(
          "advance",
          [](rcs::Trajectory& t, const Memory& memory, double time) { t.advance(memory_of(t, memory), time); },
          "memory"_a.noconvert(), "time"_a, "Let time pass [s].")
      .def(
          "state",
          [](rcs::Trajectory& t, const Memory& memory, double ahead) {
            t.look(memory_of(t, memory), ahead);
            std::vector<double> all;
            for (const auto values : {t.position(), t.velocity(), t.acceleration()})
              all.insert(all.end(), values.begin(), values.end());
            return to_array(all, {3, static_cast<std::size_t>(t.dof())});
          },
          "memory"_a.noconvert(), "ahead"_a = 0.0,
          "Position, velocity and acceleration after so many seconds of the present plan, (3, dof).")
      .def(
          "remaining", [](rcs::Trajectory& t, const Memory& memory) { return t.remaining(memory_of(t, memory)); },
          "memory"_a.noconvert(), "Time until the joints stand [s]; of a stream, until the plan is used up.");
}

}  // namespace

void bind_callback(nb::module_& m) {
  nb::class_<PyStepView>(m, "StepView",
                         "One copy of a scene while it is stepped; afterwards, using it raises WrongOrder. Arrays are "
                         "views of MuJoCo's own memory and have meaning only during the call.")
      .def_prop_ro(
          "copy", [](const PyStepView& v) { return v.get().copy; }, "Which copy this is.")
      .def_prop_ro(
          "time", [](const PyStepView& v) { return v.get().data->time; }, "Simulated time [s].")
      .def_prop_ro(
          "qpos", [](const PyStepView& v) { return data_view(v, &mjData::qpos, &mjModel::nq); }, kOwned)
      .def_prop_ro(
          "qvel", [](const PyStepView& v) { return data_view(v, &mjData::qvel, &mjModel::nv); }, kOwned)
      .def_prop_ro(
          "ctrl", [](const PyStepView& v) { return data_view(v, &mjData::ctrl, &mjModel::nu); }, kOwned)
      .def_prop_ro(
          "xpos", [](const PyStepView& v) { return data_view(v, &mjData::xpos, &mjModel::nbody, 3); }, kOwned)
      .def_prop_ro(
          "site_xpos", [](const PyStepView& v) { return data_view(v, &mjData::site_xpos, &mjModel::nsite, 3); }, kOwned)
      .def_prop_ro(
          "qfrc_applied", [](const PyStepView& v) { return data_view(v, &mjData::qfrc_applied, &mjModel::nv); }, kOwned)
      .def_prop_ro(
          "xfrc_applied", [](const PyStepView& v) { return data_view(v, &mjData::xfrc_applied, &mjModel::nbody, 6); },
          kOwned)
      .def_prop_ro(
          "contacts", [](const PyStepView& v) { return v.get().data->ncon; }, "Number of contacts.")
      .def_prop_ro("model_address", [](const PyStepView& v) { return reinterpret_cast<std::uintptr_t>(v.get().model); })
      .def_prop_ro("data_address", [](const PyStepView& v) { return reinterpret_cast<std::uintptr_t>(v.get().data); });

  nb::class_<rcs::StepCallback, PyStepCallback>(
      m, "StepCallback",
      "A function run between physics steps. Subclasses override `call(view) -> bool` and, where they remember "
      "something per copy, `reset(copy)`. Copies are stepped on several threads.")
      .def(nb::init<>())
      .def(
          "reset", [](rcs::StepCallback&, int) {}, "copy"_a,
          "Forget what was remembered of a copy; its episode starts anew.");
  nb::class_<rcs::JointsArrived, rcs::StepCallback>(m, "JointsArrived",
                                                    "True when position-controlled joints stand at their targets.")
      .def(nb::init<std::vector<int>, std::vector<int>, double, double>(), "joints"_a, "actuators"_a,
           "position_tolerance"_a, "velocity_tolerance"_a, "Tolerances in rad (or m) and rad/s (or m/s).");
  nb::class_<rcs::JointsAtRest, rcs::StepCallback>(m, "JointsAtRest", "True when joints have stood still for a while.")
      .def(nb::init<std::vector<int>, double, double, int, bool>(), "joints"_a, "velocity_tolerance"_a, "duration"_a,
           "copies"_a, "within_step"_a = false,
           "Tolerance in rad/s (or m/s), duration in s. With `within_step`, rest counts from the step's beginning.");
  nb::class_<rcs::Collision, rcs::StepCallback>(
      m, "Collision", "True when a surface of one set touches one of the other with more than a force.")
      .def(
          "__init__",
          [](rcs::Collision* self, const Flags& first, const Flags& second, double force) {
            new (self) rcs::Collision(to_flags(first), to_flags(second), force);
          },
          "first"_a, "second"_a, "force"_a,
          "One uint8 flag per geom of the model, then one per flex, for each set; force in N.");
  nb::class_<rcs::MotionLimits>(m, "MotionLimits", "Limits of a motion, one value per joint.")
      .def(nb::init<std::vector<double>, std::vector<double>, std::vector<double>, std::vector<double>,
                    std::vector<double>>(),
           "lower"_a, "upper"_a, "velocity"_a, "acceleration"_a, "jerk"_a,
           "Positions in rad, then rad/s, rad/s^2 and rad/s^3.")
      .def("lead", &rcs::MotionLimits::lead, "period"_a,
           "How far a target may lead each joint [rad], when targets come every `period` [s].");
  bind_trajectory(m);
  nb::class_<rcs::Springs>(m, "Springs",
                           "Springs and dampers with which an arm gives way when it is pushed. Without numbers, the "
                           "gains of the position servos are the springs and dampers of the joints.")
      .def(
          "__init__",
          [](rcs::Springs* self, std::vector<double> stiffness, std::vector<double> damping, int site, int body) {
            new (self) rcs::Springs{std::move(stiffness), std::move(damping), site, body};
          },
          "stiffness"_a = std::vector<double>{}, "damping"_a = std::vector<double>{}, "tcp_site"_a = -1,
          "base_body"_a = -1,
          "Six numbers each, along and about x, y, z of the base: N/m, N*s/m, then Nm/rad, Nm*s/rad.");
  nb::class_<rcs::Motion, rcs::StepCallback>(
      m, "Motion",
      "Moves position servos of some joints to a target in `mjData.userdata`, within limits of velocity, acceleration "
      "and jerk. As a callback, it is true when the joints stand at their target.")
      .def(nb::init<std::vector<int>, std::vector<int>, int, rcs::MotionLimits, int, std::optional<rcs::Springs>>(),
           "joints"_a, "actuators"_a, "address"_a, "limits"_a, "copies"_a, "springs"_a = nb::none(),
           "Joint and actuator ids, base to tip, and the first of the numbers in the user data. With springs of the "
           "TCP, the actuators are motors.")
      .def_prop_ro("dof", &rcs::Motion::dof)
      .def_prop_ro("address", &rcs::Motion::address)
      .def(
          "state",
          [](rcs::Motion& motion, const PyStepView& view) {
            motion.check(view.get().model, view.get().copy + 1);
            const std::vector<double> all = motion.state(view.get().data, view.get().copy);
            return to_array(all, {3, static_cast<std::size_t>(motion.dof())});
          },
          "view"_a, "Position, velocity and acceleration that the joints are led to at present, (3, dof).");
}
