//! Contact: something from outside acts on the arm.
//!
//! With a drive that obeys torques the [momentum observer](ExternalTorqueObserver) tells the torque from outside of each joint, with its standard deviation. A drive that closes
//! its own loop seldom tells its torques: there a joint that [falls behind](DriveLagObserver) its commands by more than that drive does by itself is in contact, and where its states carry torques, they are observed beside that. Before every drive a joint that
//! [is stopped](super::stopped_joint) in its motion is.

use super::stopped_joint::StoppedJointWatch;
use crate::drive::{CommandMode, DriveCommand, DriveState, DriveTiming};
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
/// Largest force that is expected, N: the prior of the estimate at the flange, and what is told at most. Chosen by hand; the prior decides only along directions that no joint feels, and the jammed
/// joint of a SCARA, whose torques any force explains, would make one of 4 kN.
const FORCE_N: f64 = 1e3;
/// Least share of the weighted squares of the torques that a force at the flange must explain: what holds one joint, or a link before the flange, takes torques that no such force takes.
/// Derived: of a torque of [`CERTAIN`] the noise of seven joints leaves a tenth.
const EXPLAINED: f64 = 0.9;
/// Standard deviations from which on a joint feels something, for a force that is told: two joints must. Chosen by hand, of noise alone it is one in 370; a force can be found for the
/// torque of one joint alone, as of one that is jammed, and none is known to be there.
const FEELS: f64 = 3.0;

/// Share of its effort by which the torque on a joint whose reading stays the same may grow. Measured (`vservo faults`, encoders that freeze, 20 seeds): without a bound the true joints of `panda-unlike`, `ur5-unlike` and `xarm7`
/// came to 11.8, 8.1 and 2.2 times their speed limits, with 0.15 to 2.8, 1.9 and 1.6 times, with 0.1 to 1.5, 1.04 and 1.0 times. Hard friction of a twentieth of the effort that no file tells is overcome as without a bound with 0.15 (6 of 6
/// runs), and with 0.1 in 3; of a tenth in 1 of 6, without a bound in 2.
const STUCK_SHARE: f64 = 0.15;
/// The same for the Coulomb friction of its model, from one way to the other. Derived: it is tested up to twice that of the file.
const STUCK_COULOMB: f64 = 4.0;

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
    /// The force on the flange's origin in B that explains the torques, N; `None` where torques are not known, or no such force explains them: what holds a joint, or a link before
    /// the flange.
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
    /// The torque from outside of each joint when its reading came to stay the same, N m or N.
    stuck_from: [Option<f64>; N],
    /// The last tick that was taken in.
    at: Option<MonoNs>,
    since: SinceState<N>,
}

/// What was commanded since the last new state, between which a slower drive has several ticks.
#[derive(Debug, Clone)]
struct SinceState<const N: usize> {
    ticks: u32,
    /// Sums over them, of velocities, rad/s or m/s, and of torques, N m or N.
    qd_r: SVector<f64, N>,
    tau: SVector<f64, N>,
    /// Ticks from the state before the last to the last.
    ticks_before: u32,
}

impl<const N: usize> SinceState<N> {
    fn new() -> Self {
        Self { ticks: 0, qd_r: SVector::zeros(), tau: SVector::zeros(), ticks_before: 0 }
    }

    fn add(&mut self, command: &DriveCommand<N>) {
        self.ticks += 1;
        self.qd_r += command.qd_r;
        self.tau += command.tau;
    }

    /// The ticks, the mean velocity and the mean torque, and whether there were as many ticks as to the state before: else a state came early or late, and its time is not known to the tick.
    fn take(&mut self) -> (u32, SVector<f64, N>, SVector<f64, N>, bool) {
        let ticks = self.ticks.max(1);
        let share = 1.0 / f64::from(ticks);
        let taken = (ticks, self.qd_r * share, self.tau * share, ticks == self.ticks_before);
        *self = Self { ticks_before: ticks, ..Self::new() };
        taken
    }
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
            stuck_from: [None; N],
            at: None,
            since: SinceState::new(),
        }
    }

    /// Takes in what the last `command` did to the arm, which is in `state` at `now`; `None` where one of them is not known. Behind a slower drive a state ends the ticks since the one before. A
    /// deadline that was missed, and a state that came earlier or later than the one before it, tell no acceleration, and are left out. `measured` are the torques that the state carries, N m or N, where it carries any:
    /// they count instead of the commanded ones, because delay, limits and ripple of the motors are in them.
    pub fn note(
        &mut self,
        (now, timing): (MonoNs, DriveTiming),
        robot: &Robot<N>,
        joint_control: &mut JointController<N>,
        did: Option<(&DriveState<N>, &DriveCommand<N>)>,
        measured: Option<&SVector<f64, N>>,
    ) {
        let (model, rotors) = (joint_control.take_model_change(), joint_control.take_rotor_change());
        if let Some(change) = &model {
            let joints = self.stuck_from.iter_mut().zip(change);
            joints.for_each(|(from, change)| *from = from.map(|from| from + change));
        }
        if let Some(observer) = self.observer.of_torques() {
            model.iter().for_each(|change| observer.change_model(change));
            rotors.iter().for_each(|change| observer.add_rotors(change));
        }
        let known = did.filter(|_| !timing.tells_nothing());
        let did = did.filter(|_| !timing.is_old());
        let before = std::mem::replace(&mut self.at, known.map(|_| now));
        let has_gap = before.is_some_and(|before| now - before > TICK);
        if has_gap {
            self.forget_state();
        }
        if has_gap || timing.is_gap() {
            joint_control.skip_window();
        }
        // That a joint stands is seen between two states of a slower drive, too.
        if let Some((state, command)) = known {
            let obeys_velocities = matches!(self.observer, Observer::Lag { by_position: false, .. });
            let q_r = (!obeys_velocities).then_some(&command.q_r);
            self.stopped.note(&state.q, joint_control.encoder_step(), (q_r, &command.qd_r));
        }
        match known {
            Some((_, command)) => self.since.add(command),
            None => self.since = SinceState::new(),
        }
        match (&mut self.observer, did) {
            // Between two states of a slower drive there is nothing to judge.
            (_, None) if known.is_some() => return,
            (observer, None) => {
                self.stopped.restart();
                observer.forget_state();
            }
            (Observer::Torque(observer), Some((state, _))) => {
                let (ticks, _, commanded, is_regular) = self.since.take();
                if !is_regular {
                    observer.skip();
                }
                let doubt = (&joint_control.payload_doubt(), &joint_control.rotor_doubt());
                let tau = measured.unwrap_or(&commanded);
                observer.hide(|ticks| joint_control.hidden_torque(ticks));
                observer.note(joint_control.carrying(robot), (&state.q, &state.qd), (tau, ticks), doubt);
            }
            (Observer::Lag { observer, last, by_position, torque, has_torques }, Some((state, command))) => {
                let (ticks, qd_r, _, is_regular) = self.since.take();
                if let Some(tau) = measured {
                    let zero = SVector::zeros();
                    *has_torques = true;
                    if !is_regular {
                        torque.skip();
                    }
                    torque.note(robot, (&state.q, &state.qd), (tau, ticks), (&zero, &zero));
                }
                if let Some(before) = last.replace(state.q) {
                    let lag = command.q_r - state.q;
                    observer.note((&qd_r, ticks), &(state.q - before), by_position.then_some(&lag));
                }
            }
        }
        let touched = self.excess().max() > CERTAIN;
        self.in_a_row = if touched { self.in_a_row.saturating_add(1) } else { 0 };
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

    /// Whether a joint whose reading `stays` the same has been pushed by more than friction takes since then: its encoder is frozen, or it is held.
    pub fn is_stuck(&mut self, robot: &Robot<N>, stays: &[bool; N]) -> bool {
        let Some((torque, _)) = self.external_torque() else { return false };
        let joints = self.stuck_from.iter_mut().zip(stays).zip(&torque);
        let limits = robot.limits().iter().zip(robot.friction());
        joints.zip(limits).fold(false, |is_stuck, (((from, stays), torque), (limit, friction))| {
            *from = stays.then(|| from.unwrap_or(*torque));
            let reach = STUCK_SHARE * limit.effort + STUCK_COULOMB * friction.coulomb;
            is_stuck || from.is_some_and(|from| (torque - from).abs() > reach)
        })
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
        // A joint that stands still where it should move tells no torque.
        let torques = self.external_torque().filter(|_| self.in_a_row >= TICKS);
        Some(Contact {
            joint,
            torque: torques.map(|(torque, _)| torque[joint]),
            force_B: torques.and_then(|(torque, sd)| force(robot, q, &torque, &sd)),
        })
    }
}

/// The force on the flange's origin in B, N, that explains the torques best: weighted least squares with a prior; `None` where it does not explain them.
fn force<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    torque: &SVector<f64, N>,
    sd: &SVector<f64, N>,
) -> Option<Vector3<f64>> {
    let J = robot.jacobian(q);
    let mut A = Matrix3::identity() / (FORCE_N * FORCE_N);
    let (mut b, mut squares) = (Vector3::zeros(), 0.0);
    for i in 0..N {
        let column = J.fixed_view::<3, 1>(0, i).into_owned();
        let weight = 1.0 / (sd[i] * sd[i]);
        A += column * column.transpose() * weight;
        b += column * (torque[i] * weight);
        squares += torque[i] * torque[i] * weight;
    }
    let found = Vector3::from(Ldlt::of(&A)?.solve(&b.into()));
    let feel = (0..N).filter(|i| torque[*i].abs() > FEELS * sd[*i]).count();
    (feel > 1 && b.dot(&found) >= EXPLAINED * squares && found.norm() < FORCE_N).then_some(found)
}

#[cfg(test)]
mod tests;
