// Methods that a class written in Python overrides, called from C++ with or without the GIL.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/trampoline.h>

#include <exception>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "arrays.hpp"
#include "gil.hpp"
#include "rcs/camera.hpp"
#include "rcs/result.hpp"

namespace nb = nanobind;

/// A device may take its time: other threads of Python run meanwhile. Overrides in Python take the GIL again.
using WithoutGil = nb::call_guard<ReleasedGil>;

/// What Python's `str` or another function shows of an object, with the GIL held. It never throws.
inline std::string shown(nb::handle object, PyObject* (*show)(PyObject*) = PyObject_Str) {
  const nb::object text = nb::steal(call_python([&] { return show(object.ptr()); }));
  const nb::object bytes =
      nb::steal(text.is_valid() ? PyUnicode_AsEncodedString(text.ptr(), "utf-8", "backslashreplace") : nullptr);
  if (bytes.is_valid()) return PyBytes_AsString(bytes.ptr());
  PyErr_Clear();
  return "(its text cannot be shown)";
}

/// The name of a type with its module, so that NumPy's bool is not taken for Python's.
inline std::string full_name(nb::handle type) {
  const std::string module = shown(type.attr("__module__")), name = shown(type.attr("__qualname__"));
  return module == "builtins" ? name : module + "." + name;
}

/// Find the override `name`, with the GIL held. Throws `TypeError` when the class does not have it.
inline nb::detail::ticket require_override(const nb::detail::trampoline& trampoline, const char* name) {
  try {
    return {trampoline, name, nb::detail::str_hash(name), true};
  } catch (const std::runtime_error&) {
    const nb::handle type = trampoline.base().type();
    if (PyObject_HasAttrString(type.ptr(), name)) throw;  // there, but not to be called: the interpreter ends
    throw nb::type_error((full_name(type) + " must define the method " + name).c_str());
  }
}

/// Whether the class overrides a method that it need not have.
inline bool has_override(const nb::detail::trampoline& trampoline, const char* name) {
  const HeldGil gil;
  return nb::detail::ticket(trampoline, name, nb::detail::str_hash(name), false).key.is_valid();
}

/// One of Python's own classes of errors, which both languages raise.
inline nb::object error_class(const char* name) { return nb::module_::import_("rcs.errors").attr(name); }

/// The words of a driver's exception as a fault. Ctrl-C, and errors of ours such as a missing package, are none.
inline std::optional<std::string> words_of_python(const nb::python_error& error) {
  const HeldGil gil;
  if (!error.matches(PyExc_Exception) || error.matches(error_class("RcsError"))) return {};
  return full_name(error.type()) + ": " + shown(error.value());
}

inline Array to_python(std::span<const double> values) { return to_array(values); }
template <typename T>
const T& to_python(const T& value) {
  return value;
}

/// Call the method `name` of an object that is written in Python. `valid` says in words of Python what it must return.
///
/// Throws what the method raises, and `TypeError` when it returns something else.
template <typename Result, typename... Args>
Result call_override(const nb::detail::trampoline& trampoline, const char* name, const char* valid,
                     const Args&... args) {
  const HeldGil gil;
  const nb::detail::ticket ticket = require_override(trampoline, name);
  const nb::object answer = call_python([&] { return trampoline.base().attr(ticket.key)(to_python(args)...); });
  if constexpr (!std::is_void_v<Result>) {
    Result result;
    if (nb::try_cast<Result>(answer, result)) return result;
    std::string given = shown(answer, PyObject_Repr);
    if (given.size() > 80) given = "something";
    throw nb::type_error((full_name(trampoline.base().type()) + "." + name + " returned " + given + " of type " +
                          full_name(answer.type()) + ", it must return " + valid)
                             .c_str());
  }
}

/// A device that is written in Python, and how its functions are called.
template <typename Base>
struct PyCalls : Base {
  NB_TRAMPOLINE(Base);

  bool can_guide() const override { return call_or("_can_guide", "a bool", false); }

 protected:
  template <typename Result, typename... Args>
  Result call(const char* name, const char* valid, const Args&... args) const {
    try {
      return call_override<Result>(nb_trampoline, name, valid, args...);
    } catch (const nb::python_error& error) {
      const HeldGil gil;
      if (!error.matches(error_class("DeviceFault"))) throw;
      std::throw_with_nested(rcs::DeviceFault(shown(error.value())));
    }
  }
  /// The same where the class overrides the method, else a value.
  template <typename Result>
  Result call_or(const char* name, const char* valid, Result otherwise) const {
    return has_override(nb_trampoline, name) ? call<Result>(name, valid) : otherwise;
  }
  void call_if_there(const char* name) const {
    if (has_override(nb_trampoline, name)) call<void>(name, "None");
  }
  std::optional<std::string> words_of(const std::exception& error) const override {
    const auto* raised = dynamic_cast<const nb::python_error*>(&error);
    return raised ? words_of_python(*raised) : Base::words_of(error);
  }
};

/// The calls that all devices share. Sensors need not hold or arrive.
template <typename Base>
struct PyDevice : PyCalls<Base> {
  using PyCalls<Base>::PyCalls;
  static constexpr bool kMoves = !std::is_base_of_v<rcs::Camera, Base>;

  void do_open() override { this->call_if_there("_open"); }
  void do_guide() override { this->call_if_there("_guide"); }
  void do_recover() override { this->call_if_there("_recover"); }
  void do_close() override { this->call_if_there("_close"); }
  void do_hold() override {
    if constexpr (kMoves) this->template call<void>("_hold", "None");
  }
  bool do_has_arrived() override {
    if constexpr (kMoves) return this->template call<bool>("_has_arrived", "a bool");
    return true;
  }
};

/// A command that takes a vector. It is copied before the GIL is given up: another thread may write to the array.
template <typename Device>
auto vector_command(void (Device::*command)(std::span<const double>, double)) {
  return [command](Device& device, const Vector& values, double valid_for) {
    const std::vector<double> copy = to_vector(values);
    const ReleasedGil released;
    (device.*command)(copy, valid_for);
  };
}

/// A property that is a numpy array of its own.
template <typename Struct>
void def_array(nb::class_<Struct>& type, const char* name, std::vector<double> Struct::* field, const char* doc) {
  type.def_prop_ro(name, [field](const Struct& value) { return to_array(value.*field); }, nb::rv_policy::move, doc);
}

/// When something was measured.
template <typename Struct>
void def_times(nb::class_<Struct>& type) {
  type.def_ro("time", &Struct::time, "When it was measured [s], on the host's clock that `time.monotonic` reads.")
      .def_ro("device_time", &Struct::device_time, "The same on the device's own clock [s]; NaN when it has none.");
}
