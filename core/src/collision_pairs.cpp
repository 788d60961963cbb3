#include "collision_pairs.hpp"

#include <algorithm>

namespace rcs {

namespace {

bool is_excluded(const mjModel* model, int a, int b) {
  const int signature = (std::min(a, b) << 16) + std::max(a, b), reversed = (std::max(a, b) << 16) + std::min(a, b);
  return std::any_of(model->exclude_signature, model->exclude_signature + model->nexclude,
                     [&](int s) { return s == signature || s == reversed; });
}

/// Whether one body is the parent of the other; bodies without joints between them count as one, and the world as
/// nobody's parent (MuJoCo documentation, "Collision detection: Selection").
bool is_parent_and_child(const mjModel* model, int a, int b) {
  if (model->opt.disableflags & mjDSBL_FILTERPARENT) return false;
  const int weld_a = model->body_weldid[a], weld_b = model->body_weldid[b];
  if (weld_a == 0 || weld_b == 0) return false;
  const int above_a = model->body_weldid[model->body_parentid[weld_a]];
  const int above_b = model->body_weldid[model->body_parentid[weld_b]];
  return weld_a == above_b || weld_b == above_a;
}

bool may_touch(const mjModel* model, int a, int b) {
  return (model->geom_contype[a] & model->geom_conaffinity[b]) || (model->geom_contype[b] & model->geom_conaffinity[a]);
}

}  // namespace

std::vector<GeomPair> pairs_to_check(const mjModel* model, const MovingParts& parts,
                                     const std::set<GeomPair>& allowed) {
  std::set<GeomPair> explicit_pairs;
  for (int p = 0; p < model->npair; ++p)
    explicit_pairs.insert(
        {std::min(model->pair_geom1[p], model->pair_geom2[p]), std::max(model->pair_geom1[p], model->pair_geom2[p])});
  std::vector<GeomPair> pairs;
  for (int a = 0; a < model->ngeom; ++a)
    for (int b = a + 1; b < model->ngeom; ++b) {
      const int body_a = model->geom_bodyid[a], body_b = model->geom_bodyid[b];
      if (parts.movers(body_a) == parts.movers(body_b) || allowed.contains({a, b})) continue;
      if (!explicit_pairs.contains({a, b})) {
        if (!may_touch(model, a, b)) continue;
        if (is_excluded(model, body_a, body_b) || is_parent_and_child(model, body_a, body_b)) continue;
      }
      pairs.push_back({a, b});
    }
  return pairs;
}

}  // namespace rcs
