// The robot of skeleton_drive.cpp: an arm whose joints go as they are told, within a limit of acceleration. Put your maker's calls into these functions.
#ifndef ROBOT_H
#define ROBOT_H

#include "vservo.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

// Why the drive ends. What catches it brakes first.
struct Failed {
    std::string why; // for drive.txt
};

class Robot {
public:
    Robot(size_t joints, int64_t now_ns) : q_(joints), qd_(joints), wanted_(joints), target_(joints), stamp_ns_(now_ns) {}

    // START. A robot: see that it is powered, unbraked and under remote control, and begin its real-time motion; it stays where it is, whatever `q_start` says, and
    // throws `Failed` where it may not move. A simulator: put the arm there, at rest.
    void begin(const double *q_start, uint32_t mode) {
        if (mode != kVelocity && mode != kPosition) throw Failed{"takes velocities and positions, and no torques"};
        q_.assign(q_start, q_start + q_.size());
    }

    void velocity(const double *qd) { // speedj, joint velocity controllers
        follows_position_ = false;
        wanted_.assign(qd, qd + q_.size());
    }

    void position(const double *q, const double *qd) { // servoj, joint position controllers
        follows_position_ = true;
        target_.assign(q, q + q_.size());
        wanted_.assign(qd, qd + q_.size());
    }

    void hold() { // brakes within the robot's own limits, and stays
        follows_position_ = false;
        wanted_.assign(q_.size(), 0.0);
    }

    // What the robot is beside its joints, with the maker's code and words.
    uint32_t state() const { return stopped_ ? VSERVO_ROBOT_STATE_PROTECTIVE_STOP : VSERVO_ROBOT_STATE_READY; }
    uint32_t code() const { return stopped_ ? 1 : 0; }
    const char *words() const { return stopped_ ? "stopped by SIGUSR1, as a robot stops at an obstacle" : ""; }
    bool has_stopped() const { return stopped_; }
    void stop_by_itself() { stopped_ = true; } // of this sample alone
    void clear() { stopped_ = false; } // unlock the protective stop, recover from the reflex; may take many cycles

    // The next state: what the maker's client waits for. Here the arm moves on until now, also through what this program was held up.
    void next_state(int64_t now_ns) {
        for (; stamp_ns_ < now_ns; stamp_ns_ = std::min(now_ns, stamp_ns_ + 1000000)) step(1e-9 * std::min<int64_t>(now_ns - stamp_ns_, 1000000));
    }

    // Of the newest state: when it was sampled, CLOCK_MONOTONIC. A robot with a clock of its own: its time, turned into this one.
    int64_t stamp_ns() const { return stamp_ns_; }
    const std::vector<double> &q() const { return q_; }
    const std::vector<double> &qd() const { return qd_; }

    static constexpr uint32_t kVelocity = 1, kPosition = 2; // `mode` of a command
    static constexpr uint32_t kModes = 1u << kVelocity | 1u << kPosition;

private:
    void step(double dt) {
        constexpr double kAcceleration = 20.0; // rad/s2 or m/s2: more than a run asks for (motion.max_acceleration), as a robot has it
        // Of this arm's position loop, which feeds the commanded velocity forward: 20 * 0.5 is half of that acceleration, so that no way back overshoots.
        constexpr double kGain = 20.0, kCatchingUp = 0.5; // 1/s; rad/s or m/s
        for (size_t i = 0; i < q_.size(); ++i) {
            const double back = follows_position_ ? clamped(kGain * (target_[i] - q_[i]), kCatchingUp) : 0.0;
            qd_[i] += clamped((stopped_ ? 0.0 : wanted_[i] + back) - qd_[i], kAcceleration * dt);
            q_[i] += qd_[i] * dt;
        }
    }

    static double clamped(double value, double most) { return std::max(-most, std::min(most, value)); }

    std::vector<double> q_, qd_, wanted_, target_;
    int64_t stamp_ns_;
    bool follows_position_ = false, stopped_ = false;
};

#endif
