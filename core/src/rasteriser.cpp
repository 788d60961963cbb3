#include "rasteriser.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace rcs {

namespace {

constexpr int kPlaneSquares = 16;
constexpr float kGuard = 4;         // sheets to each side of the sheet that need no clipping
constexpr float kEdge = 1e-3F;      // pixels²: neighbours overlap by rounding, and never leave a gap
constexpr float kMostEdge = 0.05F;  // of a share: of the narrowest triangles no more
constexpr int kWide = 8;            // pixels from which a row is worth whole vectors
constexpr double kOpaque = 0.999;   // as in MuJoCo's renderer

void set3(float* to, const float* from) { std::copy_n(from, 3, to); }

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

inline std::uint32_t packed(float red, float green, float blue) {
  const auto byte = [](float value) {
    const float scaled = value * 255.0F + 0.5F;
    const float low = scaled > 0.0F ? scaled : 0.0F;
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(low < 255.0F ? low : 255.0F));
  };
  return byte(red) | byte(green) << 8 | byte(blue) << 16;
}

// Whether a backdrop shows what is asked for. Only fields that are drawn count: others, such as labels, are not filled
// in.
bool is_same(const Backdrop& backdrop, const mjvScene& scene, const std::vector<const mjvGeom*>& geoms,
             const mjvGLCamera& eye, const Sheet& sheet) {
  const auto equal = [](const auto& a, const auto& b) { return std::memcmp(&a, &b, sizeof(a)) == 0; };
  if (backdrop.sheet.width != sheet.width || backdrop.sheet.height != sheet.height ||
      backdrop.geoms.size() != geoms.size() || static_cast<int>(backdrop.lights.size()) != scene.nlight ||
      !equal(backdrop.eye, eye))
    return false;
  for (int i = 0; i < scene.nlight; ++i) {
    const mjvLight &a = backdrop.lights[static_cast<std::size_t>(i)], &b = scene.lights[i];
    if (a.type != b.type || a.cutoff != b.cutoff || a.exponent != b.exponent || !equal(a.pos, b.pos) ||
        !equal(a.dir, b.dir) || !equal(a.attenuation, b.attenuation) || !equal(a.ambient, b.ambient) ||
        !equal(a.diffuse, b.diffuse) || !equal(a.specular, b.specular))
      return false;
  }
  for (std::size_t i = 0; i < geoms.size(); ++i) {
    const mjvGeom &a = backdrop.geoms[i], &b = *geoms[i];
    if (a.type != b.type || a.dataid != b.dataid || !equal(a.size, b.size) || !equal(a.pos, b.pos) ||
        !equal(a.mat, b.mat) || !equal(a.rgba, b.rgba) || a.emission != b.emission || a.specular != b.specular ||
        a.shininess != b.shininess)
      return false;
  }
  return true;
}

inline std::uint32_t mixed(std::uint32_t over, std::uint32_t under, float alpha) {
  std::uint32_t result = 0;
  for (int shift = 0; shift < 24; shift += 8) {
    const auto a = static_cast<float>(over >> shift & 255), b = static_cast<float>(under >> shift & 255);
    result |= static_cast<std::uint32_t>(a * alpha + b * (1.0F - alpha) + 0.5F) << shift;
  }
  return result;
}

}  // namespace

void Sheet::clear(int new_width, int new_height) {
  width = new_width;
  height = new_height;
  const std::size_t size = static_cast<std::size_t>(width) * height;
  colours.assign(size, 0);
  nearness.assign(size, 0.0F);
}

void Rasteriser::Vertices::resize(std::size_t size) {
  if (x.size() >= size) return;
  for (auto* values : {&x, &y, &z, &column, &row, &nearness, &red, &green, &blue}) values->resize(size);
}

void Rasteriser::Lit::resize(std::size_t size) {
  if (x.size() >= size) return;
  for (auto* values : {&x, &y, &z, &nx, &ny, &nz, &red, &green, &blue}) values->resize(size);
}

Rasteriser::Rasteriser(const mjModel* model)
    : meshes_(static_cast<std::size_t>(model->nmesh)),
      model_(model),
      box_(box_shape()),
      plane_(plane_shape(kPlaneSquares)),
      ball_(ball_shape({})),
      cylinder_(cylinder_shape({}, true)),
      tube_(cylinder_shape({}, false)),
      cap_(half_ball_shape({}, 1)),
      cup_(half_ball_shape({}, -1)) {}

std::string Rasteriser::why_not(const mjModel& model, std::span<const bool> groups) {
  if (model.nflex > 0) return "it has a soft body";
  if (model.nskin > 0) return "it has a skin";
  for (int geom = 0; geom < model.ngeom; ++geom) {
    const int group = std::clamp(model.geom_group[geom], 0, mjNGROUP - 1);
    if (!groups[static_cast<std::size_t>(group)]) continue;
    const int type = model.geom_type[geom];
    if (type == mjGEOM_HFIELD || type == mjGEOM_SDF) return "it has a height field or a signed distance field";
  }
  // Of materials that no geom has, too: which geom has which may change with every episode.
  for (int i = 0; i < model.nmat * mjNTEXROLE; ++i)
    if (model.mat_texid[i] >= 0) return "it has textures";
  for (int camera = 0; camera < model.ncam; ++camera)
    if (model.cam_projection[camera] != mjPROJ_PERSPECTIVE) return "it has a camera without perspective";
  return "";
}

void Rasteriser::place_lights(const mjvScene& scene) {
  const auto turned = [&](const float* vector, float* out, float sign) {
    for (int axis = 0; axis < 3; ++axis)
      out[axis] =
          sign * (view_.axes[axis][0] * vector[0] + view_.axes[axis][1] * vector[1] + view_.axes[axis][2] * vector[2]);
  };
  lights_.clear();
  for (int i = 0; i < scene.nlight; ++i) {
    const mjvLight& from = scene.lights[i];
    if (from.type != mjLIGHT_DIRECTIONAL && from.type != mjLIGHT_SPOT)
      continue;  // as MuJoCo's OpenGL, which has no others
    Light light{};
    light.is_everywhere = from.type == mjLIGHT_DIRECTIONAL;
    turned(from.dir, light.direction, -1.0F);
    const float offset[3] = {static_cast<float>(from.pos[0] - view_.position[0]),
                             static_cast<float>(from.pos[1] - view_.position[1]),
                             static_cast<float>(from.pos[2] - view_.position[2])};
    turned(offset, light.position, 1.0F);
    set3(light.attenuation, from.attenuation);
    const bool is_spot = from.type == mjLIGHT_SPOT && from.cutoff < 90.0F;
    light.cutoff = is_spot ? static_cast<float>(std::cos(from.cutoff * mjPI / 180)) : -1.0F;
    light.exponent = is_spot ? from.exponent : 0.0F;
    set3(light.ambient, from.ambient);
    set3(light.diffuse, from.diffuse);
    set3(light.specular, from.specular);
    lights_.push_back(light);
  }
}

void Rasteriser::draw_all(std::span<const mjvGeom* const> geoms, Sheet& sheet) {
  for (const mjvGeom* geom : geoms) draw_geom(*geom, sheet);
}

void Rasteriser::draw(const mjvScene& scene, const mjvGLCamera& eye, Sheet& sheet, Backdrop* backdrop) {
  const float* forward = eye.forward;
  const float* up = eye.up;
  const float right[3] = {forward[1] * up[2] - forward[2] * up[1], forward[2] * up[0] - forward[0] * up[2],
                          forward[0] * up[1] - forward[1] * up[0]};
  for (int i = 0; i < 3; ++i) {
    view_.axes[0][i] = right[i];
    view_.axes[1][i] = -up[i];
    view_.axes[2][i] = forward[i];
    view_.position[i] = eye.pos[i];
  }
  const float half_height = 0.5F * (eye.frustum_top - eye.frustum_bottom);
  const float aspect = static_cast<float>(sheet.width) / static_cast<float>(sheet.height);
  const float half_width = eye.frustum_width > 0 ? eye.frustum_width : half_height * aspect;
  view_.near = eye.frustum_near;
  view_.column_scale = eye.frustum_near / (2 * half_width) * static_cast<float>(sheet.width);
  view_.column_shift = (half_width - eye.frustum_center) / (2 * half_width) * static_cast<float>(sheet.width);
  view_.row_scale = eye.frustum_near / (2 * half_height) * static_cast<float>(sheet.height);
  view_.row_shift = eye.frustum_top / (2 * half_height) * static_cast<float>(sheet.height);
  place_lights(scene);
  still_.clear(), moving_.clear(), transparent_.clear();
  for (int i = 0; i < scene.ngeom; ++i) {
    const mjvGeom& geom = scene.geoms[i];
    auto& list = geom.rgba[3] < kOpaque ? transparent_ : geom.category == mjCAT_STATIC ? still_ : moving_;
    list.push_back(&geom);
  }
  if (backdrop == nullptr) {
    sheet.clear(sheet.width, sheet.height);
    draw_all(moving_, sheet);
    draw_all(still_, sheet);  // floor and walls: most of them is behind something
  } else {
    if (!is_same(*backdrop, scene, still_, eye, sheet)) {
      sheet.clear(sheet.width, sheet.height);
      draw_all(still_, sheet);
      backdrop->geoms.clear();
      for (const mjvGeom* geom : still_) backdrop->geoms.push_back(*geom);
      backdrop->lights.assign(scene.lights, scene.lights + scene.nlight);
      backdrop->eye = eye;
      backdrop->sheet = sheet;
    } else {
      sheet = backdrop->sheet;
    }
    draw_all(moving_, sheet);
  }
  // From the farthest to the nearest.
  const auto distance = [&](const mjvGeom* geom) {
    double sum = 0;
    for (int i = 0; i < 3; ++i) sum += (geom->pos[i] - view_.position[i]) * forward[i];
    return sum;
  };
  std::stable_sort(transparent_.begin(), transparent_.end(),
                   [&](const mjvGeom* a, const mjvGeom* b) { return distance(a) > distance(b); });
  for (const mjvGeom* geom : transparent_) draw_geom(*geom, sheet);
}

void Rasteriser::draw_geom(const mjvGeom& geom, Sheet& sheet) {
  if (!(geom.rgba[3] > 0.0F)) return;
  float sum = 0;
  for (const float value : geom.mat) sum += value;
  for (const float value : geom.pos) sum += value;
  for (const float value : geom.size) sum += value;
  if (!std::isfinite(sum)) return;  // of a simulation that has diverged
  const float none[3] = {0, 0, 0}, one[3] = {1, 1, 1};
  const float* size = geom.size;
  switch (geom.type) {
    case mjGEOM_BOX:
      return draw_shape(box_, geom, size, none, sheet);
    case mjGEOM_SPHERE:
    case mjGEOM_ELLIPSOID:
      return draw_shape(ball_, geom, size, none, sheet);
    case mjGEOM_CYLINDER:
      return draw_shape(cylinder_, geom, size, none, sheet);
    case mjGEOM_CAPSULE: {
      const float end[3] = {size[0], size[0], size[0]}, upper[3] = {0, 0, size[2]}, lower[3] = {0, 0, -size[2]};
      draw_shape(tube_, geom, size, none, sheet);
      draw_shape(cap_, geom, end, upper, sheet);
      return draw_shape(cup_, geom, end, lower, sheet);
    }
    case mjGEOM_PLANE: {
      // An endless one lies around the camera that the scene was made with, far enough to have no visible end.
      const float endless = 1.2F * model_->vis.map.zfar * static_cast<float>(model_->stat.extent);
      const float half[3] = {size[0] > 0 ? size[0] : endless, size[1] > 0 ? size[1] : endless, 1};
      return draw_shape(plane_, geom, half, none, sheet);
    }
    case mjGEOM_MESH: {
      if (geom.dataid < 0) return;
      const int mesh = geom.dataid / 2;
      Shape& shape = meshes_[static_cast<std::size_t>(mesh)];
      if (shape.corners.empty()) shape = mesh_shape(*model_, mesh);
      return draw_shape(shape, geom, one, none, sheet);
    }
    default:
      return;
  }
}

void Rasteriser::draw_shape(const Shape& shape, const mjvGeom& geom, const float* scale, const float* shift,
                            Sheet& sheet) {
  const std::size_t size = shape.size();
  vertices_.resize(size);
  // From the shape to the camera's frame: turned × scale + place.
  float turned[3][3], place[3];
  for (int row = 0; row < 3; ++row) {
    const float* axis = view_.axes[row];
    for (int column = 0; column < 3; ++column)
      turned[row][column] =
          axis[0] * geom.mat[column] + axis[1] * geom.mat[3 + column] + axis[2] * geom.mat[6 + column];
    place[row] =
        static_cast<float>(axis[0] * (geom.pos[0] - view_.position[0]) + axis[1] * (geom.pos[1] - view_.position[1]) +
                           axis[2] * (geom.pos[2] - view_.position[2])) +
        turned[row][0] * shift[0] + turned[row][1] * shift[1] + turned[row][2] * shift[2];
  }
  float m[3][3];
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) m[row][column] = turned[row][column] * scale[column];

  Vertices& v = vertices_;
  const float *sx = shape.position.x.data(), *sy = shape.position.y.data(), *sz = shape.position.z.data();
  float *x = v.x.data(), *y = v.y.data(), *z = v.z.data(), *column = v.column.data(), *row = v.row.data(),
        *nearness = v.nearness.data();
  float nearest = 1e30F;
  float widest = 0.0F;
  const float column_shift = view_.column_shift, row_shift = view_.row_shift;
  const float column_scale = view_.column_scale, row_scale = view_.row_scale;
#pragma GCC ivdep
  for (std::size_t i = 0; i < size; ++i) {
    x[i] = m[0][0] * sx[i] + m[0][1] * sy[i] + m[0][2] * sz[i] + place[0];
    y[i] = m[1][0] * sx[i] + m[1][1] * sy[i] + m[1][2] * sz[i] + place[1];
    z[i] = m[2][0] * sx[i] + m[2][1] * sy[i] + m[2][2] * sz[i] + place[2];
    nearness[i] = 1.0F / z[i];
    column[i] = column_scale * x[i] * nearness[i] + column_shift;
    row[i] = row_scale * y[i] * nearness[i] + row_shift;
  }
  for (std::size_t i = 0; i < size; ++i) {
    nearest = std::min(nearest, z[i]);
    widest = std::max(widest, std::max(std::abs(column[i]), std::abs(row[i])));
  }
  const auto limit = kGuard * static_cast<float>(std::max(sheet.width, sheet.height));
  const bool is_whole = nearest >= view_.near && widest <= limit;

  // Triangles that are seen from their outer side and that may cover the middle of a pixel; then light on their
  // corners.
  visible_.clear();
  used_.clear();
  is_used_.assign(size, 0);
  const auto width = static_cast<float>(sheet.width), height = static_cast<float>(sheet.height);
  // MuJoCo's OpenGL draws what is transparent twice.
  const float alpha = geom.rgba[3] < kOpaque ? 1.0F - (1.0F - geom.rgba[3]) * (1.0F - geom.rgba[3]) : 1.0F;
  const std::uint32_t* corners = shape.corners.data();
  for (std::size_t first = 0; first < shape.corners.size(); first += 3) {
    const std::uint32_t a = corners[first], b = corners[first + 1], c = corners[first + 2];
    if (is_whole) {
      const float area = (column[b] - column[a]) * (row[c] - row[a]) - (column[c] - column[a]) * (row[b] - row[a]);
      if (!(area < 0.0F)) continue;
      const float left = std::min({column[a], column[b], column[c]}),
                  right = std::max({column[a], column[b], column[c]});
      const float top = std::min({row[a], row[b], row[c]}), bottom = std::max({row[a], row[b], row[c]});
      if (left > width || right < 0.0F || top > height || bottom < 0.0F) continue;
      if (std::ceil(left - 0.5F) > right - 0.5F || std::ceil(top - 0.5F) > bottom - 0.5F) continue;
    } else {
      const float u[3] = {x[b] - x[a], y[b] - y[a], z[b] - z[a]}, w[3] = {x[c] - x[a], y[c] - y[a], z[c] - z[a]};
      const float facing =
          x[a] * (u[1] * w[2] - u[2] * w[1]) + y[a] * (u[2] * w[0] - u[0] * w[2]) + z[a] * (u[0] * w[1] - u[1] * w[0]);
      if (!(facing < 0.0F)) continue;
    }
    visible_.push_back(static_cast<std::uint32_t>(first));
    for (const std::uint32_t corner : {a, b, c})
      if (!is_used_[corner]) is_used_[corner] = 1, used_.push_back(corner);
  }
  if (visible_.empty()) return;
  shade(geom, shape, turned, scale);
  for (const std::uint32_t first : visible_) {
    if (!is_whole) {
      draw_clipped(corners + first, alpha, sheet);
      continue;
    }
    Corner triangle[3];
    for (int i = 0; i < 3; ++i) {
      const std::uint32_t n = corners[first + static_cast<std::uint32_t>(i)];
      triangle[i] = {column[n], row[n], nearness[n], v.red[n], v.green[n], v.blue[n]};
    }
    draw_triangle(triangle, alpha, sheet);
  }
}

// OpenGL's own model of light (The OpenGL Graphics System 1.5, section 2.14.1), with the eye where it is.
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
  float start[3], ambient[3] = {0, 0, 0};
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

Rasteriser::Corner Rasteriser::project(const float* place, const float* colour) const {
  const float nearness = 1.0F / place[2];
  return {view_.column_scale * place[0] * nearness + view_.column_shift,
          view_.row_scale * place[1] * nearness + view_.row_shift,
          nearness,
          colour[0],
          colour[1],
          colour[2]};
}

// What is behind the near plane or far beside the picture is cut off (Sutherland and Hodgman, 1974).
void Rasteriser::draw_clipped(const std::uint32_t* corners, float alpha, Sheet& sheet) const {
  struct Point {
    float at[3], colour[3];
  };
  constexpr int kMost = 9;  // each of six planes adds one corner at most
  Point points[kMost], kept[kMost];
  int count = 3;
  for (int i = 0; i < 3; ++i) {
    const std::uint32_t n = corners[i];
    points[i] = {{vertices_.x[n], vertices_.y[n], vertices_.z[n]},
                 {vertices_.red[n], vertices_.green[n], vertices_.blue[n]}};
  }
  const float slope_x = 0.5F * static_cast<float>(sheet.width) * kGuard / view_.column_scale;
  const float slope_y = 0.5F * static_cast<float>(sheet.height) * kGuard / view_.row_scale;
  const float planes[5][4] = {
      {0, 0, 1, -view_.near}, {1, 0, slope_x, 0}, {-1, 0, slope_x, 0}, {0, 1, slope_y, 0}, {0, -1, slope_y, 0}};
  for (const auto& plane : planes) {
    const auto inside = [&](const Point& p) {
      return plane[0] * p.at[0] + plane[1] * p.at[1] + plane[2] * p.at[2] + plane[3];
    };
    int found = 0;
    for (int i = 0; i < count; ++i) {
      const Point &here = points[i], &next = points[(i + 1) % count];
      const float a = inside(here), b = inside(next);
      if (a >= 0.0F) kept[found++] = here;
      if ((a >= 0.0F) != (b >= 0.0F)) {
        const float t = a / (a - b);
        Point& cut = kept[found++];
        for (int k = 0; k < 3; ++k) {
          cut.at[k] = here.at[k] + t * (next.at[k] - here.at[k]);
          cut.colour[k] = here.colour[k] + t * (next.colour[k] - here.colour[k]);
        }
      }
    }
    if (found < 3) return;
    count = found;
    std::copy_n(kept, count, points);
  }
  Corner triangle[3] = {project(points[0].at, points[0].colour), {}, {}};
  for (int i = 1; i + 1 < count; ++i) {
    triangle[1] = project(points[i].at, points[i].colour);
    triangle[2] = project(points[i + 1].at, points[i + 1].colour);
    draw_triangle(triangle, alpha, sheet);
  }
}

void Rasteriser::draw_triangle(const Corner (&corners)[3], float alpha, Sheet& sheet) const {
  const Corner &a = corners[0], &b = corners[1], &c = corners[2];
  const auto first = [](float value) { return static_cast<int>(std::ceil(std::max(value - 0.5F, -1.0F))); };
  const int left = std::max(0, first(std::min({a.column, b.column, c.column})));
  const int top = std::max(0, first(std::min({a.row, b.row, c.row})));
  const auto last = [](float value, int size) {
    return static_cast<int>(std::floor(std::clamp(value - 0.5F, -1.0F, static_cast<float>(size - 1))));
  };
  const int right = last(std::max({a.column, b.column, c.column}), sheet.width);
  const int bottom = last(std::max({a.row, b.row, c.row}), sheet.height);
  if (left > right || top > bottom) return;
  const float bx = b.column - a.column, by = b.row - a.row, cx = c.column - a.column, cy = c.row - a.row;
  const float area = bx * cy - cx * by;  // negative: the row counts downwards
  if (!(area < 0.0F)) return;
  const float scale = 1.0F / area;
  // Everything is linear on the sheet: the shares of b and c, the nearness, and colours times nearness.
  const float share_b_dx = cy * scale, share_b_dy = -cx * scale, share_c_dx = -by * scale, share_c_dy = bx * scale;
  const float edge = std::min(-kEdge * scale, kMostEdge);
  struct Ramp {
    float start, dx, dy;
  };
  const auto ramp = [&](float at_a, float at_b, float at_c) {
    const float to_b = at_b - at_a, to_c = at_c - at_a;
    return Ramp{at_a, to_b * share_b_dx + to_c * share_c_dx, to_b * share_b_dy + to_c * share_c_dy};
  };
  const Ramp near = ramp(a.nearness, b.nearness, c.nearness);
  const Ramp red = ramp(a.red * a.nearness, b.red * b.nearness, c.red * c.nearness);
  const Ramp green = ramp(a.green * a.nearness, b.green * b.nearness, c.green * c.nearness);
  const Ramp blue = ramp(a.blue * a.nearness, b.blue * b.nearness, c.blue * c.nearness);
  const float origin_x = static_cast<float>(left) + 0.5F - a.column;
  const int width = right - left + 1;
  for (int y = top; y <= bottom; ++y) {
    const float dy = static_cast<float>(y) + 0.5F - a.row;
    const auto at_left = [&](const Ramp& one) { return one.start + origin_x * one.dx + dy * one.dy; };
    const float b_left = origin_x * share_b_dx + dy * share_b_dy, c_left = origin_x * share_c_dx + dy * share_c_dy;
    const float near_left = at_left(near), red_left = at_left(red), green_left = at_left(green),
                blue_left = at_left(blue);
    const std::size_t offset = static_cast<std::size_t>(y) * sheet.width + left;
    float* const nearness = sheet.nearness.data() + offset;
    std::uint32_t* const colours = sheet.colours.data() + offset;
    const auto colour = [&](float x, float here) {
      const float distance = 1.0F / here;
      return packed((red_left + x * red.dx) * distance, (green_left + x * green.dx) * distance,
                    (blue_left + x * blue.dx) * distance);
    };
    if (width < kWide || alpha < 1.0F) {
      for (int i = 0; i < width; ++i) {
        const auto x = static_cast<float>(i);
        const float share_b = b_left + x * share_b_dx, share_c = c_left + x * share_c_dx;
        const float least = std::min(1.0F - share_b - share_c, std::min(share_b, share_c));
        const float here = near_left + x * near.dx;
        if (!(least >= (alpha < 1.0F ? 0.0F : -edge) && here > nearness[i])) continue;
        if (alpha < 1.0F) {
          if (share_b == 0.0F) continue;  // the neighbour's: what two triangles share is mixed in once
          colours[i] = mixed(colour(x, here), colours[i], alpha);
        } else {
          nearness[i] = here;
          colours[i] = colour(x, here);
        }
      }
      continue;
    }
    // Of a wide triangle, the part of the row that is inside; then whole vectors of pixels.
    float start = 0.0F, stop = static_cast<float>(width - 1);
    const auto cut = [&](float at_left, float dx) {  // where at_left + x dx is at least -edge
      const float bound = (-edge - at_left) / dx;
      if (dx > 0.0F)
        start = std::max(start, bound);
      else if (dx < 0.0F)
        stop = std::min(stop, bound);
      else if (at_left < -edge)
        stop = -1.0F;
    };
    cut(b_left, share_b_dx);
    cut(c_left, share_c_dx);
    cut(1.0F - b_left - c_left, -share_b_dx - share_c_dx);
    if (!(start <= stop)) continue;
    const int begin = static_cast<int>(std::ceil(start)), end = static_cast<int>(stop) + 1;
#pragma GCC ivdep
    for (int i = begin; i < end; ++i) {
      const auto x = static_cast<float>(i);
      const float here = near_left + x * near.dx;
      const float before = nearness[i];
      const std::uint32_t mask = here > before ? 0xFFFFFFFFU : 0U;  // arithmetic in place of branches
      nearness[i] = before < here ? here : before;
      colours[i] = (colour(x, here) & mask) | (colours[i] & ~mask);
    }
  }
}

}  // namespace rcs
