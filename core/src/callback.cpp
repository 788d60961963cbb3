#include "rcs/callback.hpp"

#include <cmath>
#include <string>
#include <utility>

#include "rcs/result.hpp"

namespace rcs {

namespace {

void check_joints(const char* name, const mjModel* model, const std::vector<int>& joints) {
  for (const int joint : joints) {
    if (joint < 0 || joint >= model->njnt)
      throw InvalidSetup(std::string(name) + ": there is no joint " + std::to_string(joint) + ", the model has " +
                         std::to_string(model->njnt));
    if (model->jnt_type[joint] != mjJNT_HINGE && model->jnt_type[joint] != mjJNT_SLIDE)
      throw InvalidSetup(std::string(name) + ": joint " + std::to_string(joint) + " is neither a hinge nor a slide");
  }
}

}  // namespace

JointsArrived::JointsArrived(std::vector<int> joints, std::vector<int> actuators, double position_tolerance,
                             double velocity_tolerance)
    : joints_(std::move(joints)),
      actuators_(std::move(actuators)),
      position_tolerance_(position_tolerance),
      velocity_tolerance_(velocity_tolerance) {
  if (joints_.size() != actuators_.size())
    throw InvalidSetup("JointsArrived: each joint needs its actuator; there are " + std::to_string(joints_.size()) +
                       " joints and " + std::to_string(actuators_.size()) + " actuators");
}

void JointsArrived::check(const mjModel* model, int /*copies*/) const {
  check_joints("JointsArrived", model, joints_);
  for (const int actuator : actuators_)
    if (actuator < 0 || actuator >= model->nu)
      throw InvalidSetup("JointsArrived: there is no actuator " + std::to_string(actuator) + ", the model has " +
                         std::to_string(model->nu));
}

bool JointsArrived::call(const StepView& view) {
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const double position = view.data->qpos[view.model->jnt_qposadr[joints_[i]]];
    const double velocity = view.data->qvel[view.model->jnt_dofadr[joints_[i]]];
    if (std::abs(position - view.data->ctrl[actuators_[i]]) > position_tolerance_) return false;
    if (std::abs(velocity) > velocity_tolerance_) return false;
  }
  return true;
}

JointsAtRest::JointsAtRest(std::vector<int> joints, double velocity_tolerance, double duration, int copies,
                           bool within_step)
    : joints_(std::move(joints)),
      velocity_tolerance_(velocity_tolerance),
      duration_(duration),
      within_step_(within_step) {
  if (copies < 1) throw InvalidSetup("JointsAtRest: copies must be at least 1, not " + std::to_string(copies));
  since_.assign(static_cast<std::size_t>(copies), -1.0);
}

void JointsAtRest::check(const mjModel* model, int copies) const {
  check_joints("JointsAtRest", model, joints_);
  if (since_.size() < static_cast<std::size_t>(copies))
    throw InvalidSetup("JointsAtRest: it was made for " + std::to_string(since_.size()) + " copies, the world has " +
                       std::to_string(copies));
}

bool JointsAtRest::call(const StepView& view) {
  double& since = since_[static_cast<std::size_t>(view.copy)];
  for (const int joint : joints_)
    if (std::abs(view.data->qvel[view.model->jnt_dofadr[joint]]) > velocity_tolerance_) {
      since = -1.0;
      return false;
    }
  if (since < 0.0) since = view.data->time;
  return view.data->time - since >= duration_;
}

bool Collision::call(const StepView& view) { return contact_force(view.model, view.data, first_, second_) > force_; }

void Collision::check(const mjModel* model, int /*copies*/) const {
  const auto surfaces = static_cast<std::size_t>(model->ngeom + model->nflex);
  for (const auto* flags : {&first_, &second_})
    if (flags->size() > surfaces)
      throw InvalidSetup("Collision: a set has " + std::to_string(flags->size()) + " flags, the model has " +
                         std::to_string(surfaces) + " geoms and flexes");
}

double contact_force(const mjModel* model, const mjData* data, const std::vector<std::uint8_t>& first,
                     const std::vector<std::uint8_t>& second) {
  const auto surface = [&](const mjContact& contact, int side) {
    const int geom = contact.geom[side];
    return static_cast<std::size_t>(geom >= 0 ? geom : model->ngeom + contact.flex[side]);
  };
  const auto has = [](const std::vector<std::uint8_t>& set, std::size_t i) { return i < set.size() && set[i]; };
  double total = 0.0;
  for (int i = 0; i < data->ncon; ++i) {
    const mjContact& contact = data->contact[i];
    if (contact.efc_address < 0) continue;
    const std::size_t a = surface(contact, 0), b = surface(contact, 1);
    if (!((has(first, a) && has(second, b)) || (has(first, b) && has(second, a)))) continue;
    double force[6];
    mj_contactForce(model, data, i, force);
    total += force[0];
  }
  return total;
}

}  // namespace rcs
