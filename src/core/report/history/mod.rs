//! The history of a run for `--report`: a row of each tick and of each measurement, in memory that is bounded and reserved before
//! the first tick. It is filled beside the loop, never by the real-time thread.
//!
//! ```text
//! Trace ────────► ticks          full: every second row goes, and from then on every second one (fourth ...) is kept;
//! Measurement ──► measurements   the first and the last are always there
//! Trace.measurement_record ─────┘ what became of it
//! ```

mod table;

pub use table::PostureFacts;
#[cfg(test)]
mod tests;

use crate::control::trace::{LatencyStages, MeasurementRecord, Trace};
use crate::geometry::Pose;
use crate::messages::{MAX_JOINTS, Measurement, measurement_flag};
use crate::motion::Limit;
use crate::servo::MeasurementVerdict;
use crate::time::{MonoNs, SpanNs};

/// Most ticks that are kept, so that memory has a bound: two minutes at 1 kHz; longer runs are thinned by two. Chosen by hand: usual
/// runs fit in whole, and the curves of a page have far fewer pixels.
const MAX_TICKS: usize = 120_000;
/// Most measurements that are kept, so that memory has a bound: two minutes at 100 Hz. Chosen by hand, for the same reasons.
const MAX_MEASUREMENTS: usize = 12_000;
/// Number of the last measurements among which that of a verdict is searched. Chosen by hand: more than can be in flight.
const MAX_UNDER_WAY: usize = 64;

/// What a run left behind, tick by tick.
#[derive(Debug, Clone)]
pub struct RunHistory {
    joints: usize,
    /// Ids of the points of each target, rising, by the targets' numbers.
    targets: Vec<Vec<u32>>,
    /// Most points of a target: as many have a place in each row of [`Self::px`], in the order of the ids of the row's target.
    points: usize,
    ticks: Thinned<TickRow>,
    measurements: Thinned<DetectionRow>,
    /// `u, v` of each measurement's points, px; NaN for one that was not seen.
    px: Vec<f32>,
    /// Those of the last one.
    last_px: Vec<f32>,
    first: Option<MonoNs>,
}

/// One tick. Positions keep all their digits; what is drawn only has those of a single.
#[derive(Debug, Clone, Copy)]
struct TickRow {
    tick: u64,
    time: MonoNs,
    /// Time of the tick to its command.
    total_ns: u32,
    state: u8,
    limits: [u8; Limit::ALL.len()],
    q: [f64; MAX_JOINTS],
    q_r: [f64; MAX_JOINTS],
    qd: [f32; MAX_JOINTS],
    qd_r: [f32; MAX_JOINTS],
    tau: [f32; MAX_JOINTS],
    requested_qd: [f32; MAX_JOINTS],
}

/// One measurement, and what became of it.
#[derive(Debug, Clone, Copy)]
struct DetectionRow {
    frame_id: u64,
    camera: u32,
    target_number: u32,
    exposure: MonoNs,
    status: u32,
    flags: u32,
    count: u32,
    /// `X_CO` as position and quaternion `x y z w`, where the flags say so.
    pose: [f64; 7],
    rms_px: f32,
    /// The tick that took it.
    taken: Option<MonoNs>,
    error_px: f64,
    verdict: Option<MeasurementVerdict>,
    latency: Option<LatencyStages>,
}

/// Rows: every `stride`-th is kept, and the last one.
#[derive(Debug, Clone)]
struct Thinned<T> {
    rows: Vec<T>,
    most: usize,
    stride: u64,
    seen: u64,
    last: Option<T>,
}

impl<T: Copy> Thinned<T> {
    fn new(most: usize) -> Self {
        // Even, so that halving is exact; the last row needs a place too.
        let most = most.max(2).next_multiple_of(2);
        Self { rows: Vec::with_capacity(most), most, stride: 1, seen: 0, last: None }
    }

    /// Takes a row in; whether it has a place of its own now, and whether places were given up for it.
    fn push(&mut self, row: T) -> RowOutcome {
        let kept = self.seen.is_multiple_of(self.stride);
        self.seen += 1;
        self.last = Some(row);
        if !kept {
            return RowOutcome { pushed: false, halved: false };
        }
        let halved = self.rows.len() == self.most;
        if halved {
            let mut i = 0;
            self.rows.retain(|_| {
                i += 1;
                i % 2 == 1
            });
            self.stride *= 2;
        }
        // The row that filled it up is the first of the coarser ones: `most` is even.
        self.rows.push(row);
        RowOutcome { pushed: true, halved }
    }

    /// The kept rows, and the last where it is not among them.
    fn all(&self) -> impl Iterator<Item = &T> {
        let is_kept = self.seen.checked_sub(1).is_none_or(|last| last.is_multiple_of(self.stride));
        self.rows.iter().chain(self.last.iter().filter(move |_| !is_kept))
    }
}

/// What became of a row.
struct RowOutcome {
    pushed: bool,
    halved: bool,
}

impl RunHistory {
    /// For an arm of so many joints, targets with points of these ids by their numbers, a run of at most `longest` and a camera of `rate_hz`.
    #[must_use]
    pub fn new(joints: usize, targets: &[&[u32]], longest: SpanNs, rate_hz: f64) -> Self {
        let within = |rate_hz: f64, most: usize| {
            let rows = longest.as_s().max(0.0) * rate_hz + 64.0;
            if rows < most as f64 { rows as usize } else { most }
        };
        let measurements = Thinned::new(within(rate_hz, MAX_MEASUREMENTS));
        let points = targets.iter().map(|ids| ids.len()).max().unwrap_or(0);
        Self {
            joints: joints.min(MAX_JOINTS),
            targets: targets.iter().map(|ids| ids.to_vec()).collect(),
            points,
            ticks: Thinned::new(within(1e3, MAX_TICKS)),
            px: Vec::with_capacity(measurements.most * 2 * points),
            last_px: Vec::with_capacity(2 * points),
            measurements,
            first: None,
        }
    }

    /// Takes a measurement in as it comes.
    pub fn note_measurement(&mut self, m: &Measurement) {
        let kept = self.measurements.push(DetectionRow {
            frame_id: m.frame_id,
            camera: m.camera,
            target_number: m.target_number,
            exposure: m.exposure,
            status: m.status,
            flags: m.flags,
            count: m.feature_count,
            pose: m.pose,
            rms_px: m.reprojection_rms_px as f32,
            taken: None,
            error_px: f64::NAN,
            verdict: None,
            latency: None,
        });
        let width = 2 * self.points;
        if kept.halved && width > 0 {
            let mut i = 0;
            self.px.retain(|_| {
                i += 1;
                ((i - 1) / width).is_multiple_of(2)
            });
        }
        self.last_px.clear();
        for id in self.targets.get(m.target_number as usize).into_iter().flatten() {
            let seen = m.features().iter().find(|f| f.id == u64::from(*id));
            let (u, v) = seen.map_or((f32::NAN, f32::NAN), |f| (f.u_px as f32, f.v_px as f32));
            self.last_px.extend([u, v]);
        }
        self.last_px.resize(width, f32::NAN);
        if kept.pushed {
            self.px.extend_from_slice(&self.last_px);
        }
    }

    /// Takes a tick in.
    pub fn note(&mut self, trace: &Trace) {
        self.first.get_or_insert(trace.time);
        if let Some(latest) = &trace.measurement_record {
            self.settle(trace.time, latest);
        }
        let (js, command) = (&trace.joint_state, &trace.command);
        let single = |values: &[f64; MAX_JOINTS]| values.map(|v| v as f32);
        let mut limits = [0; Limit::ALL.len()];
        for (place, limit) in limits.iter_mut().zip(Limit::ALL) {
            *place = trace.limits.joints(limit);
        }
        self.ticks.push(TickRow {
            tick: js.tick,
            time: trace.time,
            total_ns: u32::try_from((trace.commanded - trace.time).0.max(0)).unwrap_or(u32::MAX),
            state: trace.state as u8,
            limits,
            q: js.q,
            q_r: command.q_r,
            qd: single(&js.qd),
            qd_r: single(&command.qd_r),
            tau: single(&command.tau),
            requested_qd: single(&command.requested_qd),
        });
    }

    /// What became of a measurement.
    fn settle(&mut self, now: MonoNs, latest: &MeasurementRecord) {
        let is_it = |row: &&mut DetectionRow| {
            (row.frame_id, row.camera) == (latest.frame.frame_id, latest.frame.camera)
        };
        let newest = self.measurements.rows.iter_mut().rev().take(MAX_UNDER_WAY).find(is_it);
        for row in newest.into_iter().chain(self.measurements.last.as_mut().filter(is_it)) {
            row.taken = Some(now);
            row.error_px = latest.error_px;
            row.verdict = latest.verdict;
            row.latency = latest.latency;
        }
    }

    /// The joints at the first tick and at the last, rad or m, and the time between.
    #[must_use]
    pub fn ends(&self) -> Option<(&[f64], &[f64], SpanNs)> {
        let (first, last) = (self.ticks.rows.first()?, self.ticks.last.as_ref()?);
        Some((first.q.get(..self.joints)?, last.q.get(..self.joints)?, last.time - first.time))
    }

    /// The pose `X_CO` of the last measurement that has one, where the target with this number is the one that was looked for last.
    #[must_use]
    pub fn last_pose(&self, target_number: u32) -> Option<Pose> {
        let newest = self.measurements.last.iter().chain(self.measurements.rows.iter().rev());
        let is_of_it = |row: &&DetectionRow| row.target_number == target_number;
        let row = newest.take_while(is_of_it).find(|row| row.flags & measurement_flag::POSE != 0)?;
        Measurement { flags: row.flags, pose: row.pose, ..Measurement::default() }.pose()
    }
}
