// The interface of a hand with many joints.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "rcs/device.hpp"

namespace rcs {

/// What a hand measures.
struct HandState {
  std::vector<double> joints;  ///< normalised, 0 … 1 of each joint's range
  double time = 0.0;           ///< s, on the device's own monotonic clock
};

/// One multi-fingered hand. An implementation overrides the `do_` functions; users call the others.
class Hand {
 public:
  Hand(std::string name, int joint_count);
  virtual ~Hand() = default;
  Hand(const Hand&) = delete;
  Hand& operator=(const Hand&) = delete;

  const std::string& name() const { return life_.name(); }
  int joint_count() const { return joint_count_; }
  bool is_open() const { return life_.is_open(); }
  const std::string& fault() const { return life_.fault(); }

  void open();
  HandState state();
  /// Set every joint (normalised, 0 … 1) and return at once. Throws `InvalidCommand`, `WrongOrder`, `DeviceFault`.
  void command_joints(std::span<const double> joints);
  bool has_arrived();
  void hold();
  void set_fault(const std::string& reason);
  void recover();
  void close();

 protected:
  virtual void do_open() {}
  virtual HandState do_state() = 0;
  virtual void do_command_joints(std::span<const double> joints) = 0;
  virtual bool do_has_arrived() = 0;
  virtual void do_hold() = 0;
  virtual void do_recover() {}
  virtual void do_close() {}

 private:
  Lifecycle life_;
  int joint_count_;
};

}  // namespace rcs
