#include "rcs/kinematics.hpp"

#include <algorithm>
#include <cmath>
#include <thread>
#include <utility>

namespace rcs {

namespace {

constexpr double kMaxJointStep = 0.5;  // rad per iteration; larger steps leave the range where the Jacobian holds
constexpr double kStandstill = 1e-4;   // rad per iteration; a smaller step changes nothing that matters
constexpr int kTask = 6;

// SplitMix64 (Steele, Lea, Flood 2014): a restart's joints depend on the seed alone, so the same call gives the same
// answer.
double next_uniform(std::uint64_t& state) {
  state += 0x9E3779B97F4A7C15ULL;
  std::uint64_t z = state;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1.0p-53;
}

// Solve the symmetric positive definite 6 × 6 system in place by Cholesky factorisation.
void solve_cholesky(std::array<double, kTask * kTask>& a, std::array<double, kTask>& b) {
  for (int j = 0; j < kTask; ++j) {
    for (int k = 0; k < j; ++k)
      for (int i = j; i < kTask; ++i) a[i * kTask + j] -= a[i * kTask + k] * a[j * kTask + k];
    const double scale = 1.0 / std::sqrt(a[j * kTask + j]);
    for (int i = j; i < kTask; ++i) a[i * kTask + j] *= scale;
  }
  for (int i = 0; i < kTask; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= a[i * kTask + k] * b[k];
    b[i] /= a[i * kTask + i];
  }
  for (int i = kTask - 1; i >= 0; --i) {
    for (int k = i + 1; k < kTask; ++k) b[i] -= a[k * kTask + i] * b[k];
    b[i] /= a[i * kTask + i];
  }
}

double norm3(const double* v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

}  // namespace

struct DampedLeastSquares::Scratch {
  explicit Scratch(const mjModel* model)
      : data(mj_makeData(model)),
        jacobian_translation(static_cast<std::size_t>(3 * model->nv)),
        jacobian_rotation(static_cast<std::size_t>(3 * model->nv)) {}
  ~Scratch() { mj_deleteData(data); }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  mjData* data;
  std::vector<double> jacobian_translation;
  std::vector<double> jacobian_rotation;
};

DampedLeastSquares::DampedLeastSquares(const mjModel* model, std::vector<int> joints, int tcp_site, int base_body)
    : joints_(std::move(joints)), tcp_site_(tcp_site), base_body_(base_body) {
  if (tcp_site < 0 || tcp_site >= model->nsite || base_body < 0 || base_body >= model->nbody)
    throw InvalidSetup("inverse kinematics: the TCP site or the base body is not in the model");
  if (joints_.empty()) throw InvalidSetup("inverse kinematics: no joints given");
  for (const int joint : joints_) {
    if (joint < 0 || joint >= model->njnt)
      throw InvalidSetup("inverse kinematics: joint id " + std::to_string(joint) + " is not in the model");
    if (model->jnt_type[joint] != mjJNT_HINGE && model->jnt_type[joint] != mjJNT_SLIDE)
      throw InvalidSetup("inverse kinematics: only hinge and slide joints are supported");
    qpos_.push_back(model->jnt_qposadr[joint]);
    dofs_.push_back(model->jnt_dofadr[joint]);
    const bool is_limited = model->jnt_limited[joint] != 0;
    lower_.push_back(is_limited ? model->jnt_range[2 * joint] : -2 * mjPI);
    upper_.push_back(is_limited ? model->jnt_range[2 * joint + 1] : 2 * mjPI);
  }
  model_ = mj_copyModel(nullptr, model);
  borrow();
}

DampedLeastSquares::~DampedLeastSquares() { mj_deleteModel(model_); }

DampedLeastSquares::Lease DampedLeastSquares::borrow() const {
  {
    const std::lock_guard lock(mutex_);
    if (!unused_.empty()) {
      Lease lease(unused_.back().release(), GiveBack{this});
      unused_.pop_back();
      return lease;
    }
    unused_.reserve(++scratch_count_);  // giving back must not fail
  }
  return Lease(new Scratch(model_), GiveBack{this});
}

void DampedLeastSquares::GiveBack::operator()(Scratch* scratch) const {
  const std::lock_guard lock(owner->mutex_);
  owner->unused_.emplace_back(scratch);
}

void DampedLeastSquares::check_size(std::span<const double> joints) const {
  if (joints.size() != joints_.size())
    throw InvalidSetup("kinematics: " + std::to_string(joints.size()) + " joints given, the arm has " +
                       std::to_string(joints_.size()));
  for (const double q : joints)
    if (!std::isfinite(q)) throw InvalidSetup("kinematics: a joint is not finite");
}

void DampedLeastSquares::set_joints(Scratch& scratch, std::span<const double> joints) const {
  for (std::size_t i = 0; i < joints.size(); ++i) scratch.data->qpos[qpos_[i]] = joints[i];
  mj_kinematics(model_, scratch.data);
}

Pose DampedLeastSquares::forward(std::span<const double> joints) {
  check_size(joints);
  const Lease scratch = borrow();
  set_joints(*scratch, joints);
  double site_quat[4], base_inverse[4], quat[4], offset[3], translation[3];
  mju_mat2Quat(site_quat, scratch->data->site_xmat + 9 * tcp_site_);
  mju_negQuat(base_inverse, scratch->data->xquat + 4 * base_body_);
  mju_mulQuat(quat, base_inverse, site_quat);
  mju_sub3(offset, scratch->data->site_xpos + 3 * tcp_site_, scratch->data->xpos + 3 * base_body_);
  mju_rotVecQuat(translation, offset, base_inverse);
  return Pose({translation[0], translation[1], translation[2]}, {quat[1], quat[2], quat[3], quat[0]});
}

std::vector<double> DampedLeastSquares::jacobian(std::span<const double> joints) const {
  check_size(joints);
  const Lease scratch = borrow();
  set_joints(*scratch, joints);
  mj_comPos(model_, scratch->data);
  mj_jacSite(model_, scratch->data, scratch->jacobian_translation.data(), scratch->jacobian_rotation.data(), tcp_site_);
  const std::size_t n = joints_.size();
  std::vector<double> jacobian(6 * n);
  const double* base = scratch->data->xmat + 9 * base_body_;
  for (std::size_t c = 0; c < n; ++c)
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 3; ++k) {  // base^T * world axes
        jacobian[r * n + c] += base[3 * k + r] * scratch->jacobian_translation[k * model_->nv + dofs_[c]];
        jacobian[(r + 3) * n + c] += base[3 * k + r] * scratch->jacobian_rotation[k * model_->nv + dofs_[c]];
      }
  return jacobian;
}

void DampedLeastSquares::error_to(const Scratch& scratch, const std::array<double, 7>& target,
                                  std::array<double, 6>& error) const {
  mju_sub3(error.data(), target.data(), scratch.data->site_xpos + 3 * tcp_site_);
  double quat[4], inverse[4], difference[4];
  mju_mat2Quat(quat, scratch.data->site_xmat + 9 * tcp_site_);
  mju_negQuat(inverse, quat);
  mju_mulQuat(difference, target.data() + 3, inverse);
  mju_quat2Vel(error.data() + 3, difference, 1.0);
}

bool DampedLeastSquares::attempt(Scratch& scratch, const std::array<double, 7>& target, std::vector<double>& q,
                                 const IkOptions& options, IkResult& result) const {
  const int n = dof(), nv = model_->nv;
  const double weight = options.rotation_weight;
  double largest = kMaxJointStep;
  std::array<double, kTask> error;
  std::vector<double> step(static_cast<std::size_t>(n));
  std::vector<char> is_free(static_cast<std::size_t>(n));
  for (int iteration = 0;; ++iteration) {
    set_joints(scratch, q);
    error_to(scratch, target, error);
    result.translation_error = norm3(error.data());
    result.rotation_error = norm3(error.data() + 3);
    const bool is_reached = result.translation_error <= options.translation_tolerance &&
                            result.rotation_error <= options.rotation_tolerance;
    // A relaxed rotation goes on to the nearest one instead of stopping at the first that is near enough.
    if (is_reached && (weight >= 1.0 || largest < kStandstill)) return true;
    if (iteration == options.iterations) return is_reached;
    ++result.iterations;

    mj_comPos(model_, scratch.data);
    mj_jacSite(model_, scratch.data, scratch.jacobian_translation.data(), scratch.jacobian_rotation.data(), tcp_site_);
    std::fill(is_free.begin(), is_free.end(), 1);
    // At most two rounds: the second solves again without the joints that the first would push out of their range.
    for (int round = 0; round < 2; ++round) {
      std::array<double, kTask * kTask> a{};
      for (int c = 0; c < n; ++c) {
        if (!is_free[c]) continue;
        double column[kTask];
        for (int r = 0; r < 3; ++r) {
          column[r] = scratch.jacobian_translation[r * nv + dofs_[c]];
          column[r + 3] = weight * scratch.jacobian_rotation[r * nv + dofs_[c]];
        }
        for (int i = 0; i < kTask; ++i)
          for (int j = 0; j <= i; ++j) a[i * kTask + j] += column[i] * column[j];
      }
      for (int i = 0; i < kTask; ++i) a[i * kTask + i] += options.damping;
      std::array<double, kTask> b = error;
      for (int r = 3; r < kTask; ++r) b[r] *= weight;
      solve_cholesky(a, b);
      bool is_blocked = false;
      for (int c = 0; c < n; ++c) {
        step[c] = 0.0;
        if (!is_free[c]) continue;
        for (int r = 0; r < 3; ++r)
          step[c] += scratch.jacobian_translation[r * nv + dofs_[c]] * b[r] +
                     weight * scratch.jacobian_rotation[r * nv + dofs_[c]] * b[r + 3];
        const bool is_outward = (q[c] <= lower_[c] && step[c] < 0.0) || (q[c] >= upper_[c] && step[c] > 0.0);
        if (is_outward) {
          is_free[c] = 0;
          is_blocked = true;
        }
      }
      if (!is_blocked) break;
    }
    largest = 0.0;
    for (int c = 0; c < n; ++c) largest = std::max(largest, is_free[c] ? std::abs(step[c]) : 0.0);
    const double scale = largest > kMaxJointStep ? kMaxJointStep / largest : 1.0;
    for (int c = 0; c < n; ++c)
      if (is_free[c]) q[c] = std::clamp(q[c] + scale * step[c], lower_[c], upper_[c]);
  }
}

IkResult DampedLeastSquares::inverse(const Pose& target, std::span<const double> start, const IkOptions& options) {
  check_size(start);
  const int n = dof();
  IkResult result;
  result.joints.assign(start.begin(), start.end());
  for (int i = 0; i < n; ++i) result.joints[i] = std::clamp(start[i], lower_[i], upper_[i]);

  // The solve is in world axes, where MuJoCo's Jacobian is; the base may stand anywhere.
  const Lease scratch = borrow();
  set_joints(*scratch, result.joints);
  std::array<double, 7> goal;
  const double* base_quat = scratch->data->xquat + 4 * base_body_;
  const auto& translation = target.translation();
  const auto& quaternion = target.quaternion();
  const double wxyz[4] = {quaternion[3], quaternion[0], quaternion[1], quaternion[2]};
  mju_rotVecQuat(goal.data(), translation.data(), base_quat);
  mju_addTo3(goal.data(), scratch->data->xpos + 3 * base_body_);
  mju_mulQuat(goal.data() + 3, base_quat, wxyz);

  std::vector<double> q = result.joints;
  std::uint64_t random = options.seed;
  bool is_found = attempt(*scratch, goal, q, options, result);
  double best_translation = result.translation_error, best_rotation = result.rotation_error;
  for (int restart = 0; !is_found && restart < options.restarts; ++restart) {
    for (int i = 0; i < n; ++i) q[i] = lower_[i] + (upper_[i] - lower_[i]) * next_uniform(random);
    is_found = attempt(*scratch, goal, q, options, result);
    if (result.translation_error + result.rotation_error < best_translation + best_rotation) {
      best_translation = result.translation_error;
      best_rotation = result.rotation_error;
    }
  }
  result.translation_error = is_found ? result.translation_error : best_translation;
  result.rotation_error = is_found ? result.rotation_error : best_rotation;
  if (!is_found) return result;

  double largest = 0.0;
  for (int i = 0; i < n; ++i) largest = std::max(largest, std::abs(q[i] - result.joints[i]));
  const bool is_far = largest > options.max_step;
  const double fraction = is_far ? options.max_step / largest : 1.0;
  for (int i = 0; i < n; ++i)
    result.joints[i] = is_far ? result.joints[i] + fraction * (q[i] - result.joints[i]) : q[i];
  result.status = is_far ? IkStatus::clamped : IkStatus::ok;
  return result;
}

void inverse_batch(DampedLeastSquares& kinematics, std::span<const double> targets, std::span<const double> starts,
                   const IkOptions& options, int threads, std::span<double> joints, std::span<std::uint8_t> status) {
  const std::size_t n = static_cast<std::size_t>(kinematics.dof()), count = status.size();
  if (targets.size() != 7 * count || starts.size() != n * count || joints.size() != n * count)
    throw InvalidSetup("inverse kinematics: targets, starts and outputs have different numbers of rows");
  // All poses are made first: a bad one throws here and not in a thread.
  std::vector<Pose> poses;
  poses.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* t = targets.data() + 7 * i;
    poses.emplace_back(std::array<double, 3>{t[0], t[1], t[2]}, std::array<double, 4>{t[3], t[4], t[5], t[6]});
  }
  const std::vector<double> from(starts.begin(), starts.end());  // nobody writes to a copy once it is checked
  for (const double q : from)
    if (!std::isfinite(q)) throw InvalidSetup("inverse kinematics: a start joint is not finite");
  const auto solve = [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) {
      const IkResult result = kinematics.inverse(poses[i], std::span(from).subspan(i * n, n), options);
      std::copy(result.joints.begin(), result.joints.end(), joints.begin() + static_cast<std::ptrdiff_t>(i * n));
      status[i] = static_cast<std::uint8_t>(result.status);
    }
  };
  // More threads than cores help nobody, and a machine may refuse to start them.
  const std::size_t cores = std::max<std::size_t>(std::thread::hardware_concurrency(), 1);
  const std::size_t workers = std::min({static_cast<std::size_t>(std::max(threads, 1)), cores, count});
  if (workers <= 1) return solve(0, count);
  std::vector<std::jthread> pool;
  for (std::size_t w = 1; w < workers; ++w)
    pool.emplace_back([&, w] { solve(count * w / workers, count * (w + 1) / workers); });
  solve(0, count / workers);
}

}  // namespace rcs
