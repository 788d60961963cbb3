// The state that decides the future of a copy of a world, saved and written back.
#include <array>
#include <cstddef>
#include <string>
#include <type_traits>
#include <vector>

#include "rcs/result.hpp"
#include "rcs/world.hpp"

namespace rcs {

// Visits every number beside the integration state as a reference, always in the same order.
template <typename Visit>
void World::visit_saved(int copy, Visit visit) const {
  const auto index = static_cast<std::size_t>(copy);
  const auto row = [&](auto& values, std::size_t width) {
    for (std::size_t i = 0; i < width; ++i) visit(values[index * width + i]);
  };
  Readouts& out = *out_;
  visit(out.steps[index]);
  visit(out.substeps[index]);
  visit(out.ends[index]);
  visit(const_cast<std::int64_t&>(physics_steps_[index]));
  const auto remembered = [&](StepCallback& callback) {
    for (double& value : callback.memory(copy)) visit(value);
  };
  for (const Periodic& entry : periodic_) remembered(*entry.callback);
  for (const auto* list : {&converge_, &interrupt_, &fault_})
    for (const auto& entry : *list) remembered(*entry);
  row(out.poses, pose_readouts_.size() * 7);
  row(out.xyzrpy, pose_readouts_.size() * 6);
  row(out.forces, force_readouts_.size());
  row(out.openings, opening_readouts_.size());
  row(out.measurements, static_cast<std::size_t>(measured_));
}

std::size_t World::save_size() const {
  auto size = static_cast<std::size_t>(state_size_);
  visit_saved(0, [&](const auto& /*value*/) { ++size; });
  return size;
}

std::vector<double> World::save(int copy) const {
  const Taken taken(*this, "save");
  check_copy(copy);
  std::vector<double> saved(static_cast<std::size_t>(state_size_));
  read_state(copy, saved);
  visit_saved(copy, [&](const auto& value) { saved.push_back(static_cast<double>(value)); });
  return saved;
}

void World::load(int copy, std::span<const double> saved) {
  const Taken taken(*this, "load");
  check_copy(copy);
  if (const std::size_t size = save_size(); saved.size() != size)
    throw InvalidSetup("world: what is to be loaded has " + std::to_string(saved.size()) + " values; a copy has " +
                       std::to_string(size));
  write_state(copy, saved.first(static_cast<std::size_t>(state_size_)));
  auto next = saved.begin() + state_size_;
  visit_saved(copy, [&](auto& value) { value = static_cast<std::remove_cvref_t<decltype(value)>>(*next++); });
}

}  // namespace rcs
