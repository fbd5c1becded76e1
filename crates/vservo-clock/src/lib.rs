//! From the controller's time to the caller's, by the quickest of many packages.
//!
//! ```text
//! arrival = robot time + offset + delay,  delay >= 0     ->     offset <= min(arrival - robot time)
//! ```
//! The least difference over the last seconds is the offset, too late by the shortest delay, which cannot be told from it (0.1 ms in a quiet
//! network). A window that goes on follows the drift of two clocks. A stamp is never later than its arrival, and never before the one before.

/// Length of a window, ns; the offset is the least of this one and the one before. Chosen by hand: 2 s hold a thousand packages, of which one is quick, and
/// clocks that drift by 50 parts in a million apart are 0.1 ms off by then.
const WINDOW_NS: i64 = 2_000_000_000;

/// The offset between two clocks.
#[derive(Debug, Clone, Default)]
pub struct ClockMap {
    /// Least difference of this window and of the one before, ns.
    least: Option<(i64, i64)>,
    window_ends: i64,
    last_stamp: i64,
    /// Longest delay beyond the least, ns.
    longest_delay: i64,
}

impl ClockMap {
    /// The caller's time at which the controller's clock showed `robot_s`, of a package that came at `arrival`, ns.
    pub fn stamp(&mut self, robot_s: f64, arrival: i64) -> i64 {
        let robot = (robot_s * 1e9) as i64;
        let difference = arrival - robot;
        let (mut current, mut before) = self.least.unwrap_or((difference, difference));
        if arrival >= self.window_ends {
            (before, current) = (current, difference);
            self.window_ends = arrival + WINDOW_NS;
        }
        current = current.min(difference);
        self.least = Some((current, before));
        let offset = current.min(before);
        self.longest_delay = self.longest_delay.max(difference - offset);
        self.last_stamp = (robot + offset).max(self.last_stamp).min(arrival);
        self.last_stamp
    }

    /// The longest delay beyond the least that a package had, ns.
    #[must_use]
    pub fn longest_delay_ns(&self) -> i64 {
        self.longest_delay
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot's clock that starts at 100 s, runs 40 ppm fast, and whose packages take 0.1 ms and, but for one in five, up to 4 ms more.
    #[test]
    fn stamps_are_those_of_the_samples() {
        let mut map = ClockMap::default();
        let mut worst = 0;
        for k in 0..20_000_i64 {
            let sampled = 7_000_000_000 + 2_000_000 * k;
            let robot_s = 100.0 + 2e-3 * k as f64 * (1.0 + 40e-6);
            let delay = 100_000 + if k % 5 == 0 { 0 } else { (k * 7919) % 4_000_000 };
            let stamp = map.stamp(robot_s, sampled + delay);
            assert!(stamp <= sampled + delay);
            if k > 10 {
                worst = worst.max((stamp - sampled).abs());
            }
        }
        assert!(worst < 300_000, "{worst} ns");
        assert!(map.longest_delay_ns() > 3_000_000);
    }

    #[test]
    fn a_clock_that_jumps_back_does_not_turn_stamps_back() {
        let mut map = ClockMap::default();
        let first = map.stamp(50.0, 1_000_000_000);
        let second = map.stamp(0.0, 1_002_000_000);
        assert!(second >= first && second <= 1_002_000_000);
    }
}
