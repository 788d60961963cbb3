// World: stepping copies of a scene.
#include <nanobind/nanobind.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "arrays.hpp"
#include "gil.hpp"
#include "mujoco_objects.hpp"
#include "rcs/world.hpp"

using namespace nb::literals;

namespace {

using Ids = In<const int, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::string text(nb::handle object) { return nb::cast<std::string>(object.attr("__str__")()); }

/// Ids of copies from anything that numpy takes for whole numbers. Masks, fractions and ids that int32 cannot hold
/// would mean other copies than the caller's.
class CopyIds {
 public:
  explicit CopyIds(nb::handle given) {
    if (nb::try_cast(given, ids_, false)) return;
    const nb::module_ numpy = nb::module_::import_("numpy");
    nb::object array = numpy.attr("asarray")(given);
    const auto refuse = [&](const std::string& what) {
      throw rcs::InvalidSetup("world: copies are a list or an array of whole numbers, one dimension; " + what);
    };
    if (nb::cast<int>(array.attr("ndim")) != 1) refuse("these have shape " + text(array.attr("shape")));
    const std::string kind = nb::cast<std::string>(array.attr("dtype").attr("kind"));
    if (nb::cast<std::size_t>(array.attr("size")) == 0) {
      array = numpy.attr("zeros")(0, "int32");  // an empty list has no type that says anything
    } else if (kind == "b") {
      refuse("for a mask of bool, give numpy.flatnonzero of it");
    } else if (kind != "i" && kind != "u") {
      refuse("these are " + text(array.attr("dtype")));
    }
    if (nb::cast<std::size_t>(array.attr("size")) != 0)
      for (const char* extreme : {"min", "max"}) {
        const nb::object id = nb::int_(array.attr(extreme)());
        if (id < nb::int_(std::numeric_limits<int>::min()) || id > nb::int_(std::numeric_limits<int>::max()))
          refuse("there is no copy " + text(id));
      }
    ids_ = nb::cast<Ids>(numpy.attr("ascontiguousarray")(array, "int32"));
  }
  std::span<const int> span() const { return {ids_.data(), ids_.shape(0)}; }

 private:
  Ids ids_;
};

// Arrays keep alive the memory that they view, not the world: one that is cached by what a callback refers to would be
// a cycle that Python cannot see.

// A view of a vector of readouts, (…) or (copies, …).
template <typename T>
View<T> view_of(const rcs::World& world, std::vector<T>& values, std::vector<std::size_t> shape) {
  return View<T>(values.data(), shape.size(), shape.data(), keeper(world.readouts()));
}

// An array over a state component of all copies: shape (copies, size), or (size,) on the user's own data.
View<double> component(rcs::World& world, int which) {
  int size = 0;
  double* first = world.component(which, &size);
  if (!first) throw nb::value_error("that state component does not exist in this model");
  const auto n = static_cast<std::size_t>(size);
  if (!world.is_batch()) {
    const std::size_t shape[1] = {n};
    return View<double>(first, 1, shape, keeper(world.memory()));
  }
  const std::size_t shape[2] = {static_cast<std::size_t>(world.copies()), n};
  const std::int64_t strides[2] = {world.row_stride(), 1};
  return View<double>(first, 2, shape, keeper(world.memory()), strides);
}

// A view of the values of a field, (copies, size).
nb::object view_of_field(const rcs::World& world, const rcs::ModelField& field) {
  const std::size_t shape[2] = {static_cast<std::size_t>(world.copies()), static_cast<std::size_t>(field.size)};
  const nb::capsule owner = keeper(world.memory());
  return std::visit(
      [&](auto* values) { return nb::cast(View<std::remove_pointer_t<decltype(values)>>(values, 2, shape, owner)); },
      field.values);
}

rcs::StepTiming timing(std::int64_t numerator, std::int64_t denominator, bool is_synchronous, int max_substeps) {
  return {numerator, denominator, is_synchronous, max_substeps};
}

// The main thread acts upon Ctrl-C when it calls this.
void act_on_signals() {
  const HeldGil gil;
  if (PyErr_CheckSignals() != 0) nb::raise_python_error();
}

std::shared_ptr<rcs::World> pollable(std::shared_ptr<rcs::World> world) {
  world->poll_with(act_on_signals);
  return world;
}

// Lets Python find worlds that are kept alive by nothing but their own callbacks.
int traverse(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  if (!nb::inst_ready(self)) return 0;
  for (const rcs::StepCallback* callback : nb::inst_ptr<rcs::World>(self)->callbacks()) {
    const nb::object object = nb::find(callback);
    Py_VISIT(object.ptr());
  }
  return 0;
}

int clear(PyObject* self) {
  // Nothing refers to it any more, so no call is under way; and after a fork there is nothing to end.
  try {
    if (nb::inst_ready(self)) nb::inst_ptr<rcs::World>(self)->close();
  } catch (const rcs::WrongOrder&) {
  }
  return 0;
}

PyType_Slot world_slots[] = {
    {Py_tp_traverse, reinterpret_cast<void*>(traverse)}, {Py_tp_clear, reinterpret_cast<void*>(clear)}, {0, nullptr}};

}  // namespace

void bind_world(nb::module_& m) {
  nb::enum_<rcs::StepEnd>(m, "StepEnd", "Why a control step of a simulation ended.")
      .value("period", rcs::StepEnd::period, "Asynchronous: one control period has passed.")
      .value("converged", rcs::StepEnd::converged, "Synchronous: every convergence callback agreed.")
      .value("interrupted", rcs::StepEnd::interrupted, "A callback interrupted the step.")
      .value("limit", rcs::StepEnd::limit, "Synchronous: the substep limit came before convergence.")
      .value("failed", rcs::StepEnd::failed, "A state or control that is not a finite number, or an exception.")
      .value("fault", rcs::StepEnd::fault, "A robot went into its fault state, as after a collision.");

  nb::class_<rcs::World>(m, "World", nb::type_slots(world_slots),
                         "N copies of one MuJoCo scene, advanced together by one control step at a time. Another call "
                         "during a call, from a callback or another thread, raises WrongOrder.")
      .def_static(
          "on_data",
          [](const PyModel& model, const PyData& data, std::int64_t numerator, std::int64_t denominator,
             bool is_synchronous, int max_substeps) {
            if (!data.attr("model").is(model))
              throw rcs::InvalidSetup("world: the MjData is of another MjModel; make it with mujoco.MjData(model)");
            return pollable(std::make_shared<rcs::World>(model.get(), data.get(),
                                                         timing(numerator, denominator, is_synchronous, max_substeps),
                                                         kept(nb::make_tuple(model, data))));
          },
          "model"_a, "data"_a, "period_numerator"_a, "period_denominator"_a, "is_synchronous"_a, "max_substeps"_a,
          "One copy, on the caller's own model and data, which the world and its arrays keep alive.")
      .def_static(
          "of_copies",
          [](const PyModel& model, int copies, int threads, std::int64_t numerator, std::int64_t denominator,
             bool is_synchronous, int max_substeps) {
            return pollable(std::make_shared<rcs::World>(model.get(), copies, threads,
                                                         timing(numerator, denominator, is_synchronous, max_substeps)));
          },
          "model"_a, "copies"_a, "threads"_a, "period_numerator"_a, "period_denominator"_a, "is_synchronous"_a,
          "max_substeps"_a,
          "Many copies of a copy of the model, on `threads` threads (0: one per CPU that this process may use).")
      .def("close", &rcs::World::close,
           "Drop the callbacks and end the threads; those of a batch end when its last array is dropped, too. Closing "
           "twice is harmless; calls afterwards raise WrongOrder, and arrays keep their values.")
      .def_prop_ro("is_open", &rcs::World::is_open)
      .def_prop_ro("copies", &rcs::World::copies)
      .def_prop_ro("threads", &rcs::World::threads)
      .def_prop_ro("is_batch", &rcs::World::is_batch, "False for a world on the user's own data.")
      .def("add_motion", &rcs::World::add_motion, "motion"_a,
           "Have a motion lead its joints in every step. Where there is one with the same user data, that is returned.")
      .def(
          "preview",
          [](rcs::World& w, const std::shared_ptr<rcs::Motion>& motion, const Vector& target, int copy, double tick) {
            const std::vector<double> positions = w.preview(motion, copy, to_span(target), tick);
            const auto dof = static_cast<std::size_t>(motion->dof());
            return to_array(positions, {positions.size() / dof, dof});
          },
          "motion"_a, "target"_a, "copy"_a, "tick"_a,
          "Return what the next step to a target (dof,) [rad] would do: where the joints are led to (n, dof), from now "
          "to the end of the step and while they brake to rest from there, at most every `tick` [s] and at the same "
          "times for all motions; in a synchronous step, until they stand. With an empty target, they hold. "
          "Nothing changes.")
      .def("on_period", &rcs::World::on_period, "callback"_a, "period"_a,
           "Call every `period` seconds of simulated time.")
      .def("converge_when", &rcs::World::converge_when, "callback"_a,
           "A synchronous step ends when all of these are true.")
      .def("interrupt_when", &rcs::World::interrupt_when, "callback"_a,
           "A synchronous step ends when any of these is true; an asynchronous one lasts its period and says so.")
      .def("fault_when", &rcs::World::fault_when, "callback"_a,
           "A step of any kind ends at once when any of these is true: a robot went into its fault state.")
      .def(
          "measure",
          [](rcs::World& w, std::shared_ptr<rcs::Measurement> measurement) { return w.measure(measurement); },
          "measurement"_a,
          "Have something measured after every step, and after `refresh`. Returns the index of its first value in "
          "`measurements`.")
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
          "reset", [](rcs::World& w, const nb::object& copies) { w.reset(CopyIds(copies).span()); }, "copies"_a,
          nb::sig("def reset(self, copies: numpy.typing.ArrayLike) -> None"),
          "Return some copies to the initial state: their ids, in any order, each once; none if there are none.")
      .def(
          "refresh", [](rcs::World& w) { w.refresh(); }, nb::call_guard<ReleasedGil>(),
          "Recompute the readouts of all copies after the state was written to.")
      .def(
          "refresh",
          [](rcs::World& w, const nb::object& copies) {
            const CopyIds ids(copies);
            const ReleasedGil released;
            w.refresh(ids.span());
          },
          "copies"_a, nb::sig("def refresh(self, copies: numpy.typing.ArrayLike) -> None"),
          "Recompute the readouts of some copies.")
      .def(
          "advance", [](rcs::World& w) { w.advance(); }, nb::call_guard<ReleasedGil>(),
          "Advance all copies by one control step. The GIL is released.")
      .def(
          "advance",
          [](rcs::World& w, const nb::object& copies) {
            const CopyIds ids(copies);
            const ReleasedGil released;
            w.advance(ids.span());
          },
          "copies"_a, nb::sig("def advance(self, copies: numpy.typing.ArrayLike) -> None"),
          "Advance some copies by one control step.")
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
      .def(
          "save", [](const rcs::World& w, int copy) { return to_array(w.save(copy)); }, "copy"_a = 0,
          "Everything that decides the future of one copy, and what was read out, (save_size,).")
      .def(
          "load", [](rcs::World& w, Vector saved, int copy) { w.load(copy, to_span(saved)); }, "saved"_a, "copy"_a = 0,
          "Write back what `save` returned, into any copy of a world with the same model, callbacks and readouts.")
      .def_prop_ro("save_size", &rcs::World::save_size, "Number of values of `save`.")
      .def_prop_ro(
          "states",
          [](rcs::World& w) {
            if (!w.is_batch()) throw nb::attribute_error("a world on the user's data has no state rows; use get_state");
            const std::size_t shape[2] = {static_cast<std::size_t>(w.copies()),
                                          static_cast<std::size_t>(w.state_size())};
            return View<double>(w.states(), 2, shape, keeper(w.memory()));
          },
          kOwned, "Live state rows (copies, state_size) of a batch.")
      .def("component", &component, "which"_a,
           "Live array of one mjtState component: (copies, n), or (n,) for a world on the user's own data.")
      .def(
          "expand", [](rcs::World& w, const char* field) { return view_of_field(w, w.expand(field)); }, "field"_a,
          nb::sig("def expand(self, field: str) -> numpy.typing.NDArray[typing.Any]"),
          "Give a field of MjModel values per copy; returns them, (copies, size), to write to.")
      .def(
          "expanded",
          [](rcs::World& w, const char* field) -> nb::object {
            const auto found = w.expanded(field);
            return found ? view_of_field(w, *found) : nb::none();
          },
          "field"_a, nb::sig("def expanded(self, field: str) -> numpy.typing.NDArray[typing.Any] | None"),
          "The values per copy of a field of MjModel that has them, (copies, size); None for one that has not.")
      .def_prop_ro("is_varied", &rcs::World::is_varied, "Whether any field of the model has values per copy.")
      .def(
          "set_constants", [](rcs::World& w) { w.set_constants(); }, nb::call_guard<ReleasedGil>(),
          "Recompute what the models of all copies derive from masses, inertias and sizes (mj_setConst).")
      .def(
          "set_constants",
          [](rcs::World& w, const nb::object& copies) {
            const CopyIds ids(copies);
            const ReleasedGil released;
            w.set_constants(ids.span());
          },
          "copies"_a, nb::sig("def set_constants(self, copies: numpy.typing.ArrayLike) -> None"),
          "Recompute it for some copies.")
      .def_prop_ro(
          "poses",
          [](rcs::World& w) {
            const auto r = static_cast<std::size_t>(w.pose_count());
            return view_of(w, w.poses(),
                           w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r, 7}
                                        : std::vector<std::size_t>{r, 7});
          },
          kOwned,
          "Pose readouts ([copies,] readouts, 7): translation [m], quaternion xyzw. Ask again after adding one.")
      .def_prop_ro(
          "xyzrpy",
          [](rcs::World& w) {
            const auto r = static_cast<std::size_t>(w.pose_count());
            return view_of(w, w.xyzrpy(),
                           w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r, 6}
                                        : std::vector<std::size_t>{r, 6});
          },
          kOwned, "The same poses as translation [m] and roll, pitch, yaw [rad] (extrinsic xyz).")
      .def_prop_ro(
          "forces",
          [](rcs::World& w) {
            const auto r = static_cast<std::size_t>(w.force_count());
            return view_of(
                w, w.forces(),
                w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r} : std::vector<std::size_t>{r});
          },
          kOwned, "Force readouts ([copies,] readouts) [N], of the last physics step. Ask again after adding one.")
      .def_prop_ro(
          "openings",
          [](rcs::World& w) {
            const auto r = static_cast<std::size_t>(w.opening_count());
            return view_of(
                w, w.openings(),
                w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r} : std::vector<std::size_t>{r});
          },
          kOwned, "Opening readouts ([copies,] readouts) float32, 0 … 1. Ask again after adding one.")
      .def_prop_ro(
          "measurements",
          [](rcs::World& w) {
            const auto r = static_cast<std::size_t>(w.measurement_count());
            return view_of(
                w, w.measurements(),
                w.is_batch() ? std::vector<std::size_t>{std::size_t(w.copies()), r} : std::vector<std::size_t>{r});
          },
          kOwned, "Values of all measurements ([copies,] values). Ask again after adding one.")
      .def_prop_ro(
          "ends", [](rcs::World& w) { return view_of(w, w.ends(), {std::size_t(w.copies())}); }, kOwned,
          "StepEnd of the last step (copies,) uint8.")
      .def_prop_ro(
          "substeps", [](rcs::World& w) { return view_of(w, w.substeps(), {std::size_t(w.copies())}); }, kOwned,
          "Physics steps of the last step (copies,) int32.")
      .def_prop_ro(
          "steps", [](rcs::World& w) { return view_of(w, w.steps(), {std::size_t(w.copies())}); }, kOwned,
          "Control steps since reset (copies,) int64.");
}
