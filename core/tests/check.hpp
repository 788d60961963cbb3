// Checks for the C++ tests, which are plain programs: a failed check is printed with its place, and the program
// returns 1.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdio>

namespace rcs::test {

inline std::atomic<int> failures = 0;

/// Counts and prints a failed check; a passed one is silent.
inline void report(bool passed, const char* what, const char* file, int line) {
  if (passed) return;
  ++failures;
  std::fprintf(stderr, "%s:%d: failed: %s\n", file, line, what);
}

/// The result of `main`: 0 if every check passed, else 1.
inline int result() { return failures == 0 ? 0 : 1; }

}  // namespace rcs::test

/// Checks that a condition holds; the test goes on either way, so that one run shows every failure.
#define CHECK(...) ::rcs::test::report(static_cast<bool>(__VA_ARGS__), #__VA_ARGS__, __FILE__, __LINE__)

/// Checks that two numbers differ by no more than a tolerance; NaN differs from everything.
#define CHECK_NEAR(a, b, tolerance) \
  ::rcs::test::report(std::abs((a) - (b)) <= (tolerance), #a " is near " #b, __FILE__, __LINE__)

/// Checks that an expression throws the given exception.
#define CHECK_THROWS(exception, ...)                                                              \
  do {                                                                                            \
    bool thrown_by_check = false;                                                                 \
    try {                                                                                         \
      static_cast<void>(__VA_ARGS__);                                                             \
    } catch (const exception&) {                                                                  \
      thrown_by_check = true;                                                                     \
    }                                                                                             \
    ::rcs::test::report(thrown_by_check, #__VA_ARGS__ " throws " #exception, __FILE__, __LINE__); \
  } while (false)
