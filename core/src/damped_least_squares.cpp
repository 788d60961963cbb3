#include <utility>

#include "inverse_search.hpp"
#include "rcs/kinematics.hpp"
#include "serial_chain.hpp"
#include "task_matrix.hpp"

namespace rcs {

namespace {

// Any kinematics at some joints.
struct Called final : Workspace {
  explicit Called(Kinematics& kinematics, std::size_t dof) : Workspace(dof), kinematics(kinematics), joints(dof) {}

  void put(std::span<const double> given) override {
    joints.assign(given.begin(), given.end());
    const Pose pose = kinematics.forward(joints);
    const auto& q = pose.quaternion();
    translation = pose.translation();
    quaternion = {q[3], q[0], q[1], q[2]};
  }
  void differentiate() override {
    const std::vector<double> rows = kinematics.jacobian(joints);
    const std::size_t n = joints.size();
    for (std::size_t c = 0; c < n; ++c)
      for (std::size_t r = 0; r < kTask; ++r) jacobian[c][r] = rows[r * n + c];
  }

  Kinematics& kinematics;
  std::vector<double> joints;
};

}  // namespace

IkResult Kinematics::inverse(const Pose& target, std::span<const double> start, const IkOptions& options) {
  check_joints(start);
  check_options(options);
  Called scratch(*this, start.size());
  const auto [lower, upper] = joint_range();
  return solve_inverse(scratch, lower, upper, target, start, options);
}

struct DampedLeastSquares::Scratch final : Workspace {
  explicit Scratch(const SerialChain& chain, std::size_t dof) : Workspace(dof), chain(chain), place(dof) {}

  void put(std::span<const double> joints) override {
    chain.put(joints, place);
    translation = place.translation;
    quaternion = place.quaternion;
  }
  void differentiate() override {
    for (std::size_t c = 0; c < jacobian.size(); ++c) jacobian[c] = chain.column(place, c);
  }

  const SerialChain& chain;
  ChainPlace place;
};

DampedLeastSquares::DampedLeastSquares(const mjModel* model, std::vector<int> joints, int tcp_site, int base_body)
    : joints_(std::move(joints)) {
  if (tcp_site < 0 || tcp_site >= model->nsite || base_body < 0 || base_body >= model->nbody)
    throw InvalidSetup("inverse kinematics: the TCP site or the base body is not in the model");
  if (joints_.empty()) throw InvalidSetup("inverse kinematics: no joints given");
  for (const int joint : joints_) {
    if (joint < 0 || joint >= model->njnt)
      throw InvalidSetup("inverse kinematics: joint id " + std::to_string(joint) + " is not in the model");
    if (model->jnt_type[joint] != mjJNT_HINGE && model->jnt_type[joint] != mjJNT_SLIDE)
      throw InvalidSetup("inverse kinematics: only hinge and slide joints are supported");
    const bool is_limited = model->jnt_limited[joint] != 0;
    lower_.push_back(is_limited ? model->jnt_range[2 * joint] : -2 * mjPI);
    upper_.push_back(is_limited ? model->jnt_range[2 * joint + 1] : 2 * mjPI);
  }
  chain_ = std::make_unique<const SerialChain>(model, joints_, tcp_site, base_body);
  borrow();
}

DampedLeastSquares::~DampedLeastSquares() = default;

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
  return Lease(new Scratch(*chain_, joints_.size()), GiveBack{this});
}

void DampedLeastSquares::GiveBack::operator()(Scratch* scratch) const {
  const std::lock_guard lock(owner->mutex_);
  owner->unused_.emplace_back(scratch);
}

Pose DampedLeastSquares::forward(std::span<const double> joints) {
  check_joints(joints);
  const Lease scratch = borrow();
  scratch->put(joints);
  const auto& quat = scratch->quaternion;
  return Pose(scratch->translation, {quat[1], quat[2], quat[3], quat[0]});
}

std::vector<double> DampedLeastSquares::jacobian(std::span<const double> joints) {
  check_joints(joints);
  const Lease scratch = borrow();
  scratch->put(joints);
  const std::size_t n = joints_.size();
  std::vector<double> jacobian(kTask * n);
  scratch->differentiate();
  for (std::size_t c = 0; c < n; ++c)
    for (std::size_t r = 0; r < kTask; ++r) jacobian[r * n + c] = scratch->jacobian[c][r];
  return jacobian;
}

IkResult DampedLeastSquares::inverse(const Pose& target, std::span<const double> start, const IkOptions& options) {
  check_joints(start);
  check_options(options);
  const Lease scratch = borrow();
  return solve_inverse(*scratch, lower_, upper_, target, start, options);
}

void DampedLeastSquares::inverse_batch(std::span<const double> targets, std::span<const double> starts,
                                       const IkOptions& options, int threads, std::span<double> joints,
                                       std::span<std::uint8_t> status, std::span<double> errors) {
  check_options(options);
  solve_rows(targets, starts, options, threads, joints, status, errors);
}

}  // namespace rcs
