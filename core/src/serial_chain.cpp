#include "serial_chain.hpp"

#include <algorithm>

#include "rcs/result.hpp"

namespace rcs {

namespace {

template <std::size_t N>
std::array<double, N> values(const double* first) {
  std::array<double, N> own;
  std::copy_n(first, N, own.begin());
  return own;
}

void rotate(std::array<double, 3>& result, const std::array<double, 3>& vector, const std::array<double, 4>& turn) {
  mju_rotVecQuat(result.data(), vector.data(), turn.data());
}

}  // namespace

SerialChain::SerialChain(const mjModel* model, const std::vector<int>& joints, int tcp_site, int base_body) {
  for (const int joint : joints) is_slide_.push_back(model->jnt_type[joint] == mjJNT_SLIDE);
  std::vector<int> bodies;  // from the TCP to the base
  for (int body = model->site_bodyid[tcp_site]; body != base_body; body = model->body_parentid[body]) {
    if (body == 0) throw InvalidSetup("inverse kinematics: the base body does not carry the TCP");
    bodies.push_back(body);
  }
  Shift fixed;
  const auto append = [&fixed](const double* translation, const double* quaternion) {
    double moved[3], turned[4];
    mju_rotVecQuat(moved, translation, fixed.quaternion.data());
    mju_addTo3(fixed.translation.data(), moved);
    mju_mulQuat(turned, fixed.quaternion.data(), quaternion);
    fixed.quaternion = values<4>(turned);
  };
  for (auto body = bodies.rbegin(); body != bodies.rend(); ++body) {
    append(model->body_pos + 3 * *body, model->body_quat + 4 * *body);
    for (int k = 0; k < model->body_jntnum[*body]; ++k) {
      const int joint = model->body_jntadr[*body] + k;
      const auto found = std::ranges::find(joints, joint);
      if (found == joints.end()) continue;
      const auto index = static_cast<int>(found - joints.begin());
      links_.push_back({fixed, index, is_slide_[static_cast<std::size_t>(index)] != 0,
                        model->qpos0[model->jnt_qposadr[joint]], values<3>(model->jnt_pos + 3 * joint),
                        values<3>(model->jnt_axis + 3 * joint)});
      fixed = {};
    }
  }
  append(model->site_pos + 3 * tcp_site, model->site_quat + 4 * tcp_site);
  links_.push_back({fixed, -1, false, 0.0, {}, {}});
}

void SerialChain::put(std::span<const double> joints, ChainPlace& place) const {
  auto& position = place.translation;
  auto& turn = place.quaternion;
  position = {};
  turn = {1.0, 0.0, 0.0, 0.0};
  std::array<double, 3> moved;
  std::array<double, 4> turned, by;
  for (const Link& link : links_) {
    rotate(moved, link.fixed.translation, turn);
    mju_addTo3(position.data(), moved.data());
    mju_mulQuat(turned.data(), turn.data(), link.fixed.quaternion.data());
    turn = turned;
    if (link.joint < 0) break;
    const auto index = static_cast<std::size_t>(link.joint);
    const double way = joints[index] - link.reference;
    auto &anchor = place.anchors[index], &axis = place.axes[index];
    rotate(axis, link.axis, turn);
    rotate(anchor, link.anchor, turn);
    mju_addTo3(anchor.data(), position.data());
    if (link.is_slide) {
      mju_addToScl3(position.data(), axis.data(), way);
      continue;
    }
    mju_axisAngle2Quat(by.data(), link.axis.data(), way);
    mju_mulQuat(turned.data(), turn.data(), by.data());
    turn = turned;
    rotate(moved, link.anchor, turn);
    mju_sub3(position.data(), anchor.data(), moved.data());
  }
  mju_normalize4(turn.data());
}

std::array<double, 6> SerialChain::column(const ChainPlace& place, std::size_t joint) const {
  const auto& axis = place.axes[joint];
  if (is_slide_[joint]) return {axis[0], axis[1], axis[2], 0.0, 0.0, 0.0};
  double lever[3], way[3];
  mju_sub3(lever, place.translation.data(), place.anchors[joint].data());
  mju_cross(way, axis.data(), lever);
  return {way[0], way[1], way[2], axis[0], axis[1], axis[2]};
}

}  // namespace rcs
