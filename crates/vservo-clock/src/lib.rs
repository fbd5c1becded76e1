//! From the time of a controller to the caller's, by the quickest of many packages: offset and drift of two clocks, with their uncertainty.
//!
//! ```text
//! arrival - robot time = offset + drift * time + delay,  delay >= 0
//!
//!  difference  .   '      .        '           each window keeps its least difference, the package of the shortest delay;
//!            '  .     '  .   . '  .    '       the line lies below all of them, and as high as it can: two of them are on it
//!            ───x────────x─────────x───
//! ```
//! The line is the edge of the lower convex hull above the middle of the time. Delays only ever lift a package off it, so that spikes and jitter do not move it as a mean
//! would be moved; the shortest delay, which cannot be told from the offset (0.1 ms in a quiet network), is left in it. A stamp is never later than its arrival, and never before the
//! one before.

mod hull;

use hull::{Line, Point};

/// Length of a window, ns. Chosen by hand: half a second holds 60 packages of the slowest controller (125 Hz), of which one is quick.
const WINDOW_NS: i64 = 500_000_000;
/// Windows that are kept. Chosen by hand: 8 s, in which the clocks of two machines keep their drift, for that follows temperature; a delay that is 0.1 ms off then makes 12 ppm.
const WINDOWS: usize = 16;
/// Windows before a drift is looked for: with fewer, the delays of two packages would be taken for one. Chosen by hand: 2 s.
const FEWEST: usize = 4;
/// Largest drift that two clocks have. Quartz clocks are within 100 ppm by their makers' data sheets, at all temperatures; two of them drift apart by 200, and the rest is for what is
/// disciplined by the network.
const MAX_DRIFT: f64 = 500e-6;
/// A difference that is below the line by more, and a whole window that is above it by more, are a clock that was set, and not a delay. Chosen by hand: shortest delays of
/// networks change by some milliseconds when a way changes.
const STEP_NS: f64 = 50e6;

/// What is known of two clocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockEstimate {
    /// The caller's time less the controller's, at the newest package, ns, with the shortest delay in it.
    pub offset_ns: f64,
    /// Its uncertainty beside that delay, ns: how far the quickest packages of the windows lie above the line, on average.
    pub offset_sd_ns: f64,
    /// By how much the caller's clock is faster than the controller's, parts in a million.
    pub drift_ppm: f64,
    /// Its uncertainty, parts in a million; infinite as long as it is not looked for.
    pub drift_sd_ppm: f64,
}

/// The mapping of two clocks. Nothing here allocates.
#[derive(Debug, Clone, Default)]
pub struct ClockMap {
    /// The robot time and the difference of the first package, ns: everything else is counted from them, so that single numbers stay small.
    origin: Option<(i64, i64)>,
    /// The quickest packages of the windows before this one, oldest first.
    before: [Point; WINDOWS - 1],
    count: usize,
    /// That of this one.
    current: Option<Point>,
    window_ends: i64,
    line: Line,
    last_robot: i64,
    last_stamp: i64,
    /// Longest delay beyond the least, ns.
    longest_delay: i64,
}

impl ClockMap {
    /// The caller's time at which the controller's clock showed `robot_s`, of a package that came at `arrival`, ns.
    pub fn stamp(&mut self, robot_s: f64, arrival: i64) -> i64 {
        self.stamp_ns((robot_s * 1e9).round() as i64, arrival)
    }

    /// The same of a clock that counts nanoseconds.
    pub fn stamp_ns(&mut self, robot: i64, arrival: i64) -> i64 {
        if self.origin.is_some() && robot < self.last_robot {
            self.begin_anew(); // the controller was started anew, or its clock was set back
        }
        let difference = arrival.saturating_sub(robot);
        let (robot_0, difference_0) = *self.origin.get_or_insert((robot, difference));
        self.last_robot = robot;
        let point = Point {
            t: robot.saturating_sub(robot_0) as f64,
            d: difference.saturating_sub(difference_0) as f64,
        };
        let delay = point.d - self.line.at(point.t);
        if self.current.is_some() && delay < -STEP_NS {
            self.begin_anew();
            return self.stamp_ns(robot, arrival);
        }
        if robot >= self.window_ends && self.close_window() {
            self.begin_anew();
            return self.stamp_ns(robot, arrival);
        }
        if self.current.is_none() {
            self.window_ends = robot.saturating_add(WINDOW_NS);
        }
        let is_quicker =
            self.current.is_none_or(|least| point.d - least.d < self.line.slope * (point.t - least.t));
        if is_quicker {
            self.current = Some(point);
            self.fit();
        }
        let offset = self.line.at(point.t).min(point.d);
        self.longest_delay = self.longest_delay.max((point.d - offset) as i64);
        let stamp = arrival.saturating_sub((point.d - offset).round() as i64);
        self.last_stamp = stamp.max(self.last_stamp).min(arrival);
        self.last_stamp
    }

    fn begin_anew(&mut self) {
        (self.origin, self.count, self.current, self.line) = (None, 0, None, Line::default());
    }

    /// Keeps the quickest package of the window that is over; whether none of it is near the line, because a clock was set forward.
    fn close_window(&mut self) -> bool {
        let Some(least) = self.current.take() else { return false };
        if least.d - self.line.at(least.t) > STEP_NS {
            return true;
        }
        if self.count == self.before.len() {
            self.before.rotate_left(1);
            self.count -= 1;
        }
        if let Some(place) = self.before.get_mut(self.count) {
            *place = least;
            self.count += 1;
        }
        false
    }

    /// The quickest packages, oldest first.
    fn points(&self) -> impl DoubleEndedIterator<Item = Point> + Clone + '_ {
        self.before.iter().take(self.count).copied().chain(self.current)
    }

    fn fit(&mut self) {
        let mut points = [Point::default(); WINDOWS];
        let mut count = 0;
        for (place, point) in points.iter_mut().zip(self.points()) {
            *place = point;
            count += 1;
        }
        let points = points.get(..count).unwrap_or_default();
        let slope = if count < FEWEST { 0.0 } else { hull::slope_below(points) };
        self.line = Line::below(points, slope.clamp(-MAX_DRIFT, MAX_DRIFT));
    }

    /// What is known of both clocks; `None` before the first package.
    #[must_use]
    pub fn estimate(&self) -> Option<ClockEstimate> {
        let (robot_0, difference_0) = self.origin?;
        let above = self.points().map(|p| p.d - self.line.at(p.t));
        let windows = self.points().count();
        let offset_sd_ns = above.sum::<f64>() / windows.max(1) as f64;
        let span = self.points().next_back()?.t - self.points().next()?.t;
        let now = self.last_robot.saturating_sub(robot_0) as f64;
        Some(ClockEstimate {
            offset_ns: difference_0 as f64 + self.line.at(now),
            offset_sd_ns,
            drift_ppm: self.line.slope * 1e6,
            // Both ends of the line may be off by that.
            drift_sd_ppm: if windows < FEWEST {
                f64::INFINITY
            } else {
                2.0 * offset_sd_ns / span.max(1.0) * 1e6
            },
        })
    }

    /// The longest delay beyond the least that a package had, ns.
    #[must_use]
    pub fn longest_delay_ns(&self) -> i64 {
        self.longest_delay
    }
}

#[cfg(test)]
mod tests;
