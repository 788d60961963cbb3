// Errors of cameras.
#include <nanobind/nanobind.h>

#include <cstdint>
#include <stdexcept>

#include "arrays.hpp"
#include "gil.hpp"
#include "rcs/sensor_noise.hpp"

using namespace nb::literals;

namespace {

template <typename T, typename... Options>
using Given = In<T, nb::numpy, nb::c_contig, nb::device::cpu, Options...>;

}  // namespace

void bind_sensor_noise(nb::module_& m) {
  m.def(
      "add_colour_noise",
      [](Given<std::uint8_t> rgb, Given<const std::int8_t, nb::shape<-1>> table, std::uint64_t seed) {
        const ReleasedGil unlocked;
        rcs::add_colour_noise({rgb.data(), rgb.size()}, {table.data(), table.size()}, seed);
      },
      "rgb"_a.noconvert(), "table"_a, "seed"_a, R"(Add noise to colours, in place.

Args:
    rgb: Colours of any shape.
    table: Errors of 256 equally likely cases.
    seed: Determines which ones come.)");
  m.def(
      "measure_stereo",
      [](Given<std::uint16_t, nb::shape<-1, -1>> depth, Given<const std::uint8_t, nb::shape<-1, -1, 3>> rgb,
         double focal, double middle, double baseline, double half_width, double nearest, double deviation,
         double steepest, double steep_loss, double dark, Given<const float, nb::shape<-1>> normal,
         std::uint64_t seed) {
        const rcs::StereoEyes eyes{focal, middle, baseline, half_width, nearest, deviation, steepest, steep_loss, dark};
        if (depth.size() == 0) throw std::invalid_argument("depth must not be empty");
        const ReleasedGil unlocked;
        rcs::measure_stereo({depth.data(), depth.size()}, {rgb.data(), rgb.size()}, static_cast<int>(depth.shape(1)),
                            eyes, {normal.data(), normal.size()}, seed);
      },
      "depth"_a.noconvert(), "rgb"_a, nb::kw_only(), "focal"_a, "middle"_a, "baseline"_a, "half_width"_a, "nearest"_a,
      "deviation"_a, "steepest"_a, "steep_loss"_a, "dark"_a, "normal"_a, "seed"_a,
      R"(Replace true depth by what a stereo camera would measure, in place; 0 is no reading.

Args:
    depth: Depth in the picture of the left eye [mm], shape (height, width).
    rgb: Its colours, shape (height, width, 3).
    focal: Focal length [pixels].
    middle: Column of the principal point [pixels].
    baseline: Distance from the left eye to the right one [m].
    half_width: Tangent of half the right eye's field of view along x; 0 for no end.
    nearest: Nearest depth that can be measured [m].
    deviation: Standard deviation of a disparity [pixels].
    steepest: Tangent of the angle between view and normal from which a surface is steep.
    steep_loss: Share of steep pixels without a reading.
    dark: Brightness below which readings get lost [of 255].
    normal: Quantiles of the standard normal distribution of equally likely cases, as many as a power of two.
    seed: Determines which cases come.

Raises:
    ValueError: A shape does not fit.)");
}
