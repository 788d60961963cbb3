// Checks of collisions: distances and contacts of their geometry at given joints, and along joint motions.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "rcs/pose.hpp"
#include "rcs/result.hpp"

namespace rcs {

/// How near the robots are to what they must not touch.
struct Clearance {
  double distance = std::numeric_limits<double>::infinity();  ///< m, negative inside each other; at most the margin
  std::array<int, 2> geoms = {-1, -1};                        ///< ids of the nearest pair; -1 when none is that near
};

/// The place of a joint motion where it first comes too near.
struct Hit {
  double fraction = 0.0;    ///< of the motion, 0 … 1, at which a pair was found too near
  double free_until = 0.0;  ///< fraction up to which no pair was; 0 when the motion starts too near
  Clearance clearance;      ///< distance and pair there
};

/// How finely a motion is checked near obstacles; free space is crossed in larger strides that distances allow.
struct SweepOptions {
  double step = 0.002;   ///< m, by which no point of a robot moves between two checks of a pair that is near
  double turn = 0.0087;  ///< rad, by which nothing turns between two checks of a pair that is near
  double margin = 0.0;   ///< m, distance below which a pair is too near
};

/// Distances and contacts of robots in a scene of MuJoCo, at given joints and along straight joint motions.
///
/// The geometry that takes part is everything that the joints move: links, end effectors, mounted cameras, attached
/// objects. It is checked against itself and against everything else, as far as MuJoCo would let the two touch (contype
/// and conaffinity, exclusions, explicit pairs, parent and child) and the pair is not allowed. Geoms that no joint
/// moves relative to each other, such as two fingers of one gripper, are not checked against each other. Soft bodies
/// take no part.
///
/// Along a motion, each pair has an upper bound of the speed at which it can approach: sum over the joints between the
/// two of |Δq| times the largest lever arm. A pair at distance d is not looked at again before it could have covered d
/// (conservative advancement: Mirtich, "Impulse-based dynamic simulation of rigid body systems", 1996, ch. 2), or the
/// `step`, whichever is more. So contact deeper than half a step is never missed, whatever the thickness of an
/// obstacle, and with a margin of at least half a step no contact is.
///
/// Calls from several threads are as good as one after the other: each computes in memory of its own, which is kept for
/// the next call. A change of the scene meanwhile (`set_state`, `attach`, `allow`) is one for later calls.
class CollisionChecker {
 public:
  /// `robots` are the joint ids of each robot in `model`, hinges and slides with limits. The model is copied.
  /// Throws `InvalidSetup` when a joint is not in the model, or no geometry takes part that could touch anything.
  CollisionChecker(const mjModel* model, const std::vector<std::vector<int>>& robots);
  ~CollisionChecker();
  CollisionChecker(const CollisionChecker&) = delete;
  CollisionChecker& operator=(const CollisionChecker&) = delete;

  int dof() const { return static_cast<int>(joints_.size()); }
  /// Joint ids in the order of every vector of joints: those of the first robot, then of the second.
  const std::vector<int>& joints() const { return joints_; }
  std::vector<double> joint_lower() const;  ///< rad or m
  std::vector<double> joint_upper() const;  ///< rad or m
  /// Pairs of geoms that are checked.
  std::vector<std::array<int, 2>> pairs() const;
  /// A geom in words, such as "geom 'shelf' of body 'rack'".
  std::string describe(int geom) const;

  /// The places of everything else: free bodies, other joints (fingers), mocap bodies. Sizes nq, 3 × nmocap, 4 × nmocap
  /// (wxyz); empty mocap arrays leave these bodies where they are. The robots' own entries only say where they were
  /// when something is attached.
  void set_state(std::span<const double> qpos, std::span<const double> mocap_pos = {},
                 std::span<const double> mocap_quat = {});
  /// Let two things touch: all geoms of a body, or one geom, by name on each side. Returns how many pairs this drops.
  int allow(const std::string& a, const std::string& b);
  /// Let a body of its own (one with a free joint, or a mocap body) move with the body `to`, from where both are in the
  /// present state, or at `pose_in_to`. It may then touch what moves with `to` alone.
  void attach(int body, int to, const std::optional<Pose>& pose_in_to = std::nullopt);
  /// Leave an attached body where the state has it.
  void detach(int body);

  /// Smallest distance at joints `q`, if below `margin` [m].
  Clearance clearance(std::span<const double> q, double margin) const;
  /// Return whether no pair is nearer than `margin` [m] at joints `q`.
  bool is_free(std::span<const double> q, double margin = 0.0) const;
  /// The first place on the straight joint motion where a pair is nearer than the margin; none when it is free.
  std::optional<Hit> first_hit(std::span<const double> from, std::span<const double> to,
                               const SweepOptions& options) const;

  /// The same on a way of many places (count × dof, at least one), from each to the next; `fraction` and `free_until`
  /// are of the number of places. Neighbours that lie on one straight motion to within `bend` [rad] are swept together.
  std::optional<Hit> first_hit_on_way(std::span<const double> places, const SweepOptions& options, double bend) const;

  /// The same for many rows (count × dof) on at most `threads` threads; row i depends on row i of the inputs alone.
  std::vector<Clearance> clearance_rows(std::span<const double> q, double margin, int threads) const;
  std::vector<std::uint8_t> free_rows(std::span<const double> q, double margin, int threads) const;
  std::vector<std::optional<Hit>> first_hit_rows(std::span<const double> from, std::span<const double> to,
                                                 const SweepOptions& options, int threads) const;

 private:
  struct Geometry;  ///< what a scene and the ones after it share
  struct Scene;     ///< what does not change while a call uses it
  struct Scratch;   ///< what one call computes in
  struct GiveBack {
    const CollisionChecker* owner;
    void operator()(Scratch* scratch) const;
  };
  using Lease = std::unique_ptr<Scratch, GiveBack>;
  struct DeleteModel {
    void operator()(mjModel* model) const { mj_deleteModel(model); }
  };

  Lease borrow() const;
  std::shared_ptr<const Scene> scene() const;
  /// Complete what follows from a changed scene, and let later calls use it.
  void publish(Scene scene, bool has_new_geometry = true);
  std::shared_ptr<const Geometry> geometry_of(const Scene& scene) const;
  Clearance nearest(Scratch& scratch, double margin, bool any) const;
  std::optional<Hit> sweep(Scratch& scratch, std::span<const double> from, std::span<const double> to,
                           const SweepOptions& options) const;
  std::vector<int> geoms_named(const std::string& name) const;
  void check_rows(std::span<const double> q, const char* what) const;
  template <typename Work>
  void for_rows(std::size_t count, int threads, Work work) const;

  std::unique_ptr<mjModel, DeleteModel> model_;
  std::vector<int> joints_;
  mutable std::mutex mutex_;  ///< of all below
  std::mutex changing_;       ///< held while the scene is changed
  std::shared_ptr<const Scene> scene_;
  mutable std::vector<std::unique_ptr<Scratch>> unused_;
  mutable std::size_t scratch_count_ = 0;
};

}  // namespace rcs
