// Worlds, callbacks, devices and kinematics that several threads use at once: what the sanitizer of threads looks at.
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include "check.hpp"
#include "model.hpp"
#include "rcs/kinematics.hpp"
#include "rcs/sim_devices.hpp"
#include "rcs/world.hpp"

namespace {

using rcs::World;
using rcs::test::Data;
using rcs::test::Model;

constexpr int kThreads = 4;
const rcs::StepTiming k30Hz{50, 3, false, 500};
const rcs::StepTiming kSynchronous{50, 3, true, 500};

/// Counts its calls, which come from all threads of a batch.
class Count final : public rcs::StepCallback {
 public:
  bool call(const rcs::StepView&) override {
    ++calls;
    return false;
  }
  std::atomic<int> calls = 0;
};

template <typename Work>
void in_threads(Work work) {
  std::vector<std::jthread> threads;
  for (int i = 0; i < kThreads; ++i) threads.emplace_back([&work, i] { work(i); });
}

void every_thread_steps_a_batch_of_its_own_with_callbacks() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  std::vector<double> ends(kThreads);
  in_threads([&](int i) {
    World world(model.get(), 5, 3, kSynchronous);
    const auto count = std::make_shared<Count>();
    world.on_period(count, 0.01);
    world.converge_when(std::make_shared<rcs::JointsArrived>(std::vector{0}, std::vector{0}, 1e-3, 1e-2));
    world.converge_when(std::make_shared<rcs::JointsAtRest>(std::vector{0}, 1e-2, 0.02, 5));
    world.read_pose(0, 0);
    int size = 0;
    double* ctrl = world.component(mjSTATE_CTRL, &size);
    for (int copy = 0; copy < 5; ++copy) ctrl[copy * world.row_stride()] = 0.05 * copy;
    for (int step = 0; step < 5; ++step) world.advance();
    CHECK(count->calls > 0);
    ends[static_cast<std::size_t>(i)] = world.component(mjSTATE_QPOS, &size)[4 * world.row_stride()];
  });
  for (const double end : ends) CHECK(end == ends[0]);
}

void every_thread_steps_a_world_of_one_with_an_arm_of_its_own() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  in_threads([&](int) {
    const Data data(mj_makeData(model.get()));
    const auto world = std::make_shared<World>(model.get(), data.get(), k30Hz);
    const rcs::MotionLimits limits{{-10.0}, {10.0}, {1.0}, {10.0}, {1000.0}};
    const auto motion = std::make_shared<rcs::Motion>(std::vector{0}, std::vector{0}, 0, limits, 1);
    rcs::SimArm arm("cart", {{-10.0}, {10.0}, {1.0}}, world, 0, motion);
    arm.open();
    for (int step = 0; step < 30; ++step) {
      arm.command_joints(std::vector<double>{0.1});
      world->advance();
    }
    CHECK_NEAR(arm.state().joints[0], 0.1, 1e-2);
    arm.close();
  });
}

void one_solver_and_one_batch_of_targets_serve_all_threads() {
  const Model model = rcs::test::make_model(rcs::test::kArm);
  rcs::DampedLeastSquares solver(model.get(), {0, 1, 2, 3, 4, 5}, 0, 1);
  const std::vector<double> start(6, 0.3), there{0.5, 0.2, 0.4, 0.1, 0.3, 0.2};
  const rcs::Pose target = solver.forward(there);
  std::vector<double> targets, starts;
  for (int i = 0; i < 6; ++i) {
    targets.insert(targets.end(), target.translation().begin(), target.translation().end());
    targets.insert(targets.end(), target.quaternion().begin(), target.quaternion().end());
    starts.insert(starts.end(), start.begin(), start.end());
  }
  const std::vector<double> expected = solver.inverse(target, start, {}).joints;
  in_threads([&](int i) {
    std::vector<double> joints(36), errors(12);
    std::vector<std::uint8_t> status(6);
    solver.inverse_batch(targets, starts, {}, 1 + i, joints, status, errors);
    CHECK(std::equal(expected.begin(), expected.end(), joints.begin() + 30));
  });
}

}  // namespace

int main() {
  every_thread_steps_a_batch_of_its_own_with_callbacks();
  every_thread_steps_a_world_of_one_with_an_arm_of_its_own();
  one_solver_and_one_batch_of_targets_serve_all_threads();
  return rcs::test::result();
}
