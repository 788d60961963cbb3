#include "trap.hpp"

#include <mujoco/mujoco.h>

#include <csetjmp>
#include <cstdio>

#include "rcs/result.hpp"

// MuJoCo's own Python package and thread pool trap errors with these: a handler for this thread alone.
// `mju_setLogHandler` would set one for all threads, the user's too. Both functions are exported, and MuJoCo is
// pinned to one exact version.
extern "C" {
mjfLogHandler _mjPRIVATE_setTlsLogHandler(mjfLogHandler handler);
mjfLogHandler _mjPRIVATE_getGlobalLogHandler(void);
}

namespace rcs {

namespace {

struct Trap;
thread_local Trap* t_innermost = nullptr;

void on_message(const mjLogMessage* message);

struct Trap {
  Trap() : outer(t_innermost), handler(_mjPRIVATE_setTlsLogHandler(on_message)) { t_innermost = this; }
  ~Trap() {
    _mjPRIVATE_setTlsLogHandler(handler);
    t_innermost = outer;
  }
  Trap(const Trap&) = delete;
  Trap& operator=(const Trap&) = delete;

  Trap* outer;
  mjfLogHandler handler;  // the thread's before this trap; null for that of all threads
  std::jmp_buf place;
  char error[sizeof(mjLogMessage::subject) + 64];
};

void on_message(const mjLogMessage* message) {
  if (message->level == mjLOG_ERROR) {
    const char* function = message->func ? message->func : "";  // as in the errors of a batch
    std::snprintf(t_innermost->error, sizeof(t_innermost->error), "%s%s%s", function, *function ? ": " : "",
                  message->subject);
    std::longjmp(t_innermost->place, 1);
  }
  mjfLogHandler handler = nullptr;  // warnings go where they would without traps
  for (const Trap* trap = t_innermost; trap; trap = trap->outer)
    if ((handler = trap->handler) != on_message) break;
  (handler ? handler : _mjPRIVATE_getGlobalLogHandler())(message);
}

}  // namespace

bool trap(void (*work)(void*), void* argument, std::string& error) {
  Trap here;
  if (setjmp(here.place) == 0) {
    work(argument);
    return true;
  }
  error = here.error;
  return false;
}

void trapped(const char* what, void (*work)(void*), void* argument) {
  std::string error;
  if (!trap(work, argument, error)) throw SimulationError(std::string(what) + ": MuJoCo failed: " + error);
}

}  // namespace rcs
