// The GIL, given up and taken. nanobind's own guards end the process at the end of a program: Python ends a daemon
// thread that asks for the GIL then by unwinding its stack, which no C++ destructor lets pass.
#pragma once

#include <Python.h>
#include <unistd.h>

#include <exception>

/// Calls a function that takes the GIL. If the program ends meanwhile, the thread waits for that and never returns.
template <typename F>
auto take_gil(F take) noexcept {
  try {
    return take();
  } catch (...) {  // nothing but that unwinding gets here, and it may not be ended
    while (true) pause();
  }
}

/// Calls Python code, which gives the GIL up and takes it again as it runs. If the program ends meanwhile, the thread
/// waits for that and never returns. Objects that `call` owns are released without the GIL then: make them outside.
template <typename F>
decltype(auto) call_python(F call) {
  try {
    return call();
  } catch (const std::exception&) {
    throw;
  } catch (...) {  // nothing but that unwinding
    while (true) pause();
  }
}

/// Gives up the GIL for its own lifetime.
class ReleasedGil {
 public:
  ReleasedGil() : state_(PyEval_SaveThread()) {}
  ~ReleasedGil() {
    take_gil([this] { PyEval_RestoreThread(state_); });
  }
  ReleasedGil(const ReleasedGil&) = delete;
  ReleasedGil& operator=(const ReleasedGil&) = delete;

 private:
  PyThreadState* state_;
};

/// Holds the GIL for its own lifetime, in any thread and whether it was held or not.
class HeldGil {
 public:
  HeldGil() : state_(take_gil([] { return PyGILState_Ensure(); })) {}
  ~HeldGil() { PyGILState_Release(state_); }
  HeldGil(const HeldGil&) = delete;
  HeldGil& operator=(const HeldGil&) = delete;

 private:
  PyGILState_STATE state_;
};
