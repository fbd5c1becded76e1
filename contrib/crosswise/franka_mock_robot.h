// What the robot of franka_mock.cpp does: modes, motions and joints, with each thing that comes and each state that goes through the maker's server.
#pragma once

#include "mock_server.h"

#include <chrono>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <optional>

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <franka/rate_limiting.h>
#include <research_interface/robot/error.h>

namespace wire = research_interface::robot;
using Joints = std::array<double, 7>;
using Clock = std::chrono::steady_clock;

namespace {

// Of the server, once it is bound.
int states_socket = -1;

constexpr double kCycle = 1e-3;
constexpr Joints kStart{0.1, -0.5, 0.0, -2.1, 0.1, 1.8, 0.2};
// The server's own first state has zeros, and the number 1. A second has passed when the arm is where this robot has it.
constexpr uint64_t kFirstNumber = 1000;
// So long it takes to clear an error, until the user stop is released, and until the other of reply and state follows, in states.
constexpr uint64_t kClears = 30, kPressed = 300, kApart = 20;

uint64_t bits(double value) { return __builtin_bit_cast(uint64_t, value); }

template <typename Values>
void tell(const Values& values) {
  for (double value : values) {
    std::printf(" %016" PRIx64, bits(value));
  }
}

struct Script {
  std::optional<unsigned> version;
  bool pattern = false, paced = false, state_first = false;
  std::chrono::milliseconds wait{2000};
  std::map<std::string, uint8_t> answers;
  uint8_t end_status = 0;
  std::optional<unsigned> end_after, close_after;
};

class Robot {
 public:
  Robot(RobotMockServer& server, Script script) : server_(server), script_(std::move(script)) {
    for (int fd = 3; fd < 256; fd++) {
      sockaddr_storage peer{};
      socklen_t size = sizeof(peer);
      if (getpeername(fd, reinterpret_cast<sockaddr*>(&peer), &size) == 0 && peer.ss_family == AF_INET) {
        requests_socket_ = fd;
      }
    }
  }

  // Whatever comes next, one thing a time: the server does it when this has returned. False when the client is gone, or the script is over.
  bool turn() {
    if (ended_ && number_ >= reply_at_) {
      reply();
      return true;
    }
    std::array<uint8_t, 1024> bytes;
    ssize_t size = recv(requests_socket_, bytes.data(), bytes.size(), MSG_PEEK | MSG_DONTWAIT);
    wire::CommandHeader header{};
    if (size >= static_cast<ssize_t>(sizeof(header))) {
      std::memcpy(&header, bytes.data(), sizeof(header));
      if (size >= header.size && take(header)) {
        return true;
      }
    }
    pollfd waits[]{{states_socket, POLLIN, 0}, {requests_socket_, POLLIN, 0}};
    if (poll(waits, 1, 0) > 0) {
      server_.onReceiveRobotCommand([this](const wire::RobotCommand& command) { commanded(command); });
      return true;
    }
    if (size == 0 || (size < 0 && errno != EAGAIN && errno != EWOULDBLOCK) || closes()) {
      std::printf("over states %" PRIu64 " commands %u unused %u beyond_position %.3e beyond_velocity %.3e beyond_torque %.3e\n", states_, commands_,
                  unused_, beyond_[0], beyond_[1], beyond_[2]);
      return false;
    }
    auto now = Clock::now();
    if (now >= next_ && (script_.paced || !moves_ || answered_ || now > sent_ + script_.wait)) {
      if (moves_ && !answered_ && !script_.paced) {
        reflex(wire::Error::kCommunicationConstraintsViolation);
      }
      step();
      next_ = std::max(next_ + std::chrono::milliseconds(1), now - std::chrono::milliseconds(20));
      sent_ = now;
      server_.onSendUDP<wire::RobotState>([this](wire::RobotState& state) { fill(state); });
      return true;
    }
    // A request that waits to be taken is no news.
    auto left = std::chrono::duration_cast<std::chrono::nanoseconds>(next_ - now).count();
    timespec wait{0, left > 0 ? std::min(left, 1'000'000L) : 1'000'000L};
    ppoll(waits, size > 0 ? 1 : 2, &wait, nullptr);
    return true;
  }

 private:
  template <typename T>
  void on(const char* name, typename T::Status usual, std::function<void(const typename T::Request&, bool)> takes, uint32_t* number = nullptr) {
    server_.template waitForCommand<T>(
        [this, name, usual, takes](const typename T::Request& request) {
          auto refused = script_.answers.find(name);
          auto status = refused == script_.answers.end() ? usual : static_cast<typename T::Status>(refused->second);
          if (refused != script_.answers.end()) {
            script_.answers.erase(refused);
          }
          std::printf("%s", name);
          takes(request, status == usual);
          std::printf("\n");
          std::fflush(stdout);
          return typename T::Response(status);
        },
        number);
  }

  // Whether the request is taken now.
  bool take(const wire::CommandHeader& header) {
    switch (header.command) {
      case wire::Command::kMove:
        on<wire::Move>(
            "move", wire::Move::Status::kMotionStarted,
            [this](const wire::Move::Request& r, bool may) {
              std::printf(" %u %u %d", static_cast<unsigned>(r.controller_mode), static_cast<unsigned>(r.motion_generator_mode),
                          r.use_async_motion_generator);
              for (const auto& d : {r.maximum_path_deviation, r.maximum_goal_pose_deviation}) {
                tell(std::array{d.translation, d.rotation, d.elbow});
              }
              if (may) {
                begin(r);
              }
            },
            &move_number_);
        return true;
      case wire::Command::kStopMove:
        on<wire::StopMove>("stop", wire::StopMove::Status::kSuccess, [this](const auto&, bool) {
          if (moves_) {
            ends(wire::Move::Status::kPreempted, wire::RobotMode::kIdle);
          }
        });
        return true;
      case wire::Command::kSetLoad:
        on<wire::SetLoad>("load", wire::SetLoad::Status::kSuccess, [](const wire::SetLoad::Request& r, bool) {
          tell(std::array{r.m_load});
          tell(r.F_x_Cload);
          tell(r.I_load);
        });
        return true;
      case wire::Command::kSetCollisionBehavior:
        on<wire::SetCollisionBehavior>("collision", wire::SetCollisionBehavior::Status::kSuccess, [](const wire::SetCollisionBehavior::Request& r, bool) {
          for (const auto& torques : {r.lower_torque_thresholds_acceleration, r.upper_torque_thresholds_acceleration, r.lower_torque_thresholds_nominal,
                                      r.upper_torque_thresholds_nominal}) {
            tell(torques);
          }
          for (const auto& forces : {r.lower_force_thresholds_acceleration, r.upper_force_thresholds_acceleration, r.lower_force_thresholds_nominal,
                                     r.upper_force_thresholds_nominal}) {
            tell(forces);
          }
        });
        return true;
      case wire::Command::kSetJointImpedance:
        on<wire::SetJointImpedance>("stiffness", wire::SetJointImpedance::Status::kSuccess,
                                    [](const wire::SetJointImpedance::Request& r, bool) { tell(r.K_theta); });
        return true;
      case wire::Command::kAutomaticErrorRecovery:
        // The reply comes when the error is cleared.
        if (mode_ == wire::RobotMode::kReflex && script_.answers.count("recovery") == 0) {
          mode_ = wire::RobotMode::kAutomaticErrorRecovery;
          until_ = number_ + kClears;
        }
        if (mode_ == wire::RobotMode::kAutomaticErrorRecovery) {
          return false;
        }
        on<wire::AutomaticErrorRecovery>("recovery", wire::AutomaticErrorRecovery::Status::kSuccess, [](const auto&, bool) {});
        return true;
      case wire::Command::kGetRobotModel:
        ADD_FAILURE() << "The model was asked for again.";
        return false;
      default:
        ADD_FAILURE() << "The command " << static_cast<uint32_t>(header.command) << " is not played.";
        return false;
    }
  }

  void begin(const wire::Move::Request& r) {
    generator_ = r.motion_generator_mode;
    moves_ = answered_ = true;
    mode_ = wire::RobotMode::kMove;
    velocity_ = acceleration_ = torque_ = told_velocity_ = {};
    commanded_ = q_;
    errors_ = {};
  }

  // By itself or because it was asked to; reply and states tell it one after the other.
  void ends(wire::Move::Status status, wire::RobotMode mode) {
    uint64_t now = number_;
    if (status < wire::Move::Status::kReflexAborted) {
      reply_at_ = state_at_ = now;
    } else {
      reply_at_ = script_.state_first ? now + kApart : now;
      state_at_ = script_.state_first ? now : now + kApart;
    }
    std::tie(ended_, after_) = std::make_tuple(status, mode);
    answered_ = true;
  }

  void reflex(wire::Error error) {
    errors_[static_cast<size_t>(error)] = true;
    ends(wire::Move::Status::kReflexAborted, wire::RobotMode::kReflex);
  }

  // The other answer to a motion's request, behind that by which it began.
  void reply() {
    wire::Move::Status status = *ended_;
    server_.sendResponse<wire::Move>(move_number_, [status] { return wire::Move::Response(status); });
    std::printf("ended %u\n", static_cast<unsigned>(status));
    std::fflush(stdout);
    ended_.reset();
  }

  bool closes() const { return script_.close_after && commands_ >= *script_.close_after; }

  void commanded(const wire::RobotCommand& c) {
    std::printf("command %" PRIu64, c.message_id);
    tell(c.motion.q_c);
    tell(c.motion.dq_c);
    tell(c.motion.O_T_EE_c);
    tell(c.motion.O_dP_EE_c);
    tell(c.motion.elbow_c);
    tell(c.control.tau_J_d);
    std::printf(" %d %d %d\n", c.motion.valid_elbow, c.motion.motion_generation_finished, c.control.torque_command_finished);
    if (!moves_ || answered_ || c.message_id != number_) {
      unused_++;
      return;
    }
    answered_ = true;
    commands_++;
    follow(c);
    bool external = generator_ == wire::Move::MotionGeneratorMode::kNone;
    if (external ? c.control.torque_command_finished : c.motion.motion_generation_finished) {
      ends(wire::Move::Status::kSuccess, wire::RobotMode::kIdle);
    } else if (script_.end_after && commands_ >= *script_.end_after) {
      script_.end_after.reset();
      auto status = static_cast<wire::Move::Status>(script_.end_status);
      if (status == wire::Move::Status::kReflexAborted) {
        reflex(wire::Error::kJointReflex);
      } else {
        bool pressed = status == wire::Move::Status::kEmergencyAborted;
        ends(status, pressed ? wire::RobotMode::kUserStopped : wire::RobotMode::kIdle);
      }
    }
  }

  // What is commanded, and by how much the maker's own limiter would have changed it.
  void follow(const wire::RobotCommand& c) {
    Joints upper = franka::computeUpperLimitsJointVelocity(commanded_), lower = franka::computeLowerLimitsJointVelocity(commanded_);
    auto judge = [this](size_t place, double command, double limited) { beyond_[place] = std::max(beyond_[place], std::abs(command - limited)); };
    for (size_t i = 0; i < 7; i++) {
      if (generator_ == wire::Move::MotionGeneratorMode::kNone) {
        torque_wanted_[i] = c.control.tau_J_d[i];
        if (std::isfinite(torque_wanted_[i])) {
          double most = franka::kMaxTorqueRate[i] * kCycle;
          judge(2, torque_wanted_[i], std::clamp(torque_wanted_[i], torque_[i] - most, torque_[i] + most));
        }
        torque_[i] = torque_wanted_[i];
        continue;
      }
      bool by_position = generator_ == wire::Move::MotionGeneratorMode::kJointPosition;
      double velocity = by_position ? (c.motion.q_c[i] - commanded_[i]) / kCycle : c.motion.dq_c[i];
      if (std::isfinite(velocity)) {
        if (by_position) {
          judge(0, c.motion.q_c[i],
                franka::limitRate(upper[i], lower[i], franka::kMaxJointAcceleration[i], franka::kMaxJointJerk[i], c.motion.q_c[i], commanded_[i],
                                  velocity_[i], acceleration_[i]));
        } else {
          judge(1, velocity,
                franka::limitRate(upper[i], lower[i], franka::kMaxJointAcceleration[i], franka::kMaxJointJerk[i], velocity, velocity_[i],
                                  acceleration_[i]));
        }
      }
      acceleration_[i] = (velocity - velocity_[i]) / kCycle;
      velocity_[i] = velocity;
      commanded_[i] = by_position ? c.motion.q_c[i] : commanded_[i] + velocity * kCycle;
    }
  }

  // A millisecond passes.
  void step() {
    number_ = number_ == 0 ? kFirstNumber : number_ + 1;
    states_++;
    if (mode_ == wire::RobotMode::kAutomaticErrorRecovery && number_ >= until_) {
      mode_ = wire::RobotMode::kIdle;
      errors_ = {};
    }
    if (mode_ == wire::RobotMode::kUserStopped && number_ >= until_) {
      mode_ = wire::RobotMode::kIdle;
    }
    if (after_ && number_ >= state_at_) {
      mode_ = *after_;
      until_ = number_ + kPressed;
      after_.reset();
      moves_ = false;
      told_velocity_ = velocity_ = acceleration_ = torque_ = {};
    }
    if (!moves_) {
      return;
    }
    if (generator_ == wire::Move::MotionGeneratorMode::kNone) {
      // Joints that turn the faster the more torque they have: inertias of a hundredth of the largest torque, and damping.
      for (size_t i = 0; i < 7; i++) {
        double inertia = (i < 4 ? 87.0 : 12.0) / 100.0;
        told_velocity_[i] += (torque_[i] / inertia - 2.0 * told_velocity_[i]) * kCycle;
        q_[i] += told_velocity_[i] * kCycle;
      }
      commanded_ = q_;
      return;
    }
    // A robot goes on by itself where no command has come.
    for (size_t i = 0; i < 7 && !answered_; i++) {
      velocity_[i] += acceleration_[i] * kCycle;
      commanded_[i] += velocity_[i] * kCycle;
    }
    q_ = commanded_;
    told_velocity_ = velocity_;
  }

  void fill(wire::RobotState& state) {
    state.message_id = number_;
    answered_ = !moves_ || after_.has_value();
    state.robot_mode = mode_;
    state.motion_generator_mode = wire::MotionGeneratorMode::kIdle;
    state.controller_mode = wire::ControllerMode::kOther;
    if (moves_) {
      bool external = generator_ == wire::Move::MotionGeneratorMode::kNone;
      state.controller_mode = external ? wire::ControllerMode::kExternalController : wire::ControllerMode::kJointImpedance;
      state.motion_generator_mode = external                                                        ? wire::MotionGeneratorMode::kNone
                                    : generator_ == wire::Move::MotionGeneratorMode::kJointPosition ? wire::MotionGeneratorMode::kJointPosition
                                                                                                    : wire::MotionGeneratorMode::kJointVelocity;
    }
    state.q = q_;
    state.q_d = commanded_;
    state.dq = state.dq_d = told_velocity_;
    state.ddq_d = acceleration_;
    state.tau_J = state.tau_J_d = torque_;
    (mode_ == wire::RobotMode::kReflex ? state.errors : state.reflex_reason) = errors_;
    state.control_command_success_rate = moves_ ? 1.0f : 0.0f;
    if (script_.pattern && !moves_) {
      pattern(state);
    }
  }

  // A number for each value, by its name here and in the test.
  void pattern(wire::RobotState& s) const {
    auto base = static_cast<float>(number_ % 512);
    auto number = [base](int field, int i) { return base + static_cast<float>(8 * field + i) / 128.0f; };
    int field = 0;
    for (auto* joints : {&s.tau_J, &s.tau_J_d, &s.q, &s.q_d, &s.dq, &s.dq_d, &s.ddq_d, &s.tau_ext_hat_filtered}) {
      field++;
      for (int i = 0; i < 7; i++) {
        (*joints)[i] = number(field, i);
      }
    }
    s.m_ee = number(9, 0);
    s.m_load = number(9, 1);
    s.control_command_success_rate = number(9, 2);
    s.motion_generator_mode = static_cast<wire::MotionGeneratorMode>(number_ % 6);
    s.controller_mode = static_cast<wire::ControllerMode>(number_ % 4);
    s.robot_mode = static_cast<wire::RobotMode>(number_ % 7);
    s.errors = s.reflex_reason = {};
    s.errors[number_ % 41] = true;
    s.reflex_reason[(number_ + 7) % 41] = true;
  }

  RobotMockServer& server_;
  Script script_;
  int requests_socket_ = -1;
  Clock::time_point next_ = Clock::now(), sent_ = Clock::now();

  uint64_t number_ = 0, states_ = 0, until_ = 0, reply_at_ = 0, state_at_ = 0;
  wire::RobotMode mode_ = wire::RobotMode::kIdle;
  std::array<bool, 41> errors_{};
  uint32_t move_number_ = 0;
  wire::Move::MotionGeneratorMode generator_ = wire::Move::MotionGeneratorMode::kNone;
  // Whether a motion runs, and the last state was answered; how it ends, and what the robot is then.
  bool moves_ = false, answered_ = true;
  std::optional<wire::Move::Status> ended_;
  std::optional<wire::RobotMode> after_;
  unsigned commands_ = 0, unused_ = 0;
  std::array<double, 3> beyond_{};
  Joints q_ = kStart, commanded_ = kStart, velocity_{}, acceleration_{}, torque_{}, torque_wanted_{}, told_velocity_{};
};

}  // namespace
