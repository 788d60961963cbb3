// Leads joints from command to command, tick by tick, and counts commands that asked for too much. Private to the
// sources.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <span>
#include <vector>

#include "rcs/streamed_arm.hpp"
#include "rcs/trajectory.hpp"

namespace rcs {

/// The thread of an arm uses it; any may ask for the counts.
class StreamLeader {
 public:
  /// The options outlive it.
  StreamLeader(MotionLimits limits, const StreamOptions& options);

  /// Stand at these joints, which may be outside of their range.
  void stand(std::span<const double> joints);
  /// Follow a command until the next, which is to come after `period` [s].
  void follow(std::span<const double> joints, double period);
  /// The time of the command has passed without another one: go on to where it was.
  void go_on(double period);
  /// Come to rest, and stay there.
  void brake();
  /// Let a tick pass.
  const StreamPoint& advance();

  /// Where the joints are led to at present, and where to in the end [rad].
  std::span<const double> position();
  std::span<const double> target() const { return std::span(memory_).first(goal_.size()); }
  bool is_still() { return trajectory_->is_still(memory_.data()); }

  Clamped clamped() const { return {range_, speed_, acceleration_, jerk_, box_}; }
  void forget_counts() { range_ = speed_ = acceleration_ = jerk_ = box_ = 0; }

 private:
  double lower(std::size_t joint) const { return limits_.lower[joint] + options_.margin; }
  double upper(std::size_t joint) const { return limits_.upper[joint] - options_.margin; }
  void set_range(std::span<const double> joints);
  void forget_asked();
  void stay_in_range(double tick);
  void stay_in_box(double tick);

  const MotionLimits limits_;
  MotionLimits range_now_;  // with what was outside of the range
  const StreamOptions& options_;
  std::unique_ptr<Trajectory> trajectory_, braking_;
  std::vector<double> memory_, tried_;
  std::vector<double> goal_;                  // rad, of the last command
  std::array<std::vector<double>, 4> asked_;  // what commands have come to: position, speed, acceleration, jerk
  bool is_wide_ = false;                      // a joint is outside of its range
  bool was_cut_ = false;                      // on the way to the goal is the end of the box
  StreamPoint point_;
  std::atomic<std::uint64_t> range_ = 0, speed_ = 0, acceleration_ = 0, jerk_ = 0, box_ = 0;
};

}  // namespace rcs
