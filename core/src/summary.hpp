// What an exception says in a line. Private to the sources.
#pragma once

#include <exception>
#include <string>

namespace rcs {

/// The message of an exception. One from Python has its whole traceback, of which the last line says what happened; it
/// waits for the interpreter to give it.
inline std::string summary(const std::exception& error) {
  std::string text = error.what();
  while (text.ends_with('\n')) text.pop_back();
  return text.starts_with("Traceback ") ? text.substr(text.rfind('\n') + 1) : text;
}

}  // namespace rcs
