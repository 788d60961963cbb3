// Python names of cameras that draw into a learner's arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "gil.hpp"
#include "lens_object.hpp"
#include "mujoco_objects.hpp"
#include "rcs/pixel_cameras.hpp"
#include "rcs/world.hpp"
#include "render_options.hpp"

using namespace nb::literals;

namespace {

using Frames = In<std::uint8_t, nb::numpy, nb::c_contig, nb::device::cpu, nb::shape<-1, -1, -1, -1>>;
using Uses = In<const std::uint8_t, nb::numpy, nb::c_contig, nb::device::cpu, nb::shape<-1>>;
using Lenses = std::vector<std::optional<PyLens>>;

constexpr std::uint8_t kLeave = 4;
const int kUses[] = {0, 1, 2, 3, kLeave};

// The cameras with the memory of their lenses, and the arrays that they draw to or read.
struct PyPixelCameras : rcs::PixelCameras {
  PyPixelCameras(const mjModel* model, int copies, int threads, std::vector<rcs::PixelCamera> cameras,
                 std::shared_ptr<const Lenses> kept_lenses, rcs::PixelLayout layout, const rcs::RenderOptions& options)
      : rcs::PixelCameras(model, copies, threads, std::move(cameras), layout, options),
        lenses(std::move(kept_lenses)) {}

  std::shared_ptr<const Lenses> lenses;
  std::vector<Frames> to_arrays, from_arrays;
};

void check_frames(const PyPixelCameras& self, const std::vector<Frames>& arrays) {
  if (arrays.size() != self.camera_count()) throw std::invalid_argument("there must be one array for each camera");
  for (std::size_t i = 0; i < arrays.size(); ++i) {
    const rcs::PixelCamera& camera = self.camera(i);
    const int shape[4] = {self.copies(), self.channels(), camera.height, camera.width};
    for (std::size_t axis = 0; axis < 4; ++axis)
      if (arrays[i].shape(axis) != static_cast<std::size_t>(shape[axis]))
        throw std::invalid_argument("an array must have the shape (copies, channels, height, width), here (" +
                                    std::to_string(shape[0]) + ", " + std::to_string(shape[1]) + ", " +
                                    std::to_string(shape[2]) + ", " + std::to_string(shape[3]) + ")");
  }
}

}  // namespace

void bind_pixels(nb::module_& m) {
  nb::class_<PyPixelCameras>(m, "PixelCameras", R"(Cameras of all copies of a world as learners want their pictures.

After each step of a copy, the thread that has stepped it draws its cameras into arrays (copies, channels, height, width),
where channels are those of all frames of a stack, the newest last. In quality "fast", scenes without textures, soft bodies
and height fields are drawn without OpenGL, in a fifth to a half of the time; the pictures look the same but for rounding.)")
      .def(
          "__init__",
          [](PyPixelCameras* self, const PyModel& given, int copies, int threads, const std::vector<int>& camera_ids,
             int width, int height, bool is_grayscale, int stack, const Lenses& lenses, const std::string& quality,
             int max_width, int max_height, const std::string& backend, const Groups& geom_groups) {
            if (!lenses.empty() && lenses.size() != camera_ids.size())
              throw std::invalid_argument("lenses, when given, must have one entry for each camera");
            const auto kept = std::make_shared<const Lenses>(lenses);
            std::vector<rcs::PixelCamera> cameras;
            for (std::size_t i = 0; i < camera_ids.size(); ++i) {
              const PyLens* lens = kept->empty() || !(*kept)[i] ? nullptr : &*(*kept)[i];
              if (lens != nullptr && lens->lookup &&
                  (lens->lookup->shape(0) != static_cast<std::size_t>(height) ||
                   lens->lookup->shape(1) != static_cast<std::size_t>(width)))
                throw std::invalid_argument("the lookup of a lens must have the height and width of the pictures");
              cameras.push_back({camera_ids[i], width, height, lens == nullptr ? nullptr : &lens->value});
            }
            const rcs::RenderOptions options = render_options(quality, max_width, max_height, backend, geom_groups);
            const mjModel* model = given.get();
            const ReleasedGil unlocked;
            new (self) PyPixelCameras(model, copies, threads, std::move(cameras), kept, {is_grayscale, stack}, options);
          },
          nb::keep_alive<1, 2>(), "model"_a, "copies"_a, "threads"_a, "camera_ids"_a, nb::kw_only(), "width"_a,
          "height"_a, "is_grayscale"_a = false, "stack"_a = 1, "lenses"_a = Lenses(), "quality"_a = "fast",
          "max_width"_a, "max_height"_a, "backend"_a = "auto", "geom_groups"_a = kShown, R"(Prepare the cameras.

Args:
    model: The scene, which is kept alive.
    copies: Copies of the world.
    threads: Its threads: how many draw at once.
    camera_ids: Indices of the cameras in the model.
    width: Width of the pictures [pixels].
    height: The same.
    is_grayscale: One channel of luma (ITU-R BT.601) instead of red, green and blue.
    stack: Frames of an observation.
    lenses: Empty, or for each camera its lens or None.
    quality: "fast" or "full", as for `Renderer`, like all that follow.
    max_width: Largest width of a picture or of a lens's canvas [pixels].
    max_height: The same of the height.
    backend: "auto", "egl" or "osmesa".
    geom_groups: Which of the six groups of geoms are drawn.

Raises:
    ValueError: An argument is not valid.
    MissingDependency: OpenGL is needed and there is none.)")
      .def(
          "watch", [](const std::shared_ptr<PyPixelCameras>& self, rcs::World& world) { world.watch(self); }, "world"_a,
          "Have the threads of a world draw after each step.")
      .def(
          "turn",
          [](PyPixelCameras& self, std::vector<Frames> to, std::optional<std::vector<Frames>> before) {
            check_frames(self, to);
            if (before) check_frames(self, *before);
            std::vector<std::uint8_t*> places;
            std::vector<const std::uint8_t*> sources;
            for (Frames& one : to) places.push_back(one.data());
            if (before)
              for (const Frames& one : *before) sources.push_back(one.data());
            self.turn(std::move(places), std::move(sources));
            self.to_arrays = std::move(to);
            self.from_arrays = before ? std::move(*before) : std::vector<Frames>();
          },
          "to"_a.noconvert(), "before"_a.noconvert() = nb::none(),
          R"(Have what is drawn from now on go to some arrays, which are kept until the next turn.

Args:
    to: For each camera an array that is filled in place, (copies, channels, height, width).
    before: For each camera the array with the frames of the step before, of the same shape; None for none.)")
      .def_prop_ro(
          "drawn",
          [](PyPixelCameras& self) {
            const std::size_t shape[1] = {self.drawn().size()};
            return nb::ndarray<nb::numpy, const std::uint8_t>(self.drawn().data(), 1, shape, nb::find(&self));
          },
          kOwned, "Live flags (copies,): 1 for those that were drawn in a step since the last turn.")
      .def(
          "show",
          [](PyPixelCameras& self, rcs::World& world, const Uses& uses) {
            if (uses.shape(0) != static_cast<std::size_t>(self.copies()))
              throw std::invalid_argument("uses must have one entry for each copy");
            std::vector<rcs::FrameUse> chosen(uses.shape(0), rcs::FrameUse::keep);
            std::vector<int> copies;
            for (std::size_t i = 0; i < uses.shape(0); ++i) {
              if (uses(i) > kLeave) throw std::invalid_argument("a use is a number from 0 to 4");
              if (uses(i) == kLeave) continue;
              chosen[i] = static_cast<rcs::FrameUse>(uses(i));
              if (chosen[i] == rcs::FrameUse::keep && self.can_keep())
                self.keep(static_cast<int>(i));
              else
                copies.push_back(static_cast<int>(i));
            }
            const ReleasedGil unlocked;
            self.set_uses(chosen);
            world.show(self, copies);
          },
          "world"_a, "uses"_a, R"(Fill the arrays of copies as they are now, on the world's threads.

Args:
    world: The world.
    uses: The use of each copy, (copies,) uint8: `KEEP` what was there before, `ADVANCE` (the frames of a stack move
        up for the newest), `START` (the newest frame in every place), `REPLACE` the newest frame, or `LEAVE` as it is.)")
      .def_prop_ro("why_opengl", &rcs::PixelCameras::why_opengl, "Why OpenGL draws; empty if it does not.")
      .def_ro_static("KEEP", &kUses[0])
      .def_ro_static("ADVANCE", &kUses[1])
      .def_ro_static("START", &kUses[2])
      .def_ro_static("REPLACE", &kUses[3])
      .def_ro_static("LEAVE", &kUses[4]);
}
