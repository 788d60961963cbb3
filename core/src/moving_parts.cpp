#include "moving_parts.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "rcs/result.hpp"

namespace rcs {

namespace {

template <std::size_t N>
std::array<double, N> values(const double* first) {
  std::array<double, N> own;
  std::copy_n(first, N, own.begin());
  return own;
}

}  // namespace

MovingParts::MovingParts(const mjModel* model, std::span<const int> joints, std::span<const Attachment> attachments,
                         std::span<const double> qpos)
    : joint_count_(joints.size()),
      index_of_joint_(static_cast<std::size_t>(model->njnt), -1),
      movers_(static_cast<std::size_t>(model->nbody), 0),
      is_done_(static_cast<std::size_t>(model->nbody), 0),
      is_placed_(static_cast<std::size_t>(model->nbody), 0) {
  for (std::size_t i = 0; i < joints.size(); ++i)
    index_of_joint_[static_cast<std::size_t>(joints[i])] = static_cast<int>(i);
  const auto attachment_of = [&](int body) -> const Attachment* {
    const auto found = std::ranges::find(attachments, body, &Attachment::body);
    return found == attachments.end() ? nullptr : &*found;
  };
  // A body comes after its parent in a model, but what is attached may come before what it is attached to. Each round
  // adds a link of a chain of attachments at least; a ring of them never gets its turn.
  is_done_[0] = 1;
  std::size_t left = static_cast<std::size_t>(model->nbody) - 1;
  for (std::size_t round = 0; left > 0; ++round) {
    if (round > attachments.size()) throw InvalidSetup("attached bodies must not carry each other in a ring");
    for (int body = 1; body < model->nbody; ++body) {
      if (is_done_[static_cast<std::size_t>(body)]) continue;
      const Attachment* attachment = attachment_of(body);
      const int parent = attachment ? attachment->to : model->body_parentid[body];
      if (!is_done_[static_cast<std::size_t>(parent)]) continue;
      add(model, body, qpos, attachment);
      is_done_[static_cast<std::size_t>(body)] = 1;
      --left;
    }
  }
  find_levers(model);
}

void MovingParts::add(const mjModel* model, int body, std::span<const double> qpos, const Attachment* attachment) {
  const int parent = attachment ? attachment->to : model->body_parentid[body];
  std::uint64_t movers = movers_[static_cast<std::size_t>(parent)];
  const int first = model->body_jntadr[body], count = attachment ? 0 : model->body_jntnum[body];
  for (int k = 0; k < count; ++k) {
    const int index = index_of_joint_[static_cast<std::size_t>(first + k)];
    if (index >= 0) movers |= std::uint64_t{1} << index;
  }
  movers_[static_cast<std::size_t>(body)] = movers;
  // It stays where the state has it, unless it is on something attached.
  if (movers == 0 && !attachment && !is_placed_[static_cast<std::size_t>(parent)]) return;
  is_placed_[static_cast<std::size_t>(body)] = 1;
  const double* at = attachment ? attachment->translation.data() : model->body_pos + 3 * body;
  const double* turned = attachment ? attachment->quaternion.data() : model->body_quat + 4 * body;
  bodies_.push_back({body, parent, values<3>(at), values<4>(turned), static_cast<int>(joints_.size()), count});
  for (int k = 0; k < count; ++k) {
    const int joint = first + k, address = model->jnt_qposadr[joint], type = model->jnt_type[joint];
    const double* value = qpos.data() + address;
    Joint made{joint,
               index_of_joint_[static_cast<std::size_t>(joint)],
               type,
               value[0] - model->qpos0[address],
               model->qpos0[address],
               {1.0, 0.0, 0.0, 0.0},
               values<3>(model->jnt_pos + 3 * joint),
               values<3>(model->jnt_axis + 3 * joint)};
    if (type == mjJNT_BALL) {
      made.turn = values<4>(value);
      mju_normalize4(made.turn.data());
    }
    joints_.push_back(made);
  }
}

bool MovingParts::stays_as_made(const mjModel* model, std::span<const double> qpos) const {
  return std::ranges::all_of(joints_, [&](const Joint& joint) {
    if (joint.index >= 0) return true;
    const int address = model->jnt_qposadr[joint.id];
    if (joint.type != mjJNT_BALL) return qpos[static_cast<std::size_t>(address)] - model->qpos0[address] == joint.way;
    std::array<double, 4> turn = values<4>(qpos.data() + address);
    mju_normalize4(turn.data());
    return turn == joint.turn;
  });
}

void MovingParts::put(const mjModel* model, mjData* data, std::span<const double> q) const {
  double moved[3], turned[4], by[4];
  for (const Body& body : bodies_) {
    double* position = data->xpos + 3 * body.id;
    double* turn = data->xquat + 4 * body.id;
    mju_rotVecQuat(moved, body.translation.data(), data->xquat + 4 * body.parent);
    mju_add3(position, data->xpos + 3 * body.parent, moved);
    mju_mulQuat(turn, data->xquat + 4 * body.parent, body.quaternion.data());
    for (int k = 0; k < body.joint_count; ++k) {
      const Joint& joint = joints_[static_cast<std::size_t>(body.first_joint + k)];
      const double way = joint.index < 0 ? joint.way : q[static_cast<std::size_t>(joint.index)] - joint.reference;
      if (joint.type == mjJNT_SLIDE) {
        mju_rotVecQuat(moved, joint.axis.data(), turn);
        mju_addToScl3(position, moved, way);
        continue;
      }
      double anchor[3];
      mju_rotVecQuat(anchor, joint.anchor.data(), turn);
      mju_addTo3(anchor, position);
      if (joint.type == mjJNT_BALL)
        std::copy(joint.turn.begin(), joint.turn.end(), by);
      else
        mju_axisAngle2Quat(by, joint.axis.data(), way);
      mju_mulQuat(turned, turn, by);
      mju_copy4(turn, turned);
      mju_rotVecQuat(moved, joint.anchor.data(), turn);
      mju_sub3(position, anchor, moved);
    }
    mju_normalize4(turn);
    mju_quat2Mat(data->xmat + 9 * body.id, turn);
    const int first = model->body_geomadr[body.id];
    for (int g = first; g < first + model->body_geomnum[body.id]; ++g) {
      mju_mulMatVec3(moved, data->xmat + 9 * body.id, model->geom_pos + 3 * g);
      mju_add3(data->geom_xpos + 3 * g, position, moved);
      mju_mulQuat(turned, turn, model->geom_quat + 4 * g);
      mju_quat2Mat(data->geom_xmat + 9 * g, turned);
    }
  }
}

void MovingParts::find_levers(const mjModel* model) {
  levers_.assign(static_cast<std::size_t>(model->ngeom) * joint_count_, 0.0);
  std::vector<int> place(static_cast<std::size_t>(model->nbody), -1);
  for (std::size_t i = 0; i < bodies_.size(); ++i) place[static_cast<std::size_t>(bodies_[i].id)] = static_cast<int>(i);
  for (const Body& carrier : bodies_) {
    const int first = model->body_geomadr[carrier.id];
    for (int g = first; g < first + model->body_geomnum[carrier.id]; ++g) {
      // The way from the geom's farthest point down to a joint, stretched out: no posture makes it longer.
      double way = mju_norm3(model->geom_pos + 3 * g) + model->geom_rbound[g];
      for (int at = place[static_cast<std::size_t>(carrier.id)]; at >= 0;) {
        const Body& body = bodies_[static_cast<std::size_t>(at)];
        for (int k = body.joint_count - 1; k >= 0; --k) {
          const Joint& joint = joints_[static_cast<std::size_t>(body.first_joint + k)];
          const double offset = mju_norm3(joint.anchor.data());
          if (joint.index >= 0)
            levers_[static_cast<std::size_t>(g) * joint_count_ + static_cast<std::size_t>(joint.index)] =
                joint.type == mjJNT_SLIDE ? 1.0 : way + offset;
          if (joint.type != mjJNT_SLIDE) {
            way += 2.0 * offset;
            continue;
          }
          if (joint.index < 0) {
            way += std::abs(joint.way);
            continue;
          }
          const int id = model->body_jntadr[body.id] + k;
          if (!model->jnt_limited[id])
            throw InvalidSetup("collision checker: slide joint " + std::to_string(id) + " of the model has no limits");
          way += std::max(std::abs(model->jnt_range[2 * id] - joint.reference),
                          std::abs(model->jnt_range[2 * id + 1] - joint.reference));
        }
        way += mju_norm3(body.translation.data());
        at = place[static_cast<std::size_t>(body.parent)];
      }
    }
  }
}

}  // namespace rcs
