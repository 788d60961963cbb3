#include "inverse_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

namespace rcs {

namespace {

constexpr double kMaxJointStep = 0.5;  // rad per iteration; larger steps leave the range where the Jacobian holds
constexpr double kStandstill = 1e-4;   // rad per iteration; a smaller step changes nothing that matters
constexpr double kFinest = 0.1;        // of the tolerance [rad] likewise, for what follows: its last steps are short
constexpr double kFollowStep = 0.2;    // rad per iteration when following, so that the TCP's way there is straight
constexpr double kBoundedStep = 0.05;  // rad likewise, where the end is bounded and may lie anywhere on the way
constexpr double kMoreDamping = 8.0;   // factor after a step that came no nearer
constexpr double kFulfilled = 0.25;    // of the promised decrease of the squared error; less needs more damping
constexpr double kStretched = 1e-3;    // m^2/rad^2; below, an arm is near a singular posture: 3 cm per radian
constexpr double kCurvature = 0.5;     // m/rad^2, of the TCP's path when one joint turns: about half an arm's length
constexpr double kNullSpaceDamping = 1e-8;
constexpr double kLargestReturn = 0.5;  // share of the way to the preferred joints per iteration
constexpr double kNear = 1e-3;          // m; an arm that meets the translation alone comes this near at any price
constexpr double kSmallest = 1e-300;
// A radian against a metre when following: what the target leaves as it is weighs up to a hundred times more.
constexpr double kLightest = 0.03, kHeaviest = 10.0;

// SplitMix64 (Steele, Lea, Flood 2014): a restart's joints depend on the seed alone, so the same call gives the same
// answer.
double next_uniform(std::uint64_t& state) {
  state += 0x9E3779B97F4A7C15ULL;
  std::uint64_t z = state;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1.0p-53;
}

// How an attempt ended.
enum class End : std::uint8_t { reached, at_max_step, nearest };

// How much of a step to make.
struct Stride {
  double largest = 0.0;     // entry of the whole step [rad]
  double scale = 1.0;       // share to make
  double stiffness = 0.0;   // smallest squared change of the error per squared radian, when the share is below 1
  bool is_at_edge = false;  // whether that share ends at the largest change from the start
};

// Translation [m] and rotation (as a rotation vector [rad]) from the present TCP to the target: position and
// quaternion wxyz in the base frame.
std::array<double, kTask> error_to(const Workspace& scratch, const std::array<double, 7>& target) {
  std::array<double, kTask> error;
  mju_sub3(error.data(), target.data(), scratch.translation.data());
  double inverse[4], difference[4];
  mju_negQuat(inverse, scratch.quaternion.data());
  mju_mulQuat(difference, target.data() + 3, inverse);
  mju_quat2Vel(error.data() + 3, difference, 1.0);
  return error;
}

// Write the step from the present Jacobian to `step`; joints that it would take past a limit go up to it.
Stride solve_step(Workspace& scratch, const std::vector<double>& q, const std::vector<double>& start,
                  std::span<const double> max_step, const IkOptions& options, double weight, double damping) {
  const int n = static_cast<int>(q.size());
  const double furthest = !options.best_effort ? kMaxJointStep : max_step.empty() ? kFollowStep : kBoundedStep;
  const auto column = [&](int c, std::array<double, kTask>& entries) {
    entries = scratch.jacobian[static_cast<std::size_t>(c)];
    for (int r = 3; r < kTask; ++r) entries[r] *= weight;
  };
  std::array<double, kTask> entries;
  std::vector<double>& step = scratch.step;
  std::fill(step.begin(), step.end(), 0.0);
  std::fill(scratch.is_free.begin(), scratch.is_free.end(), 1);
  Stride stride;
  // Every further round solves again for the joints that the last one leaves inside their range; the others stay at
  // their limits.
  for (int round = 0;; ++round) {
    std::array<double, kTask * kTask> a{};
    std::array<double, kTask> b = scratch.error;
    for (int r = 3; r < kTask; ++r) b[r] *= weight;
    for (int c = 0; c < n; ++c) {
      column(c, entries);
      if (scratch.is_free[c]) {
        for (int i = 0; i < kTask; ++i)
          for (int j = 0; j <= i; ++j) a[i * kTask + j] += entries[i] * entries[j];
        step[c] = 0.0;
      } else if (step[c] != 0.0) {
        for (int r = 0; r < kTask; ++r) b[r] -= entries[r] * step[c];
      }
    }
    std::array<double, kTask * kTask> exact = a;
    for (int i = 0; i < kTask; ++i) a[i * kTask + i] += damping;
    factor_cholesky(a);
    solve_cholesky(a, b);
    const auto add_transposed = [&](double sign) {
      for (int c = 0; c < n; ++c) {
        if (!scratch.is_free[c]) continue;
        column(c, entries);
        for (int r = 0; r < kTask; ++r) step[c] += sign * entries[r] * b[r];
      }
    };
    add_transposed(1.0);
    if (!options.preferred.empty()) {
      double fastest = 0.0;
      for (const double s : step) fastest = std::max(fastest, std::abs(s));
      const double share = std::min(options.preferred_weight * fastest, kLargestReturn);
      b.fill(0.0);
      for (int c = 0; c < n; ++c) {
        if (!scratch.is_free[c]) continue;
        const double pull = share * (options.preferred[c] - q[c]);
        column(c, entries);
        for (int r = 0; r < kTask; ++r) b[r] += entries[r] * pull;
        step[c] += pull;
      }
      // Nearly undamped, since what leaks out of the null space would pull against the target where the arm is
      // stretched.
      for (int i = 0; i < kTask; ++i) exact[i * kTask + i] += kNullSpaceDamping;
      factor_cholesky(exact);
      solve_cholesky(exact, b);
      add_transposed(-1.0);
    }
    stride = {};
    for (const double s : step) stride.largest = std::max(stride.largest, std::abs(s));
    if (stride.largest > furthest) stride.scale = furthest / stride.largest;
    for (std::size_t c = 0; c < max_step.size(); ++c) {
      const double room = max_step[c] - std::copysign(1.0, step[c]) * (q[c] - start[c]);
      if (stride.scale * std::abs(step[c]) <= room) continue;
      stride.scale = room / std::abs(step[c]);  // one factor for all joints keeps the direction of the TCP
      stride.is_at_edge = true;
    }
    bool is_blocked = false;
    for (int c = 0; c < n; ++c) {
      if (!scratch.is_free[c] || step[c] == 0.0) continue;
      const double limit = step[c] < 0.0 ? scratch.lower[c] : scratch.upper[c];
      // A search for any solution only minds joints that are at their limits already: it may well come back.
      const double reach = options.best_effort ? stride.scale * step[c] : 0.0;
      if (step[c] < 0.0 ? q[c] + reach > limit : q[c] + reach < limit) continue;
      scratch.is_free[c] = 0;
      step[c] = stride.scale > 0.0 ? (limit - q[c]) / stride.scale : 0.0;
      is_blocked = true;
    }
    if (is_blocked && round < (options.best_effort ? n : 1)) continue;
    if (options.best_effort && stride.scale < 1.0)
      stride.stiffness = smallest_of(a, options.rotation_weight < 1.0 ? 3 : kTask);
    return stride;
  }
}

// Decrease of the squared weighted error by a share of `step`, if the Jacobian held all along.
double promised(const Workspace& scratch, double weight, double scale) {
  std::array<double, kTask> left = scratch.error;
  for (std::size_t c = 0; c < scratch.jacobian.size(); ++c)
    for (int r = 0; r < kTask; ++r) left[r] -= scale * scratch.jacobian[c][r] * scratch.step[c];
  double decrease = 0.0;
  for (int r = 0; r < kTask; ++r)
    decrease += (r < 3 ? 1.0 : weight * weight) * (scratch.error[r] * scratch.error[r] - left[r] * left[r]);
  return std::max(decrease, 0.0);
}

// Take `q` towards the target, by `max_step` at most; empty for no bound. Errors and iterations go into `result`.
End attempt(Workspace& scratch, const std::array<double, 7>& target, std::vector<double>& q,
            std::span<const double> max_step, const IkOptions& options, IkResult& result) {
  const int n = static_cast<int>(q.size());
  const bool is_relaxed = options.rotation_weight < 1.0;
  const std::vector<double> start = q;
  std::vector<double>& candidate = scratch.candidate;
  scratch.put(q);
  scratch.error = error_to(scratch, target);
  double translation = norm3(scratch.error.data()), rotation = norm3(scratch.error.data() + 3);
  // The part of the pose that the target leaves as it is weighs most; an arm that meets the translation alone does not
  // turn its tool far for the last millimetres of a translation that it cannot meet.
  const double asked = std::clamp(translation / std::max(rotation, 1e-12), kLightest, kHeaviest);
  const auto weight_at = [&](double miss) {
    if (!options.best_effort) return options.rotation_weight;
    return options.rotation_weight * (is_relaxed ? std::sqrt(std::clamp(miss / kNear, 1.0, 10.0)) : asked);
  };
  double weight = weight_at(translation);
  double damping = options.damping, largest = kMaxJointStep;
  const double standstill =
      options.best_effort && !is_relaxed ? std::min(kStandstill, kFinest * options.rotation_tolerance) : kStandstill;
  bool is_new = true;  // there is no Jacobian of q yet
  End end = End::nearest;
  for (int iteration = 0;; ++iteration) {
    const bool is_reached = translation <= options.translation_tolerance && rotation <= options.rotation_tolerance;
    // A relaxed rotation goes on to the nearest one instead of stopping at the first that is near enough.
    if (is_reached && (!is_relaxed || largest < standstill || iteration == options.iterations)) end = End::reached;
    if (end != End::nearest || largest < standstill || iteration == options.iterations) break;
    ++result.iterations;
    if (is_new) scratch.differentiate();
    Stride stride = solve_step(scratch, q, start, max_step, options, weight, damping);
    // Where the arm is nearly stretched, the part of the error that it cannot follow would use up the step.
    if (options.best_effort && stride.scale < 1.0 && stride.stiffness < kStretched) {
      const double miss = std::sqrt(translation * translation + weight * weight * rotation * rotation);
      const double extra = kCurvature * miss * (1.0 - stride.stiffness / kStretched);
      if (extra > damping) stride = solve_step(scratch, q, start, max_step, options, weight, damping = extra);
    }
    largest = stride.largest;
    for (int c = 0; c < n; ++c)
      candidate[c] = std::clamp(q[c] + stride.scale * scratch.step[c], scratch.lower[c], scratch.upper[c]);
    scratch.put(candidate);
    const std::array<double, kTask> error = error_to(scratch, target);
    const double new_translation = norm3(error.data()), new_rotation = norm3(error.data() + 3);
    const double cost = translation * translation + weight * weight * rotation * rotation;
    const double new_cost = new_translation * new_translation + weight * weight * new_rotation * new_rotation;
    // A search for any solution does not mind a step that goes wrong: it may lead out of where it is stuck.
    is_new = !options.best_effort || cost - new_cost > kFulfilled * promised(scratch, weight, stride.scale);
    if (!is_new) {
      damping = std::max(damping, options.damping) * kMoreDamping;
      continue;
    }
    std::swap(q, candidate);
    scratch.error = error;
    translation = new_translation, rotation = new_rotation, weight = weight_at(translation);
    damping = std::max(damping / kMoreDamping, options.damping);
    if (stride.is_at_edge) end = End::at_max_step;
  }
  result.translation_error = translation;
  result.rotation_error = rotation;
  return end;
}

}  // namespace

IkResult solve_inverse(Workspace& scratch, const std::vector<double>& lower, const std::vector<double>& upper,
                       const Pose& target, std::span<const double> start, const IkOptions& options) {
  const int n = static_cast<int>(start.size());
  IkResult result;
  result.joints.assign(start.begin(), start.end());
  for (int i = 0; i < n; ++i) {
    // A joint that is found outside is followed from where it is.
    scratch.lower[i] = options.best_effort ? std::min(lower[i], start[i]) : lower[i];
    scratch.upper[i] = options.best_effort ? std::max(upper[i], start[i]) : upper[i];
    result.joints[i] = std::clamp(start[i], scratch.lower[i], scratch.upper[i]);
  }
  const auto& translation = target.translation();
  const auto& quaternion = target.quaternion();
  const std::array<double, 7> goal = {translation[0], translation[1], translation[2], quaternion[3],
                                      quaternion[0],  quaternion[1],  quaternion[2]};

  std::vector<double> q = result.joints, followed;
  const std::span<const double> bound = options.best_effort ? std::span(options.max_step) : std::span<const double>();
  std::uint64_t random = options.seed;
  End end = attempt(scratch, goal, q, bound, options, result);
  if (options.best_effort) followed = q;
  double best_translation = result.translation_error, best_rotation = result.rotation_error;
  for (int restart = 0; end == End::nearest && restart < options.restarts; ++restart) {
    for (int i = 0; i < n; ++i) q[i] = lower[i] + (upper[i] - lower[i]) * next_uniform(random);
    end = attempt(scratch, goal, q, {}, options, result);
    if (result.translation_error + result.rotation_error < best_translation + best_rotation) {
      best_translation = result.translation_error;
      best_rotation = result.rotation_error;
    }
  }
  if (end == End::nearest) {
    result.translation_error = best_translation;
    result.rotation_error = best_rotation;
    if (!options.best_effort) return result;
    result.joints = followed;
    result.status = IkStatus::nearest;
    return result;
  }
  double share = 1.0;
  for (std::size_t i = 0; i < options.max_step.size(); ++i)
    share = std::min(share, options.max_step[i] / std::max(std::abs(q[i] - result.joints[i]), kSmallest));
  const bool is_far = share < 1.0;
  for (int i = 0; i < n; ++i) result.joints[i] = is_far ? result.joints[i] + share * (q[i] - result.joints[i]) : q[i];
  result.status = is_far || end == End::at_max_step ? IkStatus::clamped : IkStatus::ok;
  return result;
}

}  // namespace rcs
