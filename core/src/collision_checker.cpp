#include "rcs/collision_checker.hpp"

#include <algorithm>
#include <cmath>
#include <exception>
#include <set>
#include <thread>

#include "collision_pairs.hpp"
#include "geom_bound.hpp"
#include "geom_distance.hpp"
#include "moving_parts.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

/// Beyond the margin, distances are measured up to here [m]; farther away, bounds are good enough.
constexpr double kHorizon = 0.1;
/// Where bounding spheres promise less than this beyond the margin [m], a better bound pays.
constexpr double kFar = 0.3;
/// Where that promises less than this beyond the margin [m], measuring the distance pays.
constexpr double kNear = 0.05;
/// Rounding of distances and of the way ahead [m].
constexpr double kRounding = 1e-6;

std::string name_of(const mjModel* model, mjtObj type, int id) {
  const char* name = mj_id2name(model, type, id);
  return name && *name ? "'" + std::string(name) + "'" : std::to_string(id);
}

void check_margin(double margin) {
  if (!std::isfinite(margin)) throw InvalidSetup("collision checker: the margin is not finite");
}

void check_sweep(const SweepOptions& options) {
  check_margin(options.margin);
  if (!(options.step > 0.0) || !(options.turn > 0.0))
    throw InvalidSetup("collision checker: step and turn must be positive");
}

}  // namespace

/// What follows from the robots' own joints and what is attached to them, not from where other things are.
struct CollisionChecker::Geometry {
  MovingParts parts;
  std::vector<GeomPair> pairs{};
  std::vector<double> levers{};  ///< pairs × dof: how much a radian brings the two nearer at most [m]
  std::vector<double> turns{};   ///< pairs × dof: 1 for a hinge between the two
  std::vector<double> radii{};   ///< pairs: sum of the radii of the bounding spheres [m]
};

struct CollisionChecker::Scene {
  std::vector<double> qpos, mocap_pos, mocap_quat;
  std::vector<Attachment> attachments;
  std::set<GeomPair> allowed;
  std::shared_ptr<const Geometry> geometry{};  ///< made by `publish`
};

struct CollisionChecker::Scratch {
  mjData* data = nullptr;
  std::shared_ptr<const Scene> scene;
  std::vector<double> q, speed, least, early, due;
  std::size_t last_hit = 0;  ///< what touched last is looked at first
  ~Scratch() { mj_deleteData(data); }
};

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

Clearance CollisionChecker::nearest(Scratch& scratch, double margin, bool any) const {
  const Geometry& scene = *scratch.scene->geometry;
  const mjModel* model = model_.get();
  Clearance best{margin, {-1, -1}};
  trapped("collision checker", [&] {
    scene.parts.put(model, scratch.data, scratch.q);
    const std::size_t count = scene.pairs.size();
    for (std::size_t k = 0; k < count; ++k) {
      std::size_t p = k;
      if (any) p = k == 0 ? scratch.last_hit : k - (k <= scratch.last_hit);
      const auto [a, b] = scene.pairs[p];
      const double limit = std::max(best.distance, 0.0);  // inside each other, a bound is no longer one
      const double reach = scene.radii[p] + limit;
      if (squared_distance(scratch.data, a, b) >= reach * reach) continue;
      if (bound_of(model, scratch.data, a, b) >= limit) continue;
      const double distance = geom_distance(model, scratch.data, a, b, limit);
      if (!(distance < best.distance)) continue;
      best = {distance, {a, b}};
      if (!any) continue;
      scratch.last_hit = p;
      return;
    }
  });
  return best;
}

std::optional<Hit> CollisionChecker::sweep(Scratch& scratch, std::span<const double> from, std::span<const double> to,
                                           const SweepOptions& options) const {
  const Geometry& scene = *scratch.scene->geometry;
  const mjModel* model = model_.get();
  const std::size_t n = joints_.size(), count = scene.pairs.size();
  for (std::size_t p = 0; p < count; ++p) {
    double speed = 0.0, turn = 0.0;
    for (std::size_t j = 0; j < n; ++j) {
      const double way = std::abs(to[j] - from[j]);
      speed += way * scene.levers[p * n + j];
      turn += way * scene.turns[p * n + j];
    }
    scratch.speed[p] = speed;
    scratch.least[p] = 1.0 / std::max(speed / options.step, turn / options.turn);  // infinite where nothing moves
    scratch.early[p] = 0.0;
  }
  double free_until = 0.0;
  for (double s = 0.0;;) {
    Clearance found{options.margin, {-1, -1}};
    double next = std::numeric_limits<double>::infinity();
    trapped("collision checker", [&] {
      for (std::size_t j = 0; j < n; ++j) scratch.q[j] = from[j] + s * (to[j] - from[j]);
      scene.parts.put(model, scratch.data, scratch.q);
      for (std::size_t p = 0; p < count; ++p) {
        // With what is due, all are looked at that are half way there: kinematics are computed less often.
        if (scratch.early[p] <= s) {
          const auto [a, b] = scene.pairs[p];
          // What cannot come too near on the rest of the way need not be known better.
          const double enough = options.margin + scratch.speed[p] * (1.0 - s) + kRounding;
          double distance = std::sqrt(squared_distance(scratch.data, a, b)) - scene.radii[p];
          if (distance < std::min(options.margin + kFar, enough)) distance = bound_of(model, scratch.data, a, b);
          if (distance < std::min(options.margin + kNear, enough))
            distance = geom_distance(model, scratch.data, a, b, std::min(options.margin + kHorizon, enough));
          if (distance < found.distance) found = {distance, {a, b}};
          const double ahead = scratch.speed[p] > 0.0 ? (distance - options.margin) / scratch.speed[p]
                                                      : std::numeric_limits<double>::infinity();
          const double stride = std::max(ahead, scratch.least[p]);
          // However short the motion, its end is looked at, unless it is known to be free.
          const double latest = ahead < 1.0 - s ? 1.0 : std::numeric_limits<double>::infinity();
          scratch.early[p] = std::min(s + 0.5 * stride, latest);
          scratch.due[p] = std::min(s + stride, latest);
        }
        next = std::min(next, scratch.due[p]);
      }
    });
    if (found.geoms[0] >= 0) return Hit{s, free_until, found};
    free_until = s;
    if (s >= 1.0) return std::nullopt;
    s = std::min(next, 1.0);
  }
}

std::optional<Hit> CollisionChecker::first_hit_on_way(std::span<const double> places, const SweepOptions& options,
                                                      double bend) const {
  check_rows(places, "places");
  check_sweep(options);
  if (places.empty()) throw InvalidSetup("collision checker: a way has at least one place");
  const std::size_t n = joints_.size(), last = places.size() / n - 1;
  // Whether all places between two lie on the straight motion from one to the other, wherever on it.
  const auto is_straight = [&](std::size_t from, std::size_t to) {
    const double *a = &places[from * n], *b = &places[to * n];
    double length = 0.0;
    for (std::size_t j = 0; j < n; ++j) length += (b[j] - a[j]) * (b[j] - a[j]);
    double before = 0.0;
    for (std::size_t k = from + 1; k < to; ++k) {
      const double* at = &places[k * n];
      double along = 0.0;
      for (std::size_t j = 0; j < n; ++j) along += (at[j] - a[j]) * (b[j] - a[j]);
      along = length > 0.0 ? along / length : 0.0;
      if (along < before || along > 1.0) return false;
      before = along;
      for (std::size_t j = 0; j < n; ++j)
        if (std::abs(at[j] - a[j] - along * (b[j] - a[j])) > bend) return false;
    }
    return true;
  };
  const Lease scratch = borrow();
  for (std::size_t from = 0; from < last || from == 0;) {
    std::size_t to = std::min(from + 1, last);
    while (to < last && is_straight(from, to + 1)) ++to;
    if (auto hit = sweep(*scratch, places.subspan(from * n, n), places.subspan(to * n, n), options)) {
      const auto whole = static_cast<double>(std::max<std::size_t>(last, 1)), part = static_cast<double>(to - from);
      hit->fraction = (static_cast<double>(from) + hit->fraction * part) / whole;
      hit->free_until = (static_cast<double>(from) + hit->free_until * part) / whole;
      return hit;
    }
    if (to == last) break;
    from = to;
  }
  return std::nullopt;
}

void CollisionChecker::check_rows(std::span<const double> q, const char* what) const {
  if (q.size() % joints_.size())
    throw InvalidSetup("collision checker: " + std::string(what) + " has " + std::to_string(q.size()) +
                       " entries, the robots have " + std::to_string(joints_.size()) + " joints");
  if (!std::ranges::all_of(q, [](double v) { return std::isfinite(v); }))
    throw InvalidSetup("collision checker: " + std::string(what) + " has a joint that is not finite");
}

template <typename Work>
void CollisionChecker::for_rows(std::size_t count, int threads, Work work) const {
  // More threads than cores help nobody, and a machine may refuse to start them.
  const std::size_t cores = std::max<std::size_t>(std::thread::hardware_concurrency(), 1);
  const std::size_t workers =
      std::max<std::size_t>(std::min({static_cast<std::size_t>(std::max(threads, 1)), cores, count}), 1);
  std::vector<std::exception_ptr> errors(workers);
  const auto run = [&](std::size_t w) {
    try {
      const Lease scratch = borrow();
      for (std::size_t i = count * w / workers; i < count * (w + 1) / workers; ++i) work(*scratch, i);
    } catch (...) {
      errors[w] = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> pool;
    for (std::size_t w = 1; w < workers; ++w) pool.emplace_back(run, w);
    run(0);
  }
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

std::vector<Clearance> CollisionChecker::clearance_rows(std::span<const double> q, double margin, int threads) const {
  check_rows(q, "q");
  check_margin(margin);
  const std::size_t n = joints_.size();
  std::vector<Clearance> found(q.size() / n);
  for_rows(found.size(), threads, [&](Scratch& scratch, std::size_t i) {
    std::ranges::copy(q.subspan(i * n, n), scratch.q.begin());
    found[i] = nearest(scratch, margin, false);
  });
  return found;
}

std::vector<std::uint8_t> CollisionChecker::free_rows(std::span<const double> q, double margin, int threads) const {
  check_rows(q, "q");
  check_margin(margin);
  const std::size_t n = joints_.size();
  std::vector<std::uint8_t> is_free(q.size() / n);
  for_rows(is_free.size(), threads, [&](Scratch& scratch, std::size_t i) {
    std::ranges::copy(q.subspan(i * n, n), scratch.q.begin());
    is_free[i] = nearest(scratch, margin, true).geoms[0] < 0;
  });
  return is_free;
}

std::vector<std::optional<Hit>> CollisionChecker::first_hit_rows(std::span<const double> from,
                                                                 std::span<const double> to,
                                                                 const SweepOptions& options, int threads) const {
  check_rows(from, "from");
  check_rows(to, "to");
  check_sweep(options);
  if (from.size() != to.size()) throw InvalidSetup("collision checker: from and to have different numbers of rows");
  const std::size_t n = joints_.size();
  std::vector<std::optional<Hit>> hits(from.size() / n);
  for_rows(hits.size(), threads, [&](Scratch& scratch, std::size_t i) {
    hits[i] = sweep(scratch, from.subspan(i * n, n), to.subspan(i * n, n), options);
  });
  return hits;
}

namespace {

void require_one(std::span<const double> q, int dof) {
  if (q.size() != static_cast<std::size_t>(dof))
    throw InvalidSetup("collision checker: " + std::to_string(q.size()) + " joints given, the robots have " +
                       std::to_string(dof));
}

}  // namespace

Clearance CollisionChecker::clearance(std::span<const double> q, double margin) const {
  require_one(q, dof());
  return clearance_rows(q, margin, 1).front();
}

bool CollisionChecker::is_free(std::span<const double> q, double margin) const {
  require_one(q, dof());
  return free_rows(q, margin, 1).front() != 0;
}

std::optional<Hit> CollisionChecker::first_hit(std::span<const double> from, std::span<const double> to,
                                               const SweepOptions& options) const {
  require_one(from, dof());
  require_one(to, dof());
  return first_hit_rows(from, to, options, 1).front();
}

}  // namespace rcs
