// Linear algebra of a task with six dimensions, translation and rotation: matrices are 6 × 6 and stored by rows.
#pragma once

#include <array>
#include <cmath>

namespace rcs {

inline constexpr int kTask = 6;

// Cholesky factor of a symmetric positive definite 6 × 6 matrix, in place of its lower triangle.
inline void factor_cholesky(std::array<double, kTask * kTask>& a) {
  for (int j = 0; j < kTask; ++j) {
    for (int k = 0; k < j; ++k)
      for (int i = j; i < kTask; ++i) a[i * kTask + j] -= a[i * kTask + k] * a[j * kTask + k];
    const double scale = 1.0 / std::sqrt(a[j * kTask + j]);
    for (int i = j; i < kTask; ++i) a[i * kTask + j] *= scale;
  }
}

// Solve the system of a factor in place.
inline void solve_cholesky(const std::array<double, kTask * kTask>& a, std::array<double, kTask>& b) {
  for (int i = 0; i < kTask; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= a[i * kTask + k] * b[k];
    b[i] /= a[i * kTask + i];
  }
  for (int i = kTask - 1; i >= 0; --i) {
    for (int k = i + 1; k < kTask; ++k) b[i] -= a[k * kTask + i] * b[k];
    b[i] /= a[i * kTask + i];
  }
}

// An estimate of the smallest eigenvalue of the leading rows of the matrix of a Cholesky factor, at most as many times
// too small as there are rows.
inline double smallest_of(const std::array<double, kTask * kTask>& a, int rows) {
  double trace = 0.0;  // of the inverse
  for (int c = 0; c < rows; ++c) {
    std::array<double, kTask> column{};
    column[c] = 1.0;
    for (int i = c; i < rows; ++i) {
      for (int k = c; k < i; ++k) column[i] -= a[i * kTask + k] * column[k];
      column[i] /= a[i * kTask + i];
      trace += column[i] * column[i];
    }
  }
  return 1.0 / trace;
}

inline double norm3(const double* v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

}  // namespace rcs
