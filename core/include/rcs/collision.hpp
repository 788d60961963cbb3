// The reaction of an arm to collisions: it goes into its fault state when what presses on it is more than its limits.
#pragma once

#include <array>
#include <limits>
#include <span>
#include <vector>

#include "rcs/callback.hpp"
#include "rcs/measurement.hpp"

namespace rcs {

/// When an arm takes what it feels for a collision.
struct CollisionLimits {
  std::vector<double> torques;     ///< Nm (N), per joint
  std::array<double, 6> wrench{};  ///< N, Nm: force and moment about the TCP, in the axes of the base
  bool is_of_drives = false;       ///< limit what the drives exert, instead of what presses on the arm from outside
  double time_constant = 0.0;      ///< s: the arm's observer gives the loads through a first-order filter
  double duration = 0.0;           ///< s: a limit must be exceeded for this long
};

/// True when a limit is exceeded; a world that has it as `fault_when` ends the step then.
class CollisionReaction final : public StepCallback {
 public:
  /// `copies` are those of the world. Throws `InvalidSetup` for limits that are not positive or not one per joint.
  CollisionReaction(ArmBody arm, CollisionLimits limits, int copies);
  bool call(const StepView& view) override;
  void reset(int copy) override;
  void check(const mjModel* model, int copies) const override;
  std::span<double> memory(int copy) override;

  /// Which limit was exceeded (joints, then the wrench's six), or -1, and by which load.
  struct Cause {
    int index;
    double load;
  };
  Cause cause(int copy) const;

 private:
  std::size_t size() const { return limits_.torques.size() + 6; }
  std::size_t width() const { return 2 * size() + 3; }
  double limit(std::size_t i) const {
    const std::size_t dof = limits_.torques.size();
    return i < dof ? limits_.torques[i] : limits_.wrench[i - dof];
  }

  ArmBody arm_;
  CollisionLimits limits_;
  double share_ = 1.0;  // of a new value in the filtered one
  // Per copy: the filtered loads, for how long each is above its limit [s], the cause, and whether any is not 0.
  std::vector<double> memory_;
};

}  // namespace rcs
