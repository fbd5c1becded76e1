//! Contact: something from outside acts on the arm.
//!
//! With a drive that obeys torques the [momentum observer](ExternalTorqueObserver) tells the torque from outside of each joint, with its standard deviation. A drive that closes
//! its own loop seldom tells its torques: there a joint that [falls behind](DriveLagObserver) its commands by more than that drive does by itself is in contact, and where its states carry torques, they are observed beside that. Before every drive a joint that
//! [is stopped](super::stopped_joint) in its motion is.

use super::arm::LONGEST_HELD;
use super::stopped_joint::StoppedJointWatch;
use crate::drive::{CommandMode, DriveCommand, DriveState};
use crate::linalg::Ldlt;
use crate::motion::{DriveLagObserver, ExternalTorqueObserver, JointController};
use crate::robot::Robot;
use crate::time::{MonoNs, TICK};
use nalgebra::{Matrix3, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Standard deviations beyond which a torque or a lag comes from outside. Measured, because errors of models are not normal: of 120 random arms that differ from their models in
/// everything (friction, masses, load, encoders, delay, rotors; 831 s of runs) the largest came to 8.6.
const CERTAIN: f64 = 9.0;
/// Ticks for which it must last. Chosen by hand: one late state is no contact.
const TICKS: u32 = 2;
/// Largest force that is expected, N: the prior of the estimate at the flange. Chosen by hand; it decides only along directions that no joint feels.
const FORCE_N: f64 = 1e3;

/// By how much an encoder step changes a velocity that is told by a drive, in steps, 1/s. Derived: of differences over a tick behind a low-pass of 100 Hz, (1 - e^-0.63) / 1 ms.
const STEPS_1_S: f64 = 470.0;

/// What is done about a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ContactReaction {
    /// A fault: the arm is brought to rest. Before a drive that closes its own loop it goes back by what it pressed.
    #[default]
    Stop,
    /// A fault: the arm is brought to rest, and goes back to where it was before.
    Release,
    /// A fault: the arm is carried and can be moved by hand. Torque mode only.
    Float,
    /// The arm goes on, and gives way as its joint controller does.
    Ignore,
}

/// A contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// The joint that feels it most, from 0.
    pub joint: usize,
    /// Its torque from outside, N m or N; `None` where torques are not known.
    pub torque: Option<f64>,
    /// The force on the flange's origin in B that explains the torques best, N; `None` where torques are not known.
    pub force_B: Option<Vector3<f64>>,
}

/// A contact in the numbers of records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactNumbers {
    /// The joint, counted from 1; 0 where nothing touches the arm.
    pub joint: u32,
    /// Its torque from outside, N m or N; NaN where it is not known.
    pub torque: f64,
    /// The force on the flange's origin in the frame of the base, N; NaN likewise.
    pub force: [f64; 3],
}

impl ContactNumbers {
    /// Those of `contact`.
    #[must_use]
    pub fn of(contact: Option<&Contact>) -> Self {
        Self {
            joint: contact.map_or(0, |contact| contact.joint as u32 + 1),
            torque: contact.and_then(|contact| contact.torque).unwrap_or(f64::NAN),
            force: contact.and_then(|contact| contact.force_B).map_or([f64::NAN; 3], Into::into),
        }
    }
}

/// Watches an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct ContactWatch<const N: usize> {
    observer: Observer<N>,
    stopped: StoppedJointWatch<N>,
    in_a_row: u32,
    /// When the last state was taken in; `None` where it was late.
    at: Option<MonoNs>,
    is_late: bool,
    late_in_row: u32,
}

#[derive(Debug, Clone)]
enum Observer<const N: usize> {
    Torque(Box<ExternalTorqueObserver<N>>),
    Lag {
        observer: Box<DriveLagObserver<N>>,
        /// The last positions, rad or m.
        last: Option<SVector<f64, N>>,
        /// Whether the drive obeys positions.
        by_position: bool,
        /// What the torques that a state may carry tell, and whether any did.
        torque: Box<ExternalTorqueObserver<N>>,
        has_torques: bool,
    },
}

impl<const N: usize> Observer<N> {
    fn of_torques(&mut self) -> Option<&mut ExternalTorqueObserver<N>> {
        match self {
            Self::Torque(observer) => Some(observer),
            Self::Lag { torque, .. } => Some(torque),
        }
    }

    fn forget_state(&mut self) {
        match self {
            Self::Torque(observer) => observer.skip(),
            Self::Lag { observer, last, torque, .. } => {
                observer.restart();
                *last = None;
                torque.skip();
            }
        }
    }
}

impl<const N: usize> ContactWatch<N> {
    /// A watch over `robot` before a drive that obeys `mode`.
    #[must_use]
    pub fn new(robot: &Robot<N>, joint_control: &JointController<N>, mode: CommandMode) -> Self {
        let observer = if mode == CommandMode::Torque {
            let hidden = |ticks| joint_control.hidden_torque(ticks);
            Observer::Torque(Box::new(ExternalTorqueObserver::new(robot, joint_control.inertia(), hidden)))
        } else {
            let step = *joint_control.encoder_step();
            let moves = step.component_mul(joint_control.inertia()) * STEPS_1_S;
            let hidden = |ticks| moves / (f64::from(ticks) * TICK.as_s());
            Observer::Lag {
                observer: Box::new(DriveLagObserver::new(step)),
                last: None,
                by_position: mode == CommandMode::Position,
                torque: Box::new(ExternalTorqueObserver::new(robot, joint_control.inertia(), hidden)),
                has_torques: false,
            }
        };
        Self {
            observer,
            stopped: StoppedJointWatch::default(),
            in_a_row: 0,
            at: None,
            is_late: false,
            late_in_row: 0,
        }
    }

    /// Takes in what the last `command` did to the arm, which is in `state` at `now`; `None` where one of them is not known. A motion over more than a tick (a
    /// deadline that was missed, a state that came late) tells no acceleration, and is left out. `measured` are the torques that the state carries, N m or N, where it carries any:
    /// they count instead of the commanded ones, because delay, limits and ripple of the motors are in them.
    pub fn note(
        &mut self,
        now: MonoNs,
        robot: &Robot<N>,
        joint_control: &mut JointController<N>,
        did: Option<(&DriveState<N>, &DriveCommand<N>)>,
        measured: Option<&SVector<f64, N>>,
    ) {
        let (model, rotors) = (joint_control.take_model_change(), joint_control.take_rotor_change());
        if let Some(observer) = self.observer.of_torques() {
            model.iter().for_each(|change| observer.change_model(change));
            rotors.iter().for_each(|change| observer.add_rotors(change));
        }
        let was_late = std::mem::take(&mut self.is_late);
        self.late_in_row = if was_late { self.late_in_row.saturating_add(1) } else { 0 };
        let known = did.filter(|_| self.late_in_row <= LONGEST_HELD);
        let did = did.filter(|_| !was_late);
        let before = std::mem::replace(&mut self.at, did.map(|_| now));
        let has_gap = before.is_some_and(|before| now - before > TICK);
        if has_gap {
            self.forget_state();
        }
        if has_gap || was_late {
            joint_control.skip_window();
        }
        // That a joint stands is seen between two states of a slower drive, too.
        if let Some((state, command)) = known {
            let obeys_velocities = matches!(self.observer, Observer::Lag { by_position: false, .. });
            let q_r = (!obeys_velocities).then_some(&command.q_r);
            self.stopped.note(&state.q, joint_control.encoder_step(), (q_r, &command.qd_r));
        }
        match (&mut self.observer, did) {
            (Observer::Torque(observer), Some((state, command))) => {
                let doubt = (&joint_control.payload_doubt(), &joint_control.rotor_doubt());
                let tau = measured.unwrap_or(&command.tau);
                observer.hide(|ticks| joint_control.hidden_torque(ticks));
                observer.note(joint_control.carrying(robot), (&state.q, &state.qd), tau, doubt);
            }
            (Observer::Lag { observer, last, by_position, torque, has_torques }, Some((state, command))) => {
                if let Some(tau) = measured {
                    let zero = SVector::zeros();
                    *has_torques = true;
                    torque.note(robot, (&state.q, &state.qd), tau, (&zero, &zero));
                }
                if let Some(before) = last.replace(state.q) {
                    let lag = command.q_r - state.q;
                    observer.note(&command.qd_r, &(state.q - before), by_position.then_some(&lag));
                }
            }
            (observer, None) => observer.forget_state(),
        }
        if known.is_none() {
            self.stopped.restart();
        }
        let touched = self.excess().max() > CERTAIN;
        self.in_a_row = if touched { self.in_a_row.saturating_add(1) } else { 0 };
    }

    /// The next state came late.
    pub fn late(&mut self) {
        self.is_late = true;
    }

    /// Reference and arm were brought together: lags of before do not count.
    pub fn restart(&mut self) {
        self.in_a_row = 0;
        self.stopped.restart();
        if let Observer::Lag { observer, .. } = &mut self.observer {
            observer.restart();
        }
    }

    /// The next state has none before it.
    fn forget_state(&mut self) {
        self.stopped.restart();
        self.observer.forget_state();
    }

    /// Standard deviations by which each joint feels something from outside.
    fn excess(&self) -> SVector<f64, N> {
        match &self.observer {
            Observer::Torque(observer) => observer.excess(),
            Observer::Lag { observer, torque, .. } => {
                // That of torques is zero before any came.
                observer.excess().zip_map(&torque.excess(), f64::max)
            }
        }
    }

    /// The torque of each joint that comes from outside, N m or N, and its standard deviation; `None` where torques are not known.
    #[must_use]
    pub fn external_torque(&self) -> Option<(SVector<f64, N>, SVector<f64, N>)> {
        match &self.observer {
            Observer::Torque(observer) => Some((observer.torque(), observer.sd())),
            Observer::Lag { torque, has_torques, .. } => has_torques.then(|| (torque.torque(), torque.sd())),
        }
    }

    /// Whether something touches the arm.
    #[must_use]
    pub fn is_touched(&self) -> bool {
        self.in_a_row >= TICKS || self.stopped.held().is_some()
    }

    /// The contact of an arm in posture `q`, if there is one.
    #[must_use]
    pub fn contact(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> Option<Contact> {
        if !self.is_touched() {
            return None;
        }
        let joint = self.stopped.held().unwrap_or_else(|| self.excess().imax());
        let torques = self.external_torque();
        Some(Contact {
            joint,
            torque: torques.map(|(torque, _)| torque[joint]),
            force_B: torques.map(|(torque, sd)| force(robot, q, &torque, &sd)),
        })
    }
}

/// The force on the flange's origin in B, N, that explains the torques best: weighted least squares with a prior.
fn force<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    torque: &SVector<f64, N>,
    sd: &SVector<f64, N>,
) -> Vector3<f64> {
    let J = robot.jacobian(q);
    let mut A = Matrix3::identity() / (FORCE_N * FORCE_N);
    let mut b = Vector3::zeros();
    for i in 0..N {
        let column = J.fixed_view::<3, 1>(0, i).into_owned();
        let weight = 1.0 / (sd[i] * sd[i]);
        A += column * column.transpose() * weight;
        b += column * (torque[i] * weight);
    }
    Ldlt::of(&A).map_or(Vector3::zeros(), |factors| Vector3::from(factors.solve(&b.into())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{InverseDynamicsControl, JointLaw, ObserverSettings};
    use nalgebra::Vector6;

    /// An arm that moves to and fro by 8 rad/s^2, of whose ticks twelve in a row may be missed; the most standard deviations after 1.5 s. `told`: the times say so.
    fn felt_with_a_gap(gap: bool, told: bool) -> f64 {
        let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
        let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0));
        let mut control = JointController::new(law, ObserverSettings::none());
        let mut watch = ContactWatch::new(&robot, &control, CommandMode::Torque);
        let home = Vector6::new(0.4, -1.4, 1.3, -1.0, -1.5, 0.3);
        let (mut q, mut qd) = (home, Vector6::zeros());
        let (mut most, mut ticks) = (0.0_f64, 0);
        for k in 0..3000_i64 {
            let qdd = Vector6::repeat(8.0 * (k as f64 * 8e-3).cos());
            let tau = robot.inverse_dynamics(&q, &qd, &qdd);
            (q, qd) = robot.integrate(&q, &qd, &tau, 1e-3);
            if gap && (1500..1512).contains(&k) {
                continue;
            }
            ticks += 1;
            let now = MonoNs(if told { k } else { ticks } * 1_000_000);
            let state = DriveState { q, qd, truth: None };
            let command = DriveCommand { tau, q_r: q, qd_r: qd, qdd_r: SVector::zeros() };
            watch.note(now, &robot, &mut control, Some((&state, &command)), None);
            if k > 1500 {
                most = most.max(watch.excess().max());
            }
        }
        most
    }

    #[test]
    fn ticks_that_were_missed_are_no_contact() {
        let [none, told, untold] =
            [(false, true), (true, true), (true, false)].map(|(gap, told)| felt_with_a_gap(gap, told));
        assert!(none < 1.0 && told < 1.0, "an arm that is its model: {none} {told}");
        assert!(untold > 3.0, "it would be felt otherwise: {untold}");
    }

    /// A joint behind a drive with a state every `period` ms, which follows its reference `lag` ms late until `stop` and then stands: when something holds it.
    fn held_behind(mode: CommandMode, period: i64, lag: i64, stop: i64) -> Option<i64> {
        let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
        let law = JointLaw::InverseDynamics(InverseDynamicsControl::new(40.0, 1.0));
        let mut control = JointController::new(law, ObserverSettings::none());
        let mut watch = ContactWatch::new(&robot, &control, mode);
        let reference = |ms: i64| Vector6::repeat(-0.4 * (1.0 - (1e-3 * ms as f64 * 2.0).cos()));
        let speed = |ms: i64| (reference(ms + 1) - reference(ms)) * 1e3;
        (0..3000).find(|&ms| {
            let seen = ms - ms % period;
            let at = (seen - lag).clamp(0, stop);
            let state = DriveState {
                q: reference(at),
                qd: if at < stop { speed(at) } else { SVector::zeros() },
                truth: None,
            };
            if seen != ms {
                watch.late();
            }
            let command = DriveCommand {
                tau: SVector::zeros(),
                q_r: reference(ms + 1),
                qd_r: speed(ms),
                qdd_r: SVector::zeros(),
            };
            watch.note(MonoNs(ms * 1_000_000), &robot, &mut control, Some((&state, &command)), None);
            watch.is_touched()
        })
    }

    #[test]
    fn a_joint_that_is_held_behind_a_slower_drive_is_told() {
        for (mode, lag) in [(CommandMode::Position, 34), (CommandMode::Velocity, 4)] {
            for period in [1, 2, 4, 8] {
                assert_eq!(held_behind(mode, period, lag, i64::MAX), None, "{mode:?} {period} ms: free");
                let held = held_behind(mode, period, lag, 400).unwrap_or(i64::MAX);
                assert!(held < 400 + lag + 80, "{mode:?} {period} ms: {held}");
            }
        }
    }

    #[test]
    fn a_force_at_the_flange_is_found_from_the_joints_torques() {
        let robot: Robot<6> = crate::robot::load("ur5").unwrap().build().unwrap();
        let q = Vector6::new(0.4, -1.4, 1.3, -1.0, -1.5, 0.3);
        for wanted in [Vector3::new(30.0, 0.0, 0.0), Vector3::new(-5.0, 12.0, 40.0)] {
            let torque = robot.jacobian(&q).fixed_rows::<3>(0).tr_mul(&wanted);
            let found = force(&robot, &q, &torque, &Vector6::repeat(0.5));
            assert!((found - wanted).norm() < 0.01 * wanted.norm(), "{found} {wanted}");
        }
    }
}
