// Fields of the model that differ between the copies of a world.
#include <mujoco/mjxmacro.h>

#include <stdexcept>
#include <string>
#include <type_traits>

#include "rcs/world.hpp"

namespace rcs {

namespace {

using Values = std::variant<double*, float*, int*>;

// Returns false for numbers of another type, such as flags.
template <typename T>
bool take(void* address, Values& values) {
  if constexpr (std::is_same_v<T, double> || std::is_same_v<T, float> || std::is_same_v<T, int>) {
    values = static_cast<T*>(address);
    return true;
  } else {
    return false;
  }
}

// MuJoCo has the size of an element, which leaves float and int alike; its list of fields has the type.
bool take_as_field(const std::string& name, void* address, Values& values) {
#define X(type, field, rows, columns) \
  if (name == #field) return take<type>(address, values);
  MJMODEL_POINTERS
#undef X
  return false;
}

}  // namespace

ModelField World::expand(const std::string& field) {
  const Taken taken(*this, "expand");
  if (!batch_) throw std::invalid_argument("only a batch has model fields per copy; write to your MjModel");
  return expand_field(field);
}

ModelField World::expand_field(const std::string& field) {
  ModelField found;
  void* address = mjb_expand(batch_, field.c_str(), &found.size, nullptr);
  if (!address || !take_as_field(field, address, found.values))
    throw std::invalid_argument("\"" + field + "\" is not a field of MjModel whose numbers can differ between copies");
  is_varied_ = true;
  return found;
}

std::optional<ModelField> World::expanded(const std::string& field) {
  const Taken taken(*this, "expanded");
  if (!batch_) return std::nullopt;
  int size = 0;
  if (!mjb_expanded(batch_, field.c_str(), &size, nullptr)) return std::nullopt;
  return expand_field(field);
}

void World::set_chosen_constants(Chosen copies) {
  const Taken taken(*this, "set_constants");
  if (!batch_) throw std::invalid_argument("only a batch has models per copy; call mj_setConst on your MjModel");
  std::vector<int> room;
  copies = in_order(copies, room);
  if (copies && copies->empty()) return;
  const int failed =
      mjb_setConst(batch_, copies ? copies->data() : nullptr, copies ? static_cast<int>(copies->size()) : 0);
  if (failed == 0) return;
  int first = 0;
  while (!mjb_status(batch_)[first]) ++first;
  throw SimulationError("world: the constants of copy " + std::to_string(first) +
                        " could not be computed: " + mjb_error(batch_, first));
}

}  // namespace rcs
