//! Requests of clients that carry numbers: goals, postures, small motions, settings. They are checked and planned here, beside the real-time thread; what
//! comes out is one order, which control obeys with the request if its lifecycle accepts that.
//!
//! ```text
//! ControlCommand ─► [`Mission::plan`] ─► Request with its order ─► control: lifecycle ─► accepted? ─► [`Mission::decided`]: the mission's own goal
//!                         └► Refusal                                                      └► Refusal
//! ```

use super::accuracy::RunViewLog;
use super::truth::true_goal;
use super::{BelievedCell, Mission, RunTask, vector};
use crate::control::behaviour::CommandedMotion;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::order::ControlOrder;
use crate::geometry::{Pose, rotation_angle, unit_quaternion};
use crate::messages::{CommandForm, ControlCommand};
use crate::motion::Workspace;
use crate::scene::{is_edge_on, is_front};
use crate::servo::{PostureSearch, SetPoint};
use crate::target::PointKind;
use crate::time::SpanNs;
use nalgebra::{Point3, SVector, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};
use std::ops::RangeInclusive;

/// Bounds of `servo.gain_1_s`, in a run file and in a running loop, 1/s. Chosen by hand, wider than any use, so that a slip of the unit is reported.
pub const GAIN_1_S: RangeInclusive<f64> = 1e-3..=100.0;
/// The same of `goal.feature_error_px`. Chosen by hand.
pub const TOLERANCE_PX: RangeInclusive<f64> = 1e-6..=100.0;
/// The same of `goal.hold_s`. Chosen by hand.
pub const HOLD_S: RangeInclusive<f64> = 0.0..=60.0;

/// Longest jog, m. Chosen by hand: what a person expects of a key press, and less than what an arm has room for at most postures.
const JOG_M: f64 = 0.05;
/// The same in rad. Chosen by hand.
const JOG_RAD: f64 = 0.2;
/// Time for which a velocity may hold, s. Chosen by hand: at least some ticks, and no longer than a person would want an arm to go on by itself.
const VELOCITY_HOLD_S: RangeInclusive<f64> = 0.01..=1.0;
/// Largest velocity that anybody can mean, rad/s or m/s; slower arms go as fast as they may in that direction. Chosen by hand, beyond the fastest joints of
/// robot files, so that a slip of the unit is refused.
const VELOCITY: f64 = 30.0;
/// How far the camera may end from where a jog wants it, m and rad: more than the rounding of the search, less than anybody sees. Chosen by hand.
const JOG_REACHED: f64 = 1e-5;
/// Points that must be in the image at a goal, or all where there are fewer. Derived: four points in a plane are the fewest that give one pose.
const POINTS_IN_VIEW: usize = 4;
/// How far the points of a flat target may lie beside its plane z = 0, m. Chosen by hand: rounding.
const FLAT_M: f64 = 1e-9;
/// How far from its first point the farthest one of the target must be at a goal, px of the image's middle. Chosen by hand: half of what the smallest tag takes that is found.
const SMALLEST_PX: f64 = 8.0;
/// Normalized coordinates. Derived: they are tangents, and those of a camera that sees farther to the side than 89 degrees are beyond 57.
const FEATURES: RangeInclusive<f64> = -57.0..=57.0;
/// Position of a desired pose, m, as in a run file. Chosen by hand, wider than any cell.
const POSITION_M: RangeInclusive<f64> = -100.0..=100.0;

/// What the mission changes of its own when control accepts a request.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant)] // a few in a run
pub(super) enum MissionChange {
    /// The goal is to be reached anew.
    Start,
    /// The goal.
    Goal(SetPoint),
    /// Its tolerance, px.
    Tolerance(f64),
    /// For how long it must be held.
    Hold(SpanNs),
}

impl<const N: usize> Mission<N> {
    /// The same, which plans what clients ask for in `cell`.
    #[must_use]
    pub fn in_cell(self, cell: BelievedCell<N>) -> Self {
        Self { cell: Some(cell), ..self }
    }

    /// The same, which keeps views by which it can tell how near to its goal it has come.
    #[must_use]
    pub fn keeping_views(self, keeps: bool) -> Self {
        Self { views: keeps.then(RunViewLog::new), ..self }
    }

    /// The same, which refuses postures beyond limits in space.
    #[must_use]
    pub fn in_space(self, space: Option<Workspace<N>>) -> Self {
        Self { space, ..self }
    }

    /// The same with further targets beside the first one, each with its goal until it is given another.
    #[must_use]
    pub fn with_further_goals(mut self, further: impl IntoIterator<Item = SetPoint>) -> Self {
        self.goals.extend(further);
        self
    }

    /// Checks the request `number` of a client and plans it: the order that control is to obey with it.
    ///
    /// # Errors
    /// Why it cannot be done, whatever the state of control is.
    pub fn plan(
        &mut self,
        number: u64,
        request: Request,
        command: &ControlCommand,
    ) -> Result<Option<ControlOrder<N>>, Refusal> {
        let (change, order) = self.planned(request, command)?;
        self.pending.extend(change.map(|change| (number, change)));
        Ok(order)
    }

    /// Whether the goal or the posture of `command` would be refused whenever it is asked for; nothing changes by it. Of a posture the straight way of the joints
    /// to it is looked at where another posture stands before it, from which it begins.
    ///
    /// # Errors
    /// Why it would be refused.
    pub fn examine(&self, command: &ControlCommand) -> Result<(), Refusal> {
        match CommandForm::from_code(command.form) {
            None if command.form == 0 => Ok(()),
            Some(CommandForm::Joints) => {
                let numbers = numbers(command)?;
                let (from, to) = numbers.split_at(numbers.len() - N.min(numbers.len()));
                let to = joints_of(to)?;
                let from = if from.is_empty() { None } else { Some(joints_of(from)?) };
                self.posture_from(from.as_ref(), &to).map(drop)
            }
            Some(CommandForm::Features | CommandForm::Pose) => self.planned(Request::Goal, command).map(drop),
            _ => Err(Refusal::WrongNumbers),
        }
    }

    /// What a request changes here, and the order for control.
    #[allow(clippy::type_complexity)] // of this module alone
    fn planned(
        &self,
        request: Request,
        command: &ControlCommand,
    ) -> Result<(Option<MissionChange>, Option<ControlOrder<N>>), Refusal> {
        let form = CommandForm::from_code(command.form);
        if command.target != 0 && request != Request::Goal {
            return Err(Refusal::WrongNumbers);
        }
        if self.second.is_some() && matches!(request, Request::Goal | Request::Teach) {
            return Err(Refusal::UnknownCamera);
        }
        Ok(match (request, form) {
            (Request::Start, None) => (Some(MissionChange::Start), None),
            (Request::Hold | Request::Teach | Request::Reset | Request::Stop | Request::Shutdown, None) => {
                (None, None)
            }
            (Request::Goal, form) if form.is_some() || command.target != 0 => {
                let goal = self.goal_of(form, command)?;
                (Some(MissionChange::Goal(goal.clone())), Some(ControlOrder::Goal(goal)))
            }
            (Request::Goto, Some(CommandForm::Joints)) => {
                (None, Some(ControlOrder::Posture(self.posture(&joints(command)?)?)))
            }
            (Request::Jog, Some(form)) => (None, Some(ControlOrder::Posture(self.jogged(form, command)?))),
            (Request::Velocity, Some(form)) => (None, Some(self.velocity(form, command)?)),
            (Request::Set, Some(form)) => self.setting(form, command)?,
            _ => return Err(Refusal::WrongNumbers),
        })
    }

    /// Takes in whether control has accepted the request `number`.
    pub fn decided(&mut self, number: u64, accepted: bool) {
        while let Some((_, change)) = self.pending.pop_front_if(|(earlier, _)| *earlier <= number) {
            if !accepted {
                continue;
            }
            match change {
                MissionChange::Start => self.watch_goals_anew(),
                MissionChange::Goal(set_point) => self.set_goal(set_point),
                // Whether the goal is reached by what is asked for now, nobody has seen yet.
                MissionChange::Tolerance(px) => {
                    self.goal.tolerance_px = px;
                    self.goal_watch.begin_anew();
                }
                MissionChange::Hold(hold) => {
                    self.goal.hold = hold;
                    self.goal_watch.hold_anew();
                }
            }
        }
    }

    /// The goal is another one from now on, and rests.
    pub(super) fn set_goal(&mut self, set_point: SetPoint) {
        self.plan.path = None;
        if let RunTask::LookAndMove(task) = &mut self.task {
            task.forget_search();
        }
        self.measurements.forget_error();
        if set_point.target() != self.goal.set_point.target() {
            self.measurements.forget_view();
        }
        if let Some(place) = self.goals.get_mut(set_point.target() as usize) {
            place.clone_from(&set_point);
        }
        self.true_goal = true_goal(self.truth.as_ref(), &set_point);
        (self.goal.set_point, self.goal.id) = (set_point, self.goal.id.saturating_add(1));
        self.goal_watch.begin_anew();
        self.residual.begin_anew();
        self.way_asked = false;
    }

    /// For how long the goal has been reached and held, s; NaN where it is not.
    #[must_use]
    pub fn at_goal_s(&self) -> f64 {
        self.goal_watch.at_goal_s(self.last)
    }

    /// The last goal of each target, by the targets' numbers.
    pub fn set_points(&self) -> impl Iterator<Item = &SetPoint> {
        let present = &self.goal.set_point;
        self.goals.iter().map(move |goal| if goal.target() == present.target() { present } else { goal })
    }

    /// What the points of the goal's target are.
    pub(super) fn point_kind(&self) -> PointKind {
        let number = self.goal.set_point.target() as usize;
        self.plan.points.get(number).copied().unwrap_or(PointKind::Dots)
    }

    /// The goal that a request gives; without numbers it is the last one of the target that it names.
    fn goal_of(&self, form: Option<CommandForm>, command: &ControlCommand) -> Result<SetPoint, Refusal> {
        let target = command.target.checked_sub(1).unwrap_or(self.goal.set_point.target());
        let before = self.goals.get(target as usize).ok_or(Refusal::UnknownTarget)?;
        let Some(form) = form else { return Ok(before.clone()) };
        let numbers = numbers(command)?;
        let goal = match form {
            CommandForm::Features => {
                let ids = command.ids.get(..numbers.len() / 2).unwrap_or_default();
                if ids != before.ids() || numbers.len() != 2 * before.points().len() {
                    return Err(Refusal::OtherPoints);
                }
                if !numbers.iter().all(|x| FEATURES.contains(x)) {
                    return Err(Refusal::WrongNumbers);
                }
                let s_d: Vec<_> = numbers.chunks_exact(2).map(Vector2::from_column_slice).collect();
                before.at_features(&s_d)
            }
            CommandForm::Pose => before.at_pose(&pose_of(numbers)?),
            _ => return Err(Refusal::WrongNumbers),
        };
        let goal = goal.ok_or(Refusal::OutOfView)?;
        match flat_target_at(&goal) {
            Some(X_DO) if !is_front(X_DO) => Err(Refusal::FromBehind),
            Some(X_DO) if is_edge_on(X_DO) => Err(Refusal::EdgeOn),
            _ if !self.is_in_view(&goal) => Err(Refusal::OutOfView),
            _ if self.is_too_small(&goal) => Err(Refusal::TooSmall),
            _ => Ok(goal),
        }
    }

    /// Whether no detector could tell the points of the target apart at `goal`; of a single point that is not known.
    fn is_too_small(&self, goal: &SetPoint) -> bool {
        let (Some(cell), [first, others @ ..]) = (&self.cell, goal.features()) else { return false };
        let i = cell.camera.intrinsics();
        let apart_px = others.iter().map(|s| ((s.x - first.x) * i.fx_px).hypot((s.y - first.y) * i.fy_px));
        !others.is_empty() && apart_px.fold(0.0, f64::max) < SMALLEST_PX
    }

    /// Whether enough of the target is in the image at `goal`.
    fn is_in_view(&self, goal: &SetPoint) -> bool {
        let Some(cell) = &self.cell else { return true };
        let places = goal.features().iter().zip(goal.depths_m());
        let seen = places.filter(|(s, z)| {
            let px = cell.camera.project(&Point3::new(s.x * **z, s.y * **z, **z));
            px.is_some_and(|px| cell.camera.contains(&px, 0.0))
        });
        seen.count() >= goal.features().len().min(POINTS_IN_VIEW)
    }

    /// The posture, where the arm can be there.
    fn posture(&self, q: &SVector<f64, N>) -> Result<SVector<f64, N>, Refusal> {
        self.posture_from(Some(&vector(&self.joint_state.q)), q)
    }

    /// The same on the straight way of the joints from `from`; `None`: from wherever, so that no way is looked at.
    fn posture_from(
        &self,
        from: Option<&SVector<f64, N>>,
        q: &SVector<f64, N>,
    ) -> Result<SVector<f64, N>, Refusal> {
        let cell = self.cell.as_ref().filter(|_| self.plan.closed_loop).ok_or(Refusal::NoArm)?;
        if cell.robot.outside_limits(q).is_some() {
            return Err(Refusal::OutOfRange);
        }
        // What is beyond a limit already may go anywhere from there that is not farther beyond.
        let is_free = |space: &Workspace<N>| match from {
            Some(from) => space.is_free(from, q),
            None => space.admits(q, &vector(&self.joint_state.q)),
        };
        if self.space.as_ref().is_none_or(is_free) { Ok(*q) } else { Err(Refusal::OutOfWorkspace) }
    }

    /// The posture to which a jog leads from where the arm is.
    fn jogged(&self, form: CommandForm, command: &ControlCommand) -> Result<SVector<f64, N>, Refusal> {
        let q: SVector<f64, N> = vector(&self.joint_state.q);
        let cell = self.cell.as_ref().ok_or(Refusal::NoArm)?;
        match form {
            CommandForm::Joints => {
                let dq = joints::<N>(command)?;
                let longest = |i| if cell.robot.is_prismatic(i) { JOG_M } else { JOG_RAD };
                let is_short = (0..N).all(|i| dq[i].abs() <= longest(i));
                if is_short { self.posture(&(q + dq)) } else { Err(Refusal::TooFar) }
            }
            CommandForm::CameraMotion => {
                let &[x, y, z, rx, ry, rz] = numbers(command)? else { return Err(Refusal::WrongNumbers) };
                let (p, r) = (Vector3::new(x, y, z), Vector3::new(rx, ry, rz));
                if p.norm() > JOG_M || r.norm() > JOG_RAD {
                    return Err(Refusal::TooFar);
                }
                let search = PostureSearch { robot: &cell.robot, mount: &cell.mount };
                let by = Pose::from_parts(p.into(), UnitQuaternion::from_scaled_axis(r));
                let X_WD = search.X_WC(&q) * by;
                let found = search.towards(&q, &X_WD);
                let off = search.X_WC(&found).inv_mul(&X_WD);
                let angle = rotation_angle(&off.rotation.to_rotation_matrix());
                if off.translation.vector.norm().max(angle) > JOG_REACHED {
                    return Err(Refusal::OutOfReach);
                }
                self.posture(&found)
            }
            _ => Err(Refusal::WrongNumbers),
        }
    }

    /// The velocity of a client, with the time for which it holds.
    fn velocity(&self, form: CommandForm, command: &ControlCommand) -> Result<ControlOrder<N>, Refusal> {
        self.cell.as_ref().filter(|_| self.plan.closed_loop).ok_or(Refusal::NoArm)?;
        let (&hold_s, velocity) = numbers(command)?.split_last().ok_or(Refusal::WrongNumbers)?;
        let is_plausible = VELOCITY_HOLD_S.contains(&hold_s) && velocity.iter().all(|v| v.abs() <= VELOCITY);
        let motion = match form {
            CommandForm::JointVelocity if velocity.len() == N => {
                CommandedMotion::Joints(SVector::from_column_slice(velocity))
            }
            CommandForm::CameraTwist if velocity.len() == 6 => {
                CommandedMotion::Twist(Vector6::from_column_slice(velocity))
            }
            _ => return Err(Refusal::WrongNumbers),
        };
        if is_plausible {
            Ok(ControlOrder::Velocity(motion, SpanNs::from_s(hold_s)))
        } else {
            Err(Refusal::WrongNumbers)
        }
    }

    #[allow(clippy::type_complexity)] // of this module alone
    fn setting(
        &self,
        form: CommandForm,
        command: &ControlCommand,
    ) -> Result<(Option<MissionChange>, Option<ControlOrder<N>>), Refusal> {
        let &[x] = numbers(command)? else { return Err(Refusal::WrongNumbers) };
        let within = |range: RangeInclusive<f64>| {
            if range.contains(&x) { Ok(x) } else { Err(Refusal::WrongNumbers) }
        };
        Ok(match form {
            CommandForm::Gain => {
                let follows_law = !matches!(self.task, RunTask::LookAndMove(_));
                if !(follows_law && self.plan.law.has_one_gain()) {
                    return Err(Refusal::NoGain);
                }
                (None, Some(ControlOrder::Gain(within(GAIN_1_S)?)))
            }
            CommandForm::Tolerance => (Some(MissionChange::Tolerance(within(TOLERANCE_PX)?)), None),
            CommandForm::Hold => (Some(MissionChange::Hold(SpanNs::from_s(within(HOLD_S)?))), None),
            _ => return Err(Refusal::WrongNumbers),
        })
    }
}

fn numbers(command: &ControlCommand) -> Result<&[f64], Refusal> {
    let numbers = command.numbers();
    let is_good = !numbers.is_empty() && numbers.iter().all(|x| x.is_finite());
    if is_good { Ok(numbers) } else { Err(Refusal::WrongNumbers) }
}

fn joints<const N: usize>(command: &ControlCommand) -> Result<SVector<f64, N>, Refusal> {
    joints_of(numbers(command)?)
}

fn joints_of<const N: usize>(numbers: &[f64]) -> Result<SVector<f64, N>, Refusal> {
    if numbers.len() == N { Ok(SVector::from_column_slice(numbers)) } else { Err(Refusal::WrongNumbers) }
}

/// The pose of position and quaternion x, y, z, w.
fn pose_of(numbers: &[f64]) -> Result<Pose, Refusal> {
    let &[px, py, pz, x, y, z, w] = numbers else { return Err(Refusal::WrongNumbers) };
    let rotation =
        unit_quaternion([x, y, z, w]).filter(|_| [px, py, pz].iter().all(|x| POSITION_M.contains(x)));
    let pose = |rotation| Pose::from_parts(Translation3::new(px, py, pz), rotation);
    rotation.map(pose).ok_or(Refusal::WrongNumbers)
}

/// Where a flat target is at `goal`; `None` of a body, which has other faces, and where that is not known.
fn flat_target_at(goal: &SetPoint) -> Option<&Pose> {
    let is_flat = goal.points().iter().all(|p| p.z.abs() < FLAT_M);
    goal.X_DO().filter(|_| is_flat)
}

#[cfg(test)]
mod tests;
