// Devices whose drivers run in a process of their own, the host: the program's side of the memory that both share.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>

#include "rcs/arm.hpp"
#include "rcs/gripper.hpp"
#include "rcs/hand.hpp"
#include "rcs/streamed_arm.hpp"

namespace rcs {

/// Requests of a program to the host of a device. Among the commands, which come first, a newer one takes the place of
/// one that waits.
enum class HostCall : std::int32_t {
  joints,
  pose,
  twist,
  velocities,
  torques,
  opening,
  has_arrived,
  guide,
  recover,
  close,
};

/// How a call ended in the host.
enum class HostOutcome : std::int32_t {
  done,
  invalid,      ///< refused as `InvalidCommand`
  wrong_order,  ///< refused as `WrongOrder`
  fault,        ///< the device is in its fault state
};

/// The files of a host that the program is connected to. The owner of this closes them.
struct HostConnection {
  int memory;   ///< a file of shared memory, all zero
  int socket;   ///< open as long as the other side is there
  int process;  ///< the host's number
};

class HostLink;
struct HostMeasured;

/// The part that devices of all kinds with a host share. Their life is that of `Device`; its calls become the host's.
///
/// A thread shows the host that the program runs, without the interpreter, and looks after the host. A host that ends,
/// or does not return from a call in time, is a fault of its device; the latter is killed, for what it does later must
/// not move the device. `recover` starts another one.
class HostLine {
 public:
  /// Starts a host where needed, opens the device there, and returns the connection.
  using Connect = std::function<HostConnection()>;

  /// `answer` is how long the host may take to hold [s].
  HostLine(Device& device, Connect connect, double answer);
  ~HostLine();

  void open();
  void close();
  void hold();
  void settle();
  void recover();
  void guide();
  bool has_arrived();
  void command(HostCall call, std::span<const double> values, double valid_for, double force = kNaN,
               double period = 0.0);
  /// The last measurement of the device. Throws `DeviceFault` when it does not measure any more.
  HostMeasured measured();
  /// The number of the host's process, or 0.
  int process() const;

 private:
  std::shared_ptr<HostLink> link() const;
  std::shared_ptr<HostLink> exchange(std::shared_ptr<HostLink> link);

  Device& device_;
  const Connect connect_;
  const double answer_;
  mutable std::mutex mutex_;
  std::shared_ptr<HostLink> link_;  // another thread may hold while `recover` makes a new one
};

/// The common part of the three kinds: the calls of `Device` go to the line.
template <typename Base>
class Hosted : public Base {
 public:
  /// The number of the process of the host, or 0 where there is none.
  int host() const { return line_.process(); }
  bool can_guide() const override { return can_guide_; }

 protected:
  template <typename... About>
  Hosted(bool can_guide, HostLine::Connect connect, double answer, About&&... about)
      : Base(std::forward<About>(about)...), can_guide_(can_guide), line_(*this, std::move(connect), answer) {}

  void do_open() override { line_.open(); }
  void do_close() override { line_.close(); }
  void do_hold() override { line_.hold(); }
  void do_settle() override { line_.settle(); }
  void do_recover() override { line_.recover(); }
  void do_guide() override { line_.guide(); }
  bool do_has_arrived() override { return line_.has_arrived(); }

  const bool can_guide_;
  HostLine line_;
};

/// An arm with a host.
class HostedArm : public Hosted<Arm> {
 public:
  /// `like` is an arm of the driver that is never opened: its name, limits and kinds of commands are this one's.
  HostedArm(const Arm& like, HostLine::Connect connect, double answer);

  /// True if it is a `StreamedArm` there. Only such an arm has the following.
  bool is_streamed() const { return rate_ > 0.0; }
  /// Time between commands [s], for which they are planned. Set it before the first one.
  double period() const { return period_; }
  void set_period(double period);
  /// Commands that were clamped since `open`, as last measured.
  Clamped clamped() const;

 protected:
  ArmState do_state() override;
  void do_command_joints(std::span<const double> joints) override;
  void do_command_pose(const Pose& pose_tcp_in_base) override;
  void do_command_twist(std::span<const double> twist) override;
  void do_command_velocities(std::span<const double> velocities) override;
  void do_command_torques(std::span<const double> torques) override;

 private:
  void send(HostCall call, std::span<const double> values);

  double rate_ = 0.0;  // points per second, 0 for an arm that is not streamed
  std::atomic<double> period_ = 0.0;
  mutable std::mutex mutex_;
  Clamped clamped_;
};

/// A gripper with a host.
class HostedGripper : public Hosted<Gripper> {
 public:
  HostedGripper(const Gripper& like, HostLine::Connect connect, double answer);

 protected:
  GripperState do_state() override;
  void do_command_opening(double opening, std::optional<double> force) override;
};

/// A hand with a host.
class HostedHand : public Hosted<Hand> {
 public:
  HostedHand(const Hand& like, HostLine::Connect connect, double answer);

 protected:
  HandState do_state() override;
  void do_command_joints(std::span<const double> joints) override;
};

}  // namespace rcs
