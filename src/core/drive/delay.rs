//! Commands on their way to a drive: each takes effect a fixed number of ticks after it was written.

use super::DriveCommand;

/// Longest delay, ticks. Chosen by hand, above the latency of usual robot controllers.
pub const MAX_DELAY: usize = 50;

/// A delay line.
#[derive(Debug)]
pub(super) struct Delay<const N: usize> {
    /// The last `ticks + 1` commands.
    commands: Vec<DriveCommand<N>>,
    ticks: usize,
    next: usize,
}

/// With room for all commands: a copy may be used in a tick, too.
impl<const N: usize> Clone for Delay<N> {
    fn clone(&self) -> Self {
        let mut commands = Vec::with_capacity(self.ticks + 1);
        commands.extend_from_slice(&self.commands);
        Self { commands, ..*self }
    }
}

impl<const N: usize> Delay<N> {
    pub(super) fn new(ticks: usize) -> Self {
        Self { commands: Vec::with_capacity(ticks + 1), ticks, next: 0 }
    }

    pub(super) fn push(&mut self, command: &DriveCommand<N>) {
        match self.commands.get_mut(self.next) {
            Some(place) => *place = *command,
            None => self.commands.push(*command), // within the capacity: no allocation
        }
        self.next = (self.next + 1) % (self.ticks + 1);
    }

    /// The command that has arrived; `None` before the first one has.
    pub(super) fn arrived(&self) -> Option<&DriveCommand<N>> {
        // With the line full, the oldest command stands where the next one will go.
        (self.commands.len() > self.ticks).then(|| self.commands.get(self.next)).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;

    #[test]
    fn a_command_arrives_when_so_many_have_followed() {
        for ticks in [0, 1, 2, 5] {
            let mut d = Delay::<1>::new(ticks);
            assert!(d.arrived().is_none());
            for k in 0..20 {
                let v = Vector1::new(f64::from(k));
                d.push(&DriveCommand { tau: v, q_r: v, qd_r: v, qdd_r: v });
                let wanted = usize::try_from(k).unwrap().checked_sub(ticks).map(|k| k as f64);
                assert_eq!(d.arrived().map(|c| c.tau[0]), wanted, "delay {ticks}");
            }
        }
    }

    #[test]
    fn a_copy_has_room_for_all_commands_too() {
        assert!(Delay::<1>::new(5).clone().commands.capacity() >= 6);
    }
}
