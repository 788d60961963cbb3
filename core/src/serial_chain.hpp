// The bodies and joints from the base of an arm to its TCP, taken out of a model: a hundredth of what MuJoCo computes
// for all bodies, geoms and centres of mass, in the frame of the base.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <span>
#include <vector>

namespace rcs {

/// Where the joints of a chain have led its TCP.
struct ChainPlace {
  explicit ChainPlace(std::size_t dof) : anchors(dof), axes(dof) {}

  std::array<double, 3> translation{};           ///< of the TCP in the base frame [m]
  std::array<double, 4> quaternion{1, 0, 0, 0};  ///< likewise, wxyz
  std::vector<std::array<double, 3>> anchors;    ///< a point on each joint's axis in the base frame [m]
  std::vector<std::array<double, 3>> axes;       ///< of the joints in the base frame, of length 1
};

class SerialChain {
 public:
  /// `joints` are ids of hinges and slides, in any order; those that do not move the TCP are on no axis. Joints of the
  /// model that are not among them stay where the model has them. Throws `InvalidSetup` unless `base_body` carries the
  /// TCP.
  SerialChain(const mjModel* model, const std::vector<int>& joints, int tcp_site, int base_body);

  /// Lead the joints to positions [rad, m].
  void put(std::span<const double> joints, ChainPlace& place) const;
  /// Change of the TCP's translation and rotation (as a rotation vector) per joint [m/rad, rad/rad], as `put` has left
  /// it.
  std::array<double, 6> column(const ChainPlace& place, std::size_t joint) const;

 private:
  struct Shift {
    std::array<double, 3> translation{};
    std::array<double, 4> quaternion{1, 0, 0, 0};  // wxyz
  };
  struct Link {
    Shift fixed;    // from the link before
    int joint;      // index among the joints; -1 for none
    bool is_slide;  // else a hinge
    double reference;
    std::array<double, 3> anchor;
    std::array<double, 3> axis;
  };

  std::vector<Link> links_;
  std::vector<char> is_slide_;  // of each joint
};

}  // namespace rcs
