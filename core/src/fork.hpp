// Whether this process is a copy made by `fork`, which has the memory of its parent but not its threads. Private to the
// sources.
#pragma once

namespace rcs {

/// How many forks lie between the start of the program and this process. Objects with threads remember it when they are
/// made: in a child, waiting for a thread that is not there would last for ever.
unsigned forks();

}  // namespace rcs
