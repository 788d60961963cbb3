// Python names of the renderer.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "gil.hpp"
#include "lens_object.hpp"
#include "mujoco_objects.hpp"
#include "rcs/gl_context.hpp"
#include "rcs/render_pool.hpp"
#include "rcs/renderer.hpp"
#include "rcs/world.hpp"
#include "render_options.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

template <typename T, typename... Options>
using Given = In<T, nb::numpy, nb::c_contig, nb::device::cpu, Options...>;
using Rgb = Given<std::uint8_t, nb::shape<-1, -1, 3>>;
using Depth = Given<std::uint16_t, nb::shape<-1, -1>>;
using RgbFilm = Given<std::uint8_t, nb::shape<-1, -1, -1, 3>>;
using DepthFilm = Given<std::uint16_t, nb::shape<-1, -1, -1>>;
const rcs::Lens* lens_of(const PyLens* lens, std::size_t height, std::size_t width) {
  if (lens == nullptr) return nullptr;
  if (lens->lookup && (lens->lookup->shape(0) != height || lens->lookup->shape(1) != width))
    throw std::invalid_argument("the lookup of a lens must have the height and width of rgb");
  return &lens->value;
}

rcs::Picture picture(Rgb& rgb, std::optional<Depth>& depth, std::optional<Depth>& ids, const PyLens* lens) {
  for (const auto* values : {&depth, &ids})
    if (*values && ((*values)->shape(0) != rgb.shape(0) || (*values)->shape(1) != rgb.shape(1)))
      throw std::invalid_argument("depth and ids must have the height and width of rgb");
  return {static_cast<int>(rgb.shape(1)),  static_cast<int>(rgb.shape(0)), rgb.data(),
          depth ? depth->data() : nullptr, ids ? ids->data() : nullptr,    lens_of(lens, rgb.shape(0), rgb.shape(1))};
}

using Lenses = std::vector<std::optional<PyLens>>;
using Lists = std::optional<std::vector<std::optional<DepthFilm>>>;

// The array of a camera, or null.
std::uint16_t* film_values(Lists& lists, std::size_t camera, const RgbFilm& rgb) {
  if (!lists || !(*lists)[camera]) return nullptr;
  for (std::size_t axis = 0; axis < 3; ++axis)
    if ((*lists)[camera]->shape(axis) != rgb.shape(axis))
      throw std::invalid_argument("depth and ids must have the number, height and width of the rgb pictures");
  return (*lists)[camera]->data();
}

std::vector<rcs::Film> films(std::size_t rows, const std::vector<int>& cameras, std::vector<RgbFilm>& rgb, Lists& depth,
                             Lists& ids, const Lenses& lenses) {
  const auto is_missing = [&](const Lists& lists) { return lists && lists->size() != cameras.size(); };
  if (rgb.size() != cameras.size() || is_missing(depth) || is_missing(ids) ||
      (!lenses.empty() && lenses.size() != cameras.size()))
    throw std::invalid_argument("rgb, and depth, ids and lenses when given, must have one entry for each camera");
  std::vector<rcs::Film> list;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (rgb[i].shape(0) != rows) throw std::invalid_argument("rgb must have one picture for each row of states");
    const rcs::Lens* lens =
        lens_of(lenses.empty() || !lenses[i] ? nullptr : &*lenses[i], rgb[i].shape(1), rgb[i].shape(2));
    list.push_back({cameras[i], static_cast<int>(rgb[i].shape(2)), static_cast<int>(rgb[i].shape(1)), rgb[i].data(),
                    film_values(depth, i, rgb[i]), film_values(ids, i, rgb[i]), lens});
  }
  return list;
}

}  // namespace

void bind_render(nb::module_& m) {
  // A missing system library is reported as the package reports missing Python packages.
  nb::register_exception_translator([](const std::exception_ptr& pointer, void*) {
    try {
      std::rethrow_exception(pointer);
    } catch (const rcs::GlUnavailable& error) {
      const nb::object type = nb::module_::import_("rcs.errors").attr("MissingDependency");
      PyErr_SetString(type.ptr(), error.what());
    }
  });

  nb::class_<rcs::GlProbe>(m, "GlProbe", "The result of a look at one OpenGL backend.")
      .def_ro("name", &rcs::GlProbe::name, "\"egl\" or \"osmesa\".")
      .def_ro("ok", &rcs::GlProbe::ok, "Whether MuJoCo can draw with it.")
      .def_ro("detail", &rcs::GlProbe::detail, "Renderer and version, or why not and what to do.")
      .def("__repr__", [](const rcs::GlProbe& probe) {
        return "GlProbe(name='" + probe.name + "', ok=" + (probe.ok ? "True" : "False") + ", detail='" + probe.detail +
               "')";
      });
  m.def("probe_gl", &rcs::probe_gl, nb::call_guard<ReleasedGil>(),
        "Look at every OpenGL backend by making a context and dropping it. Chooses none.");

  nb::class_<PyLens>(m, "Lens", R"(A calibrated camera: focal lengths, principal point, distortion.

The scene is drawn on a canvas without distortion. The picture is the canvas, or is looked up in it pixel by pixel.)")
      .def(
          "__init__",
          [](PyLens* self, double scale_x, double scale_y, double cx, double cy, int width, int height,
             std::optional<Lookup> lookup) {
            const float* places = lookup ? lookup->data() : nullptr;
            new (self) PyLens{{scale_x, scale_y, cx, cy, width, height, places}, std::move(lookup)};
          },
          nb::kw_only(), "scale_x"_a = 1.0, "scale_y"_a = 1.0, "cx"_a, "cy"_a, "width"_a, "height"_a,
          "lookup"_a = nb::none(), R"(Describe a lens. It keeps `lookup` and does not copy it: write to it no more.

Args:
    scale_x: Focal length along x over that of the model's field of view at the picture's height.
    scale_y: The same along y.
    cx: Column of the principal point on the canvas [pixels]; the centre of the top left pixel is (0, 0).
    cy: Its row.
    width: Width of the canvas [pixels]; without a lookup that of the picture.
    height: The same.
    lookup: Column and row on the canvas that each pixel shows, shape (height, width, 2) of the picture, float32;
        None for the same ones.)");

  nb::class_<rcs::Renderer>(m, "Renderer", R"(Draws one scene as seen by the cameras of its model, off screen.

Calls may come from any thread; they wait for each other and run without the GIL.)")
      .def(
          "__init__",
          [](rcs::Renderer* self, const PyModel& given, const std::string& quality, int max_width, int max_height,
             const std::string& backend, const Groups& geom_groups, bool is_rasterised) {
            const rcs::RenderOptions chosen =
                render_options(quality, max_width, max_height, backend, geom_groups, is_rasterised);
            const mjModel* model = given.get();
            const ReleasedGil unlocked;
            new (self) rcs::Renderer(model, chosen);
          },
          nb::keep_alive<1, 2>(), "model"_a, nb::kw_only(), "quality"_a = "fast", "max_width"_a = 640,
          "max_height"_a = 480, "backend"_a = "auto", "geom_groups"_a = kShown, "is_rasterised"_a = false,
          R"(Make the OpenGL objects of a model, which is not changed.

Args:
    model: The scene; the renderer keeps it alive.
    quality: "fast" without shadows, reflections, sky and antialiasing and with coarse round shapes, or "full".
    max_width: Largest width of a picture [pixels].
    max_height: Largest height of a picture [pixels].
    backend: "auto" (EGL, else OSMesa), "egl" or "osmesa"; one per process.
    geom_groups: Which of the six groups of geoms are drawn; 3 to 5 are collision shapes by custom.
    is_rasterised: Draw colours without OpenGL in quality "fast", where OpenGL has no graphics card and the scene has neither
        textures, soft bodies nor height fields; depth and ids are drawn with it. Colours look the same but for rounding.

Raises:
    ValueError: An argument is not valid.
    MissingDependency: There is no OpenGL; the message has the remedy.)")
      .def(
          "update",
          [](rcs::Renderer& self, const PyData& given) {
            mjData* data = given.get();
            const ReleasedGil unlocked;
            self.update(data);
          },
          "data"_a,
          R"(Take over the poses in a data, once for all cameras.

Args:
    data: Data of the renderer's model, after `mj_forward` or `mj_kinematics`, `mj_comPos` and `mj_camlight`.)")
      .def(
          "update_from_state",
          [](rcs::Renderer& self, Given<const double, nb::shape<-1>> state) {
            const ReleasedGil unlocked;
            self.update_from_state({state.data(), state.size()});
          },
          "state"_a, R"(Take over the poses that follow from a state.

Args:
    state: A row of `mjSTATE_INTEGRATION`, shape (state_size,).)")
      .def(
          "render",
          [](rcs::Renderer& self, int camera_id, Rgb rgb, std::optional<Depth> depth, std::optional<Depth> ids,
             const PyLens* lens) {
            const rcs::Picture place = picture(rgb, depth, ids, lens);
            const ReleasedGil unlocked;
            self.render(camera_id, place);
          },
          "camera_id"_a, "rgb"_a.noconvert(), "depth"_a.noconvert() = nb::none(), "ids"_a.noconvert() = nb::none(),
          "lens"_a.none() = nb::none(), R"(Draw what a camera sees.

Args:
    camera_id: Index of the camera in the model.
    rgb: Filled in place, shape (height, width, 3), rows from the top.
    depth: Filled in place when given, shape (height, width) [mm], 0 where nothing is or it is beyond 65.535 m.
    ids: Filled in place when given, shape (height, width), what each pixel shows: 0 nothing, otherwise 1 + the number
        of a geom, or of a flex, a skin or a tendon, which are counted on in this order.
    lens: How the camera is calibrated; None for as in the model.

Raises:
    ValueError: There is no such camera, or the picture does not fit.)")
      .def("close", &rcs::Renderer::close, nb::call_guard<ReleasedGil>(), "Free everything. Closing twice is harmless.")
      .def_prop_ro("is_open", &rcs::Renderer::is_open)
      .def_prop_ro("state_size", &rcs::Renderer::state_size, "Length of a state.")
      .def_prop_ro("description", &rcs::Renderer::description, "Backend, renderer and OpenGL version.");

  nb::class_<rcs::RenderPool>(m, "RenderPool", R"(Draws many states of one scene at once, on several threads.

The pictures are those of a single `Renderer`, bit for bit. Calls run without the GIL and wait for each other.)")
      .def(
          "__init__",
          [](rcs::RenderPool* self, const PyModel& given, int threads, const std::string& quality, int max_width,
             int max_height, const std::string& backend, const Groups& geom_groups, bool is_rasterised) {
            const rcs::RenderOptions chosen =
                render_options(quality, max_width, max_height, backend, geom_groups, is_rasterised);
            const mjModel* model = given.get();
            const ReleasedGil unlocked;
            new (self) rcs::RenderPool(model, threads, chosen);
          },
          nb::keep_alive<1, 2>(), "model"_a, "threads"_a, nb::kw_only(), "quality"_a = "fast", "max_width"_a = 640,
          "max_height"_a = 480, "backend"_a = "auto", "geom_groups"_a = kShown, "is_rasterised"_a = false,
          R"(Make one renderer for each thread.

Args:
    model: The scene; the pool keeps it alive.
    threads: How many threads draw, the calling one included, 1 to MOST_THREADS.
    quality: As for `Renderer`, like all that follow.
    max_width: Largest width of a picture [pixels].
    max_height: Largest height of a picture [pixels].
    backend: "auto", "egl" or "osmesa".
    geom_groups: Which of the six groups of geoms are drawn.
    is_rasterised: Whether colours are drawn without OpenGL.

Raises:
    ValueError: An argument is not valid.
    MissingDependency: There is no OpenGL; the message has the remedy.)")
      .def(
          "render_states",
          [](rcs::RenderPool& self, Given<const double, nb::shape<-1, -1>> states, const std::vector<int>& camera_ids,
             std::vector<RgbFilm> rgb, Lists depth, rcs::World* world, Lists ids, const Lenses& lenses) {
            if (states.shape(1) != static_cast<std::size_t>(self.state_size()))
              throw std::invalid_argument("states has rows of " + std::to_string(states.shape(1)) +
                                          " numbers, this model's have " + std::to_string(self.state_size()));
            const std::vector<rcs::Film> wanted = films(states.shape(0), camera_ids, rgb, depth, ids, lenses);
            // Models that are all alike are the pool's own, which costs no copy of them.
            mjBatch* batch = world != nullptr && world->is_varied() ? world->batch() : nullptr;
            const std::shared_ptr<const void> memory = batch != nullptr ? world->memory() : nullptr;  // beyond a close
            const ReleasedGil unlocked;
            self.render_states({states.data(), states.size()}, wanted, batch);
          },
          "states"_a, "camera_ids"_a, "rgb"_a.noconvert(), "depth"_a.noconvert() = nb::none(), "world"_a = nb::none(),
          "ids"_a.noconvert() = nb::none(), "lenses"_a = Lenses(), R"(Draw each state with each camera.

Args:
    states: Rows of `mjSTATE_INTEGRATION`, shape (n, state_size).
    camera_ids: Indices of the cameras in the model.
    rgb: For each camera an array that is filled in place, shape (n, height, width, 3), rows from the top.
    depth: None, or for each camera None or an array that is filled in place, shape (n, height, width) [mm].
    world: A world of as many copies, whose fields of the model row i has those of copy i; None for those of the
        pool's model.
    ids: None, or for each camera None or an array that is filled in place, shape (n, height, width), as in
        `Renderer.render`.
    lenses: Empty, or for each camera its lens or None.

Raises:
    ValueError: A shape or a camera is not valid, or the world is of another model.)")
      .def("close", &rcs::RenderPool::close, nb::call_guard<ReleasedGil>(),
           "End the threads and free everything. Closing twice is harmless.")
      .def_prop_ro("is_open", &rcs::RenderPool::is_open)
      .def_prop_ro("threads", &rcs::RenderPool::threads)
      .def_prop_ro_static(
          "MOST_THREADS", [](nb::handle) { return rcs::RenderPool::kMostThreads; }, "Most threads of a pool.")
      .def_prop_ro("state_size", &rcs::RenderPool::state_size, "Length of a state.")
      .def_prop_ro("description", &rcs::RenderPool::description, "Backend, renderer and OpenGL version.");
}
