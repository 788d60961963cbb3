// The scene that a collision checker keeps: shared by all queries, and one set of buffers per query.
#pragma once

#include <memory>
#include <set>
#include <vector>

#include "collision_pairs.hpp"
#include "moving_parts.hpp"
#include "rcs/collision_checker.hpp"

namespace rcs {

/// Facts that follow from the robots' own joints and what is attached to them, not from where other things are.
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

}  // namespace rcs
