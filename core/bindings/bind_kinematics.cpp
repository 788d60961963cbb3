// Kinematics: the interface and the backend on MuJoCo's Jacobians.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "arrays.hpp"
#include "mujoco_objects.hpp"
#include "overrides.hpp"
#include "rcs/kinematics.hpp"

using namespace nb::literals;

namespace {

using Rows = In<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

struct PyKinematics : rcs::Kinematics {
  NB_TRAMPOLINE(rcs::Kinematics);
  int dof() const override { return call_override<int>(nb_trampoline, "_dof", "an int"); }
  std::vector<double> joint_lower() const override { return limits("_joint_lower"); }
  std::vector<double> joint_upper() const override { return limits("_joint_upper"); }
  rcs::Pose forward(std::span<const double> joints) override {
    return call_override<rcs::Pose>(nb_trampoline, "_forward", "a Pose", joints);
  }
  rcs::IkResult inverse(const rcs::Pose& target, std::span<const double> start,
                        const rcs::IkOptions& options) override {
    const HeldGil gil;
    constexpr const char* name = "_inverse";
    if (!PyObject_HasAttrString(nb_trampoline.base().type().ptr(), name))
      return rcs::Kinematics::inverse(target, start, options);
    return call_override<rcs::IkResult>(nb_trampoline, name, "an IkResult", target, start, options);
  }
  std::vector<double> jacobian(std::span<const double> joints) override {
    const HeldGil gil;
    constexpr const char* name = "_jacobian";
    if (!PyObject_HasAttrString(nb_trampoline.base().type().ptr(), name)) return rcs::Kinematics::jacobian(joints);
    const auto matrix = call_override<Rows>(nb_trampoline, name, "a float64 array (6, dof)", joints);
    if (matrix.shape(0) != 6 || matrix.shape(1) != static_cast<std::size_t>(dof()))
      throw rcs::InvalidSetup("_jacobian returned an array of a wrong shape; it must be (6, dof)");
    return {matrix.data(), matrix.data() + matrix.size()};
  }

 private:
  std::vector<double> limits(const char* name) const {
    return call_override<std::vector<double>>(nb_trampoline, name, "a sequence of floats");
  }
};

Array forward_rows(rcs::Kinematics& self, const Rows& joints) {
  const std::size_t count = joints.shape(0), n = static_cast<std::size_t>(self.dof());
  if (joints.shape(1) != n) throw rcs::InvalidSetup("forward_batch: joints must be (N, " + std::to_string(n) + ")");
  std::vector<double> poses(7 * count);
  self.forward_batch({joints.data(), joints.size()}, poses);
  return to_array(poses, {count, 7});
}

// The result of a batch: joints, status, errors.
struct Answers {
  Answers(std::size_t count, std::size_t n) : joints(count * n), status(count), errors(2 * count), shape{count, n} {}

  nb::tuple take() {
    auto* own = new std::vector<std::uint8_t>(std::move(status));
    const nb::capsule owner(own, [](void* p) noexcept { delete static_cast<std::vector<std::uint8_t>*>(p); });
    return nb::make_tuple(to_array(joints, {shape[0], shape[1]}),
                          nb::ndarray<nb::numpy, std::uint8_t>(own->data(), {shape[0]}, owner),
                          to_array(errors, {shape[0], 2}));
  }

  std::vector<double> joints;
  std::vector<std::uint8_t> status;
  std::vector<double> errors;
  std::array<std::size_t, 2> shape;
};

nb::tuple inverse_rows(rcs::Kinematics& self, const Rows& targets, const Rows& starts, const rcs::IkOptions& options,
                       int threads) {
  const std::size_t count = targets.shape(0), n = static_cast<std::size_t>(self.dof());
  if (targets.shape(1) != 7 || starts.shape(0) != count || starts.shape(1) != n)
    throw rcs::InvalidSetup("inverse_batch: targets must be (N, 7) and starts (N, " + std::to_string(n) + ")");
  Answers answers(count, n);
  {
    const ReleasedGil released;
    self.inverse_batch({targets.data(), 7 * count}, {starts.data(), n * count}, options, threads, answers.joints,
                       answers.status, answers.errors);
  }
  return answers.take();
}

std::array<double, 6> to_twist(const Vector& twist) {
  if (twist.shape(0) != 6) throw rcs::InvalidSetup("a twist must be 6 numbers: m/s and rad/s");
  std::array<double, 6> copy;
  std::copy_n(twist.data(), 6, copy.begin());
  return copy;
}

nb::tuple advance_rows(rcs::Kinematics& self, const Rows& starts, const Rows& twists, double duration,
                       const rcs::VelocityOptions& options, int threads) {
  const std::size_t count = starts.shape(0), n = static_cast<std::size_t>(self.dof());
  if (twists.shape(1) != 6 || twists.shape(0) != count || starts.shape(1) != n)
    throw rcs::InvalidSetup("advance_batch: twists must be (N, 6) and joints (N, " + std::to_string(n) + ")");
  Answers answers(count, n);
  {
    const ReleasedGil released;
    self.advance_batch({starts.data(), n * count}, {twists.data(), 6 * count}, duration, options, threads,
                       answers.joints, answers.status, answers.errors);
  }
  return answers.take();
}

std::vector<double> entries_of(const std::optional<Vector>& values) {
  return values ? to_vector(*values) : std::vector<double>{};
}

bool are_finite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

bool are_positive(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return value > 0; });
}

}  // namespace

void bind_kinematics(nb::module_& m) {
  nb::enum_<rcs::IkStatus>(m, "IkStatus", "The outcome of inverse kinematics.")
      .value("ok", rcs::IkStatus::ok, "The target is reached within the tolerances.")
      .value("clamped", rcs::IkStatus::clamped,
             "The target is farther away than allowed, the answer is the allowed step towards it.")
      .value("infeasible", rcs::IkStatus::infeasible, "No solution inside the joint limits; the answer is the start.")
      .value("nearest", rcs::IkStatus::nearest,
             "With best effort: no solution near the start, the answer is the nearest pose inside the joint limits.");
  nb::class_<rcs::IkOptions>(m, "IkOptions", "How hard inverse kinematics tries, and what it may answer.")
      .def(
          "__init__",
          [](rcs::IkOptions* self, double translation_tolerance, double rotation_tolerance, int iterations,
             int restarts, double damping, double rotation_weight, const std::optional<Vector>& max_step,
             const std::optional<Vector>& preferred, double preferred_weight, bool best_effort, std::uint64_t seed) {
            rcs::IkOptions options{
                translation_tolerance, rotation_tolerance,    iterations,       restarts,    damping, rotation_weight,
                entries_of(max_step),  entries_of(preferred), preferred_weight, best_effort, seed};
            if (!(translation_tolerance > 0) || !(rotation_tolerance > 0) || iterations < 1 || restarts < 0 ||
                !(damping > 0) || !(rotation_weight > 0) || !are_positive(options.max_step) ||
                !are_finite(options.preferred) || !(preferred_weight >= 0))
              throw rcs::InvalidSetup(
                  "IkOptions: tolerances, iterations, damping, rotation_weight and max_step must be positive, restarts "
                  "and preferred_weight not negative, and preferred finite");
            new (self) rcs::IkOptions(std::move(options));
          },
          nb::kw_only(), "translation_tolerance"_a = 1e-4, "rotation_tolerance"_a = 1e-4, "iterations"_a = 30,
          "restarts"_a = 60, "damping"_a = 1e-4, "rotation_weight"_a = 1.0, "max_step"_a = nb::none(),
          "preferred"_a = nb::none(), "preferred_weight"_a = 2.0, "best_effort"_a = false, "seed"_a = 0)
      .def_ro("translation_tolerance", &rcs::IkOptions::translation_tolerance, "m")
      .def_ro("rotation_tolerance", &rcs::IkOptions::rotation_tolerance, "rad")
      .def_ro("iterations", &rcs::IkOptions::iterations, "Per attempt.")
      .def_ro("restarts", &rcs::IkOptions::restarts,
              "Further attempts from random joints; 0 keeps to the branch of the start.")
      .def_ro("damping", &rcs::IkOptions::damping, "Damping of the least squares.")
      .def_ro("rotation_weight", &rcs::IkOptions::rotation_weight,
              "How much a radian counts against a metre; below 1 the rotation gives way to the translation.")
      .def_prop_ro(
          "max_step", [](const rcs::IkOptions& o) { return to_array(o.max_step); }, nb::rv_policy::move,
          "Largest change of each joint from the start [rad], shape (dof,), or (0,) for no bound. A solution farther "
          "away is clamped: all joints go the same share of the way towards it.")
      .def_prop_ro(
          "preferred", [](const rcs::IkOptions& o) { return to_array(o.preferred); }, nb::rv_policy::move,
          "Joints [rad] that an arm with more joints than it needs returns to without moving its TCP, shape (dof,), or "
          "(0,) for none.")
      .def_ro("preferred_weight", &rcs::IkOptions::preferred_weight,
              "How strongly it is drawn there: share of the way back per radian that the fastest joint moves for the "
              "TCP. It depends on the path alone; a TCP at rest means an arm at rest.")
      .def_ro("best_effort", &rcs::IkOptions::best_effort,
              "Follow the target: out of reach, answer with the `nearest` pose instead of the start, and beyond "
              "`max_step` with a step in the direction of the target. Everything that the target leaves unchanged is "
              "kept: a push against the end of the reach does not turn the tool, and a turn against a joint's limit "
              "does not move it. A joint that starts outside its limits goes no farther out, and need not come back.")
      .def_ro("seed", &rcs::IkOptions::seed, "Seed of the restarts; the same seed gives the same answer.");
  nb::class_<rcs::VelocityOptions>(m, "VelocityOptions", "How joints may move for a twist of the TCP.")
      .def(
          "__init__",
          [](rcs::VelocityOptions* self, const std::optional<Vector>& max_velocity,
             const std::optional<Vector>& preferred, double preferred_weight, double damping) {
            rcs::VelocityOptions options{entries_of(max_velocity), entries_of(preferred), preferred_weight, damping};
            if (!are_positive(options.max_velocity) || !are_finite(options.preferred) || !(preferred_weight >= 0) ||
                !(damping > 0))
              throw rcs::InvalidSetup(
                  "VelocityOptions: max_velocity and damping must be positive, preferred_weight not negative, and "
                  "preferred finite");
            new (self) rcs::VelocityOptions(std::move(options));
          },
          nb::kw_only(), "max_velocity"_a = nb::none(), "preferred"_a = nb::none(), "preferred_weight"_a = 2.0,
          "damping"_a = 0.03)
      .def_prop_ro(
          "max_velocity", [](const rcs::VelocityOptions& o) { return to_array(o.max_velocity); }, nb::rv_policy::move,
          "Largest speed of each joint [rad/s], shape (dof,), or (0,) for no bound. All joints are slowed down alike, "
          "so "
          "that the TCP keeps its direction.")
      .def_prop_ro(
          "preferred", [](const rcs::VelocityOptions& o) { return to_array(o.preferred); }, nb::rv_policy::move,
          "As in IkOptions: joints [rad] that an arm with more joints than it needs returns to, shape (dof,) or (0,).")
      .def_ro("preferred_weight", &rcs::VelocityOptions::preferred_weight, "As in IkOptions.")
      .def_ro("damping", &rcs::VelocityOptions::damping,
              "How near a singular posture joints are slowed down [m/rad]: where the TCP moves by less than this when "
              "the joints move by one radian, in the direction in which it does. No more than 1 / damping rad/s answer "
              "to 1 m/s.");
  nb::class_<rcs::Velocities>(m, "Velocities", "Joint velocities for a twist.")
      .def_prop_ro(
          "joints", [](const rcs::Velocities& v) { return to_array(v.joints); }, nb::rv_policy::move,
          "rad/s, shape (dof,).")
      .def_ro("status", &rcs::Velocities::status,
              "`clamped`: slower, the same way; `nearest`: the TCP moves otherwise than asked.")
      .def_ro("share", &rcs::Velocities::share,
              "Share of the speed, 0 to 1; below 1 where a joint is as fast as it may be.")
      .def_ro("translation_error", &rcs::Velocities::translation_error,
              "m/s, between what is asked, at this share, and what the joints do.")
      .def_ro("rotation_error", &rcs::Velocities::rotation_error, "rad/s, likewise.");
  nb::class_<rcs::IkResult>(m, "IkResult", "The answer of inverse kinematics.")
      .def(
          "__init__",
          [](rcs::IkResult* self, std::vector<double> joints, rcs::IkStatus status, double translation_error,
             double rotation_error, int iterations) {
            new (self) rcs::IkResult{std::move(joints), status, translation_error, rotation_error, iterations};
          },
          "joints"_a, "status"_a, "translation_error"_a = 0.0, "rotation_error"_a = 0.0, "iterations"_a = 0)
      .def_prop_ro(
          "joints", [](const rcs::IkResult& r) { return to_array(r.joints); }, nb::rv_policy::move,
          "Inside the limits [rad]; of a joint that was outside at the start of a motion, no farther out than there.")
      .def_ro("status", &rcs::IkResult::status)
      .def_ro("translation_error", &rcs::IkResult::translation_error, "m, before any clamping.")
      .def_ro("rotation_error", &rcs::IkResult::rotation_error, "rad, before any clamping.")
      .def_ro("iterations", &rcs::IkResult::iterations);
  nb::class_<rcs::Kinematics, PyKinematics>(
      m, "Kinematics",
      "Kinematics of one arm: TCP pose in the base frame from joints, and back. Subclasses override `_dof`, "
      "`_joint_lower`, `_joint_upper` and `_forward(joints)`; where they have a better one than finite differences, "
      "`_jacobian(joints)`, and than damped least squares, `_inverse(target, start, options)`.")
      .def(nb::init<>())
      .def_prop_ro("dof", &rcs::Kinematics::dof)
      .def_prop_ro(
          "joint_lower", [](const rcs::Kinematics& k) { return to_array(k.joint_lower()); }, nb::rv_policy::move, "rad")
      .def_prop_ro(
          "joint_upper", [](const rcs::Kinematics& k) { return to_array(k.joint_upper()); }, nb::rv_policy::move, "rad")
      .def(
          "forward", [](rcs::Kinematics& self, Vector joints) { return self.forward(to_span(joints)); }, "joints"_a,
          "Pose of the TCP in the base frame for joints [rad], shape (dof,).")
      .def(
          "inverse",
          [](rcs::Kinematics& self, const rcs::Pose& target, Vector start, const rcs::IkOptions& options) {
            return self.inverse(target, to_span(start), options);
          },
          "target"_a, "start"_a, "options"_a = rcs::IkOptions{},
          "Joints [rad] that bring the TCP to `target` (in the base frame), looked for from `start`, shape (dof,).")
      .def(
          "jacobian",
          [](rcs::Kinematics& self, Vector joints) {
            return to_array(self.jacobian(to_span(joints)), {6, static_cast<std::size_t>(self.dof())});
          },
          "joints"_a, "Jacobian of the TCP in the base frame, (6, dof): translation [m/rad] above rotation [rad/rad].")
      .def("forward_batch", &forward_rows, "joints"_a,
           "TCP poses (N, 7) in the base frame for joints (N, dof): translation [m], quaternion xyzw.")
      .def("inverse_batch", &inverse_rows, "targets"_a, "starts"_a, "options"_a = rcs::IkOptions{}, "threads"_a = 1,
           "Solve for targets (N, 7) from starts (N, dof).\n\nReturns joints (N, dof), IkStatus values (N,) uint8, and "
           "what is left of translation [m] and rotation [rad], (N, 2). The GIL is released. Kinematics in Python take "
           "the rows one by one in the thread of the caller.")
      .def(
          "velocities",
          [](rcs::Kinematics& self, const Vector& joints, const Vector& twist, const rcs::VelocityOptions& options) {
            return self.velocities(to_span(joints), to_twist(twist), options);
          },
          "joints"_a, "twist"_a, "options"_a = rcs::VelocityOptions{},
          "Joint velocities [rad/s] at joints (dof,) that move the TCP at a twist (6,): linear [m/s] and angular "
          "velocity [rad/s] in the base frame.")
      .def(
          "advance",
          [](rcs::Kinematics& self, const Vector& joints, const Vector& twist, double duration,
             const rcs::VelocityOptions& options) {
            return self.advance(to_span(joints), to_twist(twist), duration, options);
          },
          "joints"_a, "twist"_a, "duration"_a, "options"_a = rcs::VelocityOptions{},
          "Joints after the TCP has moved from joints (dof,) at a twist (6,) for `duration` [s]: along a straight "
          "line, "
          "turning about one axis.\n\nThe errors are what the TCP's pose lacks of it. `clamped`: it went slower, the "
          "same way, since a joint is as fast as it may be; `nearest`: a singular posture or a joint's limit made it "
          "go "
          "another way. Joints that start outside their limits go no farther out. Zero twist leaves all as they are.")
      .def("advance_batch", &advance_rows, "joints"_a, "twists"_a, "duration"_a, "options"_a = rcs::VelocityOptions{},
           "threads"_a = 1, "Advance many, joints (N, dof) at twists (N, 6).\n\nReturns what `inverse_batch` does.");
  nb::class_<rcs::DampedLeastSquares, rcs::Kinematics>(m, "DampedLeastSquares",
                                                       "Damped least squares on a chain of hinges and slides, with the "
                                                       "joint limits inside the solve. Several threads may use one "
                                                       "solver at once.")
      .def(
          "__init__",
          [](rcs::DampedLeastSquares* self, const PyModel& model, std::vector<int> joints, int tcp_site,
             int base_body) {
            new (self) rcs::DampedLeastSquares(model.get(), std::move(joints), tcp_site, base_body);
          },
          "model"_a, "joints"_a, "tcp_site"_a, "base_body"_a,
          "Take the chain out of a model; the ids of joints (base to tip), TCP site and base body are its. The model "
          "is not kept.");
}
