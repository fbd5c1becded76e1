//! Images of a run for `--report`: the first frame, the last one, those in which a target that had been found is lost, and a filmstrip, small frames that
//! are spread evenly over the run. All memory is had before the first frame; keeping one is a copy.

mod filmstrip;

use crate::messages::{FeaturePoint, FrameHeader, Measurement, TargetStatus};
use filmstrip::Filmstrip;
use std::fmt::Write;

/// Most frames without the target that are kept; the others are counted. Chosen by hand: as many as one looks through on a page.
const MAX_LOST: usize = 24;
/// Most memory for them, bytes, so that frames of many megapixels are fewer. Chosen by hand: all of them up to 4 megapixels; memory is taken before the
/// first frame.
const MAX_BYTES: usize = 96 << 20;

/// Why an image is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keepsake {
    /// The first frame of the run.
    First,
    /// A target that had been found is not.
    Lost,
    /// The last frame of the run.
    Last,
    /// One of those that are spread evenly over the run.
    Strip,
}

impl Keepsake {
    /// A word for file names and people.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Lost => "lost",
            Self::Last => "last",
            Self::Strip => "strip",
        }
    }
}

/// A grey image and what was found in it.
#[derive(Debug, Clone)]
pub struct KeptImage {
    /// Why it is kept.
    pub why: Keepsake,
    /// Columns and rows, px.
    pub size_px: (u32, u32),
    /// Its levels, row by row.
    pub grey: Vec<u8>,
    /// What vision says of it.
    pub measurement: Measurement,
}

impl KeptImage {
    /// Its file's name.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("frame-{}-{:06}.png", self.why.as_str(), self.measurement.frame_id)
    }

    fn seen(&self) -> (String, &[FeaturePoint]) {
        let status = self.measurement.target_status();
        (status.as_str().to_owned(), self.measurement.features())
    }
}

/// The images of a run.
#[derive(Debug)]
pub struct FrameArchive {
    first: KeptImage,
    last: KeptImage,
    lost: Vec<KeptImage>,
    strip: Filmstrip,
    /// How many of `lost` are in use.
    kept: usize,
    /// Frames in which the target was lost.
    losses: u64,
    /// Frames without the target.
    without: u64,
    frames: u64,
    /// Number of the target that was found in the frame before, where one was.
    found: Option<u32>,
    size_px: (u32, u32),
}

impl FrameArchive {
    /// For frames of this size, px.
    #[must_use]
    pub fn new((width, height): (u32, u32)) -> Self {
        let bytes = width as usize * height as usize;
        let room = (MAX_BYTES / bytes.max(1)).saturating_sub(2).min(MAX_LOST);
        // Written to, so that the memory is there and not only promised.
        let empty = |why| KeptImage {
            why,
            size_px: (width, height),
            grey: vec![1; bytes],
            measurement: Measurement::default(),
        };
        Self {
            first: empty(Keepsake::First),
            last: empty(Keepsake::Last),
            strip: Filmstrip::new((width, height)),
            lost: (0..room).map(|_| empty(Keepsake::Lost)).collect(),
            kept: 0,
            losses: 0,
            without: 0,
            frames: 0,
            found: None,
            size_px: (width, height),
        }
    }

    /// Takes in a frame that is not measured yet; frames of another size are passed over.
    pub fn note_frame(&mut self, header: &FrameHeader, grey: &[u8]) {
        if (header.width_px, header.height_px) != self.size_px || grey.len() != self.last.grey.len() {
            return;
        }
        self.last.grey.copy_from_slice(grey);
        self.last.measurement = Measurement {
            frame_id: header.frame_id,
            exposure: header.exposure,
            status: TargetStatus::NoPair as u32,
            ..Measurement::default()
        };
    }

    /// Takes in what was found in the frame that was noted last; of others nothing is known.
    pub fn note_measurement(&mut self, m: &Measurement) {
        if m.frame_id != self.last.measurement.frame_id {
            return;
        }
        self.last.measurement = *m;
        self.strip.note(self.frames, &self.last);
        if self.frames == 0 {
            copy(&self.last, &mut self.first);
        }
        self.frames += 1;
        // A target that is not in view when it is first looked for is not lost.
        let is_loss = self.found == Some(m.target_number) && !m.found();
        self.without += u64::from(!m.found());
        self.found = m.found().then_some(m.target_number);
        if is_loss {
            self.losses += 1;
            if let Some(place) = self.lost.get_mut(self.kept) {
                copy(&self.last, place);
                self.kept += 1;
            }
        }
    }

    /// The images: first, lost and last ones, then the filmstrip, each in the order of time.
    pub fn images(&self) -> impl Iterator<Item = &KeptImage> {
        let first = (self.frames > 0).then_some(&self.first);
        let last = (self.frames > 1).then_some(&self.last);
        first.into_iter().chain(self.lost.iter().take(self.kept)).chain(last).chain(self.strip.images())
    }

    /// `frames.csv`: a row for each point that was found in each image, and one for an image without; what was counted stands in
    /// columns of its own.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut out =
            String::from("file,why,frame_id,status,point,u_px,v_px,frames,frames_without_target,losses\n");
        for image in self.images() {
            let (status, points) = image.seen();
            let start = format!(
                "{},{},{},\"{status}\"",
                image.file_name(),
                image.why.as_str(),
                image.measurement.frame_id
            );
            let end = format!("{},{},{}", self.frames, self.without, self.losses);
            if points.is_empty() {
                let _ = writeln!(out, "{start},,,,{end}"); // a String takes everything
            }
            for p in points {
                let _ = writeln!(out, "{start},{},{:.3},{:.3},{end}", p.id.saturating_add(1), p.u_px, p.v_px);
            }
        }
        out
    }
}

fn copy(from: &KeptImage, to: &mut KeptImage) {
    to.grey.copy_from_slice(&from.grey);
    to.measurement = from.measurement;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn see(book: &mut FrameArchive, frame_id: u64, found: bool) {
        let header = FrameHeader { frame_id, width_px: 4, height_px: 2, ..FrameHeader::default() };
        book.note_frame(&header, &[frame_id as u8; 8]);
        let status = if found { TargetStatus::Found } else { TargetStatus::NoContrast } as u32;
        book.note_measurement(&Measurement { frame_id, status, ..Measurement::default() });
    }

    #[test]
    fn first_last_and_each_loss_are_kept() {
        let mut book = FrameArchive::new((4, 2));
        for (frame, found) in [(3, false), (4, true), (5, false), (6, false), (7, true), (8, true)] {
            see(&mut book, frame, found);
        }
        let whole = book.images().filter(|p| p.why != Keepsake::Strip);
        let told: Vec<_> = whole.map(|p| (p.file_name(), p.grey[0])).collect();
        let wanted =
            [("frame-first-000003.png", 3), ("frame-lost-000005.png", 5), ("frame-last-000008.png", 8)];
        assert_eq!(told, wanted.map(|(name, level)| (name.to_owned(), level)));
        let csv = book.to_csv();
        assert!(
            csv.contains("frame-lost-000005.png,lost,5,\"no contrast in the frame\",,,,6,3,1\n"),
            "{csv}"
        );
    }

    #[test]
    fn another_target_that_is_not_in_view_is_no_loss() {
        let mut book = FrameArchive::new((4, 2));
        for (frame_id, target_number, status) in [(0, 0, 0), (1, 1, 1), (2, 1, 0), (3, 1, 1)] {
            book.note_frame(
                &FrameHeader { frame_id, width_px: 4, height_px: 2, ..FrameHeader::default() },
                &[0; 8],
            );
            book.note_measurement(&Measurement { frame_id, target_number, status, ..Measurement::default() });
        }
        let lost: Vec<_> =
            book.images().filter(|p| p.why == Keepsake::Lost).map(KeptImage::file_name).collect();
        assert_eq!((lost, book.without), (vec!["frame-lost-000003.png".to_owned()], 2));
    }

    #[test]
    fn more_losses_than_there_is_room_for_are_counted() {
        let mut book = FrameArchive::new((4, 2));
        (0..100).for_each(|frame| see(&mut book, frame, frame % 2 == 0));
        assert_eq!(book.images().filter(|p| p.why != Keepsake::Strip).count(), MAX_LOST + 2);
        assert!(book.to_csv().lines().nth(1).unwrap().ends_with(",100,50,50"));
    }

    #[test]
    fn frames_and_measurements_that_do_not_match_are_ignored() {
        let mut book = FrameArchive::new((4, 2));
        let header = FrameHeader { width_px: 5, height_px: 2, ..FrameHeader::default() };
        book.note_frame(&header, &[0; 10]);
        book.note_measurement(&Measurement { frame_id: 9, ..Measurement::default() });
        assert_eq!(book.images().count(), 0);
        // no room but for two
        assert_eq!(FrameArchive::new((8192, 8192)).lost.len(), 0);
    }
}
