// Models and data of MuJoCo's Python package, and what keeps C++ memory alive for Python.
#pragma once

#include <mujoco/mujoco.h>
#include <nanobind/nanobind.h>

#include <cstdint>
#include <memory>
#include <utility>

#include "gil.hpp"

namespace nb = nanobind;

inline bool is_mujoco(nb::handle object, const char* name) {
  return nb::isinstance(object, nb::module_::import_("mujoco").attr(name));
}

/// A `mujoco.MjModel`. A bare address would keep nothing alive.
struct PyModel : nb::object {
  static bool check(PyObject* object) { return is_mujoco(object, "MjModel"); }
  NB_OBJECT_DEFAULT(PyModel, nb::object, "mujoco.MjModel", PyModel::check)
  const mjModel* get() const { return reinterpret_cast<const mjModel*>(nb::cast<std::uintptr_t>(attr("_address"))); }
};

/// A `mujoco.MjData`.
struct PyData : nb::object {
  static bool check(PyObject* object) { return is_mujoco(object, "MjData"); }
  NB_OBJECT_DEFAULT(PyData, nb::object, "mujoco.MjData", PyData::check)
  mjData* get() const { return reinterpret_cast<mjData*>(nb::cast<std::uintptr_t>(attr("_address"))); }
};

/// A Python object that C++ keeps alive, whatever thread drops it.
inline std::shared_ptr<const void> kept(nb::object object) {
  return {object.release().ptr(), [](const void* p) {
            if (!nb::is_alive()) return;  // the interpreter has ended, and with it the object
            const HeldGil gil;
            Py_DECREF(static_cast<PyObject*>(const_cast<void*>(p)));
          }};
}

/// C++ memory that a Python object, such as an array that views it, keeps alive.
inline nb::capsule keeper(std::shared_ptr<const void> memory) {
  using Memory = std::shared_ptr<const void>;
  return nb::capsule(new Memory(std::move(memory)), [](void* p) noexcept { delete static_cast<Memory*>(p); });
}
