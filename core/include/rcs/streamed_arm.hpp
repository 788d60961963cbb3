// An arm whose controller takes a point every few milliseconds: what drivers of such arms have in common.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "rcs/arm.hpp"

namespace rcs {

/// The setpoint of the joints at one tick, one value per joint.
struct StreamPoint {
  std::vector<double> position;      ///< rad
  std::vector<double> velocity;      ///< rad/s
  std::vector<double> acceleration;  ///< rad/s²
};

/// The places where the TCP may be, in the frame of the base.
struct TcpBox {
  std::array<double, 3> lower;  ///< m
  std::array<double, 3> upper;  ///< m
  /// Gives the translation of the TCP [m] from joints [rad]. It is called several times per tick, on the arm's thread.
  std::function<std::array<double, 3>(std::span<const double>)> tcp;
};

/// How an arm is streamed to.
struct StreamOptions {
  double rate = 1000.0;           ///< points per second, 10 … 2000
  double period = 1.0 / 30.0;     ///< time between commands [s]
  bool is_paced_by_read = false;  ///< `read` returns once per tick and is waited for; else multiples of the period are
  double margin = 0.0;            ///< rad, that targets keep from the ends of the joints' ranges
  double first_step = 0.2;        ///< rad, how far from the measured joints the first target may be
  double tracking_error = 0.3;    ///< rad, between where a joint is led and measured; more is a fault
  double arrival = 0.01;          ///< rad, within which a joint has arrived
  double silence = 0.25;          ///< s, for which `read` and `write` may not return; more is a fault
  int missed_ticks = 20;          ///< in a row; more are a fault
  std::optional<TcpBox> box = std::nullopt;
  std::set<CommandKind> more_commands = {};  ///< what the arm takes besides joints, by `write_other`
};

/// How many commands asked for more than is allowed, by what was too much. The arm did what is allowed.
struct Clamped {
  std::uint64_t range = 0;         ///< a target beyond the range of a joint, less the margin
  std::uint64_t speed = 0;         ///< targets that move faster
  std::uint64_t acceleration = 0;  ///< targets whose speed changes faster
  std::uint64_t jerk = 0;          ///< targets whose acceleration changes faster
  std::uint64_t box = 0;           ///< a way that leads out of the TCP box: the arm stopped inside
};

/// An arm that a thread of its own leads from command to command, at the arm's rate, along the `Trajectory` that a
/// simulated arm takes. A vendor overrides `read`, `write`, `stop` and, where needed, `connect`, `start`, `clear`,
/// `give_way` and `disconnect`; users call what every `Arm` has.
///
/// `open` connects and reads; the first command, which must be near the measured joints, starts the arm. From then on
/// each tick writes a point, within the limits of position, speed, acceleration and jerk. A command whose time is over,
/// `hold` and faults from outside brake the arm within these limits, and it is led where it stands. Exceptions of
/// `read` or `write`, a joint that is not where it is led, and too many missed ticks are faults that stop the arm at
/// once, by the controller's own means; after `recover`, it is started again by the next command. A call that does not
/// return is a fault, too: `read` and `write` after `silence`, `stop` after 8 times, the others after 60 times as long.
///
/// Threads: all these functions of the vendor run on the arm's thread, but for `connect` and `disconnect`, which run
/// before it starts and after it ends; and for `stop`, which may run on another thread beside one of them that does not
/// return. `command_joints` and `state` never wait for the arm's thread, nor it for them.
///
/// An arm that names `more_commands` takes them where it stands, and gives them to its controller as they are: these
/// limits do not count for them. Another kind of command than the last one is refused while the arm moves.
///
/// A class of a vendor calls `close()` in its destructor, as its functions are gone afterwards.
class RCS_API StreamedArm : public Arm {
 public:
  /// Throws `InvalidSetup` where the limits lack acceleration or jerk, or an option makes no sense.
  StreamedArm(std::string name, ArmLimits limits, StreamOptions options = {}, int built_for = kInterfaceVersion);
  ~StreamedArm() override;

  const StreamOptions& options() const { return options_; }
  /// Time between commands [s], for which they are planned. Set it before the first one.
  double period() const;
  void set_period(double period);

  /// Commands that were clamped since `open`.
  Clamped clamped() const;
  /// Points written since `open`, and ticks that were left out because the thread came too late.
  std::uint64_t ticks() const;
  std::uint64_t missed_ticks() const;
  /// Commands since `open` whose time was over before the next one.
  std::uint64_t lapses() const;
  /// The reason why the thread does not run in real time, and the line that mends it; empty when there is none. Known
  /// once the arm is open.
  std::string real_time_advice() const;

 protected:
  /// Connect. Nothing moves, and no motor is switched on.
  virtual void connect() {}
  /// Measure. Throw when there is no answer; an arm that cannot be read is not read again until `recover`. Where the
  /// controller still measures in its own fault state, leave that to `start` and `write`.
  virtual void read(ArmState& state) = 0;
  /// Switch on what follows points: the next one is where the arm is. It may take its time. Throw why it cannot.
  virtual void start() {}
  /// Send the point of this tick. Throw what is wrong with the controller.
  virtual void write(const StreamPoint& point) = 0;
  /// Send what one of `more_commands` asks for, in every tick until the next command: the controller keeps its limits.
  /// The values are those of the command; of a pose, translation [m] and quaternion xyzw.
  virtual void write_other(CommandKind kind, std::span<const double> values);
  /// Send what brings the arm to rest from there, a tick at a time, and return whether it stands: then joints lead it.
  virtual bool brake_other() { return true; }
  /// Stop at once by the controller's own means and hold, whatever state it is in.
  virtual void stop() = 0;
  /// Leave the controller's fault state. Nothing moves.
  virtual void clear() {}
  /// Let a person move the arm by hand, where `can_guide` says that this is possible.
  virtual void give_way() {}
  virtual void disconnect() {}

 private:
  struct Loop;

  void do_open() final;
  ArmState do_state() final;
  void do_command_joints(std::span<const double> joints) final;
  void do_command_pose(const Pose& pose_tcp_in_base) final;
  void do_command_twist(std::span<const double> twist) final;
  void do_command_velocities(std::span<const double> velocities) final;
  void do_command_torques(std::span<const double> torques) final;
  void require_near(std::span<const double> joints);
  void send(CommandKind kind, std::span<const double> values);
  bool do_has_arrived() final;
  void do_hold() final;
  void do_await_rest() final;
  void do_guide() final;
  void do_recover() final;
  void do_close() final;

  StreamOptions options_;
  std::unique_ptr<Loop> loop_;
};

}  // namespace rcs
