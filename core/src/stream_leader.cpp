#include "stream_leader.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rcs {

namespace {

// A joint that is found outside of its range comes back at this speed [rad/s].
constexpr double kReturnSpeed = 0.1;
// Places on the way to a stop at which the TCP is looked at.
constexpr int kPlaces = 8;
// How far outside of its box a TCP still counts as inside [m].
constexpr double kBoxTolerance = 1e-4;
// How far outside of its range a joint still counts as inside [rad].
constexpr double kRangeTolerance = 1e-6;

double outside(const TcpBox& box, std::span<const double> joints) {
  const std::array<double, 3> tcp = box.tcp(joints);
  double distance = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (!std::isfinite(tcp[i])) return kForever;
    distance = std::max({distance, box.lower[i] - tcp[i], tcp[i] - box.upper[i]});
  }
  return distance;
}

}  // namespace

StreamLeader::StreamLeader(MotionLimits limits, const StreamOptions& options)
    : limits_(std::move(limits)), options_(options) {
  const auto n = limits_.lower.size();
  memory_.resize(static_cast<std::size_t>(Trajectory::size(static_cast<int>(n))));
  for (auto* values : {&goal_, &point_.position, &point_.velocity, &point_.acceleration}) values->resize(n);
  for (auto& values : asked_) values.resize(n);
  trajectory_ = std::make_unique<Trajectory>(limits_);
}

void StreamLeader::stand(std::span<const double> joints) {
  Trajectory::stand(memory_, joints);
  set_range(joints);
  forget_asked();
}

std::span<const double> StreamLeader::position() {
  trajectory_->look(memory_.data(), 0.0);
  return trajectory_->position();
}

// The range of each joint is as long as it takes to have it where it is. How the rest of a plan goes on does not depend
// on it.
void StreamLeader::set_range(std::span<const double> joints) {
  is_wide_ = false;
  MotionLimits range = limits_;
  for (std::size_t i = 0; i < goal_.size(); ++i) {
    range.lower[i] = std::min(lower(i), joints[i]);
    range.upper[i] = std::max(upper(i), joints[i]);
    is_wide_ = is_wide_ || joints[i] < lower(i) || joints[i] > upper(i);
  }
  trajectory_ = std::make_unique<Trajectory>(range);
  range_now_ = range;
  braking_ = std::make_unique<Trajectory>(std::move(range));
}

void StreamLeader::forget_asked() {
  was_cut_ = false;
  std::ranges::copy(target(), asked_[0].begin());
  for (const std::size_t k : {1u, 2u, 3u}) std::ranges::fill(asked_[k], 0.0);
}

void StreamLeader::brake() {
  trajectory_->brake(memory_.data(), 1.0);
  forget_asked();
}

void StreamLeader::follow(std::span<const double> joints, double period) {
  bool is_outside = false;
  std::array<bool, 4> is_more{};
  const std::span<const double> now = position();
  const std::array most{&limits_.velocity, &limits_.acceleration, &limits_.jerk};
  for (std::size_t i = 0; i < goal_.size(); ++i) {
    // A joint that is outside may stay there.
    goal_[i] = std::clamp(joints[i], std::min(lower(i), now[i]), std::max(upper(i), now[i]));
    is_outside = is_outside || goal_[i] != joints[i];
    double value = goal_[i];
    for (std::size_t k = 0; k < asked_.size(); ++k) {
      if (k > 0 && std::abs(value) > (1.0 + 1e-9) * (*most[k - 1])[i]) is_more[k] = true;
      value = (value - std::exchange(asked_[k][i], value)) / period;
    }
  }
  range_ += is_outside;
  speed_ += is_more[1];
  acceleration_ += is_more[2];
  jerk_ += is_more[3];
  was_cut_ = false;
  go_on(period);
}

void StreamLeader::go_on(double period) {
  if (was_cut_) return;
  if (is_wide_) {
    const std::span<const double> now = position();
    set_range(std::vector<double>(now.begin(), now.end()));
  }
  const std::span<const double> now = position();
  for (std::size_t i = 0; i < goal_.size(); ++i) {
    memory_[i] = goal_[i];
    if (now[i] < lower(i)) memory_[i] = std::min(goal_[i], now[i] + kReturnSpeed * period);
    if (now[i] > upper(i)) memory_[i] = std::max(goal_[i], now[i] - kReturnSpeed * period);
  }
  if (trajectory_->is_asked(memory_.data())) trajectory_->follow(memory_.data(), {period, period, 0.0, false}, 1.0);
}

const StreamPoint& StreamLeader::advance() {
  const double tick = 1.0 / options_.rate;
  if (!is_still()) stay_in_range(tick);
  if (options_.box && !is_still()) stay_in_box(tick);
  trajectory_->advance(memory_.data(), tick);
  std::ranges::copy(trajectory_->position(), point_.position.begin());
  std::ranges::copy(trajectory_->velocity(), point_.velocity.begin());
  std::ranges::copy(trajectory_->acceleration(), point_.acceleration.begin());
  return point_;
}

// Targets that come every few ticks lead a plan to places where it cannot stop any more inside of the range. If it
// could not after this tick, it brakes now.
void StreamLeader::stay_in_range(double tick) {
  trajectory_->look(memory_.data(), tick);
  bool is_near = false;
  for (std::size_t i = 0; i < goal_.size() && !is_near; ++i) {
    const double position = trajectory_->position()[i], velocity = trajectory_->velocity()[i];
    const double most = limits_.acceleration[i], lag = 2.0 * most / limits_.jerk[i];
    const double way = std::abs(velocity) * (0.5 * std::abs(velocity) / most + lag) + most * lag * lag;
    is_near = velocity > 0.0 ? position + way > range_now_.upper[i] : position - way < range_now_.lower[i];
  }
  if (!is_near) return;
  tried_ = memory_;
  braking_->advance(tried_.data(), tick);
  braking_->brake(tried_.data(), 1.0);
  braking_->look(tried_.data(), braking_->remaining(tried_.data()));
  for (std::size_t i = 0; i < goal_.size(); ++i) {
    const double place = braking_->position()[i];
    if (place <= range_now_.upper[i] + kRangeTolerance && place >= range_now_.lower[i] - kRangeTolerance) continue;
    return trajectory_->brake(memory_.data(), 1.0);
  }
}

// From where the arm is, it can stop inside of the box; if it could not after this tick, it brakes now. One that is
// outside comes no farther.
void StreamLeader::stay_in_box(double tick) {
  const TcpBox& box = *options_.box;
  const double most = std::max(outside(box, position()), kBoxTolerance);
  tried_ = memory_;
  braking_->advance(tried_.data(), tick);
  braking_->brake(tried_.data(), 1.0);
  const double duration = braking_->remaining(tried_.data());
  for (int place = 0; place <= kPlaces; ++place) {
    braking_->look(tried_.data(), duration * place / kPlaces);
    if (outside(box, braking_->position()) <= most) continue;
    if (!std::exchange(was_cut_, true)) ++box_;
    trajectory_->brake(memory_.data(), 1.0);
    return;
  }
}

}  // namespace rcs
