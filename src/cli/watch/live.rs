//! What viewers are shown: the newest moment of the run and its newest image. The watching loop puts it here, and each viewer's thread takes it when it
//! has sent what was before: a slow viewer skips, and holds up nobody.

use crate::input::printable;
use crate::messages::FrameHeader;
use crate::monitor::{RunSnapshot, RunView};
use crate::rt::now;
use crate::source::encode_png;
use crate::time::{MonoNs, SpanNs};
use image::ExtendedColorType;
use serde::Serialize;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

/// Images are taken for so long after somebody asked for one. Chosen by hand: a viewer asks some times a second.
const WANTED: SpanNs = SpanNs(2_000_000_000);

/// The run at one moment, and what is kept of it.
#[derive(Debug, Default)]
pub(super) struct WatchMoment {
    /// Which run of this watcher, from 1; 0 before the first.
    pub(super) run: u64,
    facts: String,
    snapshot: Option<RunSnapshot>,
    word: String,
    errors: Vec<(f64, f64)>,
    events: Vec<(f64, String)>,
}

/// What a viewer has been sent.
#[derive(Debug, Default)]
pub(super) struct Sent {
    run: u64,
    errors: u64,
    events: u64,
}

/// The message of a moment, with what the viewer does not have yet.
#[derive(Serialize)]
struct Message<'a> {
    word: &'a str,
    now: &'a Option<RunSnapshot>,
    errors: &'a [(f64, f64)],
    events: &'a [(f64, String)],
}

impl WatchMoment {
    /// That of `view` at `snapshot`.
    pub(super) fn of(run: u64, view: &RunView, snapshot: RunSnapshot) -> Self {
        // to a millisecond and a ten-thousandth of a pixel, which is more than a screen shows
        let short = |x: f64, parts: f64| (x * parts).round() / parts;
        let errors = view.kept_errors().iter().map(|(s, px)| (short(*s, 1e3), short(*px, 1e4)));
        Self {
            run,
            facts: serde_json::to_string(&view.run_facts()).unwrap_or_default(),
            snapshot: Some(snapshot),
            word: String::new(),
            errors: errors.collect(),
            events: view.kept_events().iter().map(|(s, what)| (short(*s, 1e3), printable(what))).collect(),
        }
    }

    /// One without a run.
    pub(super) fn without_run(word: &str) -> Self {
        Self { word: word.to_owned(), ..Self::default() }
    }

    /// The server-sent events for a viewer who has `sent`.
    pub(super) fn events_after(&self, sent: &mut Sent) -> String {
        let mut text = String::new();
        if sent.run != self.run {
            *sent = Sent { run: self.run, ..Sent::default() };
            text += &format!("event: run\ndata: {}\n\n", self.facts);
        }
        let (errors_seen, events_seen) =
            self.snapshot.as_ref().map_or((0, 0), |snapshot| (snapshot.errors_seen, snapshot.events_seen));
        let message = Message {
            word: &self.word,
            now: &self.snapshot,
            errors: newest(&self.errors, errors_seen.saturating_sub(sent.errors)),
            events: newest(&self.events, events_seen.saturating_sub(sent.events)),
        };
        // a number that is not finite is null; nothing else of it can fail
        text += &format!("data: {}\n\n", serde_json::to_string(&message).unwrap_or_default());
        (sent.errors, sent.events) = (errors_seen, events_seen);
        text
    }
}

/// The last `count` of all, or as many as there are.
fn newest<T>(all: &[T], count: u64) -> &[T] {
    let from = all.len().saturating_sub(usize::try_from(count).unwrap_or(usize::MAX));
    all.get(from..).unwrap_or_default()
}

/// An image, encoded once for all who want it, by the first of them.
#[derive(Debug)]
pub(super) struct LiveImage {
    /// Its number here, from 1.
    pub(super) number: u64,
    header: FrameHeader,
    pixels: Vec<u8>,
    png: OnceLock<Vec<u8>>,
}

impl LiveImage {
    /// Its bytes; none of a frame that is not as its header says.
    pub(super) fn png(&self) -> &[u8] {
        let (width, height) = (self.header.width_px, self.header.height_px);
        self.png.get_or_init(|| {
            encode_png(&self.pixels, width, height, ExtendedColorType::L8).unwrap_or_default()
        })
    }
}

#[derive(Debug, Default)]
struct ShownNow {
    moment: Arc<WatchMoment>,
    moments: u64,
    image: Option<Arc<LiveImage>>,
    images: u64,
}

/// What is shown now.
#[derive(Debug, Default)]
pub(super) struct Live {
    shown: Mutex<ShownNow>,
    changed: Condvar,
    image_asked: AtomicI64,
}

impl Live {
    fn shown(&self) -> MutexGuard<'_, ShownNow> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Shows another moment; an image of another run is gone with it.
    pub(super) fn show(&self, moment: WatchMoment) {
        let mut shown = self.shown();
        if shown.moment.run != moment.run {
            shown.image = None;
        }
        shown.moment = Arc::new(moment);
        shown.moments += 1;
        drop(shown);
        self.changed.notify_all();
    }

    /// Shows another image.
    pub(super) fn show_image(&self, header: FrameHeader, pixels: Vec<u8>) {
        let mut shown = self.shown();
        shown.images += 1;
        let number = shown.images;
        shown.image = Some(Arc::new(LiveImage { number, header, pixels, png: OnceLock::new() }));
        drop(shown);
        self.changed.notify_all();
    }

    /// Whether somebody wants images at `time`.
    pub(super) fn wants_images(&self, time: MonoNs) -> bool {
        let asked = self.image_asked.load(Ordering::Relaxed);
        asked != 0 && time - MonoNs(asked) < WANTED
    }

    /// The first moment after the `seen`-th, or what there is after `longest`; and which it is.
    pub(super) fn moment_after(&self, seen: u64, longest: Duration) -> (Arc<WatchMoment>, u64) {
        let shown = self.changed.wait_timeout_while(self.shown(), longest, |shown| shown.moments == seen);
        let (shown, _) = shown.unwrap_or_else(PoisonError::into_inner);
        (Arc::clone(&shown.moment), shown.moments)
    }

    /// The first image with another number than `seen`, if one comes within `longest`.
    pub(super) fn image_after(&self, seen: u64, longest: Duration) -> Option<Arc<LiveImage>> {
        self.image_asked.store(now().0, Ordering::Relaxed);
        let is_old = |shown: &mut ShownNow| shown.image.as_ref().is_none_or(|image| image.number == seen);
        let shown = self.changed.wait_timeout_while(self.shown(), longest, is_old);
        let (shown, _) = shown.unwrap_or_else(PoisonError::into_inner);
        shown.image.clone().filter(|image| image.number != seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Status, TraceMsg, trace_flag};
    use crate::monitor::CellFacts;

    fn view(errors: u64) -> RunView {
        let mut view = RunView::new(CellFacts::default());
        view.status(&Status::default(), MonoNs(0));
        for k in 0..errors {
            let flags = trace_flag::MEASUREMENT;
            view.tick(&TraceMsg { sequence: k, flags, feature_error_px: k as f64, ..TraceMsg::default() });
        }
        view
    }

    fn told(text: &str) -> serde_json::Value {
        let data = text.lines().filter_map(|line| line.strip_prefix("data: ")).next_back().unwrap();
        serde_json::from_str(data).unwrap()
    }

    #[test]
    fn a_viewer_is_sent_each_error_once() {
        let moment = |run, errors| {
            let view = view(errors);
            WatchMoment::of(run, &view, view.snapshot(MonoNs(0), Vec::new()))
        };
        let mut sent = Sent::default();
        let first = moment(1, 5).events_after(&mut sent);
        assert!(first.starts_with("event: run\ndata: {\"instance\""), "{first}");
        assert_eq!(told(&first)["errors"].as_array().unwrap().len(), 5);
        let next = moment(1, 7).events_after(&mut sent);
        assert!(!next.contains("event: run"));
        assert_eq!(told(&next)["errors"], serde_json::json!([[0.0, 5.0], [0.0, 6.0]]));
        // What is no longer kept cannot be sent, and another run begins anew.
        let late = moment(1, 9000).events_after(&mut sent);
        assert_eq!(told(&late)["errors"].as_array().unwrap().len(), 1500);
        let other = moment(2, 1).events_after(&mut sent);
        assert!(other.contains("event: run") && told(&other)["errors"].as_array().unwrap().len() == 1);
    }

    #[test]
    fn images_are_taken_while_somebody_asks() {
        let live = Live::default();
        assert!(!live.wants_images(now()));
        assert!(live.image_after(0, Duration::ZERO).is_none());
        assert!(live.wants_images(now()) && !live.wants_images(now() + WANTED));
        let header = FrameHeader { width_px: 2, height_px: 1, ..FrameHeader::default() };
        live.show_image(header, vec![0, 255]);
        let image = live.image_after(0, Duration::ZERO).unwrap();
        let read = image::load_from_memory(image.png()).unwrap().to_luma8();
        assert_eq!((read.dimensions(), read.into_raw()), ((2, 1), vec![0, 255]));
        assert!(live.image_after(image.number, Duration::ZERO).is_none(), "it is known");
        live.show(WatchMoment { run: 1, ..WatchMoment::default() });
        assert!(live.image_after(0, Duration::ZERO).is_none(), "another run has none yet");
    }
}
