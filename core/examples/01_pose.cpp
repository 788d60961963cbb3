// Poses: where a camera sees a cup, where the gripper has to go, and the path there in steps that a robot may make.
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>

#include "rcs/pose.hpp"

int main() {
  using rcs::Pose;
  constexpr double degree = std::numbers::pi / 180;

  // The camera stands 0.6 m in front of the base and 0.5 m above it, and looks back and down; the cup is 0.5 m ahead of
  // it.
  const Pose pose_camera_in_base = Pose::from_rpy({0.6, 0.0, 0.5}, {-135 * degree, 0.0, 90 * degree});
  const Pose pose_cup_in_camera({0.0, 0.0, 0.5});

  // Frames chain from left to right: base <- camera <- cup.
  const Pose pose_cup_in_base = pose_camera_in_base * pose_cup_in_camera;
  const auto [x, y, z] = pose_cup_in_base.translation();
  std::printf("cup in base:    %.3f %.3f %.3f m\n", x, y, z);

  // The inverse leads back, and the product of both is the identity.
  const Pose back = pose_camera_in_base.inverse() * pose_cup_in_base;
  std::printf("cup in camera:  %s\n", back.is_close(pose_cup_in_camera, 1e-12, 1e-12) ? "as before" : "lost");

  // Grasp from above: the gripper's z axis points down, 0.1 m above the cup.
  const Pose pose_tcp_in_base = Pose::from_rpy({0.307, 0.0, 0.487}, {180 * degree, 0.0, 0.0});
  const Pose goal = Pose::from_rpy({x, y, z + 0.1}, {180 * degree, 0.0, 45 * degree});
  std::printf("way to go:      %.3f m and %.1f degrees\n", pose_tcp_in_base.distance_to(goal),
              pose_tcp_in_base.angle_to(goal) / degree);

  // A robot gets there in steps, each within a distance and an angle.
  int steps = 0;
  for (Pose pose = pose_tcp_in_base; pose != goal; ++steps) pose = rcs::limit_step(pose, goal, 0.02, 5 * degree);
  std::printf("steps needed:   %d of at most 20 mm and 5 degrees\n", steps);

  // Or on a path at constant speed, here its middle; printed, a pose shows every digit.
  const Pose middle = pose_tcp_in_base.interpolate(goal, 0.5);
  std::printf("half of it:     %s\n", rcs::to_string(middle).c_str());
  return pose_tcp_in_base.angle_to(middle) < 23 * degree ? 0 : 1;
}
