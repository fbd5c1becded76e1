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
    /// A frame that turns out to be damaged.
    damaged: Option<u64>,
    /// What it says of itself.
    state: CameraState,
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

    fn fill(&mut self, out: &mut [u8]) -> Result<Filled, SourceError> {
        let given = self.given.expect("a frame was given");
        out.fill(given as u8);
        Ok(if self.damaged == Some(given) { Filled::Damaged } else { Filled::Image })
    }

    fn health(&self) -> SourceHealth {
        SourceHealth { state: self.state, ..SourceHealth::default() }
    }
}

/// Keeps what is handed over.
struct RecordingSink {
    time: Rc<Cell<MonoNs>>,
    beats: usize,
    shots: Vec<(Shot, u8)>,
    told: Vec<CameraHealth>,
}

impl Outlet for RecordingSink {
    fn now(&self) -> MonoNs {
        self.time.get()
    }

    fn beat(&mut self) {
        self.beats += 1;
    }

    fn publish(&mut self, shot: &Shot, fill: &mut Fill<'_>) -> Result<Filled, ProcessError> {
        let mut pixels = [0; 4];
        let filled = fill(&mut pixels)?;
        if filled == Filled::Image {
            self.shots.push((*shot, pixels[3]));
        }
        Ok(filled)
    }

    fn tell(&mut self, health: &CameraHealth) -> Result<(), ProcessError> {
        self.told.push(*health);
        Ok(())
    }
}

/// Frames at `(ms, sequence)`; what came out, and how it ended.
fn play(frames: &[(i64, u64)], lost: u64, ends: bool) -> (RecordingSink, Result<(), ProcessError>) {
    play_as(frames, lost, ends, (None, CameraState::Unknown))
}

/// The same of a source with a damaged frame, which says of itself to be in a state.
fn play_as(
    frames: &[(i64, u64)],
    lost: u64,
    ends: bool,
    (damaged, state): (Option<u64>, CameraState),
) -> (RecordingSink, Result<(), ProcessError>) {
    let time = Rc::new(Cell::new(MonoNs(0)));
    let stop = StopFlag::default();
    let mut source = Metronome {
        time: time.clone(),
        frames: frames.iter().map(|(ms, sequence)| (MonoNs(ms * MS), *sequence)).collect(),
        lost,
        given: None,
        stop: ends.then(|| stop.clone()),
        damaged,
        state,
    };
    let mut kept = RecordingSink { time, beats: 0, shots: Vec::new(), told: Vec::new() };
    let away = SpanNs::from_s(60.0);
    let end = run(&mut source, &mut kept, SilenceLimits::with(25.0, away), &stop);
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
fn a_restarted_count_continues_with_the_source_losses_added() {
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

#[test]
fn a_camera_that_is_known_to_be_away_is_waited_for_longer() {
    let (kept, end) = play_as(&[(0, 0), (30_000, 1)], 0, false, (None, CameraState::Gone));
    assert_eq!(kept.shots.len(), 2, "half a minute is not the end");
    let error = end.unwrap_err();
    assert!(
        matches!(error, ProcessError::CameraAway { lasted_s, .. } if (60.0..61.0).contains(&lasted_s)),
        "{error}"
    );
    assert!(error.to_string().contains("unplugged") && error.exit_code() == 4);
}

#[test]
fn a_damaged_frame_stays_here_and_is_lost() {
    let frames = [(0, 0), (40, 1), (80, 2), (120, 3)];
    let (kept, end) = play_as(&frames, 0, true, (Some(2), CameraState::Streaming));
    end.unwrap();
    let seen: Vec<_> = kept.shots.iter().map(|(s, _)| (s.frame_id, s.lost)).collect();
    assert_eq!(seen, [(0, 0), (1, 0), (3, 1)]);
}

#[test]
fn health_is_sent_regularly_where_a_source_reports_it() {
    let frames: Vec<_> = (0..100).map(|k| (40 * k, k as u64)).collect();
    let (kept, end) = play_as(&frames, 3, true, (Some(50), CameraState::Streaming));
    end.unwrap();
    assert!((18..=22).contains(&kept.told.len()), "4 s at 5 Hz: {}", kept.told.len());
    let last = kept.told.last().unwrap();
    assert!(last.frames > 90 && last.lost == 4 && last.state == CameraState::Streaming as u32, "{last:?}");
    assert!(kept.told.iter().zip(0..).all(|(health, n)| health.sequence == n));
    assert!(play(&frames, 3, true).0.told.is_empty());
}
