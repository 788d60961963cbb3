#include "tcp_springs.hpp"

#include <algorithm>
#include <cmath>

namespace rcs {

namespace {

// With which an arm keeps its elbow [N·m/rad, N·m·s/rad]: those of the driver of the FR3, franka.py and its library.
constexpr double kPosture = 5.0;
const double kPostureDamping = 2.0 * std::sqrt(kPosture);
// Directions in which the TCP moves by less than this when the joints move by one radian count as free [m/rad].
constexpr double kSingular = 1e-3;

}  // namespace

bool TcpSprings::are_valid(const Springs& springs) {
  const auto& [stiffness, damping, site, body] = springs;
  if (stiffness.empty() && damping.empty()) return true;
  return stiffness.size() == 6 && damping.size() == 6 && site >= 0 && body >= 0 &&
         std::ranges::all_of(stiffness, [](double one) { return one > 0.0 && std::isfinite(one); }) &&
         std::ranges::all_of(damping, [](double one) { return one >= 0.0 && std::isfinite(one); });
}

TcpSprings::TcpSprings(const mjModel* model, const std::vector<int>& joints, const Springs& springs)
    : chain_(model, joints, springs.tcp_site, springs.base_body),
      here_(joints.size()),
      there_(joints.size()),
      columns_(joints.size()),
      posture_(joints.size()) {
  std::ranges::copy(springs.stiffness, stiffness_.begin());
  std::ranges::copy(springs.damping, damping_.begin());
}

void TcpSprings::add(std::span<const double> place, std::span<const double> led, std::span<double> torques) {
  const std::size_t n = torques.size();
  chain_.put(place.first(n), here_);
  chain_.put(led.first(n), there_);
  Six error, slip{}, force, projected{};
  mju_sub3(error.data(), there_.translation.data(), here_.translation.data());
  double back[4], turn[4];
  mju_negQuat(back, here_.quaternion.data());
  mju_mulQuat(turn, there_.quaternion.data(), back);
  mju_quat2Vel(error.data() + 3, turn, 1.0);
  std::array<double, 36> square{};  // J Jᵀ
  for (std::size_t i = 0; i < n; ++i) {
    const Six own = columns_[i] = chain_.column(here_, i), wanted = chain_.column(there_, i);
    posture_[i] = kPosture * (led[i] - place[i]) + kPostureDamping * (led[n + i] - place[n + i]);
    for (std::size_t a = 0; a < 6; ++a) {
      slip[a] += wanted[a] * led[n + i] - own[a] * place[n + i];
      projected[a] += own[a] * posture_[i];
      for (std::size_t b = 0; b < 6; ++b) square[6 * a + b] += own[a] * own[b];
    }
  }
  for (std::size_t a = 0; a < 6; ++a) {
    force[a] = stiffness_[a] * error[a] + damping_[a] * slip[a];
    square[7 * a] += kSingular * kSingular;
  }
  // Those of the posture's torques that the TCP feels are taken away: Jᵀ (J Jᵀ)⁻¹ J of them.
  mju_cholFactor(square.data(), 6, 0.0);
  Six felt;
  mju_cholSolve(felt.data(), square.data(), projected.data(), 6);
  for (std::size_t i = 0; i < n; ++i) {
    torques[i] += posture_[i];
    for (std::size_t a = 0; a < 6; ++a) torques[i] += columns_[i][a] * (force[a] - felt[a]);
  }
}

}  // namespace rcs
