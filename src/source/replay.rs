//! A folder of images as camera: PNG, PGM or JPEG files in the order of their names.

use super::image_file::{self, Size};
use super::{Exposed, Exposure, ScheduledSource, SourceError};
use crate::messages::JointState;
use std::path::{Path, PathBuf};
use tracing::warn;

const ENDINGS: [&str; 4] = ["png", "pgm", "jpg", "jpeg"];

/// Plays image files. A damaged one is reported, counted and left out, unless it is to end the replay.
#[derive(Debug)]
pub struct Replay {
    files: Vec<PathBuf>,
    /// The file that comes next.
    next: usize,
    size: Size,
    repeat: bool,
    strict: bool,
    left_out: usize,
}

impl Replay {
    /// Lists `folder`, looks at the size of every image in it, and decodes the first. `strict`: the first file that is damaged ends it.
    ///
    /// # Errors
    /// [`SourceError`] when the folder cannot be read or holds no image, or something with the name of an image is no
    /// plain file, too large, of another size than the camera, or has no readable head; where this is not strict, when all are so.
    pub fn open(
        folder: &Path,
        width: u32,
        height: u32,
        repeat: bool,
        strict: bool,
    ) -> Result<Self, SourceError> {
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
        let size = Size { width, height };
        let mut replay = Self { files, next: 0, size, repeat, strict, left_out: 0 };
        replay.check_all()?;
        replay.decode_next(&mut vec![0; width as usize * height as usize])?;
        replay.next = 0;
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

    /// How many files were damaged, and left out.
    #[must_use]
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    fn check_all(&mut self) -> Result<(), SourceError> {
        let mut i = 0;
        while let Some(file) = self.files.get(i) {
            match image_file::check(file, self.size) {
                Ok(()) => i += 1,
                Err(error) => self.leave_out(i, error)?,
            }
        }
        Ok(())
    }

    /// Decodes the next good image into `out`.
    fn decode_next(&mut self, out: &mut [u8]) -> Result<Exposed, SourceError> {
        loop {
            if self.repeat && self.next >= self.files.len() {
                self.next = 0;
            }
            let Some(file) = self.files.get(self.next) else { return Ok(Exposed::End) };
            match image_file::load_into(file, self.size, out) {
                Ok(()) => {
                    self.next += 1;
                    return Ok(Exposed::Image);
                }
                Err(error) => self.leave_out(self.next, error)?,
            }
        }
    }

    /// Goes on without file `i`, if that is allowed and others are left.
    fn leave_out(&mut self, i: usize, error: SourceError) -> Result<(), SourceError> {
        if self.strict || self.files.len() <= 1 {
            return Err(error);
        }
        self.files.remove(i);
        self.left_out += 1;
        warn!(left_out = self.left_out, "{error}; played without it (--strict stops)");
        Ok(())
    }
}

impl ScheduledSource for Replay {
    fn arm(&mut self, _state: &JointState) {}

    fn expose(&mut self, _exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError> {
        self.decode_next(out)
    }

    fn is_known_ahead(&self) -> bool {
        true
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

    fn play(replay: &mut Replay, count: usize) -> Vec<Option<u8>> {
        let mut out = vec![0; 32];
        (0..count)
            .map(|_| (replay.expose(&EXPOSURE, &mut out).unwrap() == Exposed::Image).then_some(out[5]))
            .collect()
    }

    #[test]
    fn plays_in_the_order_of_names_and_says_where_it_ends() {
        let dir = folder();
        let mut once = Replay::open(dir.path(), 8, 4, false, true).unwrap();
        assert_eq!(once.len(), 3);
        assert_eq!(play(&mut once, 5), [Some(1), Some(2), Some(3), None, None]);
        let mut looped = Replay::open(dir.path(), 8, 4, true, true).unwrap();
        assert_eq!(play(&mut looped, 4)[3], Some(1));
    }

    #[test]
    fn bad_folders_and_files_are_named() {
        let dir = folder();
        let path = dir.path();
        let message = |r: Result<Replay, SourceError>| r.unwrap_err().to_string();
        assert!(message(Replay::open(&path.join("absent"), 8, 4, false, true)).contains("absent"));
        assert!(message(Replay::open(path, 8, 5, false, true)).contains("is 8x4 px, the camera is 8x5 px"));
        let empty = tempfile::tempdir().unwrap();
        assert!(message(Replay::open(empty.path(), 8, 4, false, true)).contains("holds no"));

        let whole = std::fs::read(path.join("a.png")).unwrap();
        std::fs::write(path.join("a.png"), &whole[..whole.len() - 20]).unwrap();
        let error = Replay::open(path, 8, 4, false, true)
            .and_then(|mut r| r.expose(&EXPOSURE, &mut [0; 32]).map(|_| ()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("a.png: cannot be decoded"), "{error}");
    }

    /// Those in the middle, at the end, and of another size; what is left plays, once and again.
    #[test]
    fn damaged_files_are_left_out_where_that_is_allowed() {
        let dir = folder();
        let save = |name: &str, grey, size: (u32, u32)| {
            GrayImage::from_pixel(size.0, size.1, Luma([grey])).save(dir.path().join(name)).unwrap();
        };
        for name in ["a2.png", "z.png"] {
            save(name, 9, (8, 4));
            let whole = std::fs::read(dir.path().join(name)).unwrap();
            std::fs::write(dir.path().join(name), &whole[..whole.len() - 9]).unwrap();
        }
        save("b2.png", 9, (9, 4));
        std::fs::write(dir.path().join("b3.jpg"), "no image").unwrap();
        let mut once = Replay::open(dir.path(), 8, 4, false, false).unwrap();
        assert_eq!(once.left_out(), 2, "of another size, and none");
        assert_eq!(play(&mut once, 4), [Some(1), Some(2), Some(3), None]);
        assert_eq!(once.left_out(), 4);
        let mut looped = Replay::open(dir.path(), 8, 4, true, false).unwrap();
        assert_eq!(play(&mut looped, 7), [1, 2, 3, 1, 2, 3, 1].map(Some));
        assert!(Replay::open(dir.path(), 8, 4, false, true).is_err());
        assert!(Replay::open(dir.path(), 80, 4, false, false).is_err(), "none is left");
    }

    /// Each half of a file, and a file that lacks its last bytes, is told by name; the whole one plays.
    #[test]
    fn an_image_that_is_cut_is_told_in_every_format() {
        let image = GrayImage::from_fn(64, 48, |x, y| Luma([(x * 3 + y * 5) as u8]));
        for name in ["a.png", "a.pgm", "a.jpg", "a.jpeg"] {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join(name);
            image.save(&path).unwrap();
            let whole = std::fs::read(&path).unwrap();
            let play = || {
                Replay::open(dir.path(), 64, 48, false, true)
                    .and_then(|mut r| r.expose(&EXPOSURE, &mut [0; 64 * 48]).map(|_| ()))
            };
            play().unwrap();
            for kept in [whole.len() / 2, whole.len() * 9 / 10, whole.len() - 1] {
                std::fs::write(&path, &whole[..kept]).unwrap();
                let error =
                    play().expect_err(&format!("{name}: {kept} of {} bytes", whole.len())).to_string();
                assert!(error.contains(name), "{error}");
            }
        }
    }

    #[test]
    fn what_is_no_plain_file_is_refused_without_a_wait() {
        use rustix::fs::{CWD, FileType, Mode, mknodat};
        let dir = folder();
        let refused = |name: &str, words: &str| {
            let error = Replay::open(dir.path(), 8, 4, false, true).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(words), "{error}");
            let path = dir.path().join(name);
            std::fs::remove_file(&path).or_else(|_| std::fs::remove_dir(&path)).unwrap();
        };
        mknodat(CWD, dir.path().join("0.png"), FileType::Fifo, Mode::RWXU, 0).unwrap();
        refused("0.png", "is a pipe, not a file");
        std::os::unix::fs::symlink("/dev/zero", dir.path().join("0.pgm")).unwrap();
        refused("0.pgm", "is a device, not a file");
        std::fs::create_dir(dir.path().join("0.jpg")).unwrap();
        refused("0.jpg", "is a folder, not a file");
        let large = std::fs::File::create(dir.path().join("0.jpg")).unwrap();
        large.set_len(1 << 40).unwrap();
        refused("0.jpg", "has 1048576 MiB");
        std::os::unix::fs::symlink("a.png", dir.path().join("0.png")).unwrap();
        assert_eq!(
            Replay::open(dir.path(), 8, 4, false, true).unwrap().len(),
            4,
            "a link to an image is one"
        );
    }

    /// A head that promises more pixels than the camera has is refused before anything is allocated for them.
    #[test]
    fn a_head_that_lies_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a.pgm"), "P5 1000000 1000000 255\n").unwrap();
        let error = Replay::open(dir.path(), 8, 4, false, true).unwrap_err().to_string();
        assert!(error.contains("a.pgm: is 1000000x1000000 px"), "{error}");
    }
}
