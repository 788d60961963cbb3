// Collision checks of robots in a scene, at joints and along motions.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "gil.hpp"
#include "mujoco_objects.hpp"
#include "rcs/collision_checker.hpp"

using namespace nb::literals;

namespace {

using Rows = In<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Checker = rcs::CollisionChecker;

/// A numpy array that owns `values`.
template <typename T>
nb::ndarray<nb::numpy, T> owned(std::vector<T>&& values, std::vector<std::size_t> shape) {
  auto* kept = new std::vector<T>(std::move(values));
  const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(kept->data(), shape.size(), shape.data(), owner);
}

/// A copy, for calls without the GIL; its rows must have the robots' joints.
std::vector<double> to_rows(const Checker& self, const Rows& rows) {
  if (rows.shape(1) != static_cast<std::size_t>(self.dof()))
    throw rcs::InvalidSetup("collision checker: rows of joints must be (N, " + std::to_string(self.dof()) +
                            "), these " + "are (" + std::to_string(rows.shape(0)) + ", " +
                            std::to_string(rows.shape(1)) + ")");
  return {rows.data(), rows.data() + rows.size()};
}

nb::tuple clearance_rows(const Checker& self, const Rows& q, double margin, int threads) {
  const auto rows = to_rows(self, q);
  std::vector<rcs::Clearance> found;
  {
    const ReleasedGil released;
    found = self.clearance_rows(rows, margin, threads);
  }
  std::vector<double> distances;
  std::vector<std::int32_t> geoms;
  for (const auto& one : found) {
    distances.push_back(one.distance);
    geoms.insert(geoms.end(), one.geoms.begin(), one.geoms.end());
  }
  const std::size_t count = found.size();
  return nb::make_tuple(owned(std::move(distances), {count}), owned(std::move(geoms), {count, 2}));
}

nb::ndarray<nb::numpy, bool> free_rows(const Checker& self, const Rows& q, double margin, int threads) {
  const auto rows = to_rows(self, q);
  auto* flags = new std::vector<std::uint8_t>;
  const nb::capsule owner(flags, [](void* p) noexcept { delete static_cast<std::vector<std::uint8_t>*>(p); });
  {
    const ReleasedGil released;
    *flags = self.free_rows(rows, margin, threads);
  }
  return nb::ndarray<nb::numpy, bool>(reinterpret_cast<bool*>(flags->data()), {flags->size()}, owner);
}

nb::tuple first_hit_rows(const Checker& self, const Rows& from, const Rows& to, double step, double turn, double margin,
                         int threads) {
  const auto starts = to_rows(self, from), ends = to_rows(self, to);
  std::vector<std::optional<rcs::Hit>> hits;
  {
    const ReleasedGil released;
    hits = self.first_hit_rows(starts, ends, {step, turn, margin}, threads);
  }
  std::vector<double> fractions, free_until;
  std::vector<std::int32_t> geoms;
  for (const auto& hit : hits) {
    fractions.push_back(hit ? hit->fraction : std::numeric_limits<double>::infinity());
    free_until.push_back(hit ? hit->free_until : 1.0);
    for (const int k : {0, 1}) geoms.push_back(hit ? hit->clearance.geoms[static_cast<std::size_t>(k)] : -1);
  }
  const std::size_t count = hits.size();
  return nb::make_tuple(owned(std::move(fractions), {count}), owned(std::move(free_until), {count}),
                        owned(std::move(geoms), {count, 2}));
}

}  // namespace

void bind_collision_checker(nb::module_& m) {
  nb::class_<rcs::Clearance>(m, "Clearance", "How near robots are to what they must not touch.")
      .def_ro("distance", &rcs::Clearance::distance, "m, negative inside each other; at most the margin.")
      .def_prop_ro(
          "geoms", [](const rcs::Clearance& c) { return std::pair(c.geoms[0], c.geoms[1]); },
          "Ids of the nearest pair in the model; (-1, -1) when none is nearer than the margin.");
  nb::class_<rcs::Hit>(m, "Hit", "Where a joint motion first comes too near.")
      .def_ro("fraction", &rcs::Hit::fraction, "Fraction of the motion, 0 to 1, at which a pair was found too near.")
      .def_ro("free_until", &rcs::Hit::free_until,
              "Fraction up to which no pair was too near; 0 when the motion starts so.")
      .def_prop_ro(
          "distance", [](const rcs::Hit& h) { return h.clearance.distance; }, "Distance of the pair at `fraction` [m].")
      .def_prop_ro(
          "geoms", [](const rcs::Hit& h) { return std::pair(h.clearance.geoms[0], h.clearance.geoms[1]); },
          "Ids of the pair in the model.");
  nb::class_<Checker>(
      m, "CollisionChecker",
      "Distances and contacts of robots in a scene of MuJoCo, at given joints and along straight joint motions.\n\n"
      "The geometry that takes part is everything that the joints move: links, end effectors, mounted cameras, "
      "attached "
      "objects. It is checked against itself and against everything else, as far as MuJoCo would let the two touch and "
      "the pair is not allowed. Geoms that no joint moves relative to each other are not checked. Soft bodies take no "
      "part. Several threads may use one checker at once; what changes the scene changes it for later calls.")
      .def(
          "__init__",
          [](Checker* self, const PyModel& model, const std::vector<std::vector<int>>& robots) {
            new (self) Checker(model.get(), robots);
          },
          "model"_a, "robots"_a,
          "Copy a model; `robots` are the joint ids of each robot, hinges and slides with limits.\n\nRaises "
          "InvalidSetup when a joint is not in the model, or no geometry takes part that could touch anything.")
      .def_prop_ro("dof", &Checker::dof, "Number of joints of all robots.")
      .def_prop_ro("joints", &Checker::joints, "Joint ids in the order of every vector of joints.")
      .def_prop_ro(
          "joint_lower", [](const Checker& c) { return to_array(c.joint_lower()); }, nb::rv_policy::move, "rad or m")
      .def_prop_ro(
          "joint_upper", [](const Checker& c) { return to_array(c.joint_upper()); }, nb::rv_policy::move, "rad or m")
      .def_prop_ro(
          "pairs",
          [](const Checker& c) {
            std::vector<std::int32_t> ids;
            for (const auto& pair : c.pairs()) ids.insert(ids.end(), pair.begin(), pair.end());
            const std::size_t count = ids.size() / 2;
            return owned(std::move(ids), {count, 2});
          },
          nb::rv_policy::move, "Ids of the geoms that are checked against each other, (pairs, 2).")
      .def("describe", &Checker::describe, "geom"_a, "A geom in words, such as \"geom 'shelf' of body 'rack'\".")
      .def(
          "set_state",
          [](Checker& self, const Vector& qpos, const std::optional<Vector>& mocap_pos,
             const std::optional<Vector>& mocap_quat) {
            const std::vector<double> none;
            self.set_state(to_span(qpos), mocap_pos ? to_span(*mocap_pos) : none,
                           mocap_quat ? to_span(*mocap_quat) : none);
          },
          "qpos"_a, "mocap_pos"_a = nb::none(), "mocap_quat"_a = nb::none(),
          "Say where everything else is: `qpos` (nq,), and mocap bodies' positions (3 * nmocap,) and quaternions wxyz "
          "(4 * nmocap,), None to leave them.\n\nThe robots' own entries only say where they were when something is "
          "attached.")
      .def("allow", &Checker::allow, "a"_a, "b"_a,
           "Let two things touch: all geoms of a body, or one geom, by name on each side. Returns how many pairs this "
           "drops.")
      .def("attach", &Checker::attach, "body"_a, "to"_a, "pose_in_to"_a = nb::none(),
           "Let a body with a free joint, or a mocap body, move with the body `to` (ids), from where both are in the "
           "present state or at `pose_in_to`. It may then touch what moves with `to` alone.")
      .def("detach", &Checker::detach, "body"_a, "Leave an attached body where the state has it.")
      .def(
          "clearance",
          [](const Checker& self, const Vector& q, double margin) { return self.clearance(to_span(q), margin); }, "q"_a,
          "margin"_a, "Smallest distance at joints `q` (dof,) [rad], if below `margin` [m].")
      .def(
          "is_free",
          [](const Checker& self, const Vector& q, double margin) { return self.is_free(to_span(q), margin); }, "q"_a,
          "margin"_a = 0.0, "Whether no pair is nearer than `margin` [m] at joints `q` (dof,) [rad].")
      .def(
          "first_hit",
          [](const Checker& self, const Vector& from, const Vector& to, double step, double turn, double margin) {
            const auto start = to_vector(from), end = to_vector(to);
            const ReleasedGil released;
            return self.first_hit(start, end, {step, turn, margin});
          },
          "q_from"_a, "q_to"_a, "step"_a = 0.002, "turn"_a = 0.0087, "margin"_a = 0.0,
          "First place on the straight joint motion (dof,) -> (dof,) [rad] where a pair is nearer than `margin` [m]; "
          "None when it is free.\n\nBetween two checks of a pair that is near, no point of a robot moves by more than "
          "`step` [m] and nothing turns by more than `turn` [rad]; larger strides are made only where the distance "
          "proves them free. Contact deeper than half a step is never missed, and with a margin of at least half a "
          "step "
          "no contact is. The GIL is released.")
      .def(
          "first_hit_on_way",
          [](const Checker& self, const Rows& places, double step, double turn, double margin, double bend) {
            const auto way = to_rows(self, places);
            const ReleasedGil released;
            return self.first_hit_on_way(way, {step, turn, margin}, bend);
          },
          "places"_a, "step"_a = 0.002, "turn"_a = 0.0087, "margin"_a = 0.0, "bend"_a = 1e-3,
          "`first_hit` on a way of many places (N, dof), from each to the next; fractions are of the number of places. "
          "Neighbours that lie on one straight motion to within `bend` [rad] are swept together.")
      .def("clearance_rows", &clearance_rows, "q"_a, "margin"_a, "threads"_a = 1,
           "`clearance` of rows (N, dof): distances (N,) [m] and geoms (N, 2). The GIL is released.")
      .def("free_rows", &free_rows, "q"_a, "margin"_a = 0.0, "threads"_a = 1,
           "`is_free` of rows (N, dof): flags (N,). The GIL is released.")
      .def("first_hit_rows", &first_hit_rows, "q_from"_a, "q_to"_a, "step"_a = 0.002, "turn"_a = 0.0087,
           "margin"_a = 0.0, "threads"_a = 1,
           "`first_hit` of rows (N, dof): fractions (N,), infinite for a free motion; `free_until` (N,); geoms (N, 2). "
           "The GIL is released.");
}
