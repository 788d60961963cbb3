#include "rcs/measurement.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

void check_model(const char* name, std::uint64_t made_for, const mjModel* model) {
  if (model->signature != made_for)
    throw InvalidSetup(std::string(name) + ": it was made for another model; make it anew for this one");
}

}  // namespace

ArmBody::ArmBody(const mjModel* model, std::vector<int> joints, int tcp_site, int frame_body)
    : signature_(model->signature),
      timestep_(model->opt.timestep),
      joints_(std::move(joints)),
      tcp_site_(tcp_site),
      frame_body_(frame_body) {
  if (joints_.empty() || joints_.size() > kMostJoints)
    throw InvalidSetup("ArmBody: an arm has 1 to " + std::to_string(kMostJoints) + " joints, not " +
                       std::to_string(joints_.size()));
  for (const int joint : joints_)
    if (joint < 0 || joint >= model->njnt ||
        (model->jnt_type[joint] != mjJNT_HINGE && model->jnt_type[joint] != mjJNT_SLIDE))
      throw InvalidSetup("ArmBody: joint " + std::to_string(joint) + " is no hinge or slide of the model, which has " +
                         std::to_string(model->njnt) + " joints");
  if (tcp_site < 0 || tcp_site >= model->nsite) throw InvalidSetup("ArmBody: the TCP's site is not in the model");
  if (frame_body < 0 || frame_body >= model->nbody) throw InvalidSetup("ArmBody: the frame is not in the model");
  level_.assign(static_cast<std::size_t>(model->nbody), -1);
  level_[static_cast<std::size_t>(frame_body)] = 0;
  for (int body = 1; body < model->nbody; ++body) {  // parents come before children
    int& level = level_[static_cast<std::size_t>(body)];
    if (body != frame_body) level = level_[static_cast<std::size_t>(model->body_parentid[body])];
    level += static_cast<int>(std::ranges::count_if(joints_, [&](int j) { return model->jnt_bodyid[j] == body; }));
  }
  if (level_[static_cast<std::size_t>(model->site_bodyid[tcp_site])] != dof())
    throw InvalidSetup("ArmBody: the joints must follow each other from the frame's body to the TCP");
  for (int body = 1; body < model->nbody; ++body)
    if (level_[static_cast<std::size_t>(body)] > 0) moving_.push_back(body);
  for (int geom = 0; geom < model->ngeom; ++geom)
    level_of_geom_.push_back(level_[static_cast<std::size_t>(model->geom_bodyid[geom])]);
}

void ArmBody::check(const mjModel* model) const { check_model("ArmBody", signature_, model); }

void ArmBody::drive_torques(const mjModel* model, const mjData* data, std::span<double> torques) const {
  // The compensation of gravity comes from the drives too, whether or not MuJoCo counts it as an actuator's.
  for (std::size_t j = 0; j < joints_.size(); ++j) {
    const int dof = model->jnt_dofadr[joints_[j]];
    torques[j] = data->qfrc_actuator[dof];
    if (!model->jnt_actgravcomp[joints_[j]]) torques[j] += data->qfrc_gravcomp[dof];
  }
}

bool ArmBody::outer_loads(const mjModel* model, const mjData* data, std::span<double> torques,
                          std::span<double, 6> on_tool, std::span<double, 6> on_arm) const {
  // Forces and moments about the TCP in the scene, by the number of joints that move what they press on.
  double sums[kMostJoints + 1][6];
  bool is_pressed = false;
  const double* tcp = data->site_xpos + 3 * tcp_site_;
  const auto add = [&](int level, const double* force, const double* moment, const double* point, double sign) {
    if (level < 1) return;
    if (!is_pressed) std::fill_n(sums[0], 6 * (joints_.size() + 1), 0.0);
    is_pressed = true;
    double lever[3], turn[3];
    mju_sub3(lever, point, tcp);
    mju_cross(turn, lever, force);
    double* sum = sums[level];
    for (int k = 0; k < 3; ++k) {
      sum[k] += sign * force[k];
      sum[3 + k] += sign * (turn[k] + moment[k]);
    }
  };
  for (int i = 0; i < data->ncon; ++i) {
    const mjContact& contact = data->contact[i];
    const int first = contact.geom[0] < 0 ? -1 : level_of_geom_[static_cast<std::size_t>(contact.geom[0])];
    const int second = contact.geom[1] < 0 ? -1 : level_of_geom_[static_cast<std::size_t>(contact.geom[1])];
    if (first == second || (first < 1 && second < 1) || contact.efc_address < 0) continue;
    double local[6], force[3], moment[3];
    mj_contactForce(model, data, i, local);
    mju_mulMatTVec3(force, contact.frame, local);
    mju_mulMatTVec3(moment, contact.frame, local + 3);
    add(second, force, moment, contact.pos, 1.0);
    add(first, force, moment, contact.pos, -1.0);
  }
  for (const int body : moving_) {
    const double* applied = data->xfrc_applied + 6 * body;
    if (std::any_of(applied, applied + 6, [](double value) { return value != 0.0; }))
      add(level_[static_cast<std::size_t>(body)], applied, applied + 3, data->xipos + 3 * body, 1.0);
  }
  if (!is_pressed) {
    std::ranges::fill(torques, 0.0);
    std::ranges::fill(on_tool, 0.0);
    std::ranges::fill(on_arm, 0.0);
    return false;
  }
  double axes[4], total[6] = {};
  mju_negQuat(axes, data->xquat + 4 * frame_body_);
  mju_rotVecQuat(on_tool.data(), sums[joints_.size()], axes);
  mju_rotVecQuat(on_tool.data() + 3, sums[joints_.size()] + 3, axes);
  for (std::size_t j = joints_.size(); j-- > 0;) {
    mju_addTo(total, sums[j + 1], 6);
    const double* axis = data->xaxis + 3 * joints_[j];
    if (model->jnt_type[joints_[j]] == mjJNT_SLIDE) {
      torques[j] = mju_dot3(axis, total);
      continue;
    }
    double lever[3], turn[3];
    mju_sub3(lever, tcp, data->xanchor + 3 * joints_[j]);
    mju_cross(turn, lever, total);
    mju_addTo3(turn, total + 3);
    torques[j] = mju_dot3(axis, turn);
  }
  mju_rotVecQuat(on_arm.data(), total, axes);
  mju_rotVecQuat(on_arm.data() + 3, total + 3, axes);
  return true;
}

void ArmLoads::read(const mjModel* model, const mjData* data, std::span<double> values) const {
  const auto dof = static_cast<std::size_t>(arm_.dof());
  double on_arm[6];
  // The torques of outer forces are no part of the result; their place is overwritten.
  arm_.outer_loads(model, data, values.first(dof), values.subspan(dof).first<6>(), std::span<double, 6>(on_arm));
  arm_.drive_torques(model, data, values.first(dof));
}

FingerContacts::FingerContacts(const mjModel* model, const std::vector<std::vector<std::uint8_t>>& fingers,
                               const std::vector<std::uint8_t>& own, double force)
    : signature_(model->signature),
      fingers_(static_cast<int>(fingers.size())),
      finger_of_geom_(static_cast<std::size_t>(model->ngeom), -1),
      own_(own.begin(), own.end()),
      force_(force) {
  const auto geoms = static_cast<std::size_t>(model->ngeom), all = geoms + static_cast<std::size_t>(model->nflex);
  const auto check = [&](const std::vector<std::uint8_t>& flags) {
    if (flags.size() != geoms && flags.size() != all)
      throw InvalidSetup("FingerContacts: a set has " + std::to_string(flags.size()) + " flags, the model has " +
                         std::to_string(geoms) + " geoms");
  };
  check(own);
  own_.resize(geoms);
  for (std::size_t f = 0; f < fingers.size(); ++f) {
    check(fingers[f]);
    for (std::size_t g = 0; g < geoms; ++g)
      if (fingers[f][g]) finger_of_geom_[g] = static_cast<int>(f);
  }
}

void FingerContacts::check(const mjModel* model) const { check_model("FingerContacts", signature_, model); }

FingerContacts::Touch FingerContacts::touch_of(const mjModel* model, const mjContact& contact) const {
  if (contact.efc_address < 0) return {};
  for (int side = 0; side < 2; ++side) {
    const int geom = contact.geom[side], other = contact.geom[1 - side];
    const int finger = geom < 0 ? -1 : finger_of_geom_[static_cast<std::size_t>(geom)];
    if (finger < 0) continue;
    if (other < 0) return {finger, static_cast<int>(model->ntree) + contact.flex[1 - side]};
    if (own_[static_cast<std::size_t>(other)]) continue;
    return {finger, model->body_treeid[model->geom_bodyid[other]]};
  }
  return {};
}

double FingerContacts::force_of(const mjModel* model, const mjData* data, Touch touch, int first) const {
  double total = 0.0;
  for (int i = first; i < data->ncon; ++i) {
    const Touch other = touch_of(model, data->contact[i]);
    if (other.finger != touch.finger || other.object != touch.object) continue;
    double force[6];
    mj_contactForce(model, data, i, force);
    total += force[0];
  }
  return total;
}

void FingerContacts::read(const mjModel* model, const mjData* data, std::span<double> values) const {
  std::ranges::fill(values, 0.0);
  for (int i = 0; i < data->ncon; ++i) {
    const Touch touch = touch_of(model, data->contact[i]);
    if (touch.finger < 0) continue;
    // The sum is of all contacts of this pair; those that follow repeat it with fewer, which changes nothing.
    if (force_of(model, data, touch, i) < force_) continue;
    values[static_cast<std::size_t>(touch.finger)] = 1.0;
    if (touch.object < 0) continue;  // it cannot move
    for (int finger = 0; finger < fingers_; ++finger)
      if (finger != touch.finger && force_of(model, data, {finger, touch.object}, 0) >= force_)
        values[static_cast<std::size_t>(fingers_)] = 1.0;
  }
}

FreeBodyVelocity::FreeBodyVelocity(const mjModel* model, int joint, int frame_body)
    : signature_(model->signature), frame_body_(frame_body) {
  if (joint < 0 || joint >= model->njnt || model->jnt_type[joint] != mjJNT_FREE)
    throw InvalidSetup("FreeBodyVelocity: joint " + std::to_string(joint) +
                       " is no free joint of the model, which has " + std::to_string(model->njnt) + " joints");
  if (frame_body < 0 || frame_body >= model->nbody)
    throw InvalidSetup("FreeBodyVelocity: the frame is not in the model");
  qpos_ = model->jnt_qposadr[joint] + 3;
  dof_ = model->jnt_dofadr[joint];
}

void FreeBodyVelocity::check(const mjModel* model) const { check_model("FreeBodyVelocity", signature_, model); }

void FreeBodyVelocity::read(const mjModel* /*model*/, const mjData* data, std::span<double> values) const {
  double axes[4], spin[3];
  mju_negQuat(axes, data->xquat + 4 * frame_body_);
  mju_rotVecQuat(values.data(), data->qvel + dof_, axes);
  // The angular velocity of a free joint is in the body's own axes.
  mju_rotVecQuat(spin, data->qvel + dof_ + 3, data->qpos + qpos_);
  mju_rotVecQuat(values.data() + 3, spin, axes);
}

}  // namespace rcs
