#include "rcs/pose.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <stdexcept>

namespace rcs {

namespace {

using Vector = std::array<double, 3>;
using Quaternion = std::array<double, 4>;

constexpr double kNormTolerance = 1e-3;  // generous: recordings and policies keep quaternions as float32 and round them
constexpr double kMatrixTolerance = 1e-6;  // ten float32 roundings
constexpr double kShortestQuaternion = 1e-9;
constexpr double kGimbal = 1e-12;      // below this sine, roll and yaw are rounding noise
constexpr double kSmallSquare = 1e-4;  // of an angle; below, three terms of a series are exact to the last bit
// A product or a division leaves the squared norm within 6 epsilon of 1. Not touching it there keeps stored bits as
// they are.
constexpr double kUnitSquareTolerance = 8 * std::numeric_limits<double>::epsilon();

template <std::size_t N>
std::string format(std::span<const double, N> numbers) {
  std::string text = "(";
  for (const double number : numbers) {
    std::array<char, 32> digits{};
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr;
    if (text.size() > 1) text += ", ";
    text.append(digits.data(), end);
  }
  return text + ")";
}

template <std::size_t N>
std::string format(const std::array<double, N>& numbers) {
  return format(std::span<const double, N>(numbers));
}

template <std::size_t N>
void check_finite(const std::array<double, N>& numbers, const char* what) {
  if (!std::all_of(numbers.begin(), numbers.end(), [](double x) { return std::isfinite(x); }))
    throw std::invalid_argument(std::string(what) + " must be " + std::to_string(N) + " finite numbers, got " +
                                format(numbers));
}

template <std::size_t N>
double dot(const std::array<double, N>& a, const std::array<double, N>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < N; ++i) sum += a[i] * b[i];
  return sum;
}

template <std::size_t N>
double norm(const std::array<double, N>& v) {
  return std::sqrt(dot(v, v));
}

// a + scale * b
template <std::size_t N>
std::array<double, N> add(const std::array<double, N>& a, double scale, const std::array<double, N>& b) {
  std::array<double, N> sum;
  for (std::size_t i = 0; i < N; ++i) sum[i] = a[i] + scale * b[i];
  return sum;
}

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Quaternion multiply(const Quaternion& a, const Quaternion& b) {
  return {a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1], a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
          a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3], a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]};
}

Quaternion conjugate(const Quaternion& q) { return {-q[0], -q[1], -q[2], q[3]}; }

Vector vector_part(const Quaternion& q) { return {q[0], q[1], q[2]}; }

Vector rotate(const Quaternion& q, const Vector& v) {
  const Vector axis = vector_part(q);
  const Vector twice = add(cross(axis, v), 1.0, cross(axis, v));
  return add(add(v, q[3], twice), 1.0, cross(axis, twice));
}

Quaternion unit(const Quaternion& q) {
  const double square = dot(q, q);
  return std::abs(square - 1) <= kUnitSquareTolerance ? q : add({}, 1 / std::sqrt(square), q);
}

// Angle of a rotation: the arctangent of both parts is accurate from 0 to pi, an arccosine is not near either end.
double angle(const Quaternion& q) { return 2 * std::atan2(norm(vector_part(q)), std::abs(q[3])); }

Vector rotvec_of(const Quaternion& q) {
  const Vector axis = vector_part(q);
  const double sine = norm(axis);
  return add({}, sine > 0 ? 2 * std::atan2(sine, q[3]) / sine : 2.0, axis);
}

Quaternion quaternion_of_rotvec(const Vector& rotvec) {
  const double angle = norm(rotvec);
  const double scale = angle > 0 ? std::sin(angle / 2) / angle : 0.5;
  return {scale * rotvec[0], scale * rotvec[1], scale * rotvec[2], std::cos(angle / 2)};
}

void check_rotvec(const Vector& rotvec) {
  check_finite(rotvec, "rotation vector");
  if (!std::isfinite(dot(rotvec, rotvec)))
    throw std::invalid_argument("rotation vector must have a length that is finite when squared, got " +
                                format(rotvec));
}

Vector lerp(const Vector& from, const Vector& to, double fraction) {
  if (fraction == 1) return to;
  return add(from, fraction, add(to, -1.0, from));
}

// Shoemake, "Animating rotation with quaternion curves", 1985, along the shorter arc.
Quaternion slerp(const Quaternion& from, Quaternion to, double fraction) {
  if (fraction == 0) return from;
  if (fraction == 1) return to;
  if (dot(from, to) < 0) to = {-to[0], -to[1], -to[2], -to[3]};
  const double arc = 2 * std::atan2(norm(add(to, -1.0, from)), norm(add(to, 1.0, from)));
  if (arc == 0) return from;
  const double weight_from = std::sin((1 - fraction) * arc) / std::sin(arc);
  const double weight_to = std::sin(fraction * arc) / std::sin(arc);
  return unit(add(add({}, weight_from, from), weight_to, to));
}

void check_rotation(std::span<const double, 16> m) {
  double error = 0;
  for (int i = 0; i < 4; ++i) error = std::max(error, std::abs(m[12 + i] - (i == 3 ? 1.0 : 0.0)));
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) {
      const double product = m[i] * m[j] + m[4 + i] * m[4 + j] + m[8 + i] * m[8 + j];
      error = std::max(error, std::abs(product - (i == j ? 1.0 : 0.0)));
    }
  const double determinant = dot(Vector{m[0], m[4], m[8]}, cross({m[1], m[5], m[9]}, {m[2], m[6], m[10]}));
  if (error > kMatrixTolerance || determinant < 0)
    throw std::invalid_argument(
        "matrix must be a rotation (orthonormal within 1e-6, determinant 1) and a translation above the row "
        "(0, 0, 0, 1), got " +
        format(m));
}

// Shepperd, "Quaternion from rotation matrix", 1978: the largest component comes from the diagonal, so nothing cancels.
Quaternion quaternion_of_matrix(std::span<const double, 16> m) {
  const double trace = m[0] + m[5] + m[10];
  const double largest = std::max({trace, m[0], m[5], m[10]});
  if (largest == trace) return {m[9] - m[6], m[2] - m[8], m[4] - m[1], 1 + trace};
  if (largest == m[0]) return {1 + 2 * m[0] - trace, m[1] + m[4], m[2] + m[8], m[9] - m[6]};
  if (largest == m[5]) return {m[1] + m[4], 1 + 2 * m[5] - trace, m[6] + m[9], m[2] - m[8]};
  return {m[2] + m[8], m[6] + m[9], 1 + 2 * m[10] - trace, m[4] - m[1]};
}

double wrap(double angle) {
  if (angle > std::numbers::pi) return angle - 2 * std::numbers::pi;
  return angle <= -std::numbers::pi ? angle + 2 * std::numbers::pi : angle;
}

}  // namespace

std::array<double, 4> normalize_quaternion(const std::array<double, 4>& quaternion) {
  check_finite(quaternion, "quaternion");
  const double largest = std::abs(*std::max_element(quaternion.begin(), quaternion.end(),
                                                    [](double a, double b) { return std::abs(a) < std::abs(b); }));
  if (largest < kShortestQuaternion)
    throw std::invalid_argument("quaternion must not be zero to have a direction, got " + format(quaternion));
  // Squares of large components would overflow; those of a quaternion near norm 1 must keep their bits.
  return unit(largest > 2 ? add({}, 1 / largest, quaternion) : quaternion);
}

Pose Pose::unchecked(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion) noexcept {
  const auto first = std::find_if(quaternion.begin(), quaternion.end() - 1, [](double x) { return x != 0; });
  const bool is_flipped = quaternion[3] < 0 || (quaternion[3] == 0 && *first < 0);
  // Adding 0 turns -0 into +0, so that poses that compare equal are equal in their bits, too.
  Pose pose;
  for (int i = 0; i < 3; ++i) pose.translation_[i] = translation[i] + 0.0;
  for (int i = 0; i < 4; ++i) pose.quaternion_[i] = (is_flipped ? -quaternion[i] : quaternion[i]) + 0.0;
  return pose;
}

Pose::Pose(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion) {
  check_finite(translation, "translation");
  check_finite(quaternion, "quaternion");
  const double length = norm(quaternion);
  if (!(std::abs(length - 1) <= kNormTolerance))
    throw std::invalid_argument("quaternion (xyzw) must have norm 1 within 1e-3, got " + format(quaternion) +
                                " of norm " + std::to_string(length));
  *this = unchecked(translation, unit(quaternion));
}

Pose Pose::from_quaternion(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion) {
  return Pose(translation, quaternion);
}

Pose Pose::from_wxyz(const std::array<double, 3>& translation, const std::array<double, 4>& quaternion) {
  return Pose(translation, wxyz_to_xyzw(quaternion));
}

Pose Pose::from_matrix(std::span<const double, 16> matrix) {
  std::array<double, 16> entries;
  std::copy(matrix.begin(), matrix.end(), entries.begin());
  check_finite(entries, "matrix");
  check_rotation(matrix);
  return unchecked({matrix[3], matrix[7], matrix[11]}, unit(quaternion_of_matrix(matrix)));
}

Pose Pose::from_rpy(const std::array<double, 3>& translation, const std::array<double, 3>& rpy) {
  check_finite(translation, "translation");
  check_finite(rpy, "rpy");
  const auto about = [&rpy](int axis) {
    Quaternion q{0, 0, 0, std::cos(rpy[axis] / 2)};
    q[axis] = std::sin(rpy[axis] / 2);
    return q;
  };
  return unchecked(translation, unit(multiply(about(2), multiply(about(1), about(0)))));
}

Pose Pose::from_rotvec(const std::array<double, 3>& translation, const std::array<double, 3>& rotvec) {
  check_finite(translation, "translation");
  check_rotvec(rotvec);
  return Pose(translation, quaternion_of_rotvec(rotvec));
}

Pose Pose::from_tquat(std::span<const double, 7> tquat) {
  return Pose({tquat[0], tquat[1], tquat[2]}, {tquat[3], tquat[4], tquat[5], tquat[6]});
}

Pose Pose::from_xyzrpy(std::span<const double, 6> xyzrpy) {
  return from_rpy({xyzrpy[0], xyzrpy[1], xyzrpy[2]}, {xyzrpy[3], xyzrpy[4], xyzrpy[5]});
}

Pose Pose::exp(std::span<const double, 6> twist) {
  const Vector v{twist[0], twist[1], twist[2]};
  const Vector w{twist[3], twist[4], twist[5]};
  check_finite(v, "linear part of the twist");
  check_rotvec(w);
  const double square = dot(w, w);
  const double angle = std::sqrt(square);
  double b = 1.0 / 2 - square / 24 + square * square / 720;
  double c = 1.0 / 6 - square / 120 + square * square / 5040;
  if (square > kSmallSquare) {
    b = 2 * std::pow(std::sin(angle / 2), 2) / square;
    c = (angle - std::sin(angle)) / (square * angle);
  }
  const Vector turned = cross(w, v);
  return Pose(add(add(v, b, turned), c, cross(w, turned)), quaternion_of_rotvec(w));
}

std::array<double, 16> Pose::matrix() const noexcept {
  const auto [x, y, z, w] = quaternion_;
  const auto [tx, ty, tz] = translation_;
  return {1 - 2 * (y * y + z * z),
          2 * (x * y - z * w),
          2 * (x * z + y * w),
          tx,  //
          2 * (x * y + z * w),
          1 - 2 * (x * x + z * z),
          2 * (y * z - x * w),
          ty,  //
          2 * (x * z - y * w),
          2 * (y * z + x * w),
          1 - 2 * (x * x + y * y),
          tz,  //
          0,
          0,
          0,
          1};
}

std::array<double, 3> Pose::rpy() const noexcept {
  const auto [x, y, z, w] = quaternion_;
  const double upper = std::sqrt((w + y) * (w + y) + (x - z) * (x - z));
  const double lower = std::sqrt((w - y) * (w - y) + (x + z) * (x + z));
  double half_sum = std::atan2(x + z, w - y);         // of roll and yaw
  double half_difference = std::atan2(x - z, w + y);  // roll minus yaw
  if (lower < kGimbal) half_sum = -half_difference;
  if (upper < kGimbal) half_difference = -half_sum;
  return {wrap(half_sum + half_difference), 2 * std::atan2(upper, lower) - std::numbers::pi / 2,
          wrap(half_sum - half_difference)};
}

std::array<double, 3> Pose::rotvec() const noexcept { return rotvec_of(quaternion_); }

std::array<double, 7> Pose::tquat() const noexcept {
  return {translation_[0], translation_[1], translation_[2], quaternion_[0],
          quaternion_[1],  quaternion_[2],  quaternion_[3]};
}

std::array<double, 6> Pose::xyzrpy() const noexcept {
  const Vector angles = rpy();
  return {translation_[0], translation_[1], translation_[2], angles[0], angles[1], angles[2]};
}

std::array<double, 6> Pose::log() const noexcept {
  const Vector w = rotvec();
  const double square = dot(w, w);
  double d = 1.0 / 12 + square / 720 + square * square / 30240;
  if (square > kSmallSquare) {
    const double half_cotangent = std::sqrt(square) / 2 * quaternion_[3] / norm(vector_part(quaternion_));
    d = (1 - half_cotangent) / square;
  }
  const Vector turned = cross(w, translation_);
  const Vector v = add(add(translation_, -0.5, turned), d, cross(w, turned));
  return {v[0], v[1], v[2], w[0], w[1], w[2]};
}

Pose Pose::operator*(const Pose& right) const noexcept {
  return unchecked(apply(right.translation_), unit(multiply(quaternion_, right.quaternion_)));
}

Pose Pose::inverse() const noexcept {
  const Quaternion back = conjugate(quaternion_);
  return unchecked(add({}, -1.0, rotate(back, translation_)), back);
}

std::array<double, 3> Pose::apply(const std::array<double, 3>& point) const noexcept {
  return add(translation_, 1.0, rotate(quaternion_, point));
}

Pose Pose::interpolate(const Pose& to, double fraction) const {
  if (!(fraction >= 0 && fraction <= 1))
    throw std::invalid_argument("fraction must be in [0, 1], got " + std::to_string(fraction));
  return unchecked(lerp(translation_, to.translation_, fraction), slerp(quaternion_, to.quaternion_, fraction));
}

double Pose::angle_to(const Pose& other) const noexcept {
  return angle(multiply(conjugate(quaternion_), other.quaternion_));
}

double Pose::distance_to(const Pose& other) const noexcept { return norm(add(other.translation_, -1.0, translation_)); }

bool Pose::is_close(const Pose& other, double metres, double radians) const noexcept {
  return distance_to(other) <= metres && angle_to(other) <= radians;
}

Pose limit_step(const Pose& start, const Pose& goal, double max_translation, double max_rotation) {
  if (!(max_translation >= 0 && max_rotation >= 0))
    throw std::invalid_argument("limits of a step must be 0 or more, got " + std::to_string(max_translation) +
                                " m and " + std::to_string(max_rotation) + " rad");
  const double distance = start.distance_to(goal);
  const double angle = start.angle_to(goal);
  return Pose::unchecked(
      lerp(start.translation_, goal.translation_, distance > max_translation ? max_translation / distance : 1.0),
      slerp(start.quaternion_, goal.quaternion_, angle > max_rotation ? max_rotation / angle : 1.0));
}

std::string to_string(const Pose& pose) {
  return "Pose(translation=" + format(pose.translation()) + ", quaternion=" + format(pose.quaternion()) + ")";
}

}  // namespace rcs

// FNV-1a over words instead of bytes, with a shift: doubles of short decimals differ in their upper bits only.
std::size_t std::hash<rcs::Pose>::operator()(const rcs::Pose& pose) const noexcept {
  std::uint64_t hash = 0xCBF29CE484222325ULL;
  for (const double number : pose.tquat()) {
    hash = (hash ^ std::bit_cast<std::uint64_t>(number)) * 0x100000001B3ULL;
    hash ^= hash >> 32;
  }
  return static_cast<std::size_t>(hash);
}
