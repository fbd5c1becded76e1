//! A drive without dynamics: the joints are where the reference says, `q = q_r` of (10.75), or move as fast as it
//! says, `qd = qd_r`.

use super::{CommandMode, Drive, DriveCommand, DriveState};
use crate::time::MonoNs;
use nalgebra::SVector;

/// Joints that follow the reference exactly.
#[derive(Debug, Clone)]
pub struct IdealDrive<const N: usize> {
    /// As the encoders read.
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    q_offset: SVector<f64, N>,
    velocity: bool,
    time: Option<MonoNs>,
}

impl<const N: usize> IdealDrive<N> {
    /// An arm at rest in `q`, commanded by position.
    #[must_use]
    pub fn new(q: SVector<f64, N>) -> Self {
        Self { q, qd: SVector::zeros(), q_offset: SVector::zeros(), velocity: false, time: None }
    }

    /// The same arm commanded by velocity.
    #[must_use]
    pub fn by_velocity(self) -> Self {
        Self { velocity: true, ..self }
    }

    /// The same arm with true positions that differ from the encoders' by `q_offset`, rad or m.
    #[must_use]
    pub fn with_offset(self, q_offset: SVector<f64, N>) -> Self {
        Self { q_offset, ..self }
    }
}

impl<const N: usize> Drive<N> for IdealDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        let passed_s = (now - self.time.unwrap_or(now)).as_s();
        self.time = Some(now);
        if self.velocity {
            self.q += self.qd * passed_s;
        }
        DriveState { q: self.q, qd: self.qd, truth: Some((self.q + self.q_offset, self.qd)) }
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        if !self.velocity {
            self.q = command.q_r;
        }
        self.qd = command.qd_r;
    }

    fn modes(&self) -> &'static [CommandMode] {
        &[CommandMode::Position, CommandMode::Velocity]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn position_is_taken_at_once_and_velocity_is_integrated() {
        let start = Vector2::new(0.1, 0.2);
        let c = DriveCommand {
            tau: Vector2::zeros(),
            q_r: Vector2::new(1.0, 2.0),
            qd_r: Vector2::new(0.5, -0.25),
            qdd_r: Vector2::zeros(),
        };
        let mut position = IdealDrive::new(start);
        let mut velocity = IdealDrive::new(start).by_velocity();
        for d in [&mut position, &mut velocity] {
            assert_eq!(d.read(MonoNs(5)).q, start);
            d.write(&c);
        }
        assert_eq!(position.read(MonoNs(1_000_000_005)).q, c.q_r);
        let s = velocity.read(MonoNs(1_000_000_005));
        assert!((s.q - (start + c.qd_r)).norm() < 1e-15);
        assert_eq!(s.qd, c.qd_r);
        assert_eq!(velocity.read(MonoNs(1_000_000_005)).q, s.q, "no time, no motion");
    }
}
