// Eigenvalues and eigenvectors of symmetric 6 × 6 matrices.
#pragma once

#include <array>
#include <cmath>

#include "task_matrix.hpp"

namespace rcs {

/// A symmetric matrix as Σ values[i] · vector[i] · vector[i]ᵀ.
struct Spectrum {
  std::array<double, kTask> values{};
  std::array<std::array<double, kTask>, kTask> vectors{};  ///< one per row, of length 1
};

/// Decompose a symmetric matrix, of which both triangles are read: Jacobi's cyclic method, Golub and Van Loan, "Matrix
/// Computations", 2013, §8.5. It is exact to rounding for small eigenvalues beside large ones, too.
inline Spectrum spectrum_of(std::array<double, kTask * kTask> a) {
  constexpr int kSweeps = 20;
  Spectrum found;
  for (int i = 0; i < kTask; ++i) found.vectors[i][i] = 1.0;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    bool is_diagonal = true;
    for (int p = 0; p < kTask; ++p)
      for (int q = p + 1; q < kTask; ++q) {
        const double off = a[p * kTask + q];
        if (off * off <= 1e-30 * std::abs(a[p * kTask + p] * a[q * kTask + q]) || std::abs(off) < 1e-150) continue;
        is_diagonal = false;
        const double tau = (a[q * kTask + q] - a[p * kTask + p]) / (2 * off);
        const double t = (tau < 0.0 ? -1.0 : 1.0) / (std::abs(tau) + std::sqrt(1.0 + tau * tau));
        const double c = 1.0 / std::sqrt(1.0 + t * t), s = t * c;
        for (int k = 0; k < kTask; ++k) {
          const double left = a[k * kTask + p], right = a[k * kTask + q];
          a[k * kTask + p] = c * left - s * right;
          a[k * kTask + q] = s * left + c * right;
        }
        for (int k = 0; k < kTask; ++k) {
          const double upper = a[p * kTask + k], lower = a[q * kTask + k];
          a[p * kTask + k] = c * upper - s * lower;
          a[q * kTask + k] = s * upper + c * lower;
          const double one = found.vectors[p][k], other = found.vectors[q][k];
          found.vectors[p][k] = c * one - s * other;
          found.vectors[q][k] = s * one + c * other;
        }
      }
    if (is_diagonal) break;
  }
  for (int i = 0; i < kTask; ++i) found.values[i] = std::max(a[i * kTask + i], 0.0);
  return found;
}

}  // namespace rcs
