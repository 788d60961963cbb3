#include "rcs/callback.hpp"

#include <cmath>

namespace rcs {

bool JointsArrived::call(const StepView& view) {
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const double position = view.data->qpos[view.model->jnt_qposadr[joints_[i]]];
    const double velocity = view.data->qvel[view.model->jnt_dofadr[joints_[i]]];
    if (std::abs(position - view.data->ctrl[actuators_[i]]) > position_tolerance_) return false;
    if (std::abs(velocity) > velocity_tolerance_) return false;
  }
  return true;
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
