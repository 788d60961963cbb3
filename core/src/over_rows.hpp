// Rows of a batch, shared out among threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>
#include <thread>
#include <vector>

namespace rcs {

/// Call `work(first, end)` for shares of all rows below `count`, one for each of at most `threads` threads. Throws what
/// the first of them has thrown.
template <typename Work>
void over_shares(std::size_t count, int threads, const Work& work) {
  // More threads than cores help nobody, and a machine may refuse to start them.
  const std::size_t cores = std::max<std::size_t>(std::thread::hardware_concurrency(), 1);
  const std::size_t workers = std::min({static_cast<std::size_t>(std::max(threads, 1)), cores, count});
  if (workers <= 1) return work(std::size_t{0}, count);
  std::vector<std::exception_ptr> errors(workers);
  const auto run = [&](std::size_t w) {
    try {
      work(count * w / workers, count * (w + 1) / workers);
    } catch (...) {
      errors[w] = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> pool;
    for (std::size_t w = 1; w < workers; ++w) pool.emplace_back(run, w);
    run(0);
  }
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

/// Call `solve(i)` for each row in such shares.
template <typename Solve>
void over_rows(std::size_t count, int threads, const Solve& solve) {
  over_shares(count, threads, [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) solve(i);
  });
}

}  // namespace rcs
