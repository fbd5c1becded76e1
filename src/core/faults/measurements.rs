//! Faults of measurements, between what vision measured and what control is told.

use super::FaultWindow;
use crate::detect::Detection;
use crate::messages::{MAX_FEATURES, Measurement, frame_flag};
use crate::time::SpanNs;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// What is wrong with a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MeasurementFault {
    /// It is the last good one before once more, with its stamp.
    Stale,
    /// It is the good one before the last once more, with its stamp: one that was overtaken.
    Overtaken,
    /// All of it is displaced in the image by so many px, one way as long as the fault lasts, and the pose with it.
    Jump(f64),
    /// Two of its features have each other's ids; the pose is left as it is.
    Mislabelled,
    /// Each point in the image is off by noise of its own, of that standard deviation, px; the pose is that of the points.
    PointNoise(f64),
}

/// Puts faults into the measurements of one vision.
#[derive(Debug, Clone)]
pub struct MeasurementFaults {
    list: Vec<(MeasurementFault, FaultWindow)>,
    period_ns: f64,
    f_px: Vector2<f64>,
    /// The last good one that was given, and the one before it.
    last: Option<Box<[Measurement; 2]>>,
}

impl MeasurementFaults {
    /// Those of `list`, drawn by `seed`, for a camera with `rate_hz` and the focal lengths `f_px`.
    #[must_use]
    pub fn new(
        list: &[(MeasurementFault, FaultWindow)],
        seed: u64,
        rate_hz: f64,
        f_px: Vector2<f64>,
    ) -> Self {
        // Beside the seeds of frames: what is lost and what is stale are drawn apart.
        let seeded = |(i, (fault, window)): (u64, &(_, FaultWindow))| (*fault, window.seeded(!seed, i));
        let list: Vec<_> = (0..).zip(list).map(seeded).collect();
        // Room for it, so that nothing is allocated later.
        let last = (!list.is_empty()).then(Box::default);
        Self { list, period_ns: 1e9 / rate_hz, f_px, last }
    }

    /// Puts noise into the `points` that were found in frame `id` of the camera with the number `camera`.
    pub fn disturb(&self, camera: u64, id: u64, points: &mut [Detection]) {
        self.displace(1.0, camera, id, points);
    }

    /// Takes the noise out of them again, for what looks at the image about them, in which they are where they were.
    pub fn undo_disturb(&self, camera: u64, id: u64, points: &mut [Detection]) {
        self.displace(-1.0, camera, id, points);
    }

    fn displace(&self, share: f64, camera: u64, id: u64, points: &mut [Detection]) {
        let time = time_of(id, self.period_ns);
        for (fault, window) in &self.list {
            let MeasurementFault::PointNoise(sd_px) = fault else { continue };
            if !window.acts(time, id) {
                continue;
            }
            for point in points.iter_mut() {
                // By the point, so that it is as far off in whatever way it was found in this frame.
                let number = id ^ u64::from(point.id + 1).rotate_right(16) ^ camera.rotate_right(32);
                let mut random = window.random(number);
                point.px += Vector2::new(random.gaussian(), random.gaussian()) * (share * *sd_px);
            }
        }
    }

    /// Puts in what acts on `m`.
    pub fn apply(&mut self, m: &mut Measurement) {
        let Some(last) = &mut self.last else { return };
        let [newest, older] = &mut **last;
        let (id, time) = (m.frame_id, time_of(m.frame_id, self.period_ns));
        let mut is_stale = false;
        for (fault, window) in self.list.iter().filter(|(_, window)| window.acts(time, id)) {
            match fault {
                MeasurementFault::Stale | MeasurementFault::Overtaken => {
                    let again = if *fault == MeasurementFault::Stale { &*newest } else { &*older };
                    if again.found() {
                        is_stale = true;
                        *m = Measurement {
                            frame_id: id,
                            frame_sent: m.frame_sent,
                            flags: again.flags & !frame_flag::LAST | m.flags & frame_flag::LAST,
                            target_lost: m.target_lost,
                            ..*again
                        };
                    }
                }
                MeasurementFault::Jump(size_px) => jump(m, *size_px, window, &self.f_px),
                MeasurementFault::Mislabelled => mislabel(m, window),
                // Before the pose was computed.
                MeasurementFault::PointNoise(_) => {}
            }
        }
        if m.found() && !is_stale {
            *older = std::mem::replace(newest, *m);
        }
    }
}

/// The time of frame `id` since frame 0.
fn time_of(id: u64, period_ns: f64) -> SpanNs {
    SpanNs((id as f64 * period_ns).round() as i64)
}

/// Displaces features and pose by `size_px`, in the direction of the fault.
fn jump(m: &mut Measurement, size_px: f64, window: &FaultWindow, f_px: &Vector2<f64>) {
    let (sin, cos) = window.random(u64::MAX).between(0.0, TAU).sin_cos();
    let way_px = Vector2::new(cos, sin) * size_px;
    let way = way_px.component_div(f_px);
    let count = (m.feature_count as usize).min(MAX_FEATURES);
    for feature in m.features.iter_mut().take(count) {
        feature.u_px += way_px.x;
        feature.v_px += way_px.y;
        feature.x += way.x;
        feature.y += way.y;
    }
    // What lies at the depth z is so far aside where it looks displaced by as much.
    let [x, y, z, ..] = &mut m.pose;
    *x += way.x * *z;
    *y += way.y * *z;
}

/// Exchanges two features, which keep their places in the list.
fn mislabel(m: &mut Measurement, window: &FaultWindow) {
    let count = (m.feature_count as usize).min(MAX_FEATURES) as u64;
    if count < 2 {
        return;
    }
    let mut random = window.random(u64::MAX);
    let (a, b) = (random.bits() % count, 1 + random.bits() % (count - 1));
    let (a, b) = (a as usize, ((a + b) % count) as usize);
    m.features.swap(a, b);
    let id = m.features[a].id;
    m.features[a].id = m.features[b].id;
    m.features[b].id = id;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{FeaturePoint, TargetStatus};
    use crate::time::MonoNs;

    /// The measurement of frame `id` at 25 Hz.
    fn measured(id: u64) -> Measurement {
        let mut m = Measurement {
            frame_id: id,
            exposure: MonoNs(40_000_000 * id as i64),
            status: TargetStatus::Found as u32,
            feature_count: 4,
            ..Measurement::default()
        };
        for (k, feature) in (0..).zip(m.features.iter_mut().take(4)) {
            *feature = FeaturePoint { id: k, u_px: 100.0 * k as f64, x: k as f64, ..FeaturePoint::default() };
        }
        m.pose = [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0];
        m
    }

    /// Ten measurements with a fault from frame 4 to 6.
    fn given(fault: MeasurementFault) -> Vec<Measurement> {
        let window =
            FaultWindow { from: SpanNs(160_000_000), until: SpanNs(280_000_000), probability: 1.0, seed: 0 };
        let mut faults = MeasurementFaults::new(&[(fault, window)], 9, 25.0, Vector2::new(800.0, 800.0));
        let one = |id| {
            let mut m = measured(id);
            faults.apply(&mut m);
            m
        };
        (0..10).map(one).collect()
    }

    #[test]
    fn each_fault_acts_in_its_time_alone() {
        for fault in [
            MeasurementFault::Stale,
            MeasurementFault::Overtaken,
            MeasurementFault::Jump(20.0),
            MeasurementFault::Mislabelled,
        ] {
            for (id, m) in (0..).zip(given(fault)) {
                assert_eq!(m == measured(id), !(4..7).contains(&id), "{fault:?}, frame {id}");
                assert_eq!(m.frame_id, id);
            }
        }
    }

    #[test]
    fn a_stale_measurement_is_the_last_one_with_its_stamp() {
        let given = given(MeasurementFault::Stale);
        assert!((4..7).all(|id| given[id].exposure == given[3].exposure), "{given:?}");
        let given = self::given(MeasurementFault::Overtaken);
        assert!((4..7).all(|id| given[id].exposure == given[2].exposure), "{given:?}");
    }

    #[test]
    fn a_jump_displaces_all_features_alike_and_the_pose() {
        let given = given(MeasurementFault::Jump(20.0));
        let (m, before) = (&given[5], measured(5));
        for (a, b) in m.features().iter().zip(before.features()) {
            assert!(((a.u_px - b.u_px).hypot(a.v_px - b.v_px) - 20.0).abs() < 1e-9);
            assert!(((a.x - b.x).hypot(a.y - b.y) - 20.0 / 800.0).abs() < 1e-12);
        }
        assert!((m.pose[0].hypot(m.pose[1]) - 0.5 * 20.0 / 800.0).abs() < 1e-12);
        assert_eq!(given[4].features, m.features, "one way");
    }

    #[test]
    fn mislabelled_features_are_two_that_changed_places() {
        let given = given(MeasurementFault::Mislabelled);
        let m = &given[4];
        let ids: Vec<u64> = m.features().iter().map(|f| f.id).collect();
        assert_eq!(ids, [0, 1, 2, 3], "their ids rise");
        assert_eq!(m.features().iter().filter(|f| f.x != f.id as f64).count(), 2);
    }

    /// The noise has the standard deviation that was asked for, is new in each frame, and the same where a point is found twice in one.
    #[test]
    fn noise_of_points_is_as_large_as_asked_for() {
        let window =
            FaultWindow { from: SpanNs(0), until: SpanNs(10_000_000_000), probability: 1.0, seed: 0 };
        let list = [(MeasurementFault::PointNoise(3.0), window)];
        let faults = MeasurementFaults::new(&list, 5, 25.0, Vector2::new(800.0, 800.0));
        let dot = |id| Detection {
            id,
            px: Vector2::zeros(),
            sd_px: 0.02,
            area_px2: 100.0,
            covariance_px2: [8.0, 0.0, 8.0],
            dark_level: 20.0,
            plate_level: 200.0,
            disturbance_px: 0.0,
        };
        let at = |camera, id| {
            let mut points: Vec<_> = (0..4).map(dot).collect();
            faults.disturb(camera, id, &mut points);
            points
        };
        let all: Vec<f64> = (0..250).flat_map(|id| at(0, id)).flat_map(|dot| [dot.px.x, dot.px.y]).collect();
        let count = all.len() as f64;
        let (mean, square) =
            (all.iter().sum::<f64>() / count, all.iter().map(|x| x * x).sum::<f64>() / count);
        // Four standard deviations of the mean and of the mean square of 2000 numbers.
        assert!(mean.abs() < 4.0 * 3.0 / count.sqrt(), "{mean}");
        assert!((square / 9.0 - 1.0).abs() < 4.0 * (2.0 / count).sqrt(), "{square}");
        assert_eq!(at(0, 7)[2].px, at(0, 7)[2].px);
        assert!(at(0, 7)[2].px != at(1, 7)[2].px && at(0, 7)[2].px != at(0, 8)[2].px);
        assert_eq!(at(0, 250)[0].px, Vector2::zeros(), "it is over");
        let mut undone = at(0, 7);
        faults.undo_disturb(0, 7, &mut undone);
        assert!(undone.iter().all(|dot| dot.px.norm() < 1e-12), "{undone:?}");
    }
}
