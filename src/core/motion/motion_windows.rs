//! Means of an arm's motion and torques over two neighbouring windows of some ticks, from which payloads and rotors are estimated.
//!
//! With the positions `q_0`, `q_1`, `q_2` at the ends of windows of `a` and `b` seconds,
//!
//! ```text
//! qd = ((q_1 - q_0) b / a + (q_2 - q_1) a / b) / (a + b)        qdd = 2 ((q_2 - q_1) / b - (q_1 - q_0) / a) / (a + b)
//! ```
//! and torques are weighted by a triangle about `q_1`, as the second difference weights accelerations: no observer, which may believe in another inertia, stands between. Where encoders are coarse, windows are longer.

use crate::time::TICK;
use nalgebra::SVector;

/// Ticks of a window, beside those until the next state of a slower drive. Chosen by hand: half of it would take four times the noise of coarse encoders, and double would find a rotor when the arm has already
/// accelerated for as long as it takes to fall behind.
const WINDOW: u32 = 10;
/// Acceleration that coarse encoders may hide in a window, as a standard deviation, rad/s^2 or m/s^2; windows are longer where it would be more. An error of the acceleration is one of the torque that it takes, too,
/// and the two together look like a joint without inertia: with windows of 10 ms and steps of 2e-4 rad (1.4 rad/s^2) UR5 and Panda found no rotor of twice their inertia. Measured (`tests/cores/everything_at_once.rs`, 120 draws
/// with steps of 5e-5 to 1e-3 rad): with 0.1 28 come home and 28 end as a fault, with 0.3 31 and 24, with 1.0 25 and 27; shorter windows see more of light wrists that swing. With 1e-3 rad it is 49 ms.
const HIDDEN: f64 = 0.3;
/// The standard deviation of a second difference of positions that are uniformly off by half a step, in steps. Derived: each has one of 12^-1/2, and they count 1, -2 and 1 times.
const SECOND_DIFFERENCE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The present windows of an arm with `N` joints.
#[derive(Debug, Clone)]
pub(super) struct MotionWindows<const N: usize> {
    /// Positions at the ends of the last two windows.
    last: Option<SVector<f64, N>>,
    before: Option<SVector<f64, N>>,
    /// Sums of torques and of rising weights times torques in this window, and the latter in the last one.
    sum: SVector<f64, N>,
    rising: SVector<f64, N>,
    rose: SVector<f64, N>,
    ticks: u32,
    ticks_before: u32,
}

/// The means about the end of a window.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeanMotion<const N: usize> {
    /// Positions, rad or m, velocities and accelerations.
    pub(super) q: SVector<f64, N>,
    pub(super) qd: SVector<f64, N>,
    pub(super) qdd: SVector<f64, N>,
    /// Torques, N m or N.
    pub(super) tau: SVector<f64, N>,
    /// How far the joints have moved since, rad or m.
    pub(super) moved: SVector<f64, N>,
    /// The time from the middle of one window to that of the other, s.
    pub(super) span_s: f64,
    /// What encoders hide of the accelerations, as a standard deviation, rad/s^2 or m/s^2.
    pub(super) hidden: SVector<f64, N>,
}

impl<const N: usize> Default for MotionWindows<N> {
    fn default() -> Self {
        let zero = SVector::zeros();
        let (last, before, sum, rising, rose) = (None, None, zero, zero, zero);
        Self { last, before, sum, rising, rose, ticks: 0, ticks_before: 0 }
    }
}

impl<const N: usize> MotionWindows<N> {
    /// Forgets the present windows: what moved the arm in them is not known.
    pub(super) fn skip(&mut self) {
        (self.last, self.before, self.ticks) = (None, None, 0);
    }

    /// Takes in where the joints are after a tick in which the torques `tau` acted, N m or N; `q` is `None` where no new state came. `steps` are those of the encoders, rad or m. The means where a window ends.
    pub(super) fn note(
        &mut self,
        tau: &SVector<f64, N>,
        q: Option<&SVector<f64, N>>,
        steps: &SVector<f64, N>,
    ) -> Option<MeanMotion<N>> {
        let Some(last) = self.last else {
            (self.last, self.ticks) = (q.copied(), 0);
            (self.sum, self.rising) = (SVector::zeros(), SVector::zeros());
            return None;
        };
        self.rising += tau * (f64::from(self.ticks) + 0.5);
        self.sum += tau;
        self.ticks += 1;
        let q = q.filter(|_| self.ticks >= window(steps))?;
        let mean = self.before.map(|before| {
            let [a, b] = [self.ticks_before, self.ticks].map(f64::from);
            let [a_s, b_s] = [a, b].map(|ticks| ticks * TICK.as_s());
            let span_s = 0.5 * (a_s + b_s);
            let [rose, rises] = [(last - before) / a_s, (q - last) / b_s];
            MeanMotion {
                q: last,
                qd: (rose * b + rises * a) / (a + b),
                qdd: (rises - rose) / span_s,
                tau: (self.rose / a + self.sum - self.rising / b) * (TICK.as_s() / span_s),
                moved: q - last,
                span_s,
                hidden: steps * (SECOND_DIFFERENCE / (a_s * b_s)),
            }
        });
        (self.before, self.last) = (Some(last), Some(*q));
        (self.rose, self.ticks_before) = (self.rising, self.ticks);
        (self.sum, self.rising, self.ticks) = (SVector::zeros(), SVector::zeros(), 0);
        mean
    }
}

/// Ticks of a window before encoders with these steps, rad or m.
fn window<const N: usize>(steps: &SVector<f64, N>) -> u32 {
    let hidden_s = (SECOND_DIFFERENCE * steps.amax() / HIDDEN).sqrt();
    WINDOW.max((hidden_s / TICK.as_s()).ceil() as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// Joints whose torques are their accelerations, one with a constant jerk, and a state every `period` ticks: all means are of the same instants, whatever the windows are.
    #[test]
    fn torques_and_accelerations_are_of_the_same_instants() {
        for (period, step) in [(1, 0.0), (3, 0.0), (8, 0.0), (1, 1e-4), (4, 1e-3)] {
            let mut windows = MotionWindows::<2>::default();
            let mut count = 0;
            for k in 0..1000 {
                let (t, mid) = (f64::from(k + 1) * 1e-3, (f64::from(k) + 0.5) * 1e-3);
                let q = Vector2::new(t.powi(3), 2.0 - 3.0 * t * t);
                let q = Some(&q).filter(|_| (k + 1) % period == 0);
                let Some(mean) = windows.note(&Vector2::new(6.0 * mid, -6.0), q, &Vector2::repeat(step))
                else {
                    continue;
                };
                count += 1;
                assert!((mean.tau - mean.qdd).amax() < 2e-3, "{period} {step}: {mean:?}");
                let t = mean.q[0].cbrt();
                assert!((mean.qd - Vector2::new(3.0 * t * t, -6.0 * t)).amax() < 4e-2, "{period}: {mean:?}");
                assert!(mean.hidden.amax() <= HIDDEN, "{step}: {mean:?}");
            }
            assert!(count >= 10, "{count}");
        }
    }

    #[test]
    fn what_is_skipped_is_in_no_mean() {
        let mut windows = MotionWindows::<1>::default();
        for k in 0..200 {
            let is_wild = k == 105;
            let (tau, q) = if is_wild { (1e6, 50.0) } else { (0.0, 1.0) };
            let of = |x: f64| SVector::<f64, 1>::repeat(x);
            let mean = windows.note(&of(tau), Some(&of(q)), &of(0.0));
            if is_wild {
                windows.skip();
            }
            assert!(mean.is_none_or(|mean| mean.tau[0] == 0.0 && mean.qdd[0] == 0.0));
        }
    }
}
