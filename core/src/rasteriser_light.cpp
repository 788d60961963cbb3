// Light on the corners of triangles.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "rasteriser.hpp"

namespace rcs {

namespace {

// 2^x for x up to 0, to 2e-4; and log2 of a positive number to 1e-4: enough for highlights in steps of 1/255.
inline float exp2_of(float x) {
  x = x < -126.0F ? -126.0F : x;
  const float whole = static_cast<float>(static_cast<int>(x) - 1);
  const float part = x - whole;  // 0 to 2
  const auto bits = static_cast<std::int32_t>((whole + 127.0F) * 8388608.0F);
  const float half = 0.5F * part;
  const float p = 1.0F + half * (0.6931472F + half * (0.2402265F + half * (0.0555041F + half * 0.0096181F)));
  return std::bit_cast<float>(bits) * (p * p);
}

inline float log2_of(float x) {
  const auto bits = std::bit_cast<std::int32_t>(x);
  const float m = std::bit_cast<float>((bits & 0x007FFFFF) | 0x3F800000);  // 1 to 2
  const float e = static_cast<float>((bits >> 23) - 127);
  const float t = (m - 1.0F) / (m + 1.0F), tt = t * t;
  return e + t * (2.8853901F + tt * (0.9617967F + tt * (0.5770780F + tt * 0.4121986F)));
}

}  // namespace

// OpenGL's own model of light (The OpenGL Graphics System 1.5, section 2.14.1), with the eye where it is.
RCS_WIDE_VECTORS
void Rasteriser::shade(const mjvGeom& geom, const Shape& shape, const float (&turned)[3][3], const float* scale) {
  const std::size_t count = used_.size();
  lit_.resize(count);
  float *x = lit_.x.data(), *y = lit_.y.data(), *z = lit_.z.data(), *nx = lit_.nx.data(), *ny = lit_.ny.data(),
        *nz = lit_.nz.data(), *red = lit_.red.data(), *green = lit_.green.data(), *blue = lit_.blue.data();
  float normal[3][3];
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) normal[row][column] = turned[row][column] / scale[column];
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t n = used_[i];
    x[i] = vertices_.x[n], y[i] = vertices_.y[n], z[i] = vertices_.z[n];
    nx[i] = shape.normal.x[n], ny[i] = shape.normal.y[n], nz[i] = shape.normal.z[n];
  }
  float start[3], ambient[3] = {unlit_, unlit_, unlit_};
  for (const Light& light : lights_)
    if (light.is_everywhere)
      for (int c = 0; c < 3; ++c) ambient[c] += light.ambient[c];
  for (int c = 0; c < 3; ++c) start[c] = geom.rgba[c] * (geom.emission + ambient[c]);
  for (std::size_t i = 0; i < count; ++i) {
    const float a = normal[0][0] * nx[i] + normal[0][1] * ny[i] + normal[0][2] * nz[i];
    const float b = normal[1][0] * nx[i] + normal[1][1] * ny[i] + normal[1][2] * nz[i];
    const float c = normal[2][0] * nx[i] + normal[2][1] * ny[i] + normal[2][2] * nz[i];
    const float scale_to_one = 1.0F / std::sqrt(a * a + b * b + c * c);
    nx[i] = a * scale_to_one, ny[i] = b * scale_to_one, nz[i] = c * scale_to_one;
    red[i] = start[0], green[i] = start[1], blue[i] = start[2];
  }
  const float shininess = 128.0F * geom.shininess;
  for (const Light& light : lights_) {
    const float diffuse[3] = {geom.rgba[0] * light.diffuse[0], geom.rgba[1] * light.diffuse[1],
                              geom.rgba[2] * light.diffuse[2]};
    const float specular[3] = {geom.specular * light.specular[0], geom.specular * light.specular[1],
                               geom.specular * light.specular[2]};
    const bool is_shiny = specular[0] + specular[1] + specular[2] > 0.0F;
    if (light.is_everywhere) {
      const float lx = light.direction[0], ly = light.direction[1], lz = light.direction[2];
      if (!is_shiny) {
#pragma GCC ivdep
        for (std::size_t i = 0; i < count; ++i) {
          const float cosine = nx[i] * lx + ny[i] * ly + nz[i] * lz;
          const float bright = cosine > 0.0F ? cosine : 0.0F;
          red[i] += bright * diffuse[0], green[i] += bright * diffuse[1], blue[i] += bright * diffuse[2];
        }
        continue;
      }
#pragma GCC ivdep
      for (std::size_t i = 0; i < count; ++i) {
        const float cosine = nx[i] * lx + ny[i] * ly + nz[i] * lz;
        const float bright = cosine > 0.0F ? cosine : 0.0F;
        const float to_eye = -1.0F / std::sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
        const float hx = lx + x[i] * to_eye, hy = ly + y[i] * to_eye, hz = lz + z[i] * to_eye;
        const float half = (nx[i] * hx + ny[i] * hy + nz[i] * hz) / std::sqrt(hx * hx + hy * hy + hz * hz + 1e-12F);
        const float shine = exp2_of(shininess * log2_of(half > 1e-6F ? (half < 1.0F ? half : 1.0F) : 1e-6F));
        const float seen = cosine > 0.0F ? shine : 0.0F;
        red[i] += bright * diffuse[0] + seen * specular[0];
        green[i] += bright * diffuse[1] + seen * specular[1];
        blue[i] += bright * diffuse[2] + seen * specular[2];
      }
      continue;
    }
    for (std::size_t i = 0; i < count; ++i) {
      float l[3] = {light.position[0] - x[i], light.position[1] - y[i], light.position[2] - z[i]};
      const float distance = std::sqrt(l[0] * l[0] + l[1] * l[1] + l[2] * l[2]);
      for (float& one : l) one /= distance > 1e-9F ? distance : 1e-9F;
      float strength = 1.0F / std::max(1e-9F, light.attenuation[0] + light.attenuation[1] * distance +
                                                  light.attenuation[2] * distance * distance);
      if (light.cutoff > -1.0F) {
        const float along = l[0] * light.direction[0] + l[1] * light.direction[1] + l[2] * light.direction[2];
        strength = along < light.cutoff || along <= 0.0F ? 0.0F : strength * std::pow(along, light.exponent);
      }
      const float cosine = nx[i] * l[0] + ny[i] * l[1] + nz[i] * l[2];
      const float bright = strength * (cosine > 0.0F ? cosine : 0.0F);
      const float to_eye = -1.0F / std::sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
      const float hx = l[0] + x[i] * to_eye, hy = l[1] + y[i] * to_eye, hz = l[2] + z[i] * to_eye;
      const float half = (nx[i] * hx + ny[i] * hy + nz[i] * hz) / std::sqrt(hx * hx + hy * hy + hz * hz + 1e-12F);
      const float seen = cosine > 0.0F && half > 0.0F ? strength * std::pow(std::min(half, 1.0F), shininess) : 0.0F;
      red[i] += strength * geom.rgba[0] * light.ambient[0] + bright * diffuse[0] + seen * specular[0];
      green[i] += strength * geom.rgba[1] * light.ambient[1] + bright * diffuse[1] + seen * specular[1];
      blue[i] += strength * geom.rgba[2] * light.ambient[2] + bright * diffuse[2] + seen * specular[2];
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t n = used_[i];
    vertices_.red[n] = std::clamp(red[i], 0.0F, 1.0F);
    vertices_.green[n] = std::clamp(green[i], 0.0F, 1.0F);
    vertices_.blue[n] = std::clamp(blue[i], 0.0F, 1.0F);
  }
}

}  // namespace rcs
