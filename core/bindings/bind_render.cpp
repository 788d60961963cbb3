#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "rcs/renderer.hpp"

namespace nb = nanobind;
using namespace nb::literals;
void bind_render(nb::module_& m) {
  m.def("probe_gl", [] { nb::list l; for (auto& p : rcs::probe_gl()) l.append(nb::make_tuple(p.name, p.ok, p.detail)); return l; });
  nb::class_<rcs::Renderer>(m, "Renderer")
    .def("__init__", [](rcs::Renderer* self, uintptr_t a, bool full, int w, int h, std::string backend) {
        rcs::RenderOptions o; o.quality = full ? rcs::Quality::full : rcs::Quality::fast; o.max_width = w; o.max_height = h; o.backend = backend;
        new (self) rcs::Renderer(reinterpret_cast<const mjModel*>(a), o); }, "model"_a, "full"_a=false, "w"_a=640, "h"_a=480, "backend"_a="auto")
    .def("update", [](rcs::Renderer& s, uintptr_t d) { nb::gil_scoped_release r; s.update(reinterpret_cast<mjData*>(d)); })
    .def("render", [](rcs::Renderer& s, int cam, nb::ndarray<uint8_t, nb::shape<-1,-1,3>, nb::c_contig> rgb) {
        rcs::Picture p{(int)rgb.shape(1), (int)rgb.shape(0), rgb.data(), nullptr}; nb::gil_scoped_release r; s.render(cam, p); })
    .def("close", &rcs::Renderer::close);
}
