// World: stepping copies of a scene, and the callbacks around a step.
#include <nanobind/nanobind.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/vector.h>
#include <nanobind/trampoline.h>

#include <cstring>

#include "arrays.hpp"
#include "rcs/world.hpp"

using namespace nb::literals;

namespace {

using Ids = nb::ndarray<const int, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename T>
using View = nb::ndarray<nb::numpy, T>;

struct PyStepCallback : rcs::StepCallback {
  NB_TRAMPOLINE(rcs::StepCallback);
  bool call(const rcs::StepView& view) override {
    nb::detail::ticket ticket(nb_trampoline, "call", nb::detail::str_hash("call"), true);
    const nb::object answer = nb_trampoline.base().attr(ticket.key)(nb::cast(view));
    const int is_true = PyObject_IsTrue(answer.ptr());
    if (is_true < 0) nb::raise_python_error();
    return is_true != 0;
  }
  void reset(int copy) override { NB_OVERRIDE(reset, copy); }
};

std::span<const int> to_ids(const Ids& ids) { return {ids.data(), ids.shape(0)}; }
std::vector<std::uint8_t> to_flags(const Flags& flags) { return {flags.data(), flags.data() + flags.shape(0)}; }

// A view of a vector that belongs to the world; `self` keeps it alive.
template <typename T>
View<T> view_of(nb::handle self, std::vector<T>& values, std::vector<std::size_t> shape) {
  return View<T>(values.data(), shape.size(), shape.data(), self);
}

// An array over a state component of all copies: shape (copies, size), or (size,) on the user's own data.
View<double> component(nb::handle self, int which) {
  auto& world = nb::cast<rcs::World&>(self);
  int size = 0;
  double* first = world.component(which, &size);
  if (!first) throw nb::value_error("that state component does not exist in this model");
  const auto n = static_cast<std::size_t>(size);
  if (!world.is_batch()) {
    const std::size_t shape[1] = {n};
    return View<double>(first, 1, shape, self);
  }
  const std::size_t shape[2] = {static_cast<std::size_t>(world.copies()), n};
  const std::int64_t strides[2] = {world.row_stride(), 1};
  return View<double>(first, 2, shape, self, strides);
}

// A view of the values of a field, (copies, size).
nb::object view_of_field(nb::handle self, const rcs::ModelField& field) {
  const auto copies = static_cast<std::size_t>(nb::cast<rcs::World&>(self).copies());
  const std::size_t shape[2] = {copies, static_cast<std::size_t>(field.size)};
  return std::visit(
      [&](auto* values) { return nb::cast(View<std::remove_pointer_t<decltype(values)>>(values, 2, shape, self)); },
      field.values);
}

// A view of MuJoCo's memory during a callback.
View<double> data_view(nb::handle self, double* mjData::* first, mjtSize mjModel::* size, std::size_t width = 0) {
  const auto& view = nb::cast<const rcs::StepView&>(self);
  const std::size_t shape[2] = {static_cast<std::size_t>(view.model->*size), width};
  return View<double>(view.data->*first, width ? 2 : 1, shape, self);
}

rcs::StepTiming timing(std::int64_t numerator, std::int64_t denominator, bool is_synchronous, int max_substeps) {
  return {numerator, denominator, is_synchronous, max_substeps};
}

}  // namespace

void bind_world(nb::module_& m) {
  nb::enum_<rcs::StepEnd>(m, "StepEnd", "Why a control step of a simulation ended.")
      .value("period", rcs::StepEnd::period, "Asynchronous: one control period has passed.")
      .value("converged", rcs::StepEnd::converged, "Synchronous: every convergence callback agreed.")
      .value("interrupted", rcs::StepEnd::interrupted, "A callback interrupted the step.")
      .value("limit", rcs::StepEnd::limit, "Synchronous: the substep limit came before convergence.")
      .value("failed", rcs::StepEnd::failed, "The state left the range of finite numbers.");

  nb::class_<rcs::StepView>(m, "StepView",
                            "One copy of a scene while it is stepped. Arrays are views of MuJoCo's own memory, valid "
                            "only during the call.")
      .def_ro("copy", &rcs::StepView::copy, "Which copy this is.")
      .def_prop_ro(
          "time", [](const rcs::StepView& v) { return v.data->time; }, "Simulated time [s].")
      .def_prop_ro("qpos", [](nb::handle v) { return data_view(v, &mjData::qpos, &mjModel::nq); })
      .def_prop_ro("qvel", [](nb::handle v) { return data_view(v, &mjData::qvel, &mjModel::nv); })
      .def_prop_ro("ctrl", [](nb::handle v) { return data_view(v, &mjData::ctrl, &mjModel::nu); })
      .def_prop_ro("xpos", [](nb::handle v) { return data_view(v, &mjData::xpos, &mjModel::nbody, 3); })
      .def_prop_ro("site_xpos", [](nb::handle v) { return data_view(v, &mjData::site_xpos, &mjModel::nsite, 3); })
      .def_prop_ro("qfrc_applied", [](nb::handle v) { return data_view(v, &mjData::qfrc_applied, &mjModel::nv); })
      .def_prop_ro("xfrc_applied", [](nb::handle v) { return data_view(v, &mjData::xfrc_applied, &mjModel::nbody, 6); })
      .def_prop_ro(
          "contacts", [](const rcs::StepView& v) { return v.data->ncon; }, "Number of contacts.")
      .def_prop_ro("model_address", [](const rcs::StepView& v) { return reinterpret_cast<std::uintptr_t>(v.model); })
      .def_prop_ro("data_address", [](const rcs::StepView& v) { return reinterpret_cast<std::uintptr_t>(v.data); });

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
      .def(nb::init<std::vector<int>, double, double, int>(), "joints"_a, "velocity_tolerance"_a, "duration"_a,
           "copies"_a, "Tolerance in rad/s (or m/s), duration in s.");
  nb::class_<rcs::Collision, rcs::StepCallback>(
      m, "Collision", "True when a surface of one set touches one of the other with more than a force.")
      .def(
          "__init__",
          [](rcs::Collision* self, const Flags& first, const Flags& second, double force) {
            new (self) rcs::Collision(to_flags(first), to_flags(second), force);
          },
          "first"_a, "second"_a, "force"_a,
          "One uint8 flag per geom of the model, then one per flex, for each set; force in N.");

  nb::class_<rcs::World>(m, "World", "N copies of one MuJoCo scene, advanced together by one control step at a time.")
      .def_static(
          "on_data",
          [](std::uintptr_t model, std::uintptr_t data, std::int64_t numerator, std::int64_t denominator,
             bool is_synchronous, int max_substeps, const nb::object& /*owner*/) {
            return std::make_shared<rcs::World>(reinterpret_cast<const mjModel*>(model),
                                                reinterpret_cast<mjData*>(data),
                                                timing(numerator, denominator, is_synchronous, max_substeps));
          },
          "model_address"_a, "data_address"_a, "period_numerator"_a, "period_denominator"_a, "is_synchronous"_a,
          "max_substeps"_a, "owner"_a = nb::none(), nb::keep_alive<0, 7>(),
          "One copy, on the caller's own model and data, which must outlive the world: `owner` holds both, and the "
          "world holds `owner`.")
      .def_static(
          "of_copies",
          [](std::uintptr_t model, int copies, int threads, std::int64_t numerator, std::int64_t denominator,
             bool is_synchronous, int max_substeps) {
            return std::make_shared<rcs::World>(reinterpret_cast<const mjModel*>(model), copies, threads,
                                                timing(numerator, denominator, is_synchronous, max_substeps));
          },
          "model_address"_a, "copies"_a, "threads"_a, "period_numerator"_a, "period_denominator"_a, "is_synchronous"_a,
          "max_substeps"_a, "Many copies of a copy of the model, on `threads` threads (0: one per CPU).")
      .def_prop_ro("copies", &rcs::World::copies)
      .def_prop_ro("threads", &rcs::World::threads)
      .def_prop_ro("is_batch", &rcs::World::is_batch, "False for a world on the user's own data.")
      .def("on_period", &rcs::World::on_period, "callback"_a, "period"_a,
           "Call every `period` seconds of simulated time.")
      .def("converge_when", &rcs::World::converge_when, "callback"_a,
           "A synchronous step ends when all of these are true.")
      .def("interrupt_when", &rcs::World::interrupt_when, "callback"_a,
           "A synchronous step ends when any of these is true; an asynchronous one lasts its period and says so.")
      .def("read_pose", &rcs::World::read_pose, "site"_a, "frame_body"_a,
           "Have the pose of a site in the frame of a body read out after every call. Returns its index in `poses`.")
      .def("read_body_pose", &rcs::World::read_body_pose, "body"_a, "frame_body"_a,
           "Have the pose of a body in the frame of another read out. Returns its index in `poses`.")
      .def(
          "read_force",
          [](rcs::World& w, const Flags& first, const Flags& second) {
            return w.read_force(to_flags(first), to_flags(second));
          },
          "first"_a, "second"_a,
          "Have the normal force between two sets of surfaces read out: one uint8 flag per geom, then, where soft "
          "bodies "
          "count too, one per flex. Returns its index.")
      .def("read_opening", &rcs::World::read_opening, "joints"_a, "closed"_a, "open"_a,
           "Have the mean position of joints read out as 0 at `closed` … 1 at `open`. Returns its index in `openings`.")
      .def("keep_initial_state", &rcs::World::keep_initial_state, "copy"_a = 0,
           "Take the present state of `copy` as the one that `reset` returns to, for all copies.")
      .def(
          "reset", [](rcs::World& w) { w.reset(); }, "Return all copies to the initial state.")
      .def(
          "reset",
          [](rcs::World& w, const Ids& ids) {
            if (ids.shape(0)) w.reset(to_ids(ids));
          },
          "copies"_a, "Return some copies (int32 ids) to the initial state.")
      .def(
          "refresh", [](rcs::World& w) { w.refresh(); }, nb::call_guard<nb::gil_scoped_release>(),
          "Recompute the readouts of all copies after the state was written to.")
      .def(
          "refresh",
          [](rcs::World& w, const Ids& ids) {
            if (!ids.shape(0)) return;
            const nb::gil_scoped_release release;
            w.refresh(to_ids(ids));
          },
          "copies"_a, "Recompute the readouts of some copies.")
      .def(
          "advance", [](rcs::World& w) { w.advance(); }, nb::call_guard<nb::gil_scoped_release>(),
          "Advance all copies by one control step. The GIL is released.")
      .def(
          "advance",
          [](rcs::World& w, const Ids& ids) {
            if (!ids.shape(0)) return;
            const nb::gil_scoped_release release;
            w.advance(to_ids(ids));
          },
          "copies"_a, "Advance some copies by one control step.")
      .def_prop_ro("state_size", &rcs::World::state_size, "Number of values of mjSTATE_INTEGRATION.")
      .def(
          "get_state",
          [](const rcs::World& w, int copy) {
            std::vector<double> state(static_cast<std::size_t>(w.state_size()));
            w.get_state(copy, state);
            return to_array(state);
          },
          "copy"_a = 0, "The whole integration state of one copy, (state_size,).")
      .def(
          "set_state", [](rcs::World& w, Vector state, int copy) { w.set_state(copy, to_span(state)); }, "state"_a,
          "copy"_a = 0, "Write the whole integration state of one copy.")
      .def_prop_ro(
          "states",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            if (!w.is_batch()) throw nb::attribute_error("a world on the user's data has no state rows; use get_state");
            const std::size_t shape[2] = {static_cast<std::size_t>(w.copies()),
                                          static_cast<std::size_t>(w.state_size())};
            return View<double>(w.states(), 2, shape, self);
          },
          "Live state rows (copies, state_size) of a batch.")
      .def(
          "component", [](nb::handle self, int which) { return component(self, which); }, "which"_a,
          "Live array of one mjtState component: (copies, n), or (n,) for a world on the user's own data.")
      .def(
          "expand",
          [](nb::handle self, const char* field) {
            return view_of_field(self, nb::cast<rcs::World&>(self).expand(field));
          },
          "field"_a, nb::sig("def expand(self, field: str) -> numpy.typing.NDArray[typing.Any]"),
          "Give a field of MjModel values per copy; returns them, (copies, size), to write to.")
      .def(
          "expanded",
          [](nb::handle self, const char* field) -> nb::object {
            const auto found = nb::cast<rcs::World&>(self).expanded(field);
            return found ? view_of_field(self, *found) : nb::none();
          },
          "field"_a, nb::sig("def expanded(self, field: str) -> numpy.typing.NDArray[typing.Any] | None"),
          "The values per copy of a field of MjModel that has them, (copies, size); None for one that has not.")
      .def_prop_ro("is_varied", &rcs::World::is_varied, "Whether any field of the model has values per copy.")
      .def(
          "set_constants", [](rcs::World& w) { w.set_constants(); }, nb::call_guard<nb::gil_scoped_release>(),
          "Recompute what the models of all copies derive from masses, inertias and sizes (mj_setConst).")
      .def(
          "set_constants",
          [](rcs::World& w, const Ids& ids) {
            if (!ids.shape(0)) return;
            const nb::gil_scoped_release release;
            w.set_constants(to_ids(ids));
          },
          "copies"_a, "Recompute it for some copies (int32 ids).")
      .def_prop_ro(
          "poses",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            const auto r = static_cast<std::size_t>(w.pose_count());
            return view_of(self, w.poses(),
                           w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r, 7}
                                        : std::vector<std::size_t>{r, 7});
          },
          "Pose readouts ([copies,] readouts, 7): translation [m], quaternion xyzw. Ask again after adding one.")
      .def_prop_ro(
          "xyzrpy",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            const auto r = static_cast<std::size_t>(w.pose_count());
            return view_of(self, w.xyzrpy(),
                           w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r, 6}
                                        : std::vector<std::size_t>{r, 6});
          },
          "The same poses as translation [m] and roll, pitch, yaw [rad] (extrinsic xyz).")
      .def_prop_ro(
          "forces",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            const auto r = static_cast<std::size_t>(w.force_count());
            return view_of(
                self, w.forces(),
                w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r} : std::vector<std::size_t>{r});
          },
          "Force readouts ([copies,] readouts) [N], of the last physics step. Ask again after adding one.")
      .def_prop_ro(
          "openings",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            const auto r = static_cast<std::size_t>(w.opening_count());
            return view_of(
                self, w.openings(),
                w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r} : std::vector<std::size_t>{r});
          },
          "Opening readouts ([copies,] readouts) float32, 0 … 1. Ask again after adding one.")
      .def_prop_ro(
          "ends",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            return view_of(self, w.ends(), {std::size_t(w.copies())});
          },
          "StepEnd of the last step (copies,) uint8.")
      .def_prop_ro(
          "substeps",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            return view_of(self, w.substeps(), {std::size_t(w.copies())});
          },
          "Physics steps of the last step (copies,) int32.")
      .def_prop_ro(
          "steps",
          [](nb::handle self) {
            auto& w = nb::cast<rcs::World&>(self);
            return view_of(self, w.steps(), {std::size_t(w.copies())});
          },
          "Control steps since reset (copies,) int64.");
}
