//! Postures about the start, between which the torques show what the flange carries: gravity's direction in the flange changes, and each joint goes
//! both ways with and without the others.
//!
//! Obstacles are not known beyond `[workspace]`: no joint by itself moves the flange far, and all of them together stay near to the start.

use crate::motion::{MotionLimits, Workspace};
use crate::robot::Robot;
use nalgebra::SVector;

/// Postures beside the start, which is the last one. Chosen by hand: with six the masses are half as certain, and the tour of an arm with six joints takes a minute.
const POSTURES: usize = 12;
/// Fewest of them. Chosen by hand: each joint has then gone both ways.
const LEAST: usize = 4;
/// Farthest that a joint goes from the start, rad or m. Chosen by hand: a wrist shows gravity across and along its tool.
const FARTHEST: f64 = 1.2;
/// Farthest that a joint by itself takes the flange, m. Chosen by hand: a hand's breadth.
const FLANGE_M: f64 = 0.12;
/// Farthest that all of them take it, m. Chosen by hand: the length of a tool.
const ALL_M: f64 = 0.25;
/// Share of the way to the end of its range that a joint may go. Chosen by hand: half of it stays free for overshoot.
const RANGE_SHARE: f64 = 0.5;
/// Shares of a posture that are tried until it is within reach. Chosen by hand: less than a third of it shows little.
const SHARES: [f64; 4] = [1.0, 0.75, 0.5, 0.3];
/// Whose square roots spread the postures evenly, one for each joint: the first primes, because none of their roots is a multiple of another.
const PRIMES: [f64; 7] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0];

/// The cell in which a tour is planned.
#[derive(Debug, Clone, Copy)]
pub struct LoadTourCell<'a, const N: usize> {
    /// The arm.
    pub robot: &'a Robot<N>,
    /// Limits of its motion.
    pub limits: &'a MotionLimits<N>,
    /// Its limits in space, where there are some.
    pub space: Option<&'a Workspace<N>>,
}

/// A tour in the making.
#[derive(Debug, Clone)]
pub struct LoadTour<const N: usize> {
    start: SVector<f64, N>,
    reach: SVector<f64, N>,
    tried: usize,
    postures: Vec<SVector<f64, N>>,
}

impl<const N: usize> LoadTour<N> {
    /// A tour from `q`, rad or m, and back.
    #[must_use]
    pub fn new(q: &SVector<f64, N>, cell: &LoadTourCell<'_, N>) -> Self {
        let J = cell.robot.jacobian(q);
        let reach = SVector::from_fn(|i, _| {
            let moved = J.column(i).fixed_rows::<3>(0).norm();
            let room = cell.limits.room(i, q, 1.0).min(cell.limits.room(i, q, -1.0));
            FARTHEST.min(FLANGE_M / moved).min(RANGE_SHARE * room).max(0.0)
        });
        Self { start: *q, reach, tried: 0, postures: Vec::new() }
    }

    /// Plans one posture, so that the thread can do other things in between; at the end the whole tour, which is empty where there is no room for one.
    pub fn next_posture(&mut self, cell: &LoadTourCell<'_, N>) -> Option<Vec<SVector<f64, N>>> {
        if self.tried == POSTURES {
            if self.postures.len() < LEAST {
                return Some(Vec::new());
            }
            self.postures.push(self.start);
            return Some(std::mem::take(&mut self.postures));
        }
        self.tried += 1;
        let from = self.postures.last().copied().unwrap_or(self.start);
        let way = SVector::from_fn(|i, _| self.reach[i] * spread(self.tried, PRIMES[i % PRIMES.len()]));
        let near = |q: &SVector<f64, N>| {
            let moved =
                cell.robot.forward(q).translation.vector - cell.robot.forward(&self.start).translation.vector;
            moved.norm() <= ALL_M
        };
        let free = |q: &SVector<f64, N>| {
            cell.space.is_none_or(|space| {
                space.keeps_margin(q) && space.is_free(&from, q) && space.is_free(q, &self.start)
            })
        };
        let found = SHARES.into_iter().map(|share| self.start + way * share).find(|q| near(q) && free(q));
        self.postures.extend(found);
        None
    }
}

/// The multiple `k` of the root of `prime` modulo one, from -1 to 1.
fn spread(k: usize, prime: f64) -> f64 {
    2.0 * (k as f64 * prime.sqrt()).fract() - 1.0
}
