#include "rcs/world.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>

namespace rcs {

namespace {

struct Call {
  World* world;
  void (World::*work)(const mjModel*, mjData*, int);
};

bool has_diverged(const mjData* data) {
  return data->warning[mjWARN_BADQPOS].number || data->warning[mjWARN_BADQVEL].number ||
         data->warning[mjWARN_BADQACC].number;
}

void clear_divergence(mjData* data) {
  data->warning[mjWARN_BADQPOS].number = 0;
  data->warning[mjWARN_BADQVEL].number = 0;
  data->warning[mjWARN_BADQACC].number = 0;
}

// Extrinsic xyz (roll, pitch, yaw) of a unit quaternion wxyz.
void quat_to_rpy(const double* q, double* rpy) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  rpy[0] = std::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
  rpy[1] = std::asin(std::clamp(2.0 * (w * y - z * x), -1.0, 1.0));
  rpy[2] = std::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
}

}  // namespace

World::World(const mjModel* model, mjData* data, StepTiming timing)
    : model_(model), data_(data), copies_(1), state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  set_timing(timing);
  allocate();
}

World::World(const mjModel* model, int copies, int threads, StepTiming timing)
    : model_(model), copies_(copies), state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  if (copies < 1) throw InvalidSetup("world: copies must be at least 1, not " + std::to_string(copies));
  set_timing(timing);
  mjBatchConfig config;
  mjb_defaultConfig(&config);
  config.nthread = threads;
  char error[512] = "";
  batch_ = mjb_makeBatch(model, copies, &config, error, sizeof(error));
  if (!batch_) throw std::runtime_error(std::string("world: MuJoCo could not make the batch: ") + error);
  model_ = mjb_model(batch_);
  allocate();
}

World::~World() {
  if (batch_) mjb_deleteBatch(batch_);
}

void World::allocate() {
  const auto n = static_cast<std::size_t>(copies_);
  ends_.assign(n, static_cast<std::uint8_t>(StepEnd::period));
  substeps_.assign(n, 0);
  steps_.assign(n, 0);
  physics_steps_.assign(n, 0);
  initial_state_.resize(static_cast<std::size_t>(state_size_));
  keep_initial_state(0);
}

void World::set_timing(const StepTiming& timing) {
  if (timing.period_numerator < 1 || timing.period_denominator < 1 || timing.max_substeps < 1 ||
      timing.period_numerator < timing.period_denominator)
    throw InvalidSetup("world: a control period must be at least one physics step, and max_substeps at least 1");
  timing_ = timing;
}

void World::on_period(std::shared_ptr<StepCallback> callback, double period) {
  const auto every = static_cast<int>(std::lround(period / model_->opt.timestep));
  if (every < 1)
    throw InvalidSetup("world: a callback's period must be at least one physics step of " +
                       std::to_string(model_->opt.timestep) + " s");
  periodic_.push_back({std::move(callback), every});
}

void World::converge_when(std::shared_ptr<StepCallback> callback) { converge_.push_back(std::move(callback)); }

void World::interrupt_when(std::shared_ptr<StepCallback> callback) { interrupt_.push_back(std::move(callback)); }

int World::read_pose(int site, int frame_body) {
  if (site < 0 || site >= model_->nsite) throw InvalidSetup("world: the site of a pose readout is not in the model");
  return add_pose({site, -1, frame_body});
}

int World::read_body_pose(int body, int frame_body) {
  if (body < 0 || body >= model_->nbody) throw InvalidSetup("world: the body of a pose readout is not in the model");
  return add_pose({-1, body, frame_body});
}

int World::add_pose(PoseReadout readout) {
  if (readout.frame_body < 0 || readout.frame_body >= model_->nbody)
    throw InvalidSetup("world: the frame of a pose readout is not in the model");
  pose_readouts_.push_back(readout);
  renew(poses_, static_cast<std::size_t>(copies_) * pose_readouts_.size() * 7);
  renew(xyzrpy_, static_cast<std::size_t>(copies_) * pose_readouts_.size() * 6);
  return pose_count() - 1;
}

int World::read_force(std::vector<std::uint8_t> first, std::vector<std::uint8_t> second) {
  const auto geoms = static_cast<std::size_t>(model_->ngeom), flexes = static_cast<std::size_t>(model_->nflex);
  for (const auto* flags : {&first, &second})
    if (const std::size_t given = flags->size(); given != geoms && given != geoms + flexes)
      throw InvalidSetup("world: a force readout needs one flag per geom of the model (" + std::to_string(geoms) +
                         "), or these and one per flex (" + std::to_string(flexes) + "), not " + std::to_string(given));
  force_readouts_.push_back({std::move(first), std::move(second)});
  renew(forces_, static_cast<std::size_t>(copies_) * force_readouts_.size());
  return force_count() - 1;
}

int World::read_opening(std::vector<int> joints, double closed, double open) {
  if (joints.empty() || closed == open) throw InvalidSetup("world: an opening readout needs joints that move");
  OpeningReadout readout{{}, closed, open};
  for (const int joint : joints) {
    if (joint < 0 || joint >= model_->njnt)
      throw InvalidSetup("world: a joint of an opening readout is not in the model");
    readout.qpos.push_back(model_->jnt_qposadr[joint]);
  }
  opening_readouts_.push_back(std::move(readout));
  renew(openings_, static_cast<std::size_t>(copies_) * opening_readouts_.size());
  return opening_count() - 1;
}

void World::check_copies(std::span<const int> copies) const {
  for (const int copy : copies)
    if (copy < 0 || copy >= copies_)
      throw InvalidSetup("world: there is no copy " + std::to_string(copy) + ", there are " + std::to_string(copies_));
}

void World::keep_initial_state(int copy) { get_state(copy, initial_state_); }

void World::get_state(int copy, std::span<double> state) const {
  if (state.size() != static_cast<std::size_t>(state_size_) || copy < 0 || copy >= copies_)
    throw InvalidSetup("world: a state has " + std::to_string(state_size_) + " values, and copies are counted from 0");
  if (batch_)
    std::memcpy(state.data(), mjb_state(batch_) + static_cast<std::ptrdiff_t>(copy) * state_size_,
                sizeof(double) * state.size());
  else
    mj_getState(model_, data_, state.data(), mjSTATE_INTEGRATION);
}

void World::set_state(int copy, std::span<const double> state) {
  if (state.size() != static_cast<std::size_t>(state_size_) || copy < 0 || copy >= copies_)
    throw InvalidSetup("world: a state has " + std::to_string(state_size_) + " values, and copies are counted from 0");
  if (batch_)
    std::memcpy(mjb_state(batch_) + static_cast<std::ptrdiff_t>(copy) * state_size_, state.data(),
                sizeof(double) * state.size());
  else
    mj_setState(model_, data_, state.data(), mjSTATE_INTEGRATION);
}

double* World::component(int which, int* size) {
  if (batch_) return mjb_stateComponent(batch_, which, size);
  *size = mj_stateSize(model_, which);
  switch (which) {
    case mjSTATE_TIME:
      return &data_->time;
    case mjSTATE_QPOS:
      return data_->qpos;
    case mjSTATE_QVEL:
      return data_->qvel;
    case mjSTATE_CTRL:
      return data_->ctrl;
    case mjSTATE_MOCAP_POS:
      return data_->mocap_pos;
    case mjSTATE_MOCAP_QUAT:
      return data_->mocap_quat;
    case mjSTATE_QFRC_APPLIED:
      return data_->qfrc_applied;
    case mjSTATE_XFRC_APPLIED:
      return data_->xfrc_applied;
    default:
      throw InvalidSetup("world: that state component has no array");
  }
}

void World::run(std::span<const int> copies, Work work, bool is_saved) {
  check_copies(copies);
  failure_ = nullptr;
  if (!batch_) {
    if (model_->opt.timestep <= 0.0) throw InvalidSetup("world: the physics step must be positive");
    (this->*work)(model_, data_, 0);
  } else {
    Call call{this, work};
    const auto apply = [](const mjModel* model, mjData* data, int copy, void* argument) {
      const Call& c = *static_cast<Call*>(argument);
      (c.world->*c.work)(model, data, copy);
    };
    mjb_apply(batch_, copies.empty() ? nullptr : copies.data(), static_cast<int>(copies.size()), apply, &call,
              is_saved ? 1 : 0);
    const int* status = mjb_status(batch_);
    for (int i = 0; i < copies_; ++i)
      if (status[i]) ends_[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(StepEnd::failed);
  }
  if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
}

void World::reset(std::span<const int> copies) {
  check_copies(copies);
  const auto reset_one = [this](int copy) {
    set_state(copy, initial_state_);
    const auto i = static_cast<std::size_t>(copy);
    steps_[i] = 0;
    physics_steps_[i] = 0;
    substeps_[i] = 0;
    ends_[i] = static_cast<std::uint8_t>(StepEnd::period);
    for (const auto& entry : periodic_) entry.callback->reset(copy);
    for (const auto& entry : converge_) entry->reset(copy);
    for (const auto& entry : interrupt_) entry->reset(copy);
  };
  if (copies.empty())
    for (int copy = 0; copy < copies_; ++copy) reset_one(copy);
  else
    for (const int copy : copies) reset_one(copy);
}

void World::refresh(std::span<const int> copies) { run(copies, &World::refresh_copy, false); }

void World::advance(std::span<const int> copies) { run(copies, &World::step_copy, true); }

std::int64_t World::period_of(std::int64_t step) const {
  const std::int64_t n = timing_.period_numerator, d = timing_.period_denominator;
  return ((step + 1) * n) / d - (step * n) / d;
}

void World::refresh_copy(const mjModel* model, mjData* data, int copy) {
  mj_kinematics(model, data);
  read_out(model, data, copy, false);
}

void World::step_copy(const mjModel* model, mjData* data, int copy) {
  const auto index = static_cast<std::size_t>(copy);
  const bool is_synchronous = timing_.is_synchronous;
  const std::int64_t most = is_synchronous ? timing_.max_substeps : period_of(steps_[index]);
  StepEnd end = is_synchronous ? StepEnd::limit : StepEnd::period;
  std::int64_t done = 0;
  clear_divergence(data);
  const StepView view{model, data, copy};
  try {
    while (done < most) {
      mj_step(model, data);
      ++done;
      ++physics_steps_[index];
      for (const auto& entry : periodic_)
        if (physics_steps_[index] % entry.every == 0) entry.callback->call(view);
      bool is_interrupted = false;
      for (const auto& entry : interrupt_) is_interrupted = entry->call(view) || is_interrupted;
      if (is_interrupted) {
        end = StepEnd::interrupted;
        if (is_synchronous) break;
      }
      if (!is_synchronous) continue;
      // Every callback is asked at every physics step, so that those which remember see all of it.
      bool is_converged = !converge_.empty();
      for (const auto& entry : converge_) is_converged = entry->call(view) && is_converged;
      if (is_converged) {
        end = StepEnd::converged;
        break;
      }
    }
  } catch (...) {
    // An exception must not cross MuJoCo's threads; the first one is thrown again in the caller's.
    const std::scoped_lock lock(failure_mutex_);
    if (!failure_) failure_ = std::current_exception();
    end = StepEnd::failed;
  }
  if (has_diverged(data)) end = StepEnd::failed;
  ++steps_[index];
  substeps_[index] = static_cast<std::int32_t>(done);
  ends_[index] = static_cast<std::uint8_t>(end);
  mj_kinematics(model, data);
  read_out(model, data, copy, true);
}

void World::read_out(const mjModel* model, const mjData* data, int copy, bool has_forces) {
  const auto index = static_cast<std::size_t>(copy);
  for (std::size_t r = 0; r < pose_readouts_.size(); ++r) {
    const PoseReadout& readout = pose_readouts_[r];
    double world_quat[4], base_inverse[4], quat[4], offset[3];
    const double* position;
    if (readout.site >= 0) {
      mju_mat2Quat(world_quat, data->site_xmat + 9 * readout.site);
      position = data->site_xpos + 3 * readout.site;
    } else {
      mju_copy4(world_quat, data->xquat + 4 * readout.body);
      position = data->xpos + 3 * readout.body;
    }
    mju_negQuat(base_inverse, data->xquat + 4 * readout.frame_body);
    mju_mulQuat(quat, base_inverse, world_quat);
    mju_normalize4(quat);
    if (quat[0] < 0.0) mju_scl(quat, quat, -1.0, 4);  // one sign for one rotation
    mju_sub3(offset, position, data->xpos + 3 * readout.frame_body);
    double* pose = poses_.data() + (index * pose_readouts_.size() + r) * 7;
    double* rpy = xyzrpy_.data() + (index * pose_readouts_.size() + r) * 6;
    mju_rotVecQuat(pose, offset, base_inverse);
    mju_copy3(rpy, pose);
    pose[3] = quat[1];
    pose[4] = quat[2];
    pose[5] = quat[3];
    pose[6] = quat[0];
    quat_to_rpy(quat, rpy + 3);
  }
  for (std::size_t r = 0; r < opening_readouts_.size(); ++r) {
    const OpeningReadout& readout = opening_readouts_[r];
    double sum = 0.0;
    for (const int address : readout.qpos) sum += data->qpos[address];
    const double mean = sum / static_cast<double>(readout.qpos.size());
    openings_[index * opening_readouts_.size() + r] =
        static_cast<float>(std::clamp((mean - readout.closed) / (readout.open - readout.closed), 0.0, 1.0));
  }
  for (std::size_t r = 0; r < force_readouts_.size(); ++r)
    forces_[index * force_readouts_.size() + r] =
        has_forces ? contact_force(model, data, force_readouts_[r].first, force_readouts_[r].second) : 0.0;
}

}  // namespace rcs
