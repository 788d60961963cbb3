// Laws of worlds: exact mean rate, copies that equal a world of one, convergence, interruption, exceptions.
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "check.hpp"
#include "model.hpp"
#include "rcs/world.hpp"

namespace {

using rcs::StepEnd;
using rcs::StepTiming;
using rcs::World;
using rcs::test::Data;
using rcs::test::Model;

const StepTiming k30Hz{50, 3, false, 500};

double* qpos(World& world, int copy = 0) {
  int size = 0;
  return world.component(mjSTATE_QPOS, &size) + copy * world.row_stride();
}

double* ctrl(World& world, int copy = 0) {
  int size = 0;
  return world.component(mjSTATE_CTRL, &size) + copy * world.row_stride();
}

StepEnd end_of(World& world, int copy = 0) {
  return static_cast<StepEnd>(world.ends()[static_cast<std::size_t>(copy)]);
}

/// Answers with a function.
class Ask final : public rcs::StepCallback {
 public:
  explicit Ask(bool (*function)(const rcs::StepView&)) : function_(function) {}
  bool call(const rcs::StepView& view) override {
    ++calls;
    return function_(view);
  }
  int calls = 0;

 private:
  bool (*function_)(const rcs::StepView&);
};

void thirty_hertz_at_two_milliseconds_is_exact() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  const Data data(mj_makeData(model.get()));
  World world(model.get(), data.get(), k30Hz);
  int substeps = 0;
  for (int step = 0; step < 300; ++step) {
    world.advance();
    CHECK(world.substeps()[0] == (step % 3 == 0 ? 16 : 17));
    CHECK(end_of(world) == StepEnd::period);
    substeps += world.substeps()[0];
  }
  CHECK(substeps == 5000);
  CHECK_NEAR(data->time, 10.0, 1e-9);
}

void copies_have_the_bits_of_a_world_of_one_at_any_number_of_threads() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  for (const int threads : {1, 2, 5}) {
    World batch(model.get(), 4, threads, k30Hz);
    for (int copy = 0; copy < 4; ++copy) *ctrl(batch, copy) = 0.1 * copy;
    for (int step = 0; step < 10; ++step) batch.advance();
    for (int copy = 0; copy < 4; ++copy) {
      const Data data(mj_makeData(model.get()));
      World single(model.get(), data.get(), k30Hz);
      *ctrl(single) = 0.1 * copy;
      for (int step = 0; step < 10; ++step) single.advance();
      CHECK(*qpos(single) == *qpos(batch, copy));
    }
  }
}

void a_synchronous_step_ends_when_converged_or_at_its_limit() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  const Data data(mj_makeData(model.get()));
  World world(model.get(), data.get(), {50, 3, true, 2000});
  world.converge_when(std::make_shared<rcs::JointsArrived>(std::vector<int>{0}, std::vector<int>{0}, 1e-3, 1e-2));
  *ctrl(world) = 0.3;
  world.advance();
  CHECK(end_of(world) == StepEnd::converged);
  CHECK_NEAR(*qpos(world), 0.3, 1e-3);
  world.set_timing({50, 3, true, 5});
  *ctrl(world) = 0.6;
  world.advance();
  CHECK(end_of(world) == StepEnd::limit);
  CHECK(world.substeps()[0] == 5);
}

void an_interruption_ends_a_synchronous_step_at_once() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  const Data data(mj_makeData(model.get()));
  World world(model.get(), data.get(), {50, 3, true, 2000});
  world.interrupt_when(std::make_shared<Ask>([](const rcs::StepView& view) { return view.data->qpos[0] > 0.1; }));
  *ctrl(world) = 0.3;
  world.advance();
  CHECK(end_of(world) == StepEnd::interrupted);
  CHECK(*qpos(world) > 0.1 && *qpos(world) < 0.15);
}

void a_periodic_callback_is_called_once_per_period_and_copy() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 3, 1, k30Hz);
  const auto callback = std::make_shared<Ask>([](const rcs::StepView&) { return false; });
  world.on_period(callback, 0.01);
  for (int step = 0; step < 3; ++step) world.advance();
  CHECK(callback->calls == 3 * 10);
  CHECK_THROWS(rcs::InvalidSetup, world.on_period(callback, 0.0));
}

void an_exception_of_a_callback_reaches_the_caller_from_every_thread() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 8, 2, k30Hz);
  world.on_period(std::make_shared<Ask>([](const rcs::StepView& view) -> bool {
                    if (view.copy == 5) throw std::range_error("copy 5");
                    return false;
                  }),
                  0.002);
  CHECK_THROWS(std::range_error, world.advance());
  CHECK(end_of(world, 5) == StepEnd::failed);
  CHECK(end_of(world, 4) == StepEnd::period);
}

void a_state_that_is_not_finite_fails_in_its_copy_alone() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 3, 2, k30Hz);
  *qpos(world, 1) = std::numeric_limits<double>::quiet_NaN();
  world.advance();
  CHECK(end_of(world, 0) == StepEnd::period);
  CHECK(end_of(world, 1) == StepEnd::failed);
  CHECK(end_of(world, 2) == StepEnd::period);
  const std::vector<int> failed{1};
  world.reset(failed);
  world.advance(failed);
  CHECK(end_of(world, 1) == StepEnd::period);
}

void states_continue_with_the_same_bits() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 2, 1, {10, 1, false, 500});
  *ctrl(world, 1) = 0.5;
  world.advance();
  std::vector<double> state(static_cast<std::size_t>(world.state_size()));
  world.get_state(1, state);
  world.advance();
  const double expected = *qpos(world, 1);
  world.set_state(1, state);
  world.advance();
  CHECK(*qpos(world, 1) == expected);
  state.pop_back();
  CHECK_THROWS(rcs::InvalidSetup, world.set_state(1, state));
  CHECK_THROWS(rcs::InvalidSetup, world.get_state(2, state));
}

void poses_are_read_out_in_the_frame_of_a_body() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  const Data data(mj_makeData(model.get()));
  World world(model.get(), data.get(), k30Hz);
  const int in_world = world.read_pose(0, 0), in_cart = world.read_pose(0, 1), cart = world.read_body_pose(1, 0);
  *qpos(world) = 0.4;
  world.refresh();
  CHECK_NEAR(world.poses()[7 * in_world], 0.5, 1e-12);
  CHECK_NEAR(world.poses()[7 * in_cart], 0.1, 1e-12);
  CHECK_NEAR(world.poses()[7 * cart], 0.4, 1e-12);
  CHECK_NEAR(world.poses()[7 * in_world + 6], 1.0, 1e-12);
  CHECK(world.pose_count() == 3);
  CHECK_THROWS(rcs::InvalidSetup, world.read_pose(1, 0));
}

void copies_may_have_masses_of_their_own() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 3, 2, k30Hz);
  CHECK(!world.is_varied());
  CHECK(!world.expanded("body_mass"));
  const rcs::ModelField masses = world.expand("body_mass");
  CHECK(world.is_varied());
  CHECK(masses.size == model->nbody);
  double* mass = std::get<double*>(masses.values);
  mass[2 * masses.size + 1] *= 4.0;
  world.set_constants();
  const auto weights = world.expanded("dof_invweight0");
  CHECK(weights.has_value());
  const double* weight = std::get<double*>(weights->values);
  CHECK_NEAR(weight[0], 4.0 * weight[2 * weights->size], 1e-9);
  CHECK(std::holds_alternative<float*>(world.expand("geom_rgba").values));
  CHECK(std::holds_alternative<int*>(world.expand("geom_matid").values));
  CHECK_THROWS(std::invalid_argument, world.expand("no_such_field"));
  CHECK_THROWS(std::invalid_argument, world.expand("names"));
  const Data data(mj_makeData(model.get()));
  World single(model.get(), data.get(), k30Hz);
  CHECK_THROWS(std::invalid_argument, single.expand("body_mass"));
  CHECK_THROWS(std::invalid_argument, single.set_constants());
}

void a_soft_body_weighs_on_what_it_lies_on() {
  const Model model = rcs::test::make_model(rcs::test::kSoftBlock);
  const std::vector<std::uint8_t> plate{1, 0}, ball{0, 1}, block{0, 0, 1}, all{1, 1, 1}, geoms{1, 1};
  World batch(model.get(), 2, 1, {500, 1, false, 500});
  const Data data(mj_makeData(model.get()));
  World single(model.get(), data.get(), {500, 1, false, 500});
  for (World* world : {&batch, &single}) {
    CHECK(world->read_force(plate, block) == 0);
    CHECK(world->read_force(block, plate) == 1);
    CHECK(world->read_force(all, all) == 2);
    CHECK(world->read_force(ball, block) == 3);
    CHECK(world->read_force(geoms, geoms) == 4);  // without flags of flexes
    CHECK_THROWS(rcs::InvalidSetup, world->read_force({1, 1, 1, 1}, plate));
    CHECK_THROWS(rcs::InvalidSetup, world->read_force(plate, {1}));
    world->advance();
  }
  for (std::size_t readout = 0; readout < 5; ++readout) {
    CHECK_NEAR(single.forces()[readout], readout < 3 ? 9.81 : 0.0, 1e-2);
    CHECK(batch.forces()[5 + readout] == single.forces()[readout]);
  }
  rcs::Collision on_plate(plate, block, 1.0), on_ball(ball, block, 1.0), among_geoms(geoms, geoms, 1.0);
  const rcs::StepView view{model.get(), data.get(), 0};
  CHECK(on_plate.call(view));
  CHECK(!on_ball.call(view));
  CHECK(!among_geoms.call(view));
}

void copies_may_come_in_any_order_and_none_are_none() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 3, 2, k30Hz);
  const std::vector<int> some{2, 0}, twice{1, 1}, none;
  world.advance(some);
  world.advance(none);
  world.advance({});
  CHECK(world.steps() == std::vector<std::int64_t>{1, 0, 1});
  world.set_constants(some);
  world.refresh(none);
  world.reset(none);
  CHECK_THROWS(rcs::InvalidSetup, world.advance(twice));
  CHECK_THROWS(rcs::InvalidSetup, world.reset(twice));
  CHECK_THROWS(rcs::InvalidSetup, world.set_constants(twice));
  CHECK(world.steps() == std::vector<std::int64_t>{1, 0, 1});
  world.reset(some);
  CHECK(world.steps() == std::vector<std::int64_t>{0, 0, 0});
}

void a_world_takes_one_call_at_a_time() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 2, 1, k30Hz);
  static World* stepped;
  stepped = &world;
  world.on_period(std::make_shared<Ask>([](const rcs::StepView&) {
                    CHECK_THROWS(rcs::WrongOrder, stepped->advance());
                    CHECK_THROWS(rcs::WrongOrder, stepped->set_timing(k30Hz));
                    CHECK_THROWS(rcs::WrongOrder, stepped->read_pose(0, 0));
                    CHECK_THROWS(rcs::WrongOrder, stepped->batch());
                    return false;
                  }),
                  0.01);
  world.advance();
  CHECK(end_of(world) == StepEnd::period);
}

void an_error_of_mujoco_has_its_words_and_leaves_the_state_as_it_was() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  model->opt.integrator = 99;
  const Data data(mj_makeData(model.get()));
  World single(model.get(), data.get(), k30Hz), batch(model.get(), 3, 2, k30Hz);
  for (World* world : {&single, &batch}) {
    *qpos(*world) = 0.25;
    std::string words;
    try {
      world->advance();
    } catch (const rcs::SimulationError& error) {
      words = error.what();
    }
    CHECK(words.find("copy 0: mj_step: invalid integrator") != std::string::npos);
    CHECK(end_of(*world) == StepEnd::failed);
    CHECK(*qpos(*world) == 0.25);
    CHECK(world->steps()[0] == 0);
  }
}

void a_closed_world_leaves_the_memory_that_was_kept() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 2, 2, k30Hz);
  double* position = qpos(world);
  const auto memory = world.memory();
  world.on_period(std::make_shared<Ask>([](const rcs::StepView&) { return false; }), 0.01);
  world.close();
  world.close();
  CHECK(!world.is_open());
  CHECK(world.callbacks().empty());
  CHECK_THROWS(rcs::WrongOrder, world.advance());
  CHECK_THROWS(rcs::WrongOrder, qpos(world));
  CHECK_THROWS(rcs::WrongOrder, world.model());
  CHECK(*position == 0.0);
}

void a_long_step_can_be_ended_from_outside() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  World world(model.get(), 4, 2, {1'000'000'000, 1, false, 500});
  world.poll_with([] { throw std::range_error("enough"); });
  CHECK_THROWS(std::range_error, world.advance());
}

void data_of_another_model_is_refused() {
  const Model model = rcs::test::make_model(rcs::test::kCart), other = rcs::test::make_model(rcs::test::kArm);
  const Data data(mj_makeData(other.get()));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), data.get(), k30Hz));
}

void numbers_that_make_no_sense_are_refused() {
  const Model model = rcs::test::make_model(rcs::test::kCart);
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 0, 1, k30Hz));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 1, 1, StepTiming{1, 2, false, 500}));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 1, 1, StepTiming{0, 1, false, 500}));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 1, 1, StepTiming{1, 1, true, 0}));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 1, 1, StepTiming{std::int64_t{1} << 31, 1, false, 500}));
  CHECK_THROWS(rcs::InvalidSetup, World(model.get(), 1, -1, k30Hz));
  World world(model.get(), 2, 1, k30Hz);
  const std::vector<int> missing{0, 2};
  CHECK_THROWS(rcs::InvalidSetup, world.advance(missing));
  CHECK(world.steps()[0] == 0);
}

}  // namespace

int main() {
  thirty_hertz_at_two_milliseconds_is_exact();
  copies_have_the_bits_of_a_world_of_one_at_any_number_of_threads();
  a_synchronous_step_ends_when_converged_or_at_its_limit();
  an_interruption_ends_a_synchronous_step_at_once();
  a_periodic_callback_is_called_once_per_period_and_copy();
  an_exception_of_a_callback_reaches_the_caller_from_every_thread();
  a_state_that_is_not_finite_fails_in_its_copy_alone();
  states_continue_with_the_same_bits();
  poses_are_read_out_in_the_frame_of_a_body();
  copies_may_have_masses_of_their_own();
  a_soft_body_weighs_on_what_it_lies_on();
  copies_may_come_in_any_order_and_none_are_none();
  a_world_takes_one_call_at_a_time();
  an_error_of_mujoco_has_its_words_and_leaves_the_state_as_it_was();
  a_closed_world_leaves_the_memory_that_was_kept();
  a_long_step_can_be_ended_from_outside();
  data_of_another_model_is_refused();
  numbers_that_make_no_sense_are_refused();
  return rcs::test::result();
}
