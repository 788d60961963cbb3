// N copies of one MuJoCo scene, advanced together by one control step at a time.
//
// Time: a copy counts its own control steps. Asynchronously, step k lasts floor((k+1) r) - floor(k r) physics steps
// with r = control period / physics step, kept as a ratio of integers, so the mean rate is exact (30 Hz at 2 ms: 16,
// 17, 17). Threads: copies run on MuJoCo's own pool (mjbatch.h); the result does not depend on the number of threads.
#pragma once

#include <mujoco/mjbatch.h>
#include <mujoco/mujoco.h>

#include <cstdint>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "rcs/callback.hpp"
#include "rcs/result.hpp"

namespace rcs {

/// How long a control step lasts.
struct StepTiming {
  std::int64_t period_numerator = 50;   ///< control period in physics steps, numerator of the ratio …
  std::int64_t period_denominator = 3;  ///< … and its denominator
  bool is_synchronous = false;          ///< step until converged instead of for one control period
  int max_substeps = 500;               ///< of a synchronous step
};

/// A field of the model with values per copy: copies × size.
struct ModelField {
  std::variant<double*, float*, int*> values;
  int size = 0;
};

class World {
 public:
  /// One copy, working directly on the caller's model and data, which must outlive the world.
  World(const mjModel* model, mjData* data, StepTiming timing);
  /// Many copies of a copy of `model`, on `threads` threads (0: one per CPU).
  World(const mjModel* model, int copies, int threads, StepTiming timing);
  ~World();
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  int copies() const { return copies_; }
  int threads() const { return batch_ ? mjb_nthread(batch_) : 1; }
  bool is_batch() const { return batch_ != nullptr; }
  const mjModel* model() const { return model_; }
  const StepTiming& timing() const { return timing_; }
  void set_timing(const StepTiming& timing);

  /// Call every `period` seconds of simulated time.
  void on_period(std::shared_ptr<StepCallback> callback, double period);
  /// A synchronous step ends when all of these are true.
  void converge_when(std::shared_ptr<StepCallback> callback);
  /// A synchronous step ends when any of these is true; an asynchronous one lasts its period and says so.
  void interrupt_when(std::shared_ptr<StepCallback> callback);

  /// Have the pose of a site in the frame of a body read out after every call. Returns its index in `poses`.
  int read_pose(int site, int frame_body);
  /// Have the pose of a body in the frame of another read out. Returns its index in `poses`.
  int read_body_pose(int body, int frame_body);
  /// Have the normal force between two sets of surfaces read out: one flag per geom of the model, then, where soft
  /// bodies count too, one per flex. Returns its index in `forces`.
  int read_force(std::vector<std::uint8_t> first, std::vector<std::uint8_t> second);

  /// Have the mean position of joints read out as 0 at `closed` … 1 at `open`. Returns its index in `openings`.
  int read_opening(std::vector<int> joints, double closed, double open);

  /// Take the present state of `copy` as the one that `reset` returns to, for all copies.
  void keep_initial_state(int copy = 0);
  /// Return copies to the initial state. Empty `copies` means all.
  void reset(std::span<const int> copies = {});
  /// Recompute the readouts after the state was written to.
  void refresh(std::span<const int> copies = {});
  /// Advance copies by one control step.
  void advance(std::span<const int> copies = {});

  /// Present state [mjSTATE_INTEGRATION] of one copy.
  void get_state(int copy, std::span<double> state) const;
  void set_state(int copy, std::span<const double> state);
  int state_size() const { return state_size_; }
  /// State rows of a batch (copies × state_size); null for a world on the caller's data.
  double* states() { return batch_ ? mjb_state(batch_) : nullptr; }
  /// First element of a state component (one mjtState bit) of copy 0, and its size; rows are `row_stride` apart.
  double* component(int which, int* size);
  int row_stride() const { return batch_ ? state_size_ : 0; }
  mjBatch* batch() { return batch_; }

  /// Give a field of a batch's model (`mjModel`'s name for it) values per copy; they start as the model's.
  /// Throws `std::invalid_argument` for the caller's own model, and for a field that cannot differ between copies.
  ModelField expand(const std::string& field);
  /// The same for a field that has values per copy already; nothing for one that has not.
  std::optional<ModelField> expanded(const std::string& field);
  /// Whether any field has values per copy.
  bool is_varied() const { return is_varied_; }
  /// Recompute what the models of a batch's copies derive from masses, inertias and sizes (`mj_setConst`).
  void set_constants(std::span<const int> copies = {});

  mjData* data() { return data_; }

  std::vector<double>& poses() { return poses_; }       ///< copies × readouts × 7: translation [m], quaternion xyzw
  std::vector<double>& xyzrpy() { return xyzrpy_; }     ///< copies × readouts × 6: the same as roll, pitch, yaw [rad]
  std::vector<double>& forces() { return forces_; }     ///< copies × readouts [N], of the last physics step
  std::vector<float>& openings() { return openings_; }  ///< copies × readouts, 0 … 1
  std::vector<std::uint8_t>& ends() { return ends_; }   ///< copies: StepEnd of the last step
  std::vector<std::int32_t>& substeps() { return substeps_; }  ///< copies: physics steps of the last step
  std::vector<std::int64_t>& steps() { return steps_; }        ///< copies: control steps since reset
  int pose_count() const { return static_cast<int>(pose_readouts_.size()); }
  int opening_count() const { return static_cast<int>(opening_readouts_.size()); }
  int force_count() const { return static_cast<int>(force_readouts_.size()); }

 private:
  struct Periodic {
    std::shared_ptr<StepCallback> callback;
    int every;  // physics steps
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
  using Work = void (World::*)(const mjModel*, mjData*, int);

  int add_pose(PoseReadout readout);
  void allocate();
  /// Make a readout's array anew for one more readout. Views of the old one stay valid, with their last values.
  template <typename T>
  void renew(std::vector<T>& values, std::size_t size) {
    retired_.push_back(std::make_shared<std::vector<T>>(std::move(values)));
    values.assign(size, T{});
  }
  void check_copies(std::span<const int> copies) const;
  void run(std::span<const int> copies, Work work, bool is_saved);
  void step_copy(const mjModel* model, mjData* data, int copy);
  void refresh_copy(const mjModel* model, mjData* data, int copy);
  void read_out(const mjModel* model, const mjData* data, int copy, bool has_forces);
  std::int64_t period_of(std::int64_t step) const;

  const mjModel* model_;
  mjData* data_ = nullptr;
  mjBatch* batch_ = nullptr;
  bool is_varied_ = false;
  int copies_;
  int state_size_;
  StepTiming timing_;
  std::vector<Periodic> periodic_;
  std::vector<std::shared_ptr<StepCallback>> converge_;
  std::vector<std::shared_ptr<StepCallback>> interrupt_;
  std::vector<PoseReadout> pose_readouts_;
  std::vector<ForceReadout> force_readouts_;
  std::vector<OpeningReadout> opening_readouts_;
  std::vector<double> initial_state_;
  std::vector<double> poses_;
  std::vector<double> xyzrpy_;
  std::vector<double> forces_;
  std::vector<float> openings_;
  std::vector<std::shared_ptr<void>> retired_;
  std::vector<std::uint8_t> ends_;
  std::vector<std::int32_t> substeps_;
  std::vector<std::int64_t> steps_;
  std::vector<std::int64_t> physics_steps_;
  std::mutex failure_mutex_;
  std::exception_ptr failure_;
};

}  // namespace rcs
