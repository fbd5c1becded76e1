//! Two clocks and a network that are known, and what the mapping makes of them.

use super::*;

/// A number of 0 to 1 that looks like chance, the same for every run (splitmix64).
fn chance(k: u64) -> f64 {
    let mut z = k.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Packages each `period` ns for `seconds` from a controller whose clock is slower than the caller's by `drift`, over a network whose delay beyond `floor` is given.
struct Wire<'a> {
    period: i64,
    drift: f64,
    floor: i64,
    delay: &'a dyn Fn(u64) -> f64,
}

const BEGIN: i64 = 7_000_000_000;

impl Wire<'_> {
    /// Feeds `map`; the worst error of a stamp after the first 3 s, beside the shortest delay, ns, and the last moment.
    fn feed(&self, map: &mut ClockMap, seconds: i64) -> (i64, i64) {
        let (mut worst, mut last, mut arrived) = (0, i64::MIN, 0);
        for k in 0..seconds * 1_000_000_000 / self.period {
            let sampled = BEGIN + self.period * k;
            let robot_s = 100.0 + (self.period * k) as f64 * (1.0 - self.drift) * 1e-9;
            let delay = self.floor + (self.delay)(k as u64) as i64;
            // Packages come in their order.
            arrived = (sampled + delay).max(arrived + 1);
            let stamp = map.stamp(robot_s, arrived);
            assert!(stamp <= arrived && stamp >= last, "{stamp}");
            last = stamp;
            if k * self.period > 3_000_000_000 {
                worst = worst.max((stamp - sampled - self.floor).abs());
            }
        }
        (worst, BEGIN + self.period * (seconds * 1_000_000_000 / self.period))
    }
}

fn jitter(k: u64) -> f64 {
    -80_000.0 * (1.0 - chance(k)).ln() // exponential, 80 us on average
}

/// Jitter, and each 50th package late by up to 20 ms.
fn spikes(k: u64) -> f64 {
    jitter(k) + if chance(k ^ 0xabcd) < 0.02 { 20e6 * chance(k + 77) } else { 0.0 }
}

#[test]
fn offset_and_drift_are_found_within_what_is_stated() {
    for drift in [0.0, 100e-6, -100e-6, 37e-6] {
        for (name, delay) in [("jitter", &jitter as &dyn Fn(u64) -> f64), ("spikes", &spikes)] {
            for period in [1_000_000, 2_000_000, 8_000_000] {
                let mut map = ClockMap::default();
                let wire = Wire { period, drift, floor: 100_000, delay };
                let (worst, end) = wire.feed(&mut map, 40);
                assert!(worst < 60_000, "{name} {drift} {period}: {worst} ns");
                let told = map.estimate().unwrap();
                // Of the last package, by what the test knows of both clocks.
                let robot = 100e9 + (end - period - BEGIN) as f64 * (1.0 - drift);
                let offset = (end - period) as f64 - robot + 100_000.0;
                assert!(
                    (told.offset_ns - offset).abs() < 3.0 * told.offset_sd_ns + 1_000.0,
                    "{name} {drift} {period}: {told:?}, true {offset}"
                );
                // By how much the caller's time grows for each of the controller's.
                let true_ppm = (1.0 / (1.0 - drift) - 1.0) * 1e6;
                assert!(
                    (told.drift_ppm - true_ppm).abs() < 3.0 * told.drift_sd_ppm + 0.1,
                    "{name} {drift} {period}: {told:?}, true {true_ppm}"
                );
                assert!(
                    told.drift_sd_ppm < 20.0 && told.offset_sd_ns < 60_000.0,
                    "{name} {period}: {told:?}"
                );
            }
        }
    }
}

/// With a drift that nobody looks for, the least difference of the last 4 s, which was used before, errs by up to 0.4 ms.
#[test]
fn a_drift_of_100_ppm_leaves_stamps_where_the_samples_are() {
    for drift in [100e-6, -100e-6] {
        let mut map = ClockMap::default();
        let wire = Wire {
            period: 2_000_000,
            drift,
            floor: 100_000,
            delay: &|k| if k % 5 == 0 { 0.0 } else { 4e6 * chance(k) },
        };
        let (worst, _) = wire.feed(&mut map, 60);
        assert!(worst < 10_000, "{worst} ns");
        assert!(map.longest_delay_ns() > 3_000_000);
    }
}

#[test]
fn a_burst_of_late_packages_moves_nothing() {
    let mut map = ClockMap::default();
    let quiet = |k: u64| 20_000.0 * chance(k);
    let late = |k: u64| quiet(k) + if (20_000..23_000).contains(&k) { 30e6 } else { 0.0 };
    let wire = Wire { period: 1_000_000, drift: 50e-6, floor: 200_000, delay: &late };
    let (worst, _) = wire.feed(&mut map, 40);
    assert!(worst < 25_000, "3 s in which all are 30 ms late: {worst} ns");
}

#[test]
fn a_way_that_becomes_longer_is_followed_after_its_windows() {
    let mut map = ClockMap::default();
    let longer = |k: u64| 10_000.0 * chance(k) + if k > 10_000 { 3e6 } else { 0.0 };
    let wire = Wire { period: 1_000_000, drift: 0.0, floor: 100_000, delay: &longer };
    wire.feed(&mut map, 30);
    let told = map.estimate().unwrap();
    let expected = BEGIN as f64 - 100e9 + 3_100_000.0;
    assert!((told.offset_ns - expected).abs() < 3.0 * told.offset_sd_ns + 1_000.0, "{told:?} {expected}");
}

#[test]
fn clocks_that_are_set_are_begun_anew_and_stamps_go_on() {
    for leap_s in [-50.0, -1.0, 2.0, 500.0] {
        let mut map = ClockMap::default();
        let (mut last, mut worst) = (0, 0);
        for k in 0..6000_i64 {
            let arrival = BEGIN + 1_000_000 * k + 100_000;
            let robot_s = 100.0 + 1e-3 * k as f64 + if k >= 3000 { leap_s } else { 0.0 };
            let stamp = map.stamp(robot_s, arrival);
            assert!(stamp >= last && stamp <= arrival, "{leap_s} {k}");
            last = stamp;
            // A window after the leap.
            if k > 3600 {
                worst = worst.max(arrival - stamp);
            }
        }
        assert!(worst < 1_000, "{leap_s} s: {worst} ns");
    }
}

#[test]
fn numbers_that_are_none_break_nothing() {
    let mut map = ClockMap::default();
    assert_eq!(map.estimate(), None);
    for (robot_s, arrival) in
        [(f64::NAN, 5), (f64::INFINITY, 6), (-1e300, 7), (0.0, 8), (1e-9, i64::MAX), (f64::NEG_INFINITY, 9)]
    {
        let stamp = map.stamp(robot_s, arrival);
        assert!(stamp <= arrival);
    }
    assert_eq!(ClockMap::default().stamp(50.0, 1_000_000_000), 1_000_000_000);
}
