#include "rcs/pixel_cameras.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "pixels.hpp"
#include "rasteriser.hpp"
#include "rcs/result.hpp"
#include "scene_view.hpp"
#include "trap.hpp"

namespace rcs {

namespace {

// Shares of red, green and blue in luma, in 256ths (ITU-R BT.601: 0.299, 0.587, 0.114).
constexpr int kRed = 77, kGreen = 150, kBlue = 29;

// Write pixels as planes, of which there are one or three. `colour` gives red, green and blue of the pixel of a number.
template <typename Colour>
void write_planes(std::size_t size, bool is_grayscale, std::uint8_t* out, Colour colour) {
  if (is_grayscale) {
    for (std::size_t i = 0; i < size; ++i) {
      const auto [red, green, blue] = colour(i);
      out[i] = static_cast<std::uint8_t>((kRed * red + kGreen * green + kBlue * blue + 128) >> 8);
    }
    return;
  }
  std::uint8_t *reds = out, *greens = out + size, *blues = out + 2 * size;
  for (std::size_t i = 0; i < size; ++i) {
    const auto [red, green, blue] = colour(i);
    reds[i] = static_cast<std::uint8_t>(red);
    greens[i] = static_cast<std::uint8_t>(green);
    blues[i] = static_cast<std::uint8_t>(blue);
  }
}

struct Colour {
  int red, green, blue;
};

}  // namespace

/// The tools of one thread that draws: its own way, or OpenGL.
struct PixelCameras::Painter {
  std::unique_ptr<SceneView> view;
  std::unique_ptr<Rasteriser> rasteriser;
  std::unique_ptr<Renderer> renderer;
  Sheet sheet;
  std::vector<Backdrop> backdrops;  // one for each camera
  std::vector<std::uint8_t> rgb;    // height × width × 3
  std::vector<std::uint8_t> looked_up;
};

/// A painter that no other thread has.
class PixelCameras::Borrowed {
 public:
  explicit Borrowed(PixelCameras& owner) : owner_(owner) {
    const std::lock_guard lock(owner_.mutex_);
    if (owner_.free_.empty()) throw WrongOrder("pixel cameras: more threads draw than they were made for");
    painter_ = owner_.free_.back();
    owner_.free_.pop_back();
  }
  ~Borrowed() {
    const std::lock_guard lock(owner_.mutex_);
    owner_.free_.push_back(painter_);
  }
  Borrowed(const Borrowed&) = delete;
  Borrowed& operator=(const Borrowed&) = delete;
  Painter& operator*() const { return *painter_; }

 private:
  PixelCameras& owner_;
  Painter* painter_;
};

PixelCameras::PixelCameras(const mjModel* model, int copies, int threads, std::vector<PixelCamera> cameras,
                           PixelLayout layout, const RenderOptions& options)
    : signature_(model->signature), cameras_(std::move(cameras)), layout_(layout) {
  if (copies < 1 || threads < 1 || layout.stack < 1)
    throw std::invalid_argument("pixel cameras: at least 1 copy, 1 thread and 1 frame are needed, not " +
                                std::to_string(copies) + ", " + std::to_string(threads) + " and " +
                                std::to_string(layout.stack));
  for (const PixelCamera& one : cameras_) {
    std::uint8_t nothing = 0;
    check_picture(*model, options, one.camera, {one.width, one.height, &nothing, nullptr, nullptr, one.lens});
  }
  why_opengl_ = options.quality == Quality::fast ? Rasteriser::why_not(*model, options.geom_groups)
                                                 : "it is drawn in full quality";
  for (int i = 0; i < threads; ++i) {
    auto painter = std::make_unique<Painter>();
    if (uses_opengl()) {
      painter->renderer = std::make_unique<Renderer>(model, options);
    } else {
      painter->view = std::make_unique<SceneView>(model, options);
      painter->rasteriser = std::make_unique<Rasteriser>(model);
    }
    painter->backdrops.resize(cameras_.size());
    free_.push_back(painter.get());
    painters_.push_back(std::move(painter));
  }
  drawn_.assign(static_cast<std::size_t>(copies), 0);
  uses_.assign(static_cast<std::size_t>(copies), FrameUse::start);
}

PixelCameras::~PixelCameras() = default;

void PixelCameras::check(const mjModel* model, int copies) const {
  if (model->signature != signature_) throw InvalidSetup("pixel cameras: the world has another model than theirs");
  if (copies > this->copies())
    throw InvalidSetup("pixel cameras: the world has " + std::to_string(copies) + " copies, they are for " +
                       std::to_string(this->copies()));
}

void PixelCameras::turn(std::vector<std::uint8_t*> to, std::vector<const std::uint8_t*> from) {
  if (to.size() != cameras_.size() || (!from.empty() && from.size() != cameras_.size()))
    throw std::invalid_argument("pixel cameras: one array for each of " + std::to_string(cameras_.size()) +
                                " cameras is needed");
  to_ = std::move(to);
  from_ = std::move(from);
  std::ranges::fill(drawn_, std::uint8_t{0});
}

void PixelCameras::set_uses(std::span<const FrameUse> uses) {
  if (uses.size() != uses_.size())
    throw std::invalid_argument("pixel cameras: one use for each of " + std::to_string(uses_.size()) +
                                " copies is needed, not " + std::to_string(uses.size()));
  std::ranges::copy(uses, uses_.begin());
}

void PixelCameras::see_step(const mjModel* model, mjData* data, int copy) {
  if (to_.empty()) return;
  draw(model, data, copy, FrameUse::advance);
  drawn_[static_cast<std::size_t>(copy)] = 1;
}

void PixelCameras::see(const mjModel* model, mjData* data, int copy) {
  if (to_.empty()) throw WrongOrder("pixel cameras: there is no array to draw to; call turn first");
  draw(model, data, copy, uses_[static_cast<std::size_t>(copy)]);
}

PixelCameras::Place PixelCameras::place(std::size_t camera, int copy) const {
  const std::size_t pixels = static_cast<std::size_t>(cameras_[camera].width) * cameras_[camera].height;
  const std::size_t frame = (layout_.is_grayscale ? 1 : 3) * pixels;
  const std::size_t offset = static_cast<std::size_t>(copy) * static_cast<std::size_t>(layout_.stack) * frame;
  return {to_[camera] + offset, from_.empty() ? nullptr : from_[camera] + offset, frame};
}

void PixelCameras::keep(int copy) {
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const auto [to, from, frame] = place(i, copy);
    std::memcpy(to, from, static_cast<std::size_t>(layout_.stack) * frame);
  }
}

void PixelCameras::draw(const mjModel* model, mjData* data, int copy, FrameUse use) {
  if (from_.empty()) use = FrameUse::start;
  if (use == FrameUse::keep) return keep(copy);
  const auto stack = static_cast<std::size_t>(layout_.stack);
  const Borrowed borrowed(*this);
  Painter& painter = *borrowed;
  trapped("pixel cameras", [&] {
    mj_comPos(model, data);
    mj_camlight(model, data);
    if (model->ntendon > 0) mj_tendon(model, data);
  });
  if (painter.renderer)
    painter.renderer->update(model, data);
  else
    painter.view->update(model, data);
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const auto [to, from, frame] = place(i, copy);
    std::uint8_t* const newest = to + (stack - 1) * frame;
    const bool is_still = model->body_weldid[model->cam_bodyid[cameras_[i].camera]] == 0;
    paint(painter, cameras_[i], is_still ? &painter.backdrops[i] : nullptr, newest);
    if (use == FrameUse::start)
      for (std::size_t n = 0; n + 1 < stack; ++n) std::memcpy(to + n * frame, newest, frame);
    else
      std::memcpy(to, from + (use == FrameUse::advance ? frame : 0), (stack - 1) * frame);
  }
}

void PixelCameras::paint(Painter& painter, const PixelCamera& camera, Backdrop* backdrop, std::uint8_t* out) const {
  const std::size_t size = static_cast<std::size_t>(camera.width) * camera.height;
  const auto write_rgb = [&](const std::vector<std::uint8_t>& rgb) {
    write_planes(size, layout_.is_grayscale, out, [pixels = rgb.data()](std::size_t i) {
      return Colour{pixels[3 * i], pixels[3 * i + 1], pixels[3 * i + 2]};
    });
  };
  const Lens* lens = camera.lens;
  if (painter.renderer) {
    painter.rgb.resize(3 * size);
    painter.renderer->render(camera.camera, {camera.width, camera.height, painter.rgb.data(), nullptr, nullptr, lens});
    return write_rgb(painter.rgb);
  }
  const bool is_looked_up = lens != nullptr && lens->lookup != nullptr;
  Sheet& sheet = painter.sheet;
  sheet.width = is_looked_up ? lens->width : camera.width;
  sheet.height = is_looked_up ? lens->height : camera.height;
  const mjvGLCamera eye = painter.view->look(camera.camera, lens, camera.height, sheet.width, sheet.height);
  painter.rasteriser->draw(painter.view->scene(), eye, sheet, backdrop);
  const auto colour = [colours = sheet.colours.data()](std::size_t i) {
    return Colour{static_cast<int>(colours[i] & 255), static_cast<int>(colours[i] >> 8 & 255),
                  static_cast<int>(colours[i] >> 16 & 255)};
  };
  if (!is_looked_up) return write_planes(size, layout_.is_grayscale, out, colour);
  painter.rgb.resize(3 * sheet.colours.size());
  for (std::size_t i = 0; i < sheet.colours.size(); ++i) {
    const auto [red, green, blue] = colour(i);
    painter.rgb[3 * i] = static_cast<std::uint8_t>(red);
    painter.rgb[3 * i + 1] = static_cast<std::uint8_t>(green);
    painter.rgb[3 * i + 2] = static_cast<std::uint8_t>(blue);
  }
  painter.looked_up.resize(3 * size);
  look_up(painter.rgb.data(), *lens, camera.width, camera.height, painter.looked_up.data());
  write_rgb(painter.looked_up);
}

}  // namespace rcs
