//! A small camera that runs by its own clock, before the loop of the process, without shared memory.

use super::super::Fill;
use super::*;
use crate::source::SourceError;
use crate::time::MonoNs;
use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

const MS: i64 = 1_000_000;

/// Gives frames whenever they are due by its own count of time; the pixels are the frame's number.
struct Metronome {
    time: Rc<Cell<MonoNs>>,
    /// When each frame has its middle, and its number.
    frames: VecDeque<(MonoNs, u64)>,
    lost: u64,
    given: Option<u64>,
    /// Asked to stop when the last frame was given.
    stop: Option<StopFlag>,
}

impl FreeRunningSource for Metronome {
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError> {
        let until = self.time.get() + SpanNs(longest.as_nanos() as i64);
        let Some((mid, sequence)) = self.frames.pop_front_if(|(mid, _)| *mid <= until) else {
            self.time.set(until);
            if self.frames.is_empty()
                && let Some(stop) = &self.stop
            {
                stop.request();
            }
            return Ok(None);
        };
        self.time.set(mid.max(self.time.get()));
        self.given = Some(sequence);
        Ok(Some(Captured { mid, span: SpanNs(4 * MS), sequence, lost: self.lost }))
    }

    fn fill(&mut self, out: &mut [u8]) -> Result<(), SourceError> {
        out.fill(self.given.expect("a frame was given") as u8);
        Ok(())
    }
}

/// Keeps what is handed over.
struct Kept {
    time: Rc<Cell<MonoNs>>,
    beats: usize,
    shots: Vec<(Shot, u8)>,
}

impl Outlet for Kept {
    fn now(&self) -> MonoNs {
        self.time.get()
    }

    fn beat(&mut self) {
        self.beats += 1;
    }

    fn publish(&mut self, shot: &Shot, fill: &mut Fill<'_>) -> Result<(), ProcessError> {
        let mut pixels = [0; 4];
        fill(&mut pixels)?;
        self.shots.push((*shot, pixels[3]));
        Ok(())
    }
}

/// Frames at `(ms, sequence)`; what came out, and how it ended.
fn play(frames: &[(i64, u64)], lost: u64, ends: bool) -> (Kept, Result<(), ProcessError>) {
    let time = Rc::new(Cell::new(MonoNs(0)));
    let stop = StopFlag::default();
    let mut source = Metronome {
        time: time.clone(),
        frames: frames.iter().map(|(ms, sequence)| (MonoNs(ms * MS), *sequence)).collect(),
        lost,
        given: None,
        stop: ends.then(|| stop.clone()),
    };
    let mut kept = Kept { time, beats: 0, shots: Vec::new() };
    let end = run(&mut source, &mut kept, Patience::with(25.0), &stop);
    (kept, end)
}

#[test]
fn frames_go_out_by_the_source_s_own_timing_and_count() {
    // Irregular, with two frames lost, and faster than any period that somebody might have in mind.
    let (kept, end) = play(&[(10, 7), (51, 8), (130, 11), (131, 12)], 0, true);
    end.unwrap();
    let seen: Vec<_> =
        kept.shots.iter().map(|(s, pixel)| (s.mid.0 / MS, s.frame_id, s.lost, *pixel)).collect();
    assert_eq!(seen, [(10, 0, 0, 7), (51, 1, 0, 8), (130, 4, 2, 11), (131, 5, 2, 12)]);
    assert!(kept.shots.iter().all(|(s, _)| s.span == SpanNs(4 * MS) && !s.last));
    assert!(kept.beats > kept.shots.len());
}

#[test]
fn a_count_that_begins_anew_goes_on_and_what_the_source_lost_is_added() {
    let (kept, end) = play(&[(0, 100), (40, 101), (80, 0), (120, 1), (160, 1), (200, 3)], 5, true);
    end.unwrap();
    let seen: Vec<_> = kept.shots.iter().map(|(s, _)| (s.frame_id, s.lost)).collect();
    assert_eq!(seen, [(0, 5), (1, 5), (2, 5), (3, 5), (4, 5), (6, 6)]);
}

#[test]
fn a_silent_source_is_the_end_but_a_pause_is_not() {
    let (kept, end) = play(&[(0, 0), (40, 1), (4_000, 2)], 0, false);
    assert_eq!(kept.shots.len(), 3, "a pause of four seconds is told, and no more");
    let error = end.unwrap_err();
    assert!(matches!(error, ProcessError::SourceSilent(s) if (6.0..7.0).contains(&s)), "{error}");
    let (kept, end) = play(&[], 0, false);
    assert!(kept.shots.is_empty() && end.is_err(), "nor is one waited for that never began");
}
