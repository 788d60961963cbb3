// Values in shared memory, which one side writes while the other reads.
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <memory>
#include <thread>

#include "../src/host_memory.hpp"
#include "check.hpp"
#include "rcs/result.hpp"

namespace {

[[maybe_unused]] void a_writer_that_takes_long_is_waited_for() {
  using Large = std::array<char, std::size_t{32} << 20>;
  const auto shared = std::make_unique<rcs::Guarded<Large>>();
  const auto seen = std::make_unique<Large>();
  std::atomic<bool> ends = false;
  std::thread writer([&] {
    const auto value = std::make_unique<Large>();
    for (char letter = 'a'; !ends; letter = letter == 'z' ? 'a' : static_cast<char>(letter + 1)) {
      value->fill(letter);
      shared->write(*value);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  });
  for (int i = 0; i < 20; ++i) {
    CHECK(shared->read(*seen));
    CHECK(std::ranges::all_of(*seen, [&](char letter) { return letter == seen->front(); }));
  }
  ends = true;
  writer.join();
}

void memory_of_another_size_is_refused() {
  for (const int more : {-8, 8}) {
    const int file = memfd_create("rcs test", MFD_ALLOW_SEALING);
    CHECK(ftruncate(file, static_cast<off_t>(sizeof(rcs::HostMemory)) + more) == 0);
    CHECK(fcntl(file, F_ADD_SEALS, F_SEAL_SHRINK) == 0);
    CHECK_THROWS(rcs::InvalidSetup, rcs::map_host_memory(file));
    close(file);
  }
}

void a_text_ends_with_a_whole_character() {
  rcs::HostText<8> text{};
  text.set("\u00e9\u00e9\u00e9\u00e9");
  CHECK(text.get() == "\u00e9\u00e9\u00e9");
  text.set("1234567");
  CHECK(text.get() == "1234567");
}

}  // namespace

int main() {
  memory_of_another_size_is_refused();
  a_text_ends_with_a_whole_character();
#ifndef __SANITIZE_THREAD__  // what is read while it is written is read again; the sanitizer does not know fences
  a_writer_that_takes_long_is_waited_for();
#endif
  return rcs::test::result();
}
