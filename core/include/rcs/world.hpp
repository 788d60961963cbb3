// N copies of one MuJoCo scene, advanced together by one control step at a time.
//
// Time: a copy counts its own control steps. Asynchronously, step k lasts floor((k+1) r) - floor(k r) physics steps
// with r = control period / physics step, kept as a ratio of integers, so the mean rate is exact (30 Hz at 2 ms: 16,
// 17, 17). Threads: copies run on MuJoCo's own pool (mjbatch.h); the result does not depend on the number of threads.
// A world takes one call at a time: another one meanwhile, from a callback or another thread, throws `WrongOrder`.
#pragma once

#include <mujoco/mjbatch.h>
#include <mujoco/mujoco.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "rcs/callback.hpp"
#include "rcs/measurement.hpp"
#include "rcs/motion.hpp"
#include "rcs/result.hpp"
#include "rcs/watcher.hpp"

namespace rcs {

/// How long a control step lasts.
struct StepTiming {
  std::int64_t period_numerator = 50;   ///< control period in physics steps, numerator of the ratio …
  std::int64_t period_denominator = 3;  ///< … and its denominator
  bool is_synchronous = false;          ///< step until converged instead of for one control period
  int max_substeps = 500;               ///< of a synchronous step, from when its motions are to end
};

/// A field of the model with values per copy: copies × size.
struct ModelField {
  std::variant<double*, float*, int*> values;
  int size = 0;
};

/// The first one of a process turns MuJoCo's own profile, `mjData.timer`, off.
class World {
 public:
  /// One copy, working directly on the caller's model and data, which `owner` keeps alive; without one, both must
  /// outlive the world. Throws `InvalidSetup` when the data is of another model.
  World(const mjModel* model, mjData* data, StepTiming timing, std::shared_ptr<const void> owner = nullptr);
  /// Many copies of a copy of `model`, on `threads` threads (0: one per CPU that this process may use).
  World(const mjModel* model, int copies, int threads, StepTiming timing);
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  /// Drop the callbacks and end the threads. Closing twice is harmless; every call afterwards throws `WrongOrder`.
  void close();
  bool is_open() const { return is_open_.load(std::memory_order_relaxed); }
  /// Keeps alive what `component`, `states` and `expand` point to, beyond `close` and the world itself. The threads of
  /// a batch end when the last of these is dropped. Null for a world without owner on the caller's data.
  const std::shared_ptr<const void>& memory() const { return memory_; }

  int copies() const { return copies_; }
  int threads() const { return threads_; }
  bool is_batch() const { return is_batch_; }
  const mjModel* model() const;
  const StepTiming& timing() const { return timing_; }
  void set_timing(const StepTiming& timing);

  /// Have a motion lead its joints in every step. One that takes the user data of another is not added: that is
  /// returned.
  std::shared_ptr<Motion> add_motion(std::shared_ptr<Motion> motion);
  /// The effect of the next step of a copy on the joints of a motion; see `Motion::preview`. Throws `InvalidSetup` for
  /// a motion that is not of this world, or a target of another size.
  std::vector<double> preview(const std::shared_ptr<Motion>& motion, int copy, std::span<const double> target,
                              double tick);
  /// Call every `period` seconds of simulated time.
  void on_period(std::shared_ptr<StepCallback> callback, double period);
  /// A synchronous step ends when all of these are true.
  void converge_when(std::shared_ptr<StepCallback> callback);
  /// A synchronous step ends when any of these is true; an asynchronous one lasts its period and says so.
  void interrupt_when(std::shared_ptr<StepCallback> callback);
  /// A step of any kind ends at once when any of these is true: a robot went into its fault state.
  void fault_when(std::shared_ptr<StepCallback> callback);

  /// Have the pose of a site in the frame of a body read out after every call. Returns its index in `poses`.
  int read_pose(int site, int frame_body);
  /// Have the pose of a body in the frame of another read out. Returns its index in `poses`.
  int read_body_pose(int body, int frame_body);
  /// Have the normal force between two sets of surfaces read out: one flag per geom of the model, then, where soft
  /// bodies count too, one per flex. Returns its index in `forces`.
  int read_force(std::vector<std::uint8_t> first, std::vector<std::uint8_t> second);

  /// Have the mean position of joints read out as 0 at `closed` … 1 at `open`. Returns its index in `openings`.
  int read_opening(std::vector<int> joints, double closed, double open);

  /// Have something measured after every step, and after `refresh`. Returns the index of its first value in
  /// `measurements`.
  int measure(std::shared_ptr<const Measurement> measurement);

  /// Have copies watched at the end of each step, by the thread that has stepped them.
  void watch(std::shared_ptr<Watcher> watcher);
  /// Have some copies watched as they are now; an empty span means none.
  void show(Watcher& watcher, std::span<const int> copies);

  /// All callbacks that were added, one entry for each time.
  std::vector<const StepCallback*> callbacks() const;

  /// Have `poll` called about every 50 ms of a long step, in the thread that called; what it throws ends the step. An
  /// interpreter can act on Ctrl-C there.
  void poll_with(std::function<void()> poll);

  /// Take the present state of `copy` as the one that `reset` returns to, for all copies.
  void keep_initial_state(int copy = 0);
  // Copies may come in any order, each once; an empty span means none. Without an argument, all are meant.

  /// Return copies to the initial state.
  void reset() { reset_chosen(std::nullopt); }
  void reset(std::span<const int> copies) { reset_chosen(copies); }
  /// Recompute the readouts after the state was written to.
  void refresh() { run("refresh", std::nullopt, &World::refresh_copy, false); }
  void refresh(std::span<const int> copies) { run("refresh", copies, &World::refresh_copy, false); }
  /// Advance copies by one control step. Throws what a callback has thrown, and `SimulationError` with MuJoCo's words:
  /// then that copy's end is `failed`, and after an error of MuJoCo its state is the one before the step.
  void advance() { run("advance", std::nullopt, &World::step_copy, true); }
  void advance(std::span<const int> copies) { run("advance", copies, &World::step_copy, true); }

  /// Present state [mjSTATE_INTEGRATION] of one copy.
  void get_state(int copy, std::span<double> state) const;
  void set_state(int copy, std::span<const double> state);
  int state_size() const { return state_size_; }

  /// Everything that decides the future of one copy, and what was read out: its state, counters, the memory of
  /// callbacks and readouts. A copy of any world of the same model with the same callbacks and readouts can go on from
  /// it.
  std::vector<double> save(int copy) const;
  /// Throws `InvalidSetup` when it does not have `save_size` values.
  void load(int copy, std::span<const double> saved);
  std::size_t save_size() const;
  /// State rows of a batch (copies × state_size); null for a world on the caller's data.
  double* states();
  /// First element of a state component (one mjtState bit) of copy 0, and its size; rows are `row_stride` apart.
  double* component(int which, int* size);
  int row_stride() const { return is_batch_ ? state_size_ : 0; }
  /// Throws `WrongOrder` while a call is under way: a callback that waited for its batch would wait for ever.
  mjBatch* batch();

  /// Give a field of a batch's model (`mjModel`'s name for it) values per copy; they start as the model's.
  /// Throws `std::invalid_argument` for the caller's own model, and for a field that cannot differ between copies.
  ModelField expand(const std::string& field);
  /// The same for a field that has values per copy already; nothing for one that has not.
  std::optional<ModelField> expanded(const std::string& field);
  /// True if any field has values per copy.
  bool is_varied() const { return is_varied_; }
  /// Recompute what the models of a batch's copies derive from masses, inertias and sizes (`mj_setConst`).
  void set_constants() { set_chosen_constants(std::nullopt); }
  void set_constants(std::span<const int> copies) { set_chosen_constants(copies); }

  std::vector<double>& poses() { return out_->poses; }    ///< copies × readouts × 7: translation [m], quaternion xyzw
  std::vector<double>& xyzrpy() { return out_->xyzrpy; }  ///< copies × readouts × 6: as roll, pitch, yaw [rad]
  std::vector<double>& forces() { return out_->forces; }  ///< copies × readouts [N], of the last physics step
  std::vector<float>& openings() { return out_->openings; }           ///< copies × readouts, 0 … 1
  std::vector<double>& measurements() { return out_->measurements; }  ///< copies × values of all measurements
  std::vector<std::uint8_t>& ends() { return out_->ends; }            ///< copies: StepEnd of the last step
  std::vector<std::int32_t>& substeps() { return out_->substeps; }    ///< copies: physics steps of the last step
  std::vector<std::int64_t>& steps() { return out_->steps; }          ///< copies: control steps since reset
  /// Keeps alive the arrays above, beyond the world itself.
  std::shared_ptr<const void> readouts() const { return out_; }
  int pose_count() const { return static_cast<int>(pose_readouts_.size()); }
  int opening_count() const { return static_cast<int>(opening_readouts_.size()); }
  int force_count() const { return static_cast<int>(force_readouts_.size()); }
  int measurement_count() const { return measured_; }

 private:
  using Chosen = std::optional<std::span<const int>>;  // nothing: all copies

  /// Marks the world as taken by one call for its own lifetime.
  class Taken {
   public:
    Taken(const World& world, const char* call, bool needs_threads = true);
    ~Taken() { world_.call_.store(nullptr, std::memory_order_release); }
    Taken(const Taken&) = delete;
    Taken& operator=(const Taken&) = delete;

   private:
    const World& world_;
  };

  struct Periodic {
    std::shared_ptr<StepCallback> callback;
    std::int64_t every;  // physics steps
  };
  struct PoseReadout {
    int site;  // -1: `body` is read instead
    int body;
    int frame_body;
  };
  struct ForceReadout {
    std::vector<std::uint8_t> first;
    std::vector<std::uint8_t> second;
  };
  struct OpeningReadout {
    std::vector<int> qpos;
    double closed;
    double open;
  };
  // The readings, in memory of their own: a view of it may outlive the world.
  struct Readouts {
    std::vector<double> poses;
    std::vector<double> xyzrpy;
    std::vector<double> forces;
    std::vector<float> openings;
    std::vector<double> measurements;
    std::vector<std::uint8_t> ends;
    std::vector<std::int32_t> substeps;
    std::vector<std::int64_t> steps;
    std::vector<std::shared_ptr<void>> retired;
  };
  using Work = void (World::*)(const mjModel*, mjData*, int);

  void require_open(const char* call) const;
  void require_threads(const char* call) const;
  bool is_forked() const;
  void check_callback(const StepCallback* callback) const;
  void check_copy(int copy) const;
  void check_state(int copy, std::size_t size) const;
  int add_pose(PoseReadout readout);
  void allocate();
  /// Make a readout's array anew for one more readout. Views of the old one stay valid, with their last values.
  template <typename T>
  void renew(std::vector<T>& values, std::size_t size) {
    out_->retired.push_back(std::make_shared<std::vector<T>>(std::move(values)));
    values.assign(size, T{});
  }
  Chosen in_order(Chosen copies, std::vector<int>& room) const;
  void read_state(int copy, std::span<double> state) const;
  void write_state(int copy, std::span<const double> state);
  void reset_chosen(Chosen copies);
  void set_chosen_constants(Chosen copies);
  ModelField expand_field(const std::string& field);
  void run(const char* call, Chosen copies, Work work, bool is_saved);
  void run_taken(Chosen copies, Work work, bool is_saved);  // the world is taken already
  void run_single(Work work);
  void run_batch(Chosen copies, Work work, bool is_saved);
  void fail(int copy, std::exception_ptr error);
  bool is_stopped();
  void step_copy(const mjModel* model, mjData* data, int copy);
  void refresh_copy(const mjModel* model, mjData* data, int copy);
  void show_copy(const mjModel* model, mjData* data, int copy);
  void preview_copy(const mjModel* model, mjData* data, int copy);
  void read_out(const mjModel* model, const mjData* data, int copy, bool has_forces);
  template <typename Visit>
  void visit_saved(int copy, Visit visit) const;
  std::int64_t period_of(std::int64_t step) const;
  Motion::Step motion_step(std::int64_t step, double physics_step) const;

  const mjModel* model_;
  mjData* data_ = nullptr;
  mjBatch* batch_ = nullptr;
  std::shared_ptr<const void> memory_;
  std::atomic<bool> is_open_ = true;
  bool is_batch_ = false;
  bool is_varied_ = false;
  int copies_;
  int threads_ = 1;
  unsigned forks_;
  int state_size_;
  StepTiming timing_;
  std::vector<std::shared_ptr<Motion>> motions_;
  std::vector<Periodic> periodic_;
  std::vector<std::shared_ptr<StepCallback>> converge_;
  std::vector<std::shared_ptr<StepCallback>> interrupt_;
  std::vector<std::shared_ptr<StepCallback>> fault_;
  std::vector<std::shared_ptr<const Measurement>> measurements_;
  int measured_ = 0;  // values of all measurements
  bool measures_forces_ = false;
  std::vector<std::shared_ptr<Watcher>> watchers_;
  Watcher* shown_ = nullptr;  // of the call under way
  struct Preview {
    Motion* motion;
    std::span<const double> target;
    double tick;
    std::vector<double> positions;
  };
  Preview* previewed_ = nullptr;  // of the call under way
  std::vector<PoseReadout> pose_readouts_;
  std::vector<ForceReadout> force_readouts_;
  std::vector<OpeningReadout> opening_readouts_;
  std::vector<double> initial_state_;
  std::vector<double> state_before_;  // of a call, in a world of one
  std::shared_ptr<Readouts> out_ = std::make_shared<Readouts>();
  std::vector<std::int64_t> physics_steps_;

  mutable std::atomic<const char*> call_ = nullptr;  // the one under way
  std::function<void()> poll_;
  std::thread::id caller_;
  std::chrono::steady_clock::time_point polled_at_;
  std::atomic<bool> is_stopping_ = false;
  std::mutex failure_mutex_;  // guards both below while threads step
  std::exception_ptr failure_;
  int failed_copy_ = 0;
};

}  // namespace rcs
