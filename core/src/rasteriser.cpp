#include "rasteriser.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rcs {

namespace {

constexpr int kPlaneSquares = 16;
constexpr double kOpaque = 0.999;  // as in MuJoCo's renderer
constexpr int kMostLights = 8;     // of a scene, the first ones: OpenGL 1.5, as MuJoCo uses it, has no more
constexpr float kUnlit = 0.3F;     // share of its colour that MuJoCo draws of everything in a scene without any light

void set3(float* to, const float* from) { std::copy_n(from, 3, to); }

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

Rasteriser::Rasteriser(const mjModel* model, Roundness round)
    : meshes_(static_cast<std::size_t>(model->nmesh)),
      model_(model),
      box_(box_shape()),
      plane_(plane_shape(kPlaneSquares)),
      ball_(ball_shape(round)),
      cylinder_(cylinder_shape(round, true)),
      tube_(cylinder_shape(round, false)),
      cap_(half_ball_shape(round, 1)),
      cup_(half_ball_shape(round, -1)) {}

std::string Rasteriser::why_not(const mjModel& model, std::span<const bool> groups) {
  if (model.nflex > 0) return "it has a soft body";
  if (model.nskin > 0) return "it has a skin";
  for (int geom = 0; geom < model.ngeom; ++geom) {
    const int group = std::clamp(model.geom_group[geom], 0, mjNGROUP - 1);
    if (!groups[static_cast<std::size_t>(group)]) continue;
    const int type = model.geom_type[geom];
    if (type == mjGEOM_HFIELD || type == mjGEOM_SDF) return "it has a height field or a signed distance field";
  }
  // Materials that no geom has count, too: which geom has which may change with every episode.
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
  unlit_ = scene.nlight == 0 ? kUnlit : 0.0F;
  for (int i = 0; i < std::min(scene.nlight, kMostLights); ++i) {
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
  view_.far = eye.frustum_far;
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

RCS_WIDE_VECTORS
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
  float farthest = -1e30F;
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
    farthest = std::max(farthest, z[i]);
    widest = std::max(widest, std::max(std::abs(column[i]), std::abs(row[i])));
  }
  const auto limit = kGuard * static_cast<float>(std::max(sheet.width, sheet.height));
  if (nearest > view_.far) return;
  const bool is_whole = nearest >= view_.near && farthest <= view_.far && widest <= limit;

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

}  // namespace rcs
