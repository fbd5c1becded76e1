//! A folder of images as camera: PNG, PGM or JPEG files in the order of their names.

use super::{Exposure, Position, Source, SourceError};
use crate::messages::JointState;
use std::path::{Path, PathBuf};

const ENDINGS: [&str; 4] = ["png", "pgm", "jpg", "jpeg"];

/// Plays image files.
#[derive(Debug)]
pub struct Replay {
    files: Vec<PathBuf>,
    next: usize,
    width: u32,
    height: u32,
    repeat: bool,
}

impl Replay {
    /// Lists `folder` and looks at the size of every image in it.
    ///
    /// # Errors
    /// [`SourceError`] when the folder cannot be read or holds no image, or an image has another size than the camera
    /// or no readable head.
    pub fn open(folder: &Path, width: u32, height: u32, repeat: bool) -> Result<Self, SourceError> {
        let failed = |cause| SourceError::Folder { folder: folder.into(), cause };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
            if ending.is_some_and(|e| ENDINGS.contains(&e.as_str())) {
                files.push(path);
            }
        }
        if files.is_empty() {
            return Err(SourceError::NoImages(folder.into()));
        }
        files.sort();
        let replay = Self { files, next: 0, width, height, repeat };
        for file in &replay.files {
            let size = image::image_dimensions(file)
                .map_err(|cause| SourceError::Image { file: file.clone(), cause })?;
            replay.check_size(file, size)?;
        }
        Ok(replay)
    }

    /// How many images a round has.
    #[must_use]
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there are no images; never true for an opened folder.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    fn check_size(&self, file: &Path, (found_width, found_height): (u32, u32)) -> Result<(), SourceError> {
        let (width, height) = (self.width, self.height);
        if (found_width, found_height) == (width, height) {
            return Ok(());
        }
        Err(SourceError::Size { file: file.into(), found_width, found_height, width, height })
    }
}

impl Source for Replay {
    fn arm(&mut self, _state: &JointState) {}

    fn expose(&mut self, _exposure: &Exposure, out: &mut [u8]) -> Result<Position, SourceError> {
        let Some(file) = self.files.get(self.next) else { return Ok(Position::Last) };
        let grey =
            image::open(file).map_err(|cause| SourceError::Image { file: file.clone(), cause })?.into_luma8();
        self.check_size(file, grey.dimensions())?;
        if out.len() == grey.len() {
            out.copy_from_slice(&grey);
        }
        self.next += 1;
        if self.next == self.files.len() {
            if !self.repeat {
                return Ok(Position::Last);
            }
            self.next = 0;
        }
        Ok(Position::Running)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::{MonoNs, SpanNs};
    use image::{GrayImage, Luma};

    const EXPOSURE: Exposure = Exposure { frame_id: 0, mid: MonoNs(0), span: SpanNs(0) };

    fn folder() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for (name, grey) in [("b.pgm", 2), ("a.png", 1), ("c.PNG", 3)] {
            GrayImage::from_pixel(8, 4, Luma([grey])).save(dir.path().join(name)).unwrap();
        }
        std::fs::write(dir.path().join("notes.txt"), "not an image").unwrap();
        dir
    }

    fn play(replay: &mut Replay, count: usize) -> Vec<(u8, Position)> {
        let mut out = vec![0; 32];
        (0..count)
            .map(|_| {
                let position = replay.expose(&EXPOSURE, &mut out).unwrap();
                (out[5], position)
            })
            .collect()
    }

    #[test]
    fn plays_in_the_order_of_names_and_says_which_is_the_last() {
        let dir = folder();
        let mut once = Replay::open(dir.path(), 8, 4, false).unwrap();
        assert_eq!(once.len(), 3);
        let expected = [(1, Position::Running), (2, Position::Running), (3, Position::Last)];
        assert_eq!(play(&mut once, 3), expected);
        let mut looped = Replay::open(dir.path(), 8, 4, true).unwrap();
        assert_eq!(play(&mut looped, 4)[3], (1, Position::Running));
    }

    #[test]
    fn bad_folders_and_files_are_named() {
        let dir = folder();
        let path = dir.path();
        let message = |r: Result<Replay, SourceError>| r.unwrap_err().to_string();
        assert!(message(Replay::open(&path.join("absent"), 8, 4, false)).contains("absent"));
        assert!(message(Replay::open(path, 8, 5, false)).contains("is 8x4 px, the camera is 8x5 px"));
        let empty = tempfile::tempdir().unwrap();
        assert!(message(Replay::open(empty.path(), 8, 4, false)).contains("holds no"));

        let whole = std::fs::read(path.join("a.png")).unwrap();
        std::fs::write(path.join("a.png"), &whole[..whole.len() - 20]).unwrap();
        let error = Replay::open(path, 8, 4, false)
            .and_then(|mut r| r.expose(&EXPOSURE, &mut [0; 32]).map(|_| ()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("a.png: cannot be decoded"), "{error}");
    }
}
