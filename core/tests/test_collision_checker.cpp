// The collision checker: distances as MuJoCo's over all pairs, motions against dense sampling, and what may touch.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <random>
#include <thread>

#include "check.hpp"
#include "model.hpp"
#include "rcs/collision_checker.hpp"

namespace {

using rcs::Clearance;
using rcs::CollisionChecker;
using rcs::Hit;

/// Three hinges and a slide that carries a finger on a joint of its own, beside a sheet, a post, a floor and a free
/// ball.
constexpr const char* kScene = R"(
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" pos="0 0 -0.5"/>
    <geom name="sheet" type="box" size="0.0005 0.3 0.3" pos="0.5 0.4 0"/>
    <geom name="post" type="cylinder" size="0.03 0.3" pos="-0.4 0.3 0"/>
    <body name="ball" pos="0 -0.5 0.1"><freejoint/><geom name="ball" type="sphere" size="0.05"/></body>
    <body name="base"><geom name="base" type="box" size="0.04 0.04 0.04"/>
      <body name="link1">
        <joint name="joint1" axis="0 0 1" range="-3 3"/><geom name="link1" type="capsule" size="0.02" fromto="0.1 0 0 0.3 0 0"/>
        <body name="link2" pos="0.3 0 0">
          <joint name="joint2" axis="0 1 0" pos="0.01 0 0.02" range="-2 2"/>
          <geom name="link2" type="ellipsoid" size="0.1 0.03 0.02" pos="0.12 0 0" euler="0 0.2 0.1"/>
          <body name="link3" pos="0.25 0 0" euler="0.1 0 0">
            <joint name="joint3" type="slide" axis="1 0 0" range="-0.05 0.1"/>
            <joint name="joint4" axis="0 0 1" range="-2 2"/>
            <geom name="link3" type="box" size="0.06 0.02 0.02"/>
            <body name="finger" pos="0.07 0 0"><joint name="finger" axis="0 0 1" range="-1 1"/>
              <geom name="finger" type="capsule" size="0.01" fromto="0 0 0 0.05 0 0"/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>)";

constexpr int kDof = 4;

struct Scene {
  rcs::test::Model model = rcs::test::make_model(kScene);
  rcs::test::Data data{mj_makeData(model.get())};
  std::vector<int> joints;
  Scene() {
    for (const char* name : {"joint1", "joint2", "joint3", "joint4"})
      joints.push_back(mj_name2id(model.get(), mjOBJ_JOINT, name));
  }
  int body(const char* name) const { return mj_name2id(model.get(), mjOBJ_BODY, name); }
  CollisionChecker checker() const { return CollisionChecker(model.get(), {joints}); }
  std::span<const double> qpos() const { return {data->qpos, static_cast<std::size_t>(model->nq)}; }
  void put(std::span<const double> q) {
    for (std::size_t i = 0; i < joints.size(); ++i) data->qpos[model->jnt_qposadr[joints[i]]] = q[i];
    mj_kinematics(model.get(), data.get());
  }
  /// The smallest distance of the pairs at `q`: MuJoCo's, or minus the radius of a capsule whose axis, of which 2001
  /// points are looked at, is in a box. There MuJoCo 4.0.0 may find a distance above 0.
  double nearest(const CollisionChecker& checker, std::span<const double> q) {
    put(q);
    double best = 10.0;
    for (const auto& [a, b] : checker.pairs()) {
      double distance = mj_geomDistance(model.get(), data.get(), a, b, 10.0, nullptr);
      for (const auto& [capsule, box] : {std::pair(a, b), std::pair(b, a)})
        if (distance > 0.0 && is_pierced(capsule, box)) distance = -model->geom_size[3 * capsule];
      best = std::min(best, distance);
    }
    return best;
  }
  bool is_pierced(int capsule, int box) const {
    if (model->geom_type[capsule] != mjGEOM_CAPSULE || model->geom_type[box] != mjGEOM_BOX) return false;
    for (int step = -1000; step <= 1000; ++step) {
      mjtNum point[3], inside[3];
      for (int k = 0; k < 3; ++k)
        point[k] = data->geom_xpos[3 * capsule + k] - data->geom_xpos[3 * box + k] +
                   1e-3 * step * model->geom_size[3 * capsule + 1] * data->geom_xmat[9 * capsule + 3 * k + 2];
      mju_mulMatTVec3(inside, data->geom_xmat + 9 * box, point);
      bool is_inside = true;
      for (int k = 0; k < 3; ++k) is_inside = is_inside && std::abs(inside[k]) < model->geom_size[3 * box + k];
      if (is_inside) return true;
    }
    return false;
  }
};

std::vector<double> draw(const CollisionChecker& checker, std::mt19937& random) {
  const auto lower = checker.joint_lower(), upper = checker.joint_upper();
  std::vector<double> q;
  for (std::size_t i = 0; i < lower.size(); ++i)
    q.push_back(std::uniform_real_distribution<>(lower[i], upper[i])(random));
  return q;
}

void clearance_is_the_smallest_distance_of_all_pairs() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  std::mt19937 random(1);
  for (int k = 0; k < 500; ++k) {
    scene.data->qpos[scene.model->nq - 1] = std::sin(k);  // the finger
    scene.data->qpos[2] = 0.2 * std::cos(k);              // the ball
    checker.set_state(scene.qpos());
    const auto q = draw(checker, random);
    const double expected = scene.nearest(checker, q);
    CHECK_NEAR(checker.clearance(q, 10.0).distance, expected, 1e-9);
    CHECK(checker.is_free(q) == (expected >= 0.0));
    CHECK(checker.is_free(q, 0.03) == (expected >= 0.03));
    const Clearance capped = checker.clearance(q, 0.02);
    CHECK_NEAR(capped.distance, std::min(expected, 0.02), 1e-9);
    CHECK((capped.geoms[0] < 0) == (expected >= 0.02));
  }
}

void a_motion_is_free_where_dense_samples_are() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  std::mt19937 random(2);
  int hits = 0;
  for (int k = 0; k < 300; ++k) {
    const auto from = draw(checker, random), to = draw(checker, random);
    const auto hit = checker.first_hit(from, to, {0.002, 0.0087, 0.004});
    hits += hit.has_value();
    const auto at = [&](double s) {
      std::vector<double> q(kDof);
      for (std::size_t i = 0; i < q.size(); ++i) q[i] = from[i] + s * (to[i] - from[i]);
      return q;
    };
    if (hit) {
      CHECK_NEAR(checker.clearance(at(hit->fraction), 1.0).distance, hit->clearance.distance, 1e-9);
      CHECK(hit->clearance.distance < 0.004);
      CHECK(hit->free_until <= hit->fraction);
    }
    const double end = hit ? hit->free_until : 1.0;
    // Half a step less than the margin is what is promised.
    for (int i = 0; i <= 300 && (!hit || end > 0.0); ++i)
      if (!checker.is_free(at(end * i / 300.0), 0.0029)) {
        CHECK(!"a sample of a free part is too near");
        break;
      }
  }
  CHECK(hits > 50 && hits < 290);
}

void a_thin_sheet_in_the_middle_of_a_motion_is_never_missed() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  const std::vector<double> from = {-0.2, 0.0, 0.0, 0.0}, to = {2.2, 0.0, 0.0, 0.0};  // across the sheet of 1 mm
  CHECK(checker.is_free(from, 0.01) && checker.is_free(to, 0.01));
  for (const double step : {0.0005, 0.002, 0.01}) {
    const auto hit = checker.first_hit(from, to, {step, 0.0087, 0.0});
    CHECK(hit.has_value());
    if (hit) CHECK(checker.describe(hit->clearance.geoms[0]).find("sheet") != std::string::npos);
  }
  const auto back = checker.first_hit(to, from, {0.002, 0.0087, 0.01});
  CHECK(back.has_value() && back->fraction < 0.8);
}

void what_is_allowed_may_touch() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  const std::vector<double> from = {-0.2, 0.0, 0.0, 0.0}, to = {2.2, 0.0, 0.0, 0.0};
  const auto hit = checker.first_hit(from, to, {0.002, 0.0087, 0.0});
  CHECK(hit.has_value());
  CHECK(checker.allow("sheet", "link1") == 1);
  CHECK(checker.allow("sheet", "link1") == 0);
  for (const char* name : {"link2", "link3", "finger"}) CHECK(checker.allow(name, "sheet") == 1);
  CHECK(!checker.first_hit(from, to, {0.002, 0.0087, 0.0}).has_value());
  CHECK_THROWS(rcs::InvalidSetup, checker.allow("sheet", "no such thing"));
}

void what_moves_together_is_not_checked_and_parent_and_child_are_not() {
  Scene scene;
  const auto id = [&](const char* name) { return mj_name2id(scene.model.get(), mjOBJ_GEOM, name); };
  const auto pairs = scene.checker().pairs();
  const auto has = [&](const char* a, const char* b) {
    return std::ranges::find(pairs, std::array{std::min(id(a), id(b)), std::max(id(a), id(b))}) != pairs.end();
  };
  CHECK(has("link1", "link3") && has("link2", "finger") && has("base", "link2") && has("ball", "link1"));
  CHECK(has("base", "link1"));  // the base is part of the world, whose children MuJoCo lets touch it
  CHECK(!has("link1", "link2") && !has("link3", "finger") && !has("sheet", "post") && !has("ball", "floor"));
}

void an_attached_body_moves_with_what_carries_it() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  const int ball = scene.body("ball"), link = scene.body("link3");
  std::mt19937 random(3);
  const std::vector<double> at_grasp = {-0.5, 0.3, 0.0, 0.2};
  scene.put(at_grasp);
  const mjData* data = scene.data.get();
  const auto pose_of = [&](int body) {
    const double *t = data->xpos + 3 * body, *q = data->xquat + 4 * body;
    return rcs::Pose({t[0], t[1], t[2]}, {q[1], q[2], q[3], q[0]});
  };
  const rcs::Pose grip = pose_of(link).inverse() * pose_of(ball);
  checker.set_state(scene.qpos());
  const std::size_t loose = checker.pairs().size();
  checker.attach(ball, link);
  CHECK(checker.pairs().size() != loose);
  for (int k = 0; k < 100; ++k) {
    const auto q = draw(checker, random);
    scene.put(q);
    const rcs::Pose ball_pose = pose_of(link) * grip;
    std::copy_n(ball_pose.translation().begin(), 3, scene.data->qpos);
    const auto turn = ball_pose.quaternion();
    const double wxyz[4] = {turn[3], turn[0], turn[1], turn[2]};
    std::copy_n(wxyz, 4, scene.data->qpos + 3);
    CHECK_NEAR(checker.clearance(q, 10.0).distance, scene.nearest(checker, q), 1e-9);
  }
  checker.detach(ball);
  CHECK(checker.pairs().size() == loose);
  CHECK_THROWS(rcs::InvalidSetup, checker.detach(ball));
  CHECK_THROWS(rcs::InvalidSetup, checker.attach(link, ball));
  checker.attach(ball, link, rcs::Pose({0.1, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}));
  CHECK_THROWS(rcs::InvalidSetup, checker.attach(ball, ball));
}

void what_is_part_of_an_attached_body_goes_with_it() {
  const rcs::test::Model model = rcs::test::make_model(R"(
<mujoco>
  <worldbody>
    <body name="box" pos="1 1 1"><freejoint/><geom type="box" size="0.02 0.02 0.02"/>
      <body name="lid" pos="0 0 0.3"><geom type="sphere" size="0.04"/></body></body>
    <body name="base" pos="0 0 0.1"><geom type="box" size="0.01 0.01 0.01"/></body>
    <body name="link">
      <joint name="joint" axis="0 0 1" range="-3 3"/><geom type="capsule" size="0.02" fromto="0.1 0 0.4 0.3 0 0.4"/>
    </body>
  </worldbody>
</mujoco>)");
  const auto body = [&](const char* name) { return mj_name2id(model.get(), mjOBJ_BODY, name); };
  CollisionChecker checker(model.get(), {{mj_name2id(model.get(), mjOBJ_JOINT, "joint")}});
  const std::vector<double> q = {0.0};
  CHECK(checker.clearance(q, 10.0).distance > 0.1);
  checker.attach(body("box"), body("base"), rcs::Pose({0.2, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}));
  CHECK(checker.clearance(q, 10.0).distance < 0.0);
}

void rows_and_threads_give_what_single_calls_give() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  std::mt19937 random(4);
  std::vector<double> rows;
  std::vector<std::vector<double>> single;
  for (int k = 0; k < 64; ++k) {
    single.push_back(draw(checker, random));
    rows.insert(rows.end(), single.back().begin(), single.back().end());
  }
  const auto distances = checker.clearance_rows(rows, 0.5, 4);
  const auto flags = checker.free_rows(rows, 0.01, 4);
  std::vector<double> to(rows.rbegin(), rows.rend());
  for (std::size_t i = 0; i < to.size(); i += kDof) std::reverse(to.begin() + i, to.begin() + i + kDof);
  const auto hits = checker.first_hit_rows(rows, to, {}, 4);
  std::atomic<int> wrong = 0;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 4; ++t)
      threads.emplace_back([&] {
        for (std::size_t i = 0; i < single.size(); ++i) {
          wrong += checker.clearance(single[i], 0.5).distance != distances[i].distance;
          wrong += checker.is_free(single[i], 0.01) != (flags[i] != 0);
          const auto hit = checker.first_hit(single[i], single[single.size() - 1 - i], {});
          wrong += hit.has_value() != hits[i].has_value() || (hit && hit->fraction != hits[i]->fraction);
        }
      });
  }
  CHECK(wrong == 0);
}

void what_makes_no_sense_is_refused() {
  Scene scene;
  CollisionChecker checker = scene.checker();
  const std::vector<double> good(kDof, 0.0), few(kDof - 1, 0.0), nan_joints(kDof, std::nan(""));
  CHECK_THROWS(rcs::InvalidSetup, checker.is_free(few));
  CHECK_THROWS(rcs::InvalidSetup, checker.clearance(nan_joints, 0.1));
  CHECK_THROWS(rcs::InvalidSetup, checker.clearance(good, std::nan("")));
  CHECK_THROWS(rcs::InvalidSetup, checker.first_hit(good, good, {0.0, 0.1, 0.0}));
  CHECK_THROWS(rcs::InvalidSetup, checker.set_state(few));
  CHECK_THROWS(rcs::InvalidSetup, CollisionChecker(scene.model.get(), {{scene.joints[0], scene.joints[0]}}));
  CHECK_THROWS(rcs::InvalidSetup, CollisionChecker(scene.model.get(), {{99}}));
  CHECK_THROWS(rcs::InvalidSetup, CollisionChecker(scene.model.get(), {{0}}));  // the free joint of the ball
}

void without_robot_geometry_there_is_nothing_to_check() {
  Scene scene;
  CHECK_THROWS(rcs::InvalidSetup, CollisionChecker(scene.model.get(), {}));
  for (int g = 0; g < scene.model->ngeom; ++g) scene.model->geom_contype[g] = scene.model->geom_conaffinity[g] = 0;
  CHECK_THROWS(rcs::InvalidSetup, scene.checker());
}

}  // namespace

int main() {
  clearance_is_the_smallest_distance_of_all_pairs();
  a_motion_is_free_where_dense_samples_are();
  a_thin_sheet_in_the_middle_of_a_motion_is_never_missed();
  what_is_allowed_may_touch();
  what_moves_together_is_not_checked_and_parent_and_child_are_not();
  an_attached_body_moves_with_what_carries_it();
  what_is_part_of_an_attached_body_goes_with_it();
  rows_and_threads_give_what_single_calls_give();
  what_makes_no_sense_is_refused();
  without_robot_geometry_there_is_nothing_to_check();
  return rcs::test::result();
}
