// A drive for vservo in C++: between control and a robot, which robot.h stands for. Put the calls of your robot's maker there; what is here stays.
//
//     skeleton_drive JOINT_NAME...            (see README.md beside this file)
//
//            START            a command                                   LAST, SIGTERM, SIGINT: exit code 0
//   Waits ─────────► Holds ─────────────► Obeys      any of the three ──► silence, a command that no drive may obey: exit code 1, reason in drive.txt
//   nothing is sent  states are sent      commands are obeyed             in either case the arm is braked first, and stands
//
// While the guardian's stop stands, while the robot has stopped by itself, and while CLEAR is asked for, Obeys holds the arm whatever is commanded.
#include "robot.h"
#include "vservo_drive.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

namespace {

// The period of this robot's states. A real robot has its own: wait for its next state instead of sleeping (`run`, below).
constexpr int64_t kCycleNs = 1000000;
// Without a command for so long, control is no more: a hundred of its ticks, as the drives that come with vservo have it.
constexpr int64_t kSilenceNs = 100000000;
// By how much the arm is behind its commands: `vservo drive check` measures it.
constexpr int64_t kLagNs = 0;
// The arm counts as standing below this speed, rad/s or m/s: less than a reading of a usual encoder tells in a cycle.
constexpr double kRest = 1e-4;
// The longest time for braking: four times what this arm takes from 10 rad/s.
constexpr int64_t kBrakingNs = 2000000000;

volatile std::sig_atomic_t g_stop = 0;       // SIGTERM, SIGINT: somebody ends this program
volatile std::sig_atomic_t g_protective = 0; // SIGUSR1: the arm of this sample stops by itself, as robots do. For trying; leave it out

enum class Stage { Waits, Holds, Obeys };

class Drive {
public:
    Drive(vservo_drive *vservo, std::vector<const char *> names) : vservo_(vservo), names_(std::move(names)), robot_(names_.size(), vservo_drive_now_ns()) {}

    // Until LAST, or a signal. Leaves an arm that stands; throws `Failed` after that, too.
    void run() {
        try {
            int64_t next = vservo_drive_now_ns();
            while (!over_ && !g_stop) {
                next = std::max(next, vservo_drive_now_ns() - 10 * kCycleNs) + kCycleNs; // after a pause there is no burst
                vservo_drive_sleep_until_ns(next); // a robot: wait for its next state
                cycle();
            }
        } catch (const Failed &) {
            come_to_rest();
            throw;
        }
        come_to_rest();
    }

private:
    void cycle() {
        if (g_protective) robot_.stop_by_itself();
        g_protective = 0;
        robot_.next_state(vservo_drive_now_ns());
        tell_what_the_robot_is();
        if (stage_ != Stage::Waits) checked(send(++count_, 0));
        vservo_DriveCommand command;
        while (checked(vservo_drive_receive(vservo_, &command)) == 1) take(command);
        if (stage_ == Stage::Obeys && vservo_drive_now_ns() - commanded_ns_ > kSilenceNs) throw Failed{"no command for 100 ms: control has ended"};
        obey();
    }

    void take(const vservo_DriveCommand &command) {
        if (command.flags & VSERVO_DRIVE_FLAG_LAST) {
            over_ = true;
        } else if (command.flags & VSERVO_DRIVE_FLAG_START) {
            start(command);
        } else if (stage_ != Stage::Waits) {
            if (!vservo_drive_is_valid_command(&command, joints())) throw Failed{"a command of other joints, or with numbers that are none"};
            last_ = command;
            commanded_ns_ = vservo_drive_now_ns();
            stage_ = Stage::Obeys;
            // One CLEAR clears one stop: what stops the robot afterwards needs a new one.
            const bool asked = command.flags & VSERVO_DRIVE_FLAG_CLEAR;
            if (asked && !clear_asked_) robot_.clear();
            clear_asked_ = asked;
        }
    }

    // START may come more than once, and is answered each time.
    void start(const vservo_DriveCommand &command) {
        if (command.flags & VSERVO_DRIVE_FLAG_LOCKSTEP) throw Failed{"a robot knows no lockstep: set run.clock = \"realtime\""};
        if (command.joints != joints()) throw Failed{"the robot file has " + std::to_string(command.joints) + " joints, this drive " + std::to_string(joints())};
        if (stage_ == Stage::Waits) robot_.begin(command.q_r, command.mode);
        stage_ = Stage::Holds;
        robot_.hold();
        // Before the answer, which control takes with what came before it.
        checked(vservo_drive_send_joint_names(vservo_, names_.data(), joints(), nullptr, nullptr));
        checked(vservo_drive_send_properties(vservo_, kCycleNs, kSilenceNs, kLagNs, nullptr, 0)); // in mode torque with the robot's limits of torque rates
        robot_.next_state(vservo_drive_now_ns()); // no two states have the same stamp
        checked(send(0, VSERVO_DRIVE_FLAG_INITIAL));
    }

    void obey() {
        const bool guarded = checked(vservo_drive_is_stopped_by_guardian(vservo_)) == 1;
        const bool holds = stage_ != Stage::Obeys || guarded || robot_.has_stopped() || clear_asked_;
        if (!holds && last_.mode == Robot::kVelocity) return robot_.velocity(last_.qd_r);
        if (!holds && last_.mode == Robot::kPosition) return robot_.position(last_.q_r, last_.qd_r);
        robot_.hold(); // also in a mode that the first state does not name, for which control does not ask
    }

    // Words come before the state that shows it.
    void tell_what_the_robot_is() {
        if (robot_.state() == told_state_ || stage_ == Stage::Waits) return;
        told_state_ = robot_.state();
        checked(vservo_drive_send_robot_text(vservo_, robot_.state(), robot_.code(), robot_.words()));
    }

    int32_t send(uint64_t tick, uint32_t flags) {
        vservo_DriveState state{};
        state.tick = tick;
        state.stamp = robot_.stamp_ns();
        state.joints = joints();
        state.modes = Robot::kModes;
        state.flags = flags;
        state.robot_state = robot_.state();
        state.robot_code = robot_.code();
        std::copy(robot_.q().begin(), robot_.q().end(), state.q);
        std::copy(robot_.qd().begin(), robot_.qd().end(), state.qd);
        return vservo_drive_send(vservo_, &state);
    }

    // Brakes, and goes on telling where the arm is until it stands, as far as anybody can still be told.
    void come_to_rest() {
        const int64_t end = vservo_drive_now_ns() + kBrakingNs;
        const auto moves = [](double speed) { return std::abs(speed) > kRest; };
        robot_.hold();
        do {
            vservo_drive_sleep_until_ns(vservo_drive_now_ns() + kCycleNs);
            robot_.next_state(vservo_drive_now_ns());
            if (stage_ != Stage::Waits) send(++count_, 0);
        } while (std::any_of(robot_.qd().begin(), robot_.qd().end(), moves) && vservo_drive_now_ns() < end);
    }

    uint32_t joints() const { return static_cast<uint32_t>(names_.size()); }

    static int32_t checked(int32_t answer) {
        if (answer < 0) throw Failed{vservo_drive_last_error()};
        return answer;
    }

    vservo_drive *vservo_;
    std::vector<const char *> names_;
    Robot robot_;
    Stage stage_ = Stage::Waits;
    bool over_ = false, clear_asked_ = false;
    vservo_DriveCommand last_{};
    int64_t commanded_ns_ = 0;
    uint64_t count_ = 0;
    uint32_t told_state_ = VSERVO_ROBOT_STATE_READY;
};

} // namespace

int main(int argc, char **argv) {
    std::signal(SIGTERM, [](int) { g_stop = 1; });
    std::signal(SIGINT, [](int) { g_stop = 1; });
    std::signal(SIGUSR1, [](int) { g_protective = 1; });
    if (argc < 2 || argc - 1 > VSERVO_MAX_JOINTS) {
        std::fprintf(stderr, "usage: skeleton_drive JOINT_NAME...   (1 to %d, in the order of the robot file)\n", VSERVO_MAX_JOINTS);
        return 2;
    }
    vservo_drive *vservo = vservo_drive_open(nullptr); // the instance that `vservo run` names
    if (!vservo) {
        std::fprintf(stderr, "skeleton_drive: %s\n", vservo_drive_last_error());
        return 1;
    }
    int code = 0;
    try {
        Drive(vservo, {argv + 1, argv + argc}).run();
    } catch (const Failed &failed) {
        std::fprintf(stderr, "skeleton_drive: %s\n", failed.why.c_str());
        vservo_drive_leave_reason(nullptr, failed.why.c_str());
        code = 1;
    }
    vservo_drive_close(vservo);
    return code;
}
