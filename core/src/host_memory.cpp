#include "host_memory.hpp"

#include <fcntl.h>
#include <linux/futex.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <climits>
#include <ctime>

#include "rcs/host_desk.hpp"
#include "rcs/result.hpp"

namespace rcs {

namespace {
const std::uint32_t* word(const std::atomic<std::uint32_t>& number) {
  return reinterpret_cast<const std::uint32_t*>(&number);
}
}  // namespace

std::int64_t host_clock() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

std::size_t host_memory_size() { return sizeof(HostMemory); }

HostMemory* map_host_memory(int file) {
  // Memory that the other side made smaller would end this one.
  const int seals = fcntl(file, F_GET_SEALS);
  if (seals < 0 || (seals & F_SEAL_SHRINK) == 0)
    throw InvalidSetup("the memory shared with a host must be a memfd that cannot shrink (F_SEAL_SHRINK)");
  struct stat about{};
  if (fstat(file, &about) != 0 || about.st_size != static_cast<off_t>(sizeof(HostMemory)))
    throw InvalidSetup("the memory shared with a host has " + std::to_string(about.st_size) + " bytes, valid is " +
                       std::to_string(sizeof(HostMemory)) + "; start hosts and programs with the same version of rcs");
  void* memory = mmap(nullptr, sizeof(HostMemory), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  if (memory == MAP_FAILED)
    throw InvalidSetup(std::string("the memory of a host cannot be mapped: ") + strerror(errno));
  return static_cast<HostMemory*>(memory);
}

void unmap_host_memory(HostMemory* memory) { munmap(memory, sizeof(HostMemory)); }

void await_change(const std::atomic<std::uint32_t>& number, std::uint32_t value, double seconds) {
  const auto ns = static_cast<std::int64_t>(std::clamp(seconds, 0.0, 60.0) * 1e9);
  const timespec limit{ns / 1000000000, ns % 1000000000};
  syscall(SYS_futex, word(number), FUTEX_WAIT, value, &limit, nullptr, 0);
}

void wake_all(std::atomic<std::uint32_t>& number) {
  syscall(SYS_futex, word(number), FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
}

bool is_gone(int socket, int process_file) {
  std::array<pollfd, 2> files{{{socket, POLLIN, 0}, {process_file, POLLIN, 0}}};  // nobody writes to the socket
  return poll(files.data(), files.size(), 0) > 0;
}

int open_process(int process) { return static_cast<int>(syscall(SYS_pidfd_open, process, 0)); }

}  // namespace rcs
