// Joint velocities for a twist of the TCP, and where they lead.
//
// A twist is divided along the principal directions of the arm's manipulability, and the arm follows each as far as it
// can: near a singular posture, the direction that is lost there is damped, and no other one. Maciejewski and Klein,
// "Numerical filtering for the operation of robotic manipulators through kinematically singular configurations", 1988.
#include <algorithm>
#include <cmath>
#include <utility>

#include "eigen6.hpp"
#include "over_rows.hpp"
#include "rcs/kinematics.hpp"

namespace rcs {

namespace {

using Task = std::array<double, kTask>;

constexpr double kStride = 0.03;      // rad of the fastest joint between two evaluations of the Jacobian
constexpr int kMostStrides = 1000;    // of one call; an arm goes round more than four times
constexpr int kMostCorrections = 4;   // of the pose after a stride; each takes a further digit or two
constexpr double kOnPath = 1e-10;     // m and rad; nearer needs no correction
constexpr double kRounding = 1e-9;    // m and rad; what is nearer to what was asked for is met
constexpr double kMet = 1e-4;         // of the speed; what deviates by less is what was asked for
constexpr double kHeaviest = 10.0;    // of what a twist leaves as it is, where not all can be met
constexpr double kTranslation = 1e3;  // against the rotation of an arm with fewer than six joints, which leans
constexpr double kLean = 0.2;         // rad/rad; where such an arm's lean is damped, so that it does not take all speed
constexpr double kDeepest = 0.1;      // of the damping; an arm goes no nearer to a singular posture on its own
constexpr double kNothing = 1e-12;    // rad/s, and rad to a limit

double norm6(const Task& v) {
  return std::sqrt(norm3(v.data()) * norm3(v.data()) + norm3(v.data() + 3) * norm3(v.data() + 3));
}

// One posture, and how the joints may move there.
class Posture {
 public:
  Posture(std::size_t dof, const Task& twist, double damping) : dof_(dof), damping_(damping), is_free_(dof, 1) {
    // The twist decides which part weighs more where a joint's limit allows only one of the two: a push does not turn
    // the tool, a turn does not move it. Both are multiplied, never divided, so that nothing is damped for it.
    const double linear = norm3(twist.data()), angular = norm3(twist.data() + 3);
    const double ratio = linear / std::max(angular, 1e-12);
    const double translation = dof < kTask ? kTranslation : std::clamp(1.0 / std::max(ratio, 1e-12), 1.0, kHeaviest);
    const double rotation = dof < kTask ? 1.0 : std::clamp(ratio, 1.0, kHeaviest);
    weight_ = {translation, translation, translation, rotation, rotation, rotation};
  }

  void set(std::vector<double> jacobian) {
    jacobian_ = std::move(jacobian);
    decompose();
  }
  void set_free(std::size_t joint, bool is_free) { is_free_[joint] = is_free; }
  void set_all_free() { std::fill(is_free_.begin(), is_free_.end(), 1); }
  bool is_free(std::size_t joint) const { return is_free_[joint] != 0; }
  void set_barred(bool is_barred) { is_barred_ = is_barred; }

  void decompose() {
    std::array<double, kTask * kTask> a{};
    for (int i = 0; i < kTask; ++i)
      for (int j = 0; j <= i; ++j) {
        double sum = 0.0;
        for (std::size_t c = 0; c < dof_; ++c)
          if (is_free_[c]) sum += jacobian_[i * dof_ + c] * jacobian_[j * dof_ + c];
        a[i * kTask + j] = a[j * kTask + i] = sum;
      }
    // Where no direction is damped, weights make no difference.
    factor_ = a;
    factor_cholesky(factor_);
    is_regular_ = dof_ >= kTask && smallest_of(factor_, kTask) > damping_ * damping_;
    if (is_regular_) return;
    for (int i = 0; i < kTask; ++i)
      for (int j = 0; j < kTask; ++j) a[i * kTask + j] *= weight_[i] * weight_[j];
    spectrum_ = spectrum_of(a);
    const double lean = dof_ < kTask ? std::max(kLean, damping_) : damping_;
    for (int i = 0; i < kTask; ++i) {
      least_[i] = 0.0;
      for (int k = 0; k < kTask; ++k) {
        const double part = spectrum_.vectors[i][k] * weight_[k] * (k < 3 ? damping_ : lean);
        least_[i] += part * part;
      }
    }
  }

  // Nearness to a singular posture: 1 and more where nothing is damped, 0 in it. For an arm with few joints, only
  // directions that move the TCP count: those three weigh most.
  double nearest_singularity() const {
    if (is_regular_) return 1.0;
    double nearest = 1.0;
    const double heavy = dof_ < kTask ? 1.0 : 0.0;
    for (int i = 0; i < kTask; ++i)
      if (least_[i] > heavy) nearest = std::min(nearest, spectrum_.values[i] / least_[i]);
    return std::sqrt(nearest);
  }

  // The motion of the free joints for a motion of the TCP, least squares in what cannot be met, added to `joints`.
  void add_motion(const Task& motion, std::vector<double>& joints) const {
    if (is_regular_) {
      Task pulled = motion;
      solve_cholesky(factor_, pulled);
      return add_transposed(pulled, 1.0, joints);
    }
    Task pulled{};
    for (int i = 0; i < kTask; ++i) {
      if (is_barred_ && spectrum_.values[i] < least_[i]) continue;
      add_part(i, motion, 1.0 / std::max(spectrum_.values[i], least_[i]), pulled);
    }
    add_transposed(pulled, 1.0, joints);
  }

  // Keep the part of a motion of the joints that leaves the TCP where it is.
  void project(std::vector<double>& joints) const {
    for (std::size_t c = 0; c < dof_; ++c)
      if (!is_free_[c]) joints[c] = 0.0;
    const Task motion = motion_of(joints);
    if (is_regular_) {
      Task pulled = motion;
      solve_cholesky(factor_, pulled);
      return add_transposed(pulled, -1.0, joints);
    }
    Task pulled{};
    for (int i = 0; i < kTask; ++i)
      if (spectrum_.values[i] > 1e-8 * least_[i]) add_part(i, motion, 1.0 / spectrum_.values[i], pulled);
    add_transposed(pulled, -1.0, joints);
  }

  // The TCP's motion for a motion of the joints.
  Task motion_of(const std::vector<double>& joints) const {
    Task motion{};
    for (int r = 0; r < kTask; ++r)
      for (std::size_t c = 0; c < dof_; ++c) motion[r] += jacobian_[r * dof_ + c] * joints[c];
    return motion;
  }

 private:
  void add_part(int i, const Task& motion, double gain, Task& pulled) const {
    double along = 0.0;
    for (int k = 0; k < kTask; ++k) along += spectrum_.vectors[i][k] * weight_[k] * motion[k];
    for (int k = 0; k < kTask; ++k) pulled[k] += gain * along * spectrum_.vectors[i][k] * weight_[k];
  }
  void add_transposed(const Task& pulled, double sign, std::vector<double>& joints) const {
    for (std::size_t c = 0; c < dof_; ++c) {
      if (!is_free_[c]) continue;
      for (int r = 0; r < kTask; ++r) joints[c] += sign * jacobian_[r * dof_ + c] * pulled[r];
    }
  }

  std::size_t dof_;
  double damping_;
  std::vector<char> is_free_;
  std::vector<double> jacobian_;
  Task weight_{};
  Task least_{};                                // eigenvalue at which damping begins
  std::array<double, kTask * kTask> factor_{};  // of the matrix without weights
  bool is_regular_ = false;                     // whether no direction is damped
  Spectrum spectrum_;
  bool is_barred_ = false;  // whether directions that are damped are left out
};

struct Range {
  const std::vector<double>& lower;
  const std::vector<double>& upper;

  bool is_blocked(std::size_t joint, double at, double velocity) const {
    return (velocity < 0.0 && at <= lower[joint] + kNothing) || (velocity > 0.0 && at >= upper[joint] - kNothing);
  }
};

double fastest_of(const std::vector<double>& velocities) {
  double fastest = 0.0;
  for (const double v : velocities) fastest = std::max(fastest, std::abs(v));
  return fastest;
}

// Share of the way that all joints can go until one is as fast as it may be.
double share_within(const std::vector<double>& velocities, const std::vector<double>& most) {
  double share = 1.0;
  for (std::size_t c = 0; c < most.size(); ++c)
    if (std::abs(velocities[c]) > most[c]) share = std::min(share, most[c] / std::abs(velocities[c]));
  return share;
}

// Velocities at a posture whose Jacobian is set.
Velocities solve(Posture& posture, const std::vector<double>& q, const Range& range, const Task& twist,
                 const VelocityOptions& options) {
  const std::size_t n = q.size();
  Velocities found;
  std::vector<double> rest(n);
  for (std::size_t round = 0;; ++round) {
    found.joints.assign(n, 0.0);
    posture.add_motion(twist, found.joints);
    found.share = share_within(found.joints, options.max_velocity);
    for (double& v : found.joints) v *= found.share;
    if (!options.preferred.empty()) {
      const double rate = options.preferred_weight * fastest_of(found.joints);
      for (std::size_t c = 0; c < n; ++c) rest[c] = rate * (options.preferred[c] - q[c]);
      posture.project(rest);
      double part = 1.0;
      for (std::size_t c = 0; c < options.max_velocity.size(); ++c) {
        const double room = options.max_velocity[c] - std::copysign(1.0, rest[c]) * found.joints[c];
        if (std::abs(rest[c]) > room) part = std::min(part, std::max(room, 0.0) / std::abs(rest[c]));
      }
      for (std::size_t c = 0; c < n; ++c) found.joints[c] += part * rest[c];
    }
    bool is_blocked = false;
    for (std::size_t c = 0; c < n; ++c)
      if (posture.is_free(c) && range.is_blocked(c, q[c], found.joints[c])) {
        posture.set_free(c, false);
        is_blocked = true;
      }
    if (!is_blocked || round == n) break;
    posture.decompose();
  }
  Task missed = posture.motion_of(found.joints);
  for (int r = 0; r < kTask; ++r) missed[r] -= found.share * twist[r];
  found.translation_error = norm3(missed.data());
  found.rotation_error = norm3(missed.data() + 3);
  // An arm with fewer than six joints leans as it must.
  const double missing = n < kTask ? found.translation_error : norm6(missed);
  if (missing > kMet * found.share * norm6(twist))
    found.status = IkStatus::nearest;
  else if (found.share < 1.0)
    found.status = IkStatus::clamped;
  return found;
}

// A pose after a motion along and about the axes of the base.
Pose moved(const Pose& pose, const Task& motion) {
  const auto& at = pose.translation();
  const Pose turned = Pose::from_rotvec({}, {motion[3], motion[4], motion[5]}) * Pose({}, pose.quaternion());
  return Pose({at[0] + motion[0], at[1] + motion[1], at[2] + motion[2]}, turned.quaternion());
}

// The motion along and about the axes of the base that leads from one pose to another.
Task motion_between(const Pose& from, const Pose& to) {
  const auto turn = (Pose({}, to.quaternion()) * Pose({}, from.quaternion()).inverse()).rotvec();
  Task motion;
  for (int r = 0; r < 3; ++r) {
    motion[r] = to.translation()[r] - from.translation()[r];
    motion[r + 3] = turn[r];
  }
  return motion;
}

Task scaled(const Task& motion, double by) {
  Task result;
  for (int r = 0; r < kTask; ++r) result[r] = by * motion[r];
  return result;
}

void require(const Kinematics& kinematics, std::span<const double> twist, const VelocityOptions& options) {
  const auto n = static_cast<std::size_t>(kinematics.dof());
  for (const double v : twist)
    if (!std::isfinite(v)) throw InvalidSetup("velocity kinematics: a twist is not finite");
  for (const auto* row : {&options.max_velocity, &options.preferred})
    if (!row->empty() && row->size() != n)
      throw InvalidSetup("velocity kinematics: max_velocity and preferred must have one entry for each of the " +
                         std::to_string(n) + " joints or none, one has " + std::to_string(row->size()));
}

}  // namespace

Velocities Kinematics::velocities(std::span<const double> joints, std::span<const double, 6> twist,
                                  const VelocityOptions& options) {
  check_joints(joints);
  require(*this, twist, options);
  const auto [lower, upper] = joint_range();
  const std::vector<double> q(joints.begin(), joints.end());
  Task asked;
  std::copy(twist.begin(), twist.end(), asked.begin());
  Posture posture(q.size(), asked, options.damping);
  posture.set(jacobian(q));
  return solve(posture, q, {lower, upper}, asked, options);
}

IkResult Kinematics::advance(std::span<const double> joints, std::span<const double, 6> twist, double duration,
                             const VelocityOptions& options) {
  check_joints(joints);
  require(*this, twist, options);
  if (!(duration >= 0.0) || !std::isfinite(duration))
    throw InvalidSetup("velocity kinematics: the duration must be finite and not negative");
  const std::size_t n = joints.size();
  auto [lower, upper] = joint_range();
  for (std::size_t c = 0; c < n; ++c) {
    lower[c] = std::min(lower[c], joints[c]);
    upper[c] = std::max(upper[c], joints[c]);
  }
  const Range range{lower, upper};
  IkResult result;
  result.status = IkStatus::ok;
  result.joints.assign(joints.begin(), joints.end());
  Task asked;
  std::copy(twist.begin(), twist.end(), asked.begin());
  if (norm6(asked) * duration == 0.0) return result;

  const std::vector<double> start = result.joints;
  std::vector<double>& q = result.joints;
  std::vector<double> candidate(n), correction(n);
  Posture posture(n, asked, options.damping), there(n, asked, options.damping);
  const Pose begin = forward(q);
  Pose pose = begin;
  double left = duration;
  while (left > 1e-9 * duration && result.iterations < kMostStrides) {
    ++result.iterations;
    posture.set_all_free();
    posture.set_barred(false);
    posture.set(jacobian(q));
    const double nearness = posture.nearest_singularity();
    double time = 0.0;
    Pose reached;
    // Twice at most: a stride that would lead deeper into a singular posture is made again without what leads there.
    for (int attempt = 0;; ++attempt) {
      const Velocities found = solve(posture, q, range, asked, options);
      if (found.status == IkStatus::nearest || (found.status == IkStatus::clamped && result.status == IkStatus::ok))
        result.status = found.status;
      const double fastest = fastest_of(found.joints);
      candidate = q;
      time = 0.0;
      if (fastest < kNothing) break;
      time = std::min(left, kStride / fastest);
      for (std::size_t c = 0; c < n; ++c) {
        const double v = found.joints[c];
        if (v == 0.0) continue;
        const double room = ((v < 0.0 ? lower[c] : upper[c]) - q[c]) / v;
        time = std::min(time, std::max(room, 0.0));
      }
      for (std::size_t c = 0; c < n; ++c) candidate[c] = std::clamp(q[c] + time * found.joints[c], lower[c], upper[c]);
      // The Jacobian has changed on the way; what the TCP misses by that is made up for.
      const Pose goal = moved(pose, scaled(posture.motion_of(found.joints), time));
      reached = forward(candidate);
      double before = HUGE_VAL;
      for (int k = 0; k < kMostCorrections; ++k) {
        const Task error = motion_between(reached, goal);
        const double size = norm6(error);
        if (size < kOnPath || size > 0.5 * before) break;
        before = size;
        std::fill(correction.begin(), correction.end(), 0.0);
        posture.add_motion(error, correction);
        if (!(fastest_of(correction) < kStride)) break;
        for (std::size_t c = 0; c < n; ++c) candidate[c] = std::clamp(candidate[c] + correction[c], lower[c], upper[c]);
        reached = forward(candidate);
      }
      if (attempt > 0 || nearness > 2.0 * kDeepest) break;
      there.set(jacobian(candidate));
      const double nearer = there.nearest_singularity();
      if (nearer >= nearness || nearer >= kDeepest) break;
      posture.set_barred(true);
      result.status = IkStatus::nearest;
    }
    if (time <= 0.0) break;
    q = candidate;
    pose = reached;
    left -= time;
  }
  if (result.iterations == kMostStrides && result.status == IkStatus::ok) result.status = IkStatus::clamped;
  if (!options.max_velocity.empty()) {
    double share = 1.0;
    for (std::size_t c = 0; c < n; ++c) {
      const double most = options.max_velocity[c] * duration, way = std::abs(q[c] - start[c]);
      if (way > most) share = std::min(share, most / way);
    }
    for (std::size_t c = 0; share < 1.0 && c < n; ++c) q[c] = start[c] + share * (q[c] - start[c]);
    if (share < 1.0) pose = forward(q);
  }
  const Task missed = motion_between(pose, moved(begin, scaled(asked, duration)));
  result.translation_error = norm3(missed.data());
  result.rotation_error = norm3(missed.data() + 3);
  const double missing = n < kTask ? result.translation_error : norm6(missed);
  if (result.status == IkStatus::ok && missing > kMet * norm6(asked) * duration + kRounding)
    result.status = IkStatus::nearest;
  return result;
}

void Kinematics::advance_batch(std::span<const double> starts, std::span<const double> twists, double duration,
                               const VelocityOptions& options, int threads, std::span<double> joints,
                               std::span<std::uint8_t> status, std::span<double> errors) {
  const std::size_t n = static_cast<std::size_t>(dof()), count = status.size();
  if (twists.size() != kTask * count || starts.size() != n * count || joints.size() != n * count ||
      errors.size() != 2 * count)
    throw InvalidSetup("velocity kinematics: starts, twists and outputs have different numbers of rows");
  // Everything that would throw in a thread throws here.
  const std::vector<double> from(starts.begin(), starts.end()), asked(twists.begin(), twists.end());
  for (const double q : from)
    if (!std::isfinite(q)) throw InvalidSetup("velocity kinematics: a joint is not finite");
  require(*this, asked, options);
  if (!(duration >= 0.0) || !std::isfinite(duration))
    throw InvalidSetup("velocity kinematics: the duration must be finite and not negative");
  over_rows(count, is_thread_safe() ? threads : 1, [&](std::size_t i) {
    const IkResult result =
        advance(std::span(from).subspan(i * n, n), std::span(asked).subspan(i * kTask).first<6>(), duration, options);
    std::copy(result.joints.begin(), result.joints.end(), joints.begin() + static_cast<std::ptrdiff_t>(i * n));
    status[i] = static_cast<std::uint8_t>(result.status);
    errors[2 * i] = result.translation_error;
    errors[2 * i + 1] = result.rotation_error;
  });
}

}  // namespace rcs
