// The bodies that given joints of a model move: where they are for joint values, and how far a joint moves their geoms.
// Private to the sources.
#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace rcs {

/// A body that moves with another one instead of by its own free joint.
struct Attachment {
  int body;
  int to;
  std::array<double, 3> translation;  ///< of the body in the frame of `to`
  std::array<double, 4> quaternion;   ///< wxyz
};

class MovingParts {
 public:
  /// At most this many joints: each is a bit of a mask.
  static constexpr std::size_t kMaxJoints = 64;

  /// Joints that are not among `joints` stay where `qpos` has them. Throws `InvalidSetup` for a slide without limits.
  MovingParts(const mjModel* model, std::span<const int> joints, std::span<const Attachment> attachments,
              std::span<const double> qpos);

  /// Put the moving bodies and their geoms where joints `q` bring them; the others must be in place already.
  void put(const mjModel* model, mjData* data, std::span<const double> q) const;
  /// Whether the joints that stay are where `qpos` has them too.
  bool stays_as_made(const mjModel* model, std::span<const double> qpos) const;
  /// The joints that move a body, one bit each.
  std::uint64_t movers(int body) const { return movers_[static_cast<std::size_t>(body)]; }
  /// Upper bound of how far joint `joint` moves any point of a geom per radian, or per metre of a slide.
  double lever(int geom, std::size_t joint) const {
    return levers_[static_cast<std::size_t>(geom) * joint_count_ + joint];
  }

 private:
  struct Joint {
    int id;     ///< in the model
    int index;  ///< in the joints that are given; -1 for one that stays
    int type;
    double way;                  ///< of one that stays: from the reference [rad] or [m]
    double reference;            ///< value at which the body is where the model has it
    std::array<double, 4> turn;  ///< of a ball joint, which stays
    std::array<double, 3> anchor, axis;
  };
  struct Body {
    int id, parent;
    std::array<double, 3> translation;
    std::array<double, 4> quaternion;
    int first_joint, joint_count;
  };

  void add(const mjModel* model, int body, std::span<const double> qpos, const Attachment* attachment);
  void find_levers(const mjModel* model);

  std::size_t joint_count_;
  std::vector<int> index_of_joint_;  ///< per joint of the model; -1 for one that stays
  std::vector<std::uint64_t> movers_;
  std::vector<std::uint8_t> is_done_;
  std::vector<std::uint8_t> is_placed_;  ///< per body: whether it is in `bodies_`
  std::vector<Body> bodies_;             ///< parents first
  std::vector<Joint> joints_;
  std::vector<double> levers_;
};

}  // namespace rcs
