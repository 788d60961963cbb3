// Callbacks of a world while it steps, and those that every robot needs.
#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace rcs {

/// One copy of a scene while it is stepped. MuJoCo's own structures, valid only during the call.
struct StepView {
  const mjModel* model;
  mjData* data;
  int copy;
  const std::shared_ptr<const void>* memory = nullptr;  ///< keeps `model` and `data`, where the world does
};

/// A function run between physics steps, in C++ or Python. Copies are stepped on several threads: what a callback
/// remembers it must keep per `view.copy`.
class StepCallback {
 public:
  virtual ~StepCallback() = default;
  /// The meaning of the result depends on how the callback was added to the world; periodic ones return anything.
  virtual bool call(const StepView& view) = 0;
  /// A synchronous step of a copy begins, of which this may be the end.
  virtual void begin(int /*copy*/) {}
  /// Forget what was remembered of a copy; its episode starts anew.
  virtual void reset(int /*copy*/) {}
  /// The memory of a copy, to be saved and written back with the copy's state; of the same size at all times.
  virtual std::span<double> memory(int /*copy*/) { return {}; }
  /// Throws `InvalidSetup` if it cannot be called in a world of this model and number of copies.
  virtual void check(const mjModel* /*model*/, int /*copies*/) const {}
};

/// True when position-controlled joints stand at their targets.
class JointsArrived final : public StepCallback {
 public:
  /// `joints` are hinge or slide joint ids, `actuators` the position servos whose controls are their targets.
  /// Throws `InvalidSetup` if they differ in number.
  JointsArrived(std::vector<int> joints, std::vector<int> actuators, double position_tolerance,
                double velocity_tolerance);
  bool call(const StepView& view) override;
  void check(const mjModel* model, int copies) const override;

 private:
  std::vector<int> joints_;
  std::vector<int> actuators_;
  double position_tolerance_;  // rad or m
  double velocity_tolerance_;  // rad/s or m/s
};

/// True when joints have stood still for a while: a gripper that closed on an object never reaches its target.
class JointsAtRest final : public StepCallback {
 public:
  /// `joints` are hinge or slide joint ids, `copies` those of the world. With `within_step`, only rest since the
  /// beginning of the step counts. Throws `InvalidSetup` if there are no copies.
  JointsAtRest(std::vector<int> joints, double velocity_tolerance, double duration, int copies,
               bool within_step = false);
  bool call(const StepView& view) override;
  void begin(int copy) override {
    if (within_step_) reset(copy);
  }
  void reset(int copy) override { since_[static_cast<std::size_t>(copy)] = -1.0; }
  std::span<double> memory(int copy) override { return std::span(since_).subspan(static_cast<std::size_t>(copy), 1); }
  void check(const mjModel* model, int copies) const override;

 private:
  std::vector<int> joints_;
  double velocity_tolerance_;  // rad/s or m/s
  double duration_;            // s
  bool within_step_;
  std::vector<double> since_;  // s, when the joints came to rest; negative while they move
};

/// True when a surface of one set touches one of the other with more than a given force. See `contact_force`.
class Collision final : public StepCallback {
 public:
  /// `first` and `second` hold one flag per geom of the model, then one per flex; `force` is in N.
  Collision(std::vector<std::uint8_t> first, std::vector<std::uint8_t> second, double force)
      : first_(std::move(first)), second_(std::move(second)), force_(force) {}
  bool call(const StepView& view) override;
  void check(const mjModel* model, int copies) const override;

 private:
  std::vector<std::uint8_t> first_;
  std::vector<std::uint8_t> second_;
  double force_;
};

/// Sum of the normal forces [N] between two sets of surfaces, each given as one flag per geom of the model and then one
/// per flex. Flags that are left out at the end count as 0: a set of geoms alone needs none for flexes.
double contact_force(const mjModel* model, const mjData* data, const std::vector<std::uint8_t>& first,
                     const std::vector<std::uint8_t>& second);

}  // namespace rcs
