#include <algorithm>
#include <cmath>
#include <limits>

#include "collision_scene.hpp"
#include "geom_bound.hpp"
#include "geom_distance.hpp"
#include "over_rows.hpp"
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

void check_margin(double margin) {
  if (!std::isfinite(margin)) throw InvalidSetup("collision checker: the margin is not finite");
}

void check_sweep(const SweepOptions& options) {
  check_margin(options.margin);
  if (!(options.step > 0.0) || !(options.turn > 0.0))
    throw InvalidSetup("collision checker: step and turn must be positive");
}

void require_one(std::span<const double> q, int dof) {
  if (q.size() != static_cast<std::size_t>(dof))
    throw InvalidSetup("collision checker: " + std::to_string(q.size()) + " joints given, the robots have " +
                       std::to_string(dof));
}

}  // namespace

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
          // A distance that cannot become too small on the rest of the way need not be known better.
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
  over_shares(count, threads, [&](std::size_t first, std::size_t end) {
    const Lease scratch = borrow();
    for (std::size_t i = first; i < end; ++i) work(*scratch, i);
  });
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
