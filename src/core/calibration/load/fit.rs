//! Least squares over the equations of a recording, with a prior that keeps what the motion does not show finite.
//!
//! Residuals are no white noise: friction that is not as its formula, ripple and rotors differ for as long as a joint moves one way. So each
//! joint's equations weigh as much as their own residuals let them, and an equation counts only as far as it says something that its neighbours
//! have not said: by the sum of the residuals' correlations along time.

use super::equations::{EVERY, JointEquation, LOAD, equations};
use super::estimate::{GYRATION_M, JOINT, LoadEstimate, LoadPosterior};
use super::recording::LoadRecording;
use crate::robot::{Inertia, Robot, parallel_axis};
use crate::time::TICK;
use nalgebra::{DMatrix, DVector, Vector3};
use thiserror::Error;

/// Fewest equations. Chosen by hand: ten for each number of an arm of seven joints, 3 s of motion of one joint.
const LEAST: usize = 310;
/// Rounds in which weights and the prior of the inertia follow what was found. Chosen by hand: the fourth changes the third by less than a per cent of a
/// standard deviation.
const ROUNDS: usize = 5;
/// Standard deviation of what no model of a joint's torque is better than, as a share of its largest effort. Chosen by hand: a tenth of what a torque constant is
/// usually told to.
const FLOOR: f64 = 1e-3;
/// How long that keeps its sign, s. Chosen by hand: half of a leg of the motion.
const FLOOR_S: f64 = 1.0;
/// The same before any residual is known. Chosen by hand: the rounds that follow forget it.
const FIRST_GUESS: f64 = 0.01;
/// Correlations below are taken as the end of what residuals remember. Chosen by hand, above what a hundred numbers correlate by chance.
const REMEMBERED: f64 = 0.1;
/// Longest memory, s. Chosen by hand: the longest leg.
const LONGEST_S: f64 = 6.0;
/// Standard deviation of the prior of the mass, kg. Chosen by hand: ten times what an arm of seven joints carries, so that it is told by the motion alone.
const PRIOR_KG: f64 = 100.0;
/// The same of the first moment, kg m. Chosen by hand: ten times that of 3 kg at 0.1 m, for the same.
const PRIOR_KG_M: f64 = 3.0;
/// Mass that the prior of the moments counts with at least, kg. Chosen by hand: that of a small camera.
const LEAST_KG: f64 = 0.1;
/// Prior of a joint's friction, as a share of its largest effort: at any speed, and at its largest one. Chosen by hand: more would leave nothing to move with.
const FRICTION_SHARE: f64 = 0.5;
/// Prior of rotors that the file tells, as a share. Chosen by hand, beyond what makers state.
const TOLD_ROTOR_SHARE: f64 = 0.2;
/// Prior of rotors that it does not tell, as a share of what is likely ([`JointLimits::likely_rotor`](crate::robot::JointLimits::likely_rotor)). Chosen by hand:
/// with all of what is likely, or none.
const UNTOLD_ROTOR_SHARE: f64 = 1.0;
/// Standard deviation of the mass, kg, from which on it counts as not seen. Chosen by hand: half a kilogram is what the grippers of small arms weigh.
const UNSEEN_KG: f64 = 0.5;
/// The same as a share of the mass, since a heavy load may be less certain; both must be exceeded. Chosen by hand: two deviations from none.
const UNSEEN_SHARE: f64 = 0.5;
/// Standard deviations by which a mass may be below zero. Chosen by hand: one of a thousand by chance.
const BELOW_ZERO: f64 = 3.0;

/// Why no load was found.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum LoadError {
    /// The joints hardly moved.
    #[error(
        "only {found} instants of moving joints were seen, {needed} are needed: start where the joints are away from the ends of their ranges, and \
         where [workspace] leaves room"
    )]
    TooFew {
        /// Equations.
        found: usize,
        /// At least.
        needed: usize,
    },
    /// The mass does not show.
    #[error(
        "the mass does not show: {mass_kg:.2} +- {sd_kg:.2} kg. Start in a posture where the flange is far from the axes of the large joints, or gravity \
         is across them"
    )]
    Unseen {
        /// What was found, kg.
        mass_kg: f64,
        /// Its standard deviation, kg.
        sd_kg: f64,
    },
    /// The arm is lighter than its model.
    #[error(
        "the load would weigh {mass_kg:.2} +- {sd_kg:.2} kg: the robot file tells heavier links than the arm has, or [tool] counts what is in the robot file \
         already"
    )]
    Negative {
        /// What was found, kg.
        mass_kg: f64,
        /// Its standard deviation, kg.
        sd_kg: f64,
    },
    /// The equations have no solution.
    #[error("the torques contradict themselves: they are not finite, or not of this arm")]
    Singular,
}

/// The load of the arm `robot`, which is believed to carry `tool`; both in the flange's frame. What is found includes the tool.
///
/// # Errors
/// [`LoadError`], each with what helps.
pub fn fit_load<const N: usize>(
    robot: &Robot<N>,
    tool: &Inertia,
    recording: &LoadRecording<N>,
) -> Result<LoadEstimate, LoadError> {
    let equations = equations(robot, tool, recording);
    if equations.len() < LEAST {
        return Err(LoadError::TooFew { found: equations.len(), needed: LEAST });
    }
    let mut problem = LoadProblem::new(robot, tool, &equations);
    let mut posterior = problem.solve()?;
    for _ in 1..ROUNDS {
        problem.follow(&posterior);
        posterior = problem.solve()?;
    }
    let (mass_kg, sd_kg) = (posterior.load[0], posterior.covariance[(0, 0)].sqrt());
    if mass_kg < -BELOW_ZERO * sd_kg {
        return Err(LoadError::Negative { mass_kg, sd_kg });
    }
    if sd_kg > UNSEEN_KG && sd_kg > UNSEEN_SHARE * mass_kg.abs() {
        return Err(LoadError::Unseen { mass_kg, sd_kg });
    }
    Ok(LoadEstimate::new(&posterior, robot, problem.residual_shares(&posterior)))
}

/// The equations with their weights and the prior.
struct LoadProblem<'a, const N: usize> {
    robot: &'a Robot<N>,
    tool: Inertia,
    equations: &'a [JointEquation],
    /// Variance of each joint's torques for one equation of those that say something new, (N m)^2 or N^2.
    variance: [f64; N],
    prior: LoadPrior,
}

/// Means and standard deviations of all numbers before the motion.
struct LoadPrior {
    mean: DVector<f64>,
    sd: DVector<f64>,
}

impl<'a, const N: usize> LoadProblem<'a, N> {
    fn new(robot: &'a Robot<N>, tool: &Inertia, equations: &'a [JointEquation]) -> Self {
        let mut prior =
            LoadPrior { mean: DVector::zeros(LOAD + JOINT * N), sd: DVector::zeros(LOAD + JOINT * N) };
        for (i, limit) in robot.limits().iter().enumerate() {
            let (friction, told) = (robot.friction()[i], robot.armature()[i]);
            let rotor =
                if told > 0.0 { TOLD_ROTOR_SHARE * told } else { UNTOLD_ROTOR_SHARE * limit.likely_rotor() };
            let effort = FRICTION_SHARE * limit.effort;
            let numbers =
                [(friction.coulomb, effort), (friction.viscous, effort / limit.velocity), (0.0, rotor)];
            for (k, (mean, sd)) in numbers.into_iter().enumerate() {
                (prior.mean[LOAD + JOINT * i + k], prior.sd[LOAD + JOINT * i + k]) = (mean, sd);
            }
        }
        let variance =
            std::array::from_fn(|i| (FIRST_GUESS * robot.limits()[i].effort).powi(2) * FLOOR_S / step_s());
        let mut problem = Self { robot, tool: *tool, equations, variance, prior };
        problem.expect(tool.mass, &tool.com);
        problem
    }

    /// The prior of a load of about `mass` kg at `com`, m: its moments are those of the tool about its own centre of mass, within what loads have.
    fn expect(&mut self, mass: f64, com: &Vector3<f64>) {
        let h = self.tool.com * self.tool.mass;
        let I = self.tool.about_com + parallel_axis(mass.max(0.0), com);
        let means = [self.tool.mass, h.x, h.y, h.z, I.m11, I.m22, I.m33, I.m12, I.m13, I.m23];
        let moment = mass.max(LEAST_KG) * GYRATION_M * GYRATION_M;
        for (k, mean) in means.into_iter().enumerate() {
            self.prior.mean[k] = mean;
            self.prior.sd[k] = match k {
                0 => PRIOR_KG,
                1..=3 => PRIOR_KG_M,
                4..=6 => moment,
                // Products of inertia are at most half of the largest moment.
                _ => 0.5 * moment,
            };
        }
    }

    fn row(equation: &JointEquation) -> impl Iterator<Item = (usize, f64)> + '_ {
        let first = LOAD + JOINT * equation.joint;
        let of_joint = [equation.qd.signum(), equation.qd, equation.qdd];
        let load = equation.load.iter().copied().enumerate();
        load.chain(of_joint.into_iter().enumerate().map(move |(k, x)| (first + k, x)))
    }

    fn solve(&self) -> Result<LoadPosterior, LoadError> {
        let size = LOAD + JOINT * N;
        let weights = self.prior.sd.map(|sd| sd.powi(-2));
        let mut information = DMatrix::from_diagonal(&weights);
        let mut right = weights.component_mul(&self.prior.mean);
        for equation in self.equations {
            let weight = 1.0 / self.variance[equation.joint];
            for (i, a) in Self::row(equation) {
                right[i] += weight * a * equation.torque;
                for (j, b) in Self::row(equation) {
                    information[(i, j)] += weight * a * b;
                }
            }
        }
        // Scaled by the prior, so that kilograms and their moments may stand beside each other.
        let scale = &self.prior.sd;
        let scaled = DMatrix::from_fn(size, size, |i, j| information[(i, j)] * scale[i] * scale[j]);
        let factors = scaled.cholesky().ok_or(LoadError::Singular)?;
        let found = factors.solve(&right.component_mul(scale)).component_mul(scale);
        let inverse = factors.inverse();
        let covariance = DMatrix::from_fn(size, size, |i, j| inverse[(i, j)] * scale[i] * scale[j]);
        if !found.iter().chain(covariance.iter()).all(|x| x.is_finite()) {
            return Err(LoadError::Singular);
        }
        Ok(LoadPosterior {
            load: std::array::from_fn(|k| found[k]),
            joints: found.iter().skip(LOAD).copied().collect(),
            covariance,
            moment_prior_sd: self.prior.sd[4],
        })
    }

    /// Residuals of joint `i`, with their instants.
    fn residuals(&self, i: usize, at: &LoadPosterior) -> Vec<(usize, f64)> {
        let number = |k: usize| {
            if k < LOAD { at.load[k] } else { at.joints.get(k - LOAD).copied().unwrap_or_default() }
        };
        let of_joint = self.equations.iter().filter(|equation| equation.joint == i);
        of_joint
            .map(|e| (e.instant, e.torque - Self::row(e).map(|(k, a)| a * number(k)).sum::<f64>()))
            .collect()
    }

    /// Sets weights and prior by what was found.
    fn follow(&mut self, at: &LoadPosterior) {
        for i in 0..N {
            let residuals = self.residuals(i, at);
            if residuals.is_empty() {
                continue;
            }
            let square = residuals.iter().map(|(_, r)| r * r).sum::<f64>() / residuals.len() as f64;
            let floor = (FLOOR * self.robot.limits()[i].effort).powi(2) * FLOOR_S / step_s();
            self.variance[i] = square * memory(&residuals, square) + floor;
        }
        let mass = at.load[0];
        let h = Vector3::new(at.load[1], at.load[2], at.load[3]);
        self.expect(mass, &if mass > LEAST_KG { h / mass } else { Vector3::zeros() });
    }

    /// Root mean square of each joint's residuals, as a share of its largest effort.
    fn residual_shares(&self, at: &LoadPosterior) -> Vec<f64> {
        let share = |i: usize| {
            let residuals = self.residuals(i, at);
            let square = residuals.iter().map(|(_, r)| r * r).sum::<f64>() / (residuals.len().max(1) as f64);
            square.sqrt() / self.robot.limits()[i].effort
        };
        (0..N).map(share).collect()
    }
}

/// Time between two instants, s.
fn step_s() -> f64 {
    EVERY as f64 * TICK.as_s()
}

/// How many neighbours say the same: 1 and twice the sum of the correlations along time, until they are forgotten.
fn memory(residuals: &[(usize, f64)], square: f64) -> f64 {
    if square <= 0.0 {
        return 1.0;
    }
    let mut memory = 1.0;
    for lag in 1..=(LONGEST_S / step_s()) as usize {
        let (mut sum, mut count) = (0.0, 0_u32);
        let mut later = residuals.iter().peekable();
        for (instant, r) in residuals {
            while later.peek().is_some_and(|(at, _)| *at < instant + lag) {
                later.next();
            }
            if let Some((_, next)) = later.peek().filter(|(at, _)| *at == instant + lag) {
                sum += r * next;
                count += 1;
            }
        }
        let correlation = if count > 0 { sum / f64::from(count) / square } else { 0.0 };
        if correlation < REMEMBERED {
            break;
        }
        memory += 2.0 * correlation;
    }
    memory
}
