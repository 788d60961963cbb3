#include "open_devices.hpp"

#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <system_error>
#include <thread>
#include <utility>

#include "termination.hpp"

namespace rcs {

namespace {

std::atomic<OpenDevices*>& instance() {
  static std::atomic<OpenDevices*> only = new OpenDevices;
  return only;
}

// The locks of the parent may be taken in its child, and its thread is not there: the child leaves them as they are.
[[maybe_unused]] const int g_registered = pthread_atfork(nullptr, nullptr, [] { instance() = new OpenDevices; });

}  // namespace

OpenDevices& OpenDevices::get() { return *instance(); }

OpenDevices::Entry& OpenDevices::entry(Device& device) {
  const auto found = std::ranges::find(entries_, &device, &Entry::device);
  return found != entries_.end() ? *found : entries_.emplace_back(Entry{&device});
}

void OpenDevices::add(Device& device) {
  if (device.moves()) hold_at_termination();
  const std::lock_guard lock(mutex_);
  entry(device).deadline = kNever;
}

void OpenDevices::remove(Device& device) {
  const std::lock_guard lock(mutex_);
  std::erase_if(entries_, [&](const Entry& entry) { return entry.device == &device; });
}

void OpenDevices::await(Device& device) {
  std::unique_lock lock(mutex_);
  released_.wait(lock, [&] { return std::ranges::find(busy_, &device) == busy_.end(); });
}

void OpenDevices::release(Device* device) {
  busy_.erase(std::ranges::find(busy_, device));
  released_.notify_all();
}

OpenDevices::Clock::time_point OpenDevices::exchange_deadline(Device& device, Clock::time_point deadline) {
  const std::lock_guard lock(mutex_);
  const auto former = std::exchange(entry(device).deadline, deadline);
  if (deadline < kNever && !is_watching_) {
    std::thread([this] { watch(); }).detach();
    is_watching_ = true;
  }
  if (deadline < wakes_at_) changed_.notify_one();
  return former;
}

void OpenDevices::stop_all(const std::string& reason) {
  std::vector<Device*> devices;
  {
    const std::lock_guard lock(mutex_);
    for (const Entry& entry : entries_)
      if (entry.device->moves()) devices.push_back(entry.device);
    busy_.insert(busy_.end(), devices.begin(), devices.end());
  }
  for (Device* device : devices) device->mark_fault(reason);
  {
    // One that takes its time must not keep the others moving.
    std::vector<Device*> alone;
    std::vector<std::jthread> threads;
    threads.reserve(devices.size());
    for (Device* device : devices) {
      try {
        threads.emplace_back([device, &reason] {
          device->set_fault(reason);
          device->do_await_rest();
        });
      } catch (const std::system_error&) {
        device->set_fault(reason);  // no thread can be started: one after the other is better than none
        alone.push_back(device);
      }
    }
    for (Device* device : alone) device->do_await_rest();
  }
  const std::lock_guard lock(mutex_);
  for (Device* device : devices) release(device);
}

void OpenDevices::watch() {
  pthread_setname_np(pthread_self(), "rcs watchdog");
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are for the threads of the program
  std::unique_lock lock(mutex_);
  while (true) {
    const auto next = std::ranges::min_element(entries_, {}, &Entry::deadline);
    wakes_at_ = next == entries_.end() ? kNever : next->deadline;
    if (wakes_at_ == kNever) {
      changed_.wait(lock);
    } else if (Clock::now() < wakes_at_) {
      changed_.wait_until(lock, wakes_at_);
    } else {
      Device* device = next->device;
      next->deadline = kNever;
      busy_.push_back(device);
      lock.unlock();
      // One that takes its time must not keep the others moving.
      const auto lapse = [this, device] {
        device->lapse();
        const std::lock_guard held(mutex_);
        release(device);
      };
      try {
        std::thread(lapse).detach();
      } catch (const std::system_error&) {
        lapse();  // no thread can be started: one after the other is better than none
      }
      lock.lock();
    }
  }
}

void stop_all(const std::string& reason) { OpenDevices::get().stop_all(reason); }

}  // namespace rcs
