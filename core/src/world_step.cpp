// Worlds while they step: which copies, how long, and what is read out.
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "rcs/world.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

using std::chrono::steady_clock;

// How often a long step looks whether it is to end. The clock is read only every so many physics steps.
constexpr std::int64_t kSubstepsPerPoll = 64;
constexpr std::chrono::milliseconds kPollPeriod{50};

struct Call {
  World* world;
  void (World::*work)(const mjModel*, mjData*, int);
};

// After these the numbers mean nothing. MuJoCo takes a control that is not finite as 0.
constexpr mjtWarning kDivergence[] = {mjWARN_BADQPOS, mjWARN_BADQVEL, mjWARN_BADQACC, mjWARN_BADCTRL};
// After these the simulation goes on with contacts or constraints left out.
constexpr mjtWarning kOverflow[] = {mjWARN_CONTACTFULL, mjWARN_CNSTRFULL};

bool has_diverged(const mjData* data) {
  return std::ranges::any_of(kDivergence, [data](mjtWarning w) { return data->warning[w].number != 0; });
}

void clear_warnings(mjData* data) {
  for (const mjtWarning warning : kDivergence) data->warning[warning].number = 0;
  for (const mjtWarning warning : kOverflow) data->warning[warning].number = 0;
}

SimulationError failure_in(int copy, const std::string& words) {
  return SimulationError("world: MuJoCo failed in copy " + std::to_string(copy) + ": " + words);
}

// Extrinsic xyz (roll, pitch, yaw) of a unit quaternion wxyz.
void quat_to_rpy(const double* q, double* rpy) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  rpy[0] = std::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
  rpy[1] = std::asin(std::clamp(2.0 * (w * y - z * x), -1.0, 1.0));
  rpy[2] = std::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
}

}  // namespace

void World::run(const char* call, Chosen copies, Work work, bool is_saved) {
  const Taken taken(*this, call);
  run_taken(copies, work, is_saved);
}

void World::run_taken(Chosen copies, Work work, bool is_saved) {
  std::vector<int> room;
  copies = in_order(copies, room);
  if (copies && copies->empty()) return;
  failure_ = nullptr;
  is_stopping_ = false;
  caller_ = std::this_thread::get_id();
  polled_at_ = {};
  if (batch_)
    run_batch(copies, work, is_saved);
  else
    run_single(work);
  if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
}

void World::run_single(Work work) {
  if (!(model_->opt.timestep > 0.0)) throw InvalidSetup("world: the physics step must be positive");
  mj_getState(model_, data_, state_before_.data(), mjSTATE_INTEGRATION);
  Call call{this, work};
  std::string words;
  const auto apply = [](void* argument) {
    const Call& c = *static_cast<Call*>(argument);
    (c.world->*c.work)(c.world->model_, c.world->data_, 0);
  };
  if (trap(apply, &call, words)) return;
  // As MuJoCo does for copies: what it left unfinished is cleared, and the state is the one before the call.
  mj_resetData(model_, data_);
  write_state(0, state_before_);
  fail(0, std::make_exception_ptr(failure_in(0, words)));
  out_->ends[0] = static_cast<std::uint8_t>(StepEnd::failed);
  out_->substeps[0] = 0;
}

void World::run_batch(Chosen copies, Work work, bool is_saved) {
  Call call{this, work};
  const auto apply = [](const mjModel* model, mjData* data, int copy, void* argument) {
    const Call& c = *static_cast<Call*>(argument);
    (c.world->*c.work)(model, data, copy);
  };
  const int failed = mjb_apply(batch_, copies ? copies->data() : nullptr, copies ? static_cast<int>(copies->size()) : 0,
                               apply, &call, is_saved ? 1 : 0);
  if (failed == 0) return;
  const int* status = mjb_status(batch_);
  const auto take_over = [&](int copy) {
    if (!status[copy]) return;
    fail(copy, std::make_exception_ptr(failure_in(copy, mjb_error(batch_, copy))));
    out_->ends[static_cast<std::size_t>(copy)] = static_cast<std::uint8_t>(StepEnd::failed);
    out_->substeps[static_cast<std::size_t>(copy)] = 0;
  };
  if (copies)
    std::ranges::for_each(*copies, take_over);
  else
    for (int copy = 0; copy < copies_; ++copy) take_over(copy);
}

// An exception must not cross MuJoCo's threads; that of the first copy is thrown again in the caller's.
void World::fail(int copy, std::exception_ptr error) {
  const std::scoped_lock lock(failure_mutex_);
  if (failure_ && failed_copy_ <= copy) return;
  failed_copy_ = copy;
  failure_.swap(error);  // `error` is dropped after the lock: an interpreter's exception may have to wait for it
}

bool World::is_stopped() {
  if (is_stopping_.load(std::memory_order_relaxed)) return true;
  if (!poll_ || std::this_thread::get_id() != caller_) return false;
  const auto now = steady_clock::now();
  if (polled_at_ == steady_clock::time_point{}) polled_at_ = now;  // short steps never read the clock
  if (now - polled_at_ < kPollPeriod) return false;
  polled_at_ = now;
  try {
    poll_();
  } catch (...) {
    is_stopping_ = true;  // the other copies too
    throw;
  }
  return false;
}

void World::reset_chosen(Chosen copies) {
  const Taken taken(*this, "reset");
  std::vector<int> room;
  copies = in_order(copies, room);
  const auto reset_one = [this](int copy) {
    write_state(copy, initial_state_);
    const auto i = static_cast<std::size_t>(copy);
    out_->steps[i] = 0;
    physics_steps_[i] = 0;
    out_->substeps[i] = 0;
    out_->ends[i] = static_cast<std::uint8_t>(StepEnd::period);
    for (const auto& entry : periodic_) entry.callback->reset(copy);
    for (const auto& entry : converge_) entry->reset(copy);
    for (const auto& entry : interrupt_) entry->reset(copy);
    for (const auto& entry : fault_) entry->reset(copy);
  };
  if (copies)
    std::ranges::for_each(*copies, reset_one);
  else
    for (int copy = 0; copy < copies_; ++copy) reset_one(copy);
}

std::int64_t World::period_of(std::int64_t step) const {
  // A frequency such as 10 pi Hz has terms of 50 bits, whose products with a step number are longer than 64.
  __extension__ using Wide = __int128;
  const Wide n = timing_.period_numerator, d = timing_.period_denominator, k = step;
  return static_cast<std::int64_t>(((k + 1) * n) / d - (k * n) / d);
}

Motion::Step World::motion_step(std::int64_t step, double physics_step) const {
  __extension__ using Wide = __int128;
  const Wide n = timing_.period_numerator, d = timing_.period_denominator;
  const double rest = static_cast<double>((Wide{step} + 1) * n % d) / static_cast<double>(d);
  return {static_cast<double>(n) / static_cast<double>(d) * physics_step,
          static_cast<double>(period_of(step)) * physics_step, rest * physics_step, timing_.is_synchronous};
}

void World::refresh_copy(const mjModel* model, mjData* data, int copy) {
  if (!measures_forces_) {
    mj_kinematics(model, data);
  } else {
    // Forces are part of what is measured. The solver's warm start is part of the state, which stays as it is. It is
    // not kept on MuJoCo's own stack, whose functions have other names under a sanitizer, and the library lacks those.
    thread_local std::vector<double> warm;
    warm.assign(data->qacc_warmstart, data->qacc_warmstart + model->nv);
    mj_forward(model, data);
    std::ranges::copy(warm, data->qacc_warmstart);
  }
  read_out(model, data, copy, false);
}

// MuJoCo's errors jump out of here: no local object may need its destructor while `mj_step` runs, and what is counted
// is written at the end.
void World::step_copy(const mjModel* model, mjData* data, int copy) {
  const auto index = static_cast<std::size_t>(copy);
  const bool is_synchronous = timing_.is_synchronous;
  const std::int64_t period = period_of(out_->steps[index]);
  std::int64_t most = is_synchronous ? timing_.max_substeps : period;
  const std::int64_t least = std::min(period, most);
  StepEnd end = is_synchronous ? StepEnd::limit : StepEnd::period;
  const std::int64_t before = physics_steps_[index];
  std::int64_t done = 0;
  clear_warnings(data);
  const StepView view{model, data, copy, &memory_};
  try {
    if (!motions_.empty()) {
      const Motion::Step step = motion_step(out_->steps[index], model->opt.timestep);
      double longest = 0.0;
      for (const auto& motion : motions_) {
        motion->begin(model, data, copy, step);
        if (is_synchronous) longest = std::max(longest, motion->remaining(data, copy));
      }
      most += static_cast<std::int64_t>(std::ceil(longest / model->opt.timestep));
    }
    if (is_synchronous)
      for (const auto& entry : converge_) entry->begin(copy);
    while (done < most) {
      if (done % kSubstepsPerPoll == 0 && (done == 0 ? is_stopping_.load(std::memory_order_relaxed) : is_stopped())) {
        end = StepEnd::failed;
        break;
      }
      for (const auto& motion : motions_) motion->advance(model, data, copy);
      mj_step(model, data);
      ++done;
      for (const auto& entry : periodic_)
        if ((before + done) % entry.every == 0) entry.callback->call(view);
      bool is_interrupted = false;
      for (const auto& entry : interrupt_) is_interrupted = entry->call(view) || is_interrupted;
      if (is_interrupted) {
        end = StepEnd::interrupted;
        if (is_synchronous) break;
      }
      bool is_faulty = false;
      for (const auto& entry : fault_) is_faulty = entry->call(view) || is_faulty;
      if (is_faulty) {
        end = StepEnd::fault;
        break;
      }
      if (!is_synchronous) continue;
      // Every callback is asked at every physics step, so that those which remember see all of it.
      bool is_converged = !converge_.empty();
      for (const auto& entry : converge_) is_converged = entry->call(view) && is_converged;
      if (is_converged && done >= least) {
        end = StepEnd::converged;
        break;
      }
    }
  } catch (...) {
    fail(copy, std::current_exception());
    end = StepEnd::failed;
  }
  if (has_diverged(data)) end = StepEnd::failed;
  for (const mjtWarning warning : kOverflow)
    if (const mjWarningStat& stat = data->warning[warning]; stat.number != 0) {
      fail(copy, std::make_exception_ptr(failure_in(copy, mju_warningText(warning, stat.lastinfo))));
      end = StepEnd::failed;
    }
  physics_steps_[index] = before + done;
  ++out_->steps[index];
  out_->substeps[index] = static_cast<std::int32_t>(done);
  out_->ends[index] = static_cast<std::uint8_t>(end);
  mj_kinematics(model, data);
  read_out(model, data, copy, true);
  try {
    for (const auto& watcher : watchers_) watcher->see_step(model, data, copy);
  } catch (...) {
    fail(copy, std::current_exception());
    out_->ends[index] = static_cast<std::uint8_t>(StepEnd::failed);
  }
}

void World::show(Watcher& watcher, std::span<const int> copies) {
  const Taken taken(*this, "show");
  watcher.check(model_, copies_);
  shown_ = &watcher;
  run_taken(copies, &World::show_copy, false);
}

void World::show_copy(const mjModel* model, mjData* data, int copy) {
  mj_kinematics(model, data);
  try {
    shown_->see(model, data, copy);
  } catch (...) {
    fail(copy, std::current_exception());
  }
}

std::vector<double> World::preview(const std::shared_ptr<Motion>& motion, int copy, std::span<const double> target,
                                   double tick) {
  const Taken taken(*this, "preview");
  check_copy(copy);
  if (std::ranges::find(motions_, motion) == motions_.end())
    throw InvalidSetup("world: the motion to preview is not one of this world");
  if ((!target.empty() && target.size() != static_cast<std::size_t>(motion->dof())) ||
      !(tick > 0.0 && std::isfinite(tick)))
    throw InvalidSetup("world: a preview needs a target with one number per joint, " + std::to_string(motion->dof()) +
                       ", and a tick above 0");
  Preview asked{motion.get(), target, tick, {}};
  previewed_ = &asked;
  run_taken(std::span<const int>(&copy, 1), &World::preview_copy, false);
  return std::move(asked.positions);
}

void World::preview_copy(const mjModel* model, mjData* data, int copy) {
  const Motion::Step step = motion_step(out_->steps[static_cast<std::size_t>(copy)], model->opt.timestep);
  try {
    previewed_->positions = previewed_->motion->preview(model, data, copy, step, previewed_->target, previewed_->tick);
  } catch (...) {
    fail(copy, std::current_exception());
  }
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
    double* pose = out_->poses.data() + (index * pose_readouts_.size() + r) * 7;
    double* rpy = out_->xyzrpy.data() + (index * pose_readouts_.size() + r) * 6;
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
    out_->openings[index * opening_readouts_.size() + r] =
        static_cast<float>(std::clamp((mean - readout.closed) / (readout.open - readout.closed), 0.0, 1.0));
  }
  for (std::size_t r = 0; r < force_readouts_.size(); ++r)
    out_->forces[index * force_readouts_.size() + r] =
        has_forces ? contact_force(model, data, force_readouts_[r].first, force_readouts_[r].second) : 0.0;
  double* values = out_->measurements.data() + index * static_cast<std::size_t>(measured_);
  for (const auto& measurement : measurements_) {
    const auto size = static_cast<std::size_t>(measurement->size());
    measurement->read(model, data, {values, size});
    values += size;
  }
}

}  // namespace rcs
