// The newest value of one thread for another, where neither waits for the other. Private to the sources.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace rcs {

/// Three values: one is written, one is read, and the third is exchanged for either.
template <typename T>
class Newest {
 public:
  /// The writer's: fill it in, then publish it. It has an old value.
  T& next() { return values_[written_]; }
  void publish() { written_ = between_.exchange(written_ | kFresh, std::memory_order_acq_rel) & kIndex; }

  /// The reader's: whether there is a value that it has not taken yet, and the last one that was published.
  bool is_fresh() const { return between_.load(std::memory_order_acquire) & kFresh; }
  const T& take() {
    if (is_fresh()) read_ = between_.exchange(read_, std::memory_order_acq_rel) & kIndex;
    return values_[read_];
  }

 private:
  static constexpr std::uint8_t kIndex = 3, kFresh = 4;

  std::array<T, 3> values_{};
  std::atomic<std::uint8_t> between_ = 0;
  std::uint8_t written_ = 1, read_ = 2;
};

}  // namespace rcs
