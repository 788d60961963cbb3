#include "rcs/collision_checker.hpp"

#include <algorithm>
#include <cmath>

#include "collision_scene.hpp"
#include "geom_bound.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

std::string name_of(const mjModel* model, mjtObj type, int id) {
  const char* name = mj_id2name(model, type, id);
  return name && *name ? "'" + std::string(name) + "'" : std::to_string(id);
}

}  // namespace

CollisionChecker::CollisionChecker(const mjModel* model, const std::vector<std::vector<int>>& robots) {
  for (const auto& robot : robots)
    for (const int joint : robot) {
      if (joint < 0 || joint >= model->njnt)
        throw InvalidSetup("collision checker: joint id " + std::to_string(joint) + " is not in the model, which has " +
                           std::to_string(model->njnt) + " joints");
      if (model->jnt_type[joint] != mjJNT_HINGE && model->jnt_type[joint] != mjJNT_SLIDE)
        throw InvalidSetup("collision checker: joint " + name_of(model, mjOBJ_JOINT, joint) +
                           " is neither a hinge nor a slide");
      if (std::ranges::find(joints_, joint) != joints_.end())
        throw InvalidSetup("collision checker: joint " + name_of(model, mjOBJ_JOINT, joint) + " is given twice");
      joints_.push_back(joint);
    }
  if (joints_.size() > MovingParts::kMaxJoints)
    throw InvalidSetup("collision checker: " + std::to_string(joints_.size()) + " joints given, at most " +
                       std::to_string(MovingParts::kMaxJoints) + " are possible");
  model_.reset(mj_copyModel(nullptr, model));
  if (!model_) throw InvalidSetup("collision checker: the model could not be copied");
  Scene scene;
  scene.qpos.assign(model->qpos0, model->qpos0 + model->nq);
  for (int body = 0; body < model->nbody; ++body)
    if (model->body_mocapid[body] >= 0) {
      scene.mocap_pos.insert(scene.mocap_pos.end(), model->body_pos + 3 * body, model->body_pos + 3 * body + 3);
      scene.mocap_quat.insert(scene.mocap_quat.end(), model->body_quat + 4 * body, model->body_quat + 4 * body + 4);
    }
  publish(std::move(scene));
  if (scene_->geometry->pairs.empty())
    throw InvalidSetup(
        "collision checker: no geometry of the robots takes part: the joints that were given move no geom that could "
        "touch anything (contype and conaffinity). Give the joints of the robot, and a model that has collision geoms");
}

CollisionChecker::~CollisionChecker() = default;

void CollisionChecker::publish(Scene scene, bool has_new_geometry) {
  if (has_new_geometry) scene.geometry = geometry_of(scene);
  auto made = std::make_shared<const Scene>(std::move(scene));
  const std::lock_guard lock(mutex_);
  scene_ = std::move(made);
}

std::shared_ptr<const CollisionChecker::Geometry> CollisionChecker::geometry_of(const Scene& scene) const {
  const std::size_t n = joints_.size();
  auto made = std::make_shared<Geometry>(Geometry{MovingParts(model_.get(), joints_, scene.attachments, scene.qpos)});
  const MovingParts& parts = made->parts;
  made->pairs = pairs_to_check(model_.get(), parts, scene.allowed);
  made->levers.assign(made->pairs.size() * n, 0.0);
  made->turns.assign(made->pairs.size() * n, 0.0);
  made->radii.resize(made->pairs.size());
  for (std::size_t p = 0; p < made->pairs.size(); ++p) {
    const auto [a, b] = made->pairs[p];
    made->radii[p] = radii_of(model_.get(), a, b);
    const std::uint64_t between = parts.movers(model_->geom_bodyid[a]) ^ parts.movers(model_->geom_bodyid[b]);
    for (std::size_t j = 0; j < n; ++j) {
      if (!(between >> j & 1)) continue;
      made->levers[p * n + j] = std::max(parts.lever(a, j), parts.lever(b, j));
      made->turns[p * n + j] = model_->jnt_type[joints_[j]] == mjJNT_HINGE;
    }
  }
  return made;
}

std::shared_ptr<const CollisionChecker::Scene> CollisionChecker::scene() const {
  const std::lock_guard lock(mutex_);
  return scene_;
}

CollisionChecker::Lease CollisionChecker::borrow() const {
  Lease lease(nullptr, GiveBack{this});
  {
    const std::lock_guard lock(mutex_);
    if (!unused_.empty()) {
      lease.reset(unused_.back().release());
      unused_.pop_back();
    } else {
      unused_.reserve(++scratch_count_);  // giving back must not fail
    }
  }
  if (!lease) {
    lease.reset(new Scratch);
    lease->data = mj_makeData(model_.get());
    if (!lease->data) throw SimulationError("collision checker: MuJoCo could not make its data");
    lease->q.resize(joints_.size());
  }
  auto newest = scene();
  if (lease->scene == newest) return lease;
  mjData* data = lease->data;
  std::copy(newest->qpos.begin(), newest->qpos.end(), data->qpos);
  std::copy(newest->mocap_pos.begin(), newest->mocap_pos.end(), data->mocap_pos);
  std::copy(newest->mocap_quat.begin(), newest->mocap_quat.end(), data->mocap_quat);
  trapped("collision checker", [&] { mj_kinematics(model_.get(), data); });
  for (auto* values : {&lease->speed, &lease->least, &lease->early, &lease->due})
    values->resize(newest->geometry->pairs.size());
  lease->last_hit = 0;
  lease->scene = std::move(newest);
  return lease;
}

void CollisionChecker::GiveBack::operator()(Scratch* scratch) const {
  const std::lock_guard lock(owner->mutex_);
  owner->unused_.emplace_back(scratch);
}

std::vector<double> CollisionChecker::joint_lower() const {
  std::vector<double> lower;
  for (const int j : joints_) lower.push_back(model_->jnt_limited[j] ? model_->jnt_range[2 * j] : -2 * mjPI);
  return lower;
}

std::vector<double> CollisionChecker::joint_upper() const {
  std::vector<double> upper;
  for (const int j : joints_) upper.push_back(model_->jnt_limited[j] ? model_->jnt_range[2 * j + 1] : 2 * mjPI);
  return upper;
}

std::vector<std::array<int, 2>> CollisionChecker::pairs() const { return scene()->geometry->pairs; }

std::string CollisionChecker::describe(int geom) const {
  if (geom < 0 || geom >= model_->ngeom)
    throw InvalidSetup("collision checker: geom id " + std::to_string(geom) + " is not in the model");
  return "geom " + name_of(model_.get(), mjOBJ_GEOM, geom) + " of body " +
         name_of(model_.get(), mjOBJ_BODY, model_->geom_bodyid[geom]);
}

void CollisionChecker::set_state(std::span<const double> qpos, std::span<const double> mocap_pos,
                                 std::span<const double> mocap_quat) {
  const auto check = [](std::span<const double> values, int size, const char* what) {
    if (values.size() != static_cast<std::size_t>(size))
      throw InvalidSetup("collision checker: " + std::string(what) + " has " + std::to_string(values.size()) +
                         " entries, the model has " + std::to_string(size));
    if (!std::ranges::all_of(values, [](double v) { return std::isfinite(v); }))
      throw InvalidSetup("collision checker: " + std::string(what) + " has an entry that is not finite");
  };
  check(qpos, static_cast<int>(model_->nq), "qpos");
  if (!mocap_pos.empty()) check(mocap_pos, static_cast<int>(3 * model_->nmocap), "mocap_pos");
  if (!mocap_quat.empty()) check(mocap_quat, static_cast<int>(4 * model_->nmocap), "mocap_quat");
  const std::lock_guard lock(changing_);
  Scene changed = *scene();
  changed.qpos.assign(qpos.begin(), qpos.end());
  if (!mocap_pos.empty()) changed.mocap_pos.assign(mocap_pos.begin(), mocap_pos.end());
  if (!mocap_quat.empty()) changed.mocap_quat.assign(mocap_quat.begin(), mocap_quat.end());
  const bool has_new_geometry = !changed.geometry->parts.stays_as_made(model_.get(), changed.qpos);
  publish(std::move(changed), has_new_geometry);
}

std::vector<int> CollisionChecker::geoms_named(const std::string& name) const {
  std::vector<int> geoms;
  const int geom = mj_name2id(model_.get(), mjOBJ_GEOM, name.c_str());
  const int body = mj_name2id(model_.get(), mjOBJ_BODY, name.c_str());
  if (geom < 0 && body < 0)
    throw InvalidSetup("collision checker: the model has neither a body nor a geom named '" + name + "'");
  if (geom >= 0) geoms.push_back(geom);
  if (body >= 0)
    for (int g = model_->body_geomadr[body]; g < model_->body_geomadr[body] + model_->body_geomnum[body]; ++g)
      if (g != geom) geoms.push_back(g);
  return geoms;
}

int CollisionChecker::allow(const std::string& a, const std::string& b) {
  const std::vector<int> of_a = geoms_named(a), of_b = geoms_named(b);
  const std::lock_guard lock(changing_);
  Scene changed = *scene();
  const std::size_t before = changed.geometry->pairs.size();
  for (const int i : of_a)
    for (const int j : of_b) changed.allowed.insert({std::min(i, j), std::max(i, j)});
  publish(std::move(changed));
  return static_cast<int>(before - scene()->geometry->pairs.size());
}

void CollisionChecker::attach(int body, int to, const std::optional<Pose>& pose_in_to) {
  for (const int id : {body, to})
    if (id <= 0 || id >= model_->nbody)
      throw InvalidSetup("collision checker: body id " + std::to_string(id) + " is not a body of the model that moves");
  const int first = model_->body_jntadr[body];
  const bool is_free = model_->body_jntnum[body] == 1 && model_->jnt_type[first] == mjJNT_FREE;
  if (!is_free && model_->body_mocapid[body] < 0)
    throw InvalidSetup("collision checker: body " + name_of(model_.get(), mjOBJ_BODY, body) +
                       " cannot be attached, because it has neither a free joint nor is it a mocap body");
  const std::lock_guard lock(changing_);
  Scene changed = *scene();
  std::erase_if(changed.attachments, [&](const Attachment& a) { return a.body == body; });
  Attachment attachment{body, to, {}, {}};
  if (pose_in_to) {
    attachment.translation = pose_in_to->translation();
    const auto turn = pose_in_to->quaternion();
    attachment.quaternion = {turn[3], turn[0], turn[1], turn[2]};
  } else {
    const Lease scratch = borrow();
    // Queries may have left the robots elsewhere.
    for (std::size_t i = 0; i < joints_.size(); ++i)
      scratch->q[i] = changed.qpos[static_cast<std::size_t>(model_->jnt_qposadr[joints_[i]])];
    scratch->scene->geometry->parts.put(model_.get(), scratch->data, scratch->q);
    const mjData* data = scratch->data;
    double back[4], away[3];
    mju_negQuat(back, data->xquat + 4 * to);
    mju_sub3(away, data->xpos + 3 * body, data->xpos + 3 * to);
    mju_rotVecQuat(attachment.translation.data(), away, back);
    mju_mulQuat(attachment.quaternion.data(), back, data->xquat + 4 * body);
  }
  changed.attachments.push_back(attachment);
  publish(std::move(changed));
}

void CollisionChecker::detach(int body) {
  const std::lock_guard lock(changing_);
  Scene changed = *scene();
  if (std::erase_if(changed.attachments, [&](const Attachment& a) { return a.body == body; }) == 0)
    throw InvalidSetup("collision checker: body id " + std::to_string(body) + " is not attached");
  publish(std::move(changed));
}

}  // namespace rcs
