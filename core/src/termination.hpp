// The effect of SIGTERM and SIGHUP on a program with open devices. Private to the sources.
#pragma once

namespace rcs {

/// From now on, have every open device that moves hold before one of these signals ends the process.
///
/// A signal that the program ignores or handles itself is left alone: its handler ends the program, or does not. A
/// second signal ends the process at once, and so do devices that do not hold in time.
void hold_at_termination();

}  // namespace rcs
