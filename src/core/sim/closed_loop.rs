//! The one loop over ticks in which everything simulated runs: whole systems, experiments, studies and their tests.
//!
//! ```text
//! sense ──► a frame is due: see ──► on its way, one latency ──► act ──► next tick
//! ```
//! What an arm, a camera and a controller are is up to the [`ClosedLoop`]; when frames are exposed, lost and used is not.

use crate::scene::{FrameSchedule, Irregularity};
use crate::time::SpanNs;
use std::collections::VecDeque;
use std::ops::ControlFlow;

/// What goes on in a tick. Each part may end the loop.
pub trait ClosedLoop {
    /// The image of the camera.
    type Observation;
    /// How the loop ends.
    type Outcome;

    /// The state of the arm at `tick`, before anything is seen.
    fn sense(&mut self, tick: u64) -> ControlFlow<Self::Outcome>;

    /// Exposes the frame `frame_id` at `tick`, and measures it.
    fn see(&mut self, tick: u64, frame_id: u64) -> ControlFlow<Self::Outcome, Self::Observation>;

    /// Moves the arm up to the next tick. `seen`: what reaches control at this one, the newest if several do.
    fn act(&mut self, tick: u64, seen: Option<Self::Observation>) -> ControlFlow<Self::Outcome>;
}

/// Runs `system` from tick 0 until it ends, with the frames of `frames`.
pub fn run<L: ClosedLoop>(frames: &FrameSchedule, system: &mut L) -> L::Outcome {
    let mut on_their_way = VecDeque::new();
    let mut tick = 0;
    loop {
        if let ControlFlow::Break(end) = one_tick(frames, system, &mut on_their_way, tick) {
            return end;
        }
        tick += 1;
    }
}

fn one_tick<L: ClosedLoop>(
    frames: &FrameSchedule,
    system: &mut L,
    on_their_way: &mut VecDeque<(u64, L::Observation)>,
    tick: u64,
) -> ControlFlow<L::Outcome> {
    system.sense(tick)?;
    if let Some(frame_id) = frames.frame_at(tick).filter(|id| !frames.is_lost(*id)) {
        on_their_way.push_back((frames.usable_tick(frame_id), system.see(tick, frame_id)?));
    }
    let mut newest = None;
    while let Some((_, seen)) = on_their_way.pop_front_if(|(usable, _)| *usable <= tick) {
        newest = Some(seen);
    }
    system.act(tick, newest)
}

/// A frame every `ticks`, seen at once.
#[must_use]
pub fn frame_every(ticks: u32) -> FrameSchedule {
    FrameSchedule::new(1e3 / f64::from(ticks), SpanNs(0), Irregularity::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes down what happens.
    #[derive(Default)]
    struct Diary(Vec<String>);

    impl ClosedLoop for Diary {
        type Observation = u64;
        type Outcome = u64;

        fn sense(&mut self, tick: u64) -> ControlFlow<u64> {
            if tick == 5 { ControlFlow::Break(tick) } else { ControlFlow::Continue(()) }
        }

        fn see(&mut self, tick: u64, frame_id: u64) -> ControlFlow<u64, u64> {
            self.0.push(format!("{tick}: see {frame_id}"));
            ControlFlow::Continue(frame_id)
        }

        fn act(&mut self, tick: u64, seen: Option<u64>) -> ControlFlow<u64> {
            self.0.extend(seen.map(|frame_id| format!("{tick}: use {frame_id}")));
            ControlFlow::Continue(())
        }
    }

    #[test]
    fn frames_are_used_one_latency_after_their_exposure() {
        let mut diary = Diary::default();
        let late = FrameSchedule::new(500.0, SpanNs(1_000_000), Irregularity::default());
        assert_eq!(run(&late, &mut diary), 5);
        assert_eq!(diary.0, ["0: see 0", "1: use 0", "2: see 1", "3: use 1", "4: see 2"]);
        let mut diary = Diary::default();
        run(&frame_every(3), &mut diary);
        assert_eq!(diary.0, ["0: see 0", "0: use 0", "3: see 1", "3: use 1"]);
    }
}
