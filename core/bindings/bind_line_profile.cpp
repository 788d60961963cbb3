// How fast to go along a line.
#include <nanobind/nanobind.h>

#include "arrays.hpp"
#include "rcs/line_profile.hpp"

using namespace nb::literals;

void bind_line_profile(nb::module_& m) {
  using Profile = rcs::LineProfile;
  nb::class_<Profile>(m, "LineProfile",
                      "The quickest motion along a line over a distance from speed to speed, at limited acceleration "
                      "and jerk, without acceleration at either end (Ruckig).")
      .def(
          "__init__",
          [](Profile* self, double distance, double from_speed, double to_speed, double velocity, double acceleration,
             double jerk) { new (self) Profile(distance, from_speed, to_speed, {velocity, acceleration, jerk}); },
          "distance"_a, "from_speed"_a, "to_speed"_a, "velocity"_a, "acceleration"_a, "jerk"_a,
          "Plan it; the unit of all numbers is that of the distance, and seconds.\n\nRaises InvalidSetup for limits "
          "that "
          "are not positive, speeds outside 0 to `velocity`, or a distance too short to get from speed to speed.")
      .def_prop_ro("duration", &Profile::duration, "s")
      .def(
          "at",
          [](const Profile& self, const Vector& times) {
            std::vector<double> rows;
            for (const double time : to_span(times)) {
              const auto row = self.at(time);
              rows.insert(rows.end(), row.begin(), row.end());
            }
            return to_array(rows, {times.shape(0), 4});
          },
          "times"_a,
          "Way, velocity, acceleration and jerk, (N, 4), at times (N,) [s] after the start; before and after, those of "
          "the ends.")
      .def_static(
          "fastest",
          [](double from_speed, double distance, double velocity, double acceleration, double jerk) {
            return Profile::fastest(from_speed, distance, {velocity, acceleration, jerk});
          },
          "from_speed"_a, "distance"_a, "velocity"_a, "acceleration"_a, "jerk"_a,
          "The highest speed up to `velocity` that can be reached from a speed over a distance.");
}
