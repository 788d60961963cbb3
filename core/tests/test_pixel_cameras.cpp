// Pixels of many copies: what is drawn, where it goes, and that threads and copies make no difference.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "model.hpp"
#include "rcs/pixel_cameras.hpp"
#include "rcs/result.hpp"
#include "rcs/world.hpp"

namespace {

using rcs::FrameUse;
using rcs::PixelCameras;
using rcs::PixelLayout;
using Bytes = std::vector<std::uint8_t>;

constexpr int kSize = 16;
constexpr std::size_t kPlane = kSize * kSize;

// A red ball that moves along x above a wide green box, seen from above; light comes from everywhere.
constexpr const char* kScene = R"(
<mujoco>
  <option timestep="0.01" gravity="0 0 0"/>
  <statistic extent="1"/>
  <visual><headlight active="1" ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>
  <worldbody>
    <geom type="box" size="9 9 0.1" pos="0 0 -0.1" rgba="0 1 0 1"/>
    <body name="ball" pos="0 0 0.2">
      <joint type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.1" rgba="1 0 0 1"/>
    </body>
    <geom type="box" size="0.1 0.1 0.05" pos="0.6 0.6 0.4" rgba="0 0 1 0.5"/>
    <geom type="box" size="0.05 0.05 0.05" pos="-0.5 -0.5 0.3" rgba="1 1 1 1" group="3"/>
    <camera name="top" pos="0 0 2" fovy="60"/>
  </worldbody>
</mujoco>)";

std::array<int, 3> pixel(const Bytes& frame, int x, int y) {
  const std::size_t i = static_cast<std::size_t>(y) * kSize + static_cast<std::size_t>(x);
  return {frame[i], frame[i + kPlane], frame[i + 2 * kPlane]};
}

rcs::RenderOptions options() { return {rcs::Quality::fast, kSize, kSize}; }

std::shared_ptr<PixelCameras> cameras(const mjModel* model, int copies, int threads, PixelLayout layout = {}) {
  return std::make_shared<PixelCameras>(model, copies, threads,
                                        std::vector<rcs::PixelCamera>{{0, kSize, kSize, nullptr}}, layout, options());
}

void the_nearest_is_seen_where_it_is() {
  const rcs::test::Model model = rcs::test::make_model(kScene);
  const rcs::test::Data data(mj_makeData(model.get()));
  mj_forward(model.get(), data.get());
  const auto drawn = cameras(model.get(), 1, 1);
  CHECK(drawn->why_opengl().empty());
  Bytes frame(3 * kPlane);
  drawn->turn({frame.data()}, {});
  drawn->see_step(model.get(), data.get(), 0);
  CHECK(drawn->drawn()[0] == 1);
  CHECK(pixel(frame, 7, 7) == std::array{255, 0, 0});
  CHECK(pixel(frame, 8, 8) == std::array{255, 0, 0});
  CHECK(pixel(frame, 0, 0) == std::array{0, 255, 0});    // the box reaches beyond the picture and behind the camera
  CHECK(pixel(frame, 3, 12) == std::array{0, 255, 0});   // a collision shape is not drawn
  CHECK(pixel(frame, 13, 2) == std::array{0, 64, 191});  // what is transparent is mixed in twice
  data->qpos[0] = 0.5;
  mj_kinematics(model.get(), data.get());
  drawn->see_step(model.get(), data.get(), 0);
  CHECK(pixel(frame, 7, 7) == std::array{0, 255, 0});
  CHECK(pixel(frame, 11, 7) == std::array{255, 0, 0});
  data->qpos[0] = std::numeric_limits<double>::quiet_NaN();  // a simulation that has diverged
  mj_kinematics(model.get(), data.get());
  drawn->see_step(model.get(), data.get(), 0);
  CHECK(pixel(frame, 7, 7) == std::array{0, 255, 0});
}

void frames_move_up_in_a_stack() {
  const rcs::test::Model model = rcs::test::make_model(kScene);
  const rcs::test::Data data(mj_makeData(model.get()));
  mj_forward(model.get(), data.get());
  const auto drawn = cameras(model.get(), 1, 1, {true, 3});
  CHECK(drawn->channels() == 3);
  std::array<Bytes, 3> stacks{Bytes(3 * kPlane), Bytes(3 * kPlane), Bytes(3 * kPlane)};
  const auto frame = [&](std::size_t stack, std::size_t place) {
    const auto first = stacks[stack].begin() + static_cast<std::ptrdiff_t>(place * kPlane);
    return Bytes(first, first + kPlane);
  };
  const std::array start{FrameUse::start};
  drawn->turn({stacks[0].data()}, {});
  drawn->see_step(model.get(), data.get(), 0);  // nothing was before
  CHECK(frame(0, 0) == frame(0, 2) && frame(0, 1) == frame(0, 2));
  CHECK(frame(0, 2)[7 * kSize + 7] == 77);  // 77 / 256 of 255
  drawn->turn({stacks[1].data()}, {stacks[0].data()});
  CHECK(drawn->drawn()[0] == 0);
  data->qpos[0] = 0.4;
  mj_kinematics(model.get(), data.get());
  drawn->see_step(model.get(), data.get(), 0);
  CHECK(frame(1, 0) == frame(0, 1) && frame(1, 1) == frame(0, 2) && frame(1, 2) != frame(0, 2));
  drawn->turn({stacks[2].data()}, {stacks[1].data()});
  drawn->keep(0);
  CHECK(stacks[2] == stacks[1]);
  data->qpos[0] = -0.4;
  mj_kinematics(model.get(), data.get());
  const std::array replace{FrameUse::replace};
  drawn->set_uses(replace);
  drawn->see(model.get(), data.get(), 0);
  CHECK(frame(2, 0) == frame(1, 0) && frame(2, 1) == frame(1, 1) && frame(2, 2) != frame(1, 2));
  drawn->set_uses(start);
  drawn->see(model.get(), data.get(), 0);
  CHECK(frame(2, 0) == frame(2, 2) && frame(2, 1) == frame(2, 2));
}

void threads_and_copies_make_no_difference() {
  const rcs::test::Model model = rcs::test::make_model(kScene);
  constexpr int kCopies = 9;
  std::vector<Bytes> pictures;
  for (const int threads : {1, 2, 4}) {
    rcs::World world(model.get(), kCopies, threads, {.period_numerator = 2, .period_denominator = 1});
    const auto drawn = cameras(model.get(), kCopies, world.threads());
    world.watch(drawn);
    int size = 0;
    double* speeds = world.component(mjSTATE_QVEL, &size);
    for (int copy = 0; copy < kCopies; ++copy) speeds[copy * world.row_stride()] = copy;
    Bytes& frames = pictures.emplace_back(kCopies * 3 * kPlane);
    drawn->turn({frames.data()}, {});
    for (int step = 0; step < 5; ++step) world.advance();
    CHECK(std::ranges::all_of(drawn->drawn(), [](std::uint8_t flag) { return flag == 1; }));
    // One copy that is shown, in a world of its own, is what its thread has drawn.
    Bytes shown(kCopies * 3 * kPlane);
    drawn->turn({shown.data()}, {});
    const std::array<int, 2> some{2, 7};
    world.show(*drawn, some);
    for (const int copy : some) {
      const auto first = static_cast<std::ptrdiff_t>(static_cast<std::size_t>(copy) * 3 * kPlane);
      CHECK(std::equal(shown.begin() + first, shown.begin() + first + 3 * kPlane, frames.begin() + first));
    }
    CHECK(std::all_of(shown.begin(), shown.begin() + 2 * 3 * kPlane, [](std::uint8_t value) { return value == 0; }));
  }
  CHECK(pictures[0] == pictures[1] && pictures[0] == pictures[2]);
  const auto copy = [&](int number) {
    const auto first = pictures[0].begin() + number * static_cast<std::ptrdiff_t>(3 * kPlane);
    return Bytes(first, first + 3 * kPlane);
  };
  CHECK(copy(1) != copy(5));
}

void what_does_not_fit_is_refused() {
  const rcs::test::Model model = rcs::test::make_model(kScene), other = rcs::test::make_model(rcs::test::kCart);
  const auto drawn = cameras(model.get(), 2, 1);
  CHECK_THROWS(std::invalid_argument, drawn->turn({}, {}));
  CHECK_THROWS(std::invalid_argument, drawn->set_uses({}));
  CHECK_THROWS(std::invalid_argument, cameras(model.get(), 0, 1));
  CHECK_THROWS(std::invalid_argument, cameras(model.get(), 1, 1, {false, 0}));
  CHECK_THROWS(std::invalid_argument, cameras(other.get(), 1, 1));  // it has no camera
  rcs::World large(model.get(), 3, 1, {}), another(other.get(), 2, 1, {}), world(model.get(), 2, 1, {});
  CHECK_THROWS(rcs::InvalidSetup, large.watch(drawn));
  CHECK_THROWS(rcs::InvalidSetup, another.watch(drawn));
  CHECK_THROWS(rcs::InvalidSetup, world.watch(nullptr));
  const std::array<int, 1> first{0};
  CHECK_THROWS(rcs::WrongOrder, world.show(*drawn, first));  // there is no array to draw to
  world.close();
  CHECK_THROWS(rcs::WrongOrder, world.show(*drawn, first));
}

}  // namespace

int main() {
  the_nearest_is_seen_where_it_is();
  frames_move_up_in_a_stack();
  threads_and_copies_make_no_difference();
  what_does_not_fit_is_refused();
  return rcs::test::result();
}
