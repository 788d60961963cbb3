#include "rcs/world.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <system_error>
#include <utility>

#ifdef __linux__
#include <sched.h>
#endif

#include "fork.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

int available_cpus() {
#ifdef __linux__
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof(set), &set) == 0) return std::max(1, CPU_COUNT(&set));
#endif
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

// MuJoCo's pool ends the process when a thread of it cannot start. So they are started once before, all at a time.
void check_threads_can_start(int threads) {
  std::atomic<bool> is_over = false;
  std::vector<std::thread> started;
  started.reserve(static_cast<std::size_t>(threads));
  std::string reason;
  try {
    for (int i = 0; i < threads; ++i) started.emplace_back([&is_over] { is_over.wait(false); });
  } catch (const std::system_error& error) {
    reason = error.what();
  }
  is_over = true;
  is_over.notify_all();
  for (std::thread& thread : started) thread.join();
  if (!reason.empty())
    throw std::runtime_error("world: only " + std::to_string(started.size()) + " of " + std::to_string(threads) +
                             " threads could be started (" + reason + "); ask for fewer threads or close other worlds");
}

}  // namespace

World::Taken::Taken(const World& world, const char* call, bool needs_threads) : world_(world) {
  const char* other = nullptr;
  if (!world.call_.compare_exchange_strong(other, call, std::memory_order_acquire))
    throw WrongOrder(std::string("world: ") + call + " was called while the world is already " +
                     (std::strcmp(other, "advance") == 0 ? "stepping" : "busy with " + std::string(other)) +
                     ", in one of its callbacks or another thread; a world takes one call at a time");
  try {
    world.require_open(call);
    if (needs_threads) world.require_threads(call);
  } catch (...) {
    world.call_.store(nullptr, std::memory_order_release);
    throw;
  }
}

void World::require_open(const char* call) const {
  if (!is_open()) throw WrongOrder(std::string("world: ") + call + " was called after close(); make a new world");
}

bool World::is_forked() const { return threads_ > 1 && forks_ != forks(); }

void World::require_threads(const char* call) const {
  if (is_forked())
    throw WrongOrder(std::string("world: ") + call +
                     " was called after a fork, and the threads of this world are in the parent process; make the "
                     "world in the child, or start the child with \"spawn\"");
}

World::World(const mjModel* model, mjData* data, StepTiming timing, std::shared_ptr<const void> owner)
    : model_(model),
      data_(data),
      memory_(std::move(owner)),
      copies_(1),
      forks_(forks()),
      state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  if (model->signature != data->signature)
    throw InvalidSetup("world: the data is of another model; make it with mj_makeData of this one");
  set_timing(timing);
  state_before_.resize(static_cast<std::size_t>(state_size_));
  allocate();
}

World::World(const mjModel* model, int copies, int threads, StepTiming timing)
    : model_(model),
      is_batch_(true),
      copies_(copies),
      forks_(forks()),
      state_size_(mj_stateSize(model, mjSTATE_INTEGRATION)) {
  if (copies < 1) throw InvalidSetup("world: copies must be at least 1, not " + std::to_string(copies));
  if (threads < 0)
    throw InvalidSetup("world: threads must be at least 1, or 0 for one per CPU, not " + std::to_string(threads));
  set_timing(timing);
  const int wanted = std::min(threads > 0 ? threads : available_cpus(), copies);
  check_threads_can_start(wanted - 1);  // the caller's thread is one of them
  mjBatchConfig config;
  mjb_defaultConfig(&config);
  config.nthread = wanted;
  char error[512] = "";
  trapped("world", [&] { batch_ = mjb_makeBatch(model, copies, &config, error, sizeof(error)); });
  if (!batch_) throw InvalidSetup(std::string("world: MuJoCo could not make the batch: ") + error);
  threads_ = mjb_nthread(batch_);
  memory_ = std::shared_ptr<mjBatch>(batch_, [made_at = forks_, has_threads = threads_ > 1](mjBatch* batch) {
    // In a child of a fork, waiting for the parent's threads would last for ever.
    if (!has_threads || made_at == forks()) mjb_deleteBatch(batch);
  });
  model_ = mjb_model(batch_);
  allocate();
}

void World::close() {
  std::vector<Periodic> periodic;
  std::vector<std::shared_ptr<StepCallback>> converge, interrupt, fault;
  std::vector<std::shared_ptr<Watcher>> watchers;
  std::shared_ptr<const void> memory;
  if (!is_open()) return;
  if (is_forked()) call_ = nullptr;  // a call that was under way is one of the parent's
  const Taken taken(*this, "close", false);
  is_open_ = false;
  // Dropped after the world is free again: what a callback holds may call the world as it goes.
  periodic.swap(periodic_);
  converge.swap(converge_);
  interrupt.swap(interrupt_);
  fault.swap(fault_);
  watchers.swap(watchers_);
  memory.swap(memory_);
  poll_ = nullptr;
}

const mjModel* World::model() const {
  require_open("model");
  return model_;
}

mjBatch* World::batch() {
  require_open("batch");
  if (const char* call = call_.load())
    throw WrongOrder(std::string("world: its batch was asked for while ") + call + " is under way");
  return batch_;
}

void World::allocate() {
  // MuJoCo's profile of its functions, `mjData.timer`, reads the clock some thirty times in a physics step, 3 % of its
  // time. It is turned off once in a process, so that somebody may turn it on again.
  [[maybe_unused]] static const mjfTime none = mjcb_time = nullptr;
  const auto n = static_cast<std::size_t>(copies_);
  out_->ends.assign(n, static_cast<std::uint8_t>(StepEnd::period));
  out_->substeps.assign(n, 0);
  out_->steps.assign(n, 0);
  physics_steps_.assign(n, 0);
  initial_state_.resize(static_cast<std::size_t>(state_size_));
  keep_initial_state(0);
}

void World::set_timing(const StepTiming& timing) {
  const Taken taken(*this, "set_timing");
  if (timing.period_numerator < 1 || timing.period_denominator < 1 || timing.max_substeps < 1 ||
      timing.period_numerator < timing.period_denominator)
    throw InvalidSetup("world: a control period must be at least one physics step, and max_substeps at least 1");
  if (timing.period_numerator / timing.period_denominator >= std::numeric_limits<std::int32_t>::max())
    throw InvalidSetup("world: a control period has " +
                       std::to_string(timing.period_numerator / timing.period_denominator) +
                       " physics steps, at most 2147483646 can be counted");
  timing_ = timing;
}

void World::check_callback(const StepCallback* callback) const {
  if (!callback) throw InvalidSetup("world: a callback is needed, not null");
  callback->check(model_, copies_);
}

std::shared_ptr<Motion> World::add_motion(std::shared_ptr<Motion> motion) {
  const Taken taken(*this, "add_motion");
  check_callback(motion.get());
  for (const auto& other : motions_) {
    if (other->address() == motion->address() && other->dof() == motion->dof()) return other;
    if (other->address() < motion->address() + Trajectory::size(motion->dof()) &&
        motion->address() < other->address() + Trajectory::size(other->dof()))
      throw InvalidSetup("world: the user data of a motion overlap those of another");
  }
  motions_.push_back(motion);
  return motion;
}

void World::on_period(std::shared_ptr<StepCallback> callback, double period) {
  const Taken taken(*this, "on_period");
  check_callback(callback.get());
  const double every = std::round(period / model_->opt.timestep);
  // Above 2^53, whole numbers have gaps. Written so that NaN is refused.
  if (!(every >= 1.0 && every <= 9007199254740992.0))
    throw InvalidSetup("world: a callback's period must be at least one physics step of " +
                       std::to_string(model_->opt.timestep) + " s and finite, not " + std::to_string(period) + " s");
  periodic_.push_back({std::move(callback), static_cast<std::int64_t>(every)});
}

void World::converge_when(std::shared_ptr<StepCallback> callback) {
  const Taken taken(*this, "converge_when");
  check_callback(callback.get());
  converge_.push_back(std::move(callback));
}

void World::interrupt_when(std::shared_ptr<StepCallback> callback) {
  const Taken taken(*this, "interrupt_when");
  check_callback(callback.get());
  interrupt_.push_back(std::move(callback));
}

void World::fault_when(std::shared_ptr<StepCallback> callback) {
  const Taken taken(*this, "fault_when");
  check_callback(callback.get());
  fault_.push_back(std::move(callback));
}

std::vector<const StepCallback*> World::callbacks() const {
  std::vector<const StepCallback*> all;
  for (const auto& entry : periodic_) all.push_back(entry.callback.get());
  for (const auto* list : {&converge_, &interrupt_, &fault_})
    for (const auto& entry : *list) all.push_back(entry.get());
  return all;
}

void World::poll_with(std::function<void()> poll) {
  const Taken taken(*this, "poll_with");
  poll_ = std::move(poll);
}

int World::read_pose(int site, int frame_body) {
  const Taken taken(*this, "read_pose");
  if (site < 0 || site >= model_->nsite) throw InvalidSetup("world: the site of a pose readout is not in the model");
  return add_pose({site, -1, frame_body});
}

int World::read_body_pose(int body, int frame_body) {
  const Taken taken(*this, "read_body_pose");
  if (body < 0 || body >= model_->nbody) throw InvalidSetup("world: the body of a pose readout is not in the model");
  return add_pose({-1, body, frame_body});
}

int World::add_pose(PoseReadout readout) {
  if (readout.frame_body < 0 || readout.frame_body >= model_->nbody)
    throw InvalidSetup("world: the frame of a pose readout is not in the model");
  pose_readouts_.push_back(readout);
  renew(out_->poses, static_cast<std::size_t>(copies_) * pose_readouts_.size() * 7);
  renew(out_->xyzrpy, static_cast<std::size_t>(copies_) * pose_readouts_.size() * 6);
  return pose_count() - 1;
}

int World::read_force(std::vector<std::uint8_t> first, std::vector<std::uint8_t> second) {
  const Taken taken(*this, "read_force");
  const auto geoms = static_cast<std::size_t>(model_->ngeom), flexes = static_cast<std::size_t>(model_->nflex);
  for (const auto* flags : {&first, &second})
    if (const std::size_t given = flags->size(); given != geoms && given != geoms + flexes)
      throw InvalidSetup("world: a force readout needs one flag per geom of the model (" + std::to_string(geoms) +
                         "), or these and one per flex (" + std::to_string(flexes) + "), not " + std::to_string(given));
  force_readouts_.push_back({std::move(first), std::move(second)});
  renew(out_->forces, static_cast<std::size_t>(copies_) * force_readouts_.size());
  return force_count() - 1;
}

int World::read_opening(std::vector<int> joints, double closed, double open) {
  const Taken taken(*this, "read_opening");
  if (joints.empty() || closed == open) throw InvalidSetup("world: an opening readout needs joints that move");
  OpeningReadout readout{{}, closed, open};
  for (const int joint : joints) {
    if (joint < 0 || joint >= model_->njnt)
      throw InvalidSetup("world: a joint of an opening readout is not in the model");
    readout.qpos.push_back(model_->jnt_qposadr[joint]);
  }
  opening_readouts_.push_back(std::move(readout));
  renew(out_->openings, static_cast<std::size_t>(copies_) * opening_readouts_.size());
  return opening_count() - 1;
}

int World::measure(std::shared_ptr<const Measurement> measurement) {
  const Taken taken(*this, "measure");
  if (!measurement) throw InvalidSetup("world: a measurement is needed, not null");
  measurement->check(model_);
  const int first = measured_;
  measured_ += measurement->size();
  measures_forces_ = measures_forces_ || measurement->needs_forces();
  measurements_.push_back(std::move(measurement));
  renew(out_->measurements, static_cast<std::size_t>(copies_) * static_cast<std::size_t>(measured_));
  return first;
}

void World::watch(std::shared_ptr<Watcher> watcher) {
  const Taken taken(*this, "watch");
  if (!watcher) throw InvalidSetup("world: a watcher is needed, not null");
  watcher->check(model_, copies_);
  watchers_.push_back(std::move(watcher));
}

void World::check_copy(int copy) const {
  if (copy < 0 || copy >= copies_)
    throw InvalidSetup("world: there is no copy " + std::to_string(copy) + ", there are " + std::to_string(copies_));
}

// MuJoCo ends the process unless its ids ascend. They are sorted into `room` where they do not.
World::Chosen World::in_order(Chosen copies, std::vector<int>& room) const {
  if (!copies) return copies;
  bool is_ascending = true;
  for (std::size_t i = 0; i < copies->size(); ++i) {
    check_copy((*copies)[i]);
    is_ascending = is_ascending && (i == 0 || (*copies)[i - 1] < (*copies)[i]);
  }
  if (is_ascending) return copies;
  room.assign(copies->begin(), copies->end());
  std::ranges::sort(room);
  if (const auto twice = std::ranges::adjacent_find(room); twice != room.end())
    throw InvalidSetup("world: copy " + std::to_string(*twice) + " is named more than once; each may be named once");
  return room;
}

void World::keep_initial_state(int copy) {
  const Taken taken(*this, "keep_initial_state");
  check_copy(copy);
  read_state(copy, initial_state_);
}

void World::check_state(int copy, std::size_t size) const {
  check_copy(copy);
  if (size != static_cast<std::size_t>(state_size_))
    throw InvalidSetup("world: a state has " + std::to_string(state_size_) + " values, not " + std::to_string(size));
}

void World::get_state(int copy, std::span<double> state) const {
  const Taken taken(*this, "get_state");
  check_state(copy, state.size());
  read_state(copy, state);
}

void World::set_state(int copy, std::span<const double> state) {
  const Taken taken(*this, "set_state");
  check_state(copy, state.size());
  write_state(copy, state);
}

void World::read_state(int copy, std::span<double> state) const {
  if (batch_)
    std::memcpy(state.data(), mjb_state(batch_) + static_cast<std::ptrdiff_t>(copy) * state_size_,
                sizeof(double) * state.size());
  else
    mj_getState(model_, data_, state.data(), mjSTATE_INTEGRATION);
}

void World::write_state(int copy, std::span<const double> state) {
  if (batch_)
    std::memcpy(mjb_state(batch_) + static_cast<std::ptrdiff_t>(copy) * state_size_, state.data(),
                sizeof(double) * state.size());
  else
    trapped("world", [&] { mj_setState(model_, data_, state.data(), mjSTATE_INTEGRATION); });
}

double* World::states() {
  require_open("states");
  return batch_ ? mjb_state(batch_) : nullptr;
}

double* World::component(int which, int* size) {
  require_open("component");
  if (which <= 0 || which >= 1 << mjNSTATE || !std::has_single_bit(static_cast<unsigned>(which)))
    throw InvalidSetup("world: a state component is one bit of mjtState, not " + std::to_string(which));
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
    case mjSTATE_USERDATA:
      return data_->userdata;
    default:
      throw InvalidSetup("world: that state component has no array");
  }
}

}  // namespace rcs
