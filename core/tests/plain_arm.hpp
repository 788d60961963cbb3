// An arm of two joints that are where a test says, and that tells which calls came.
#pragma once

#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rcs/arm.hpp"

namespace rcs::test {

inline const rcs::ArmLimits kLimits{{-1.0, -2.0}, {1.0, 2.0}, {1.0, 1.0}};

class PlainArm final : public rcs::Arm {
 public:
  explicit PlainArm(rcs::ArmLimits limits = kLimits) : Arm("arm", std::move(limits)) {}
  std::vector<double> measured{0.0, 0.0};
  std::vector<double> target{0.0, 0.0};
  std::string calls;
  bool fails_to_hold = false;

 protected:
  void do_open() override { calls += "open "; }
  rcs::ArmState do_state() override { return {measured, std::vector<double>(measured.size(), 0.0), 1.0}; }
  void do_command_joints(std::span<const double> joints) override { target.assign(joints.begin(), joints.end()); }
  bool do_has_arrived() override { return target == measured; }
  void do_hold() override {
    calls += "hold ";
    if (fails_to_hold) throw std::runtime_error("no answer");
    target = measured;
  }
  void do_recover() override { calls += "recover "; }
  void do_close() override { calls += "close "; }
};

}  // namespace rcs::test
