//! One image file, read with care: only plain files, bounded in size before anything is decoded, and whole.
//!
//! Decoders forgive: a JPEG that ends early is filled up with grey. So the end of a file is looked for here: `EOI` of a
//! JPEG, `IEND` of a PNG. The samples of a PGM are counted by its decoder.

use super::SourceError;
use image::codecs::png::PngEncoder;
use image::{ColorType, DynamicImage, ExtendedColorType, GrayImage, ImageDecoder, ImageEncoder, ImageFormat};
use image::{ImageError, ImageReader, Limits};
use rustix::fs::OFlags;
use std::borrow::Cow;
use std::fs::{File, FileType, OpenOptions};
use std::io::{BufReader, Cursor, Read, Seek};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

/// Text PGM needs at most 6 bytes a pixel, PNG with four channels of 16 bits 8.
const BYTES_PER_PIXEL: u64 = 16;
/// For everything else in a file: comments, profiles, thumbnails.
const BYTES_BESIDE: u64 = 16 << 20;
/// What a decoder may allocate beside the image, bytes. Chosen by hand: lines and tables need far less, and a hostile file must not take all memory.
const DECODER_BYTES: u64 = 64 << 20;

/// Columns and rows that files must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Size {
    pub(super) width: u32,
    pub(super) height: u32,
}

impl Size {
    fn largest_file(self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * BYTES_PER_PIXEL + BYTES_BESIDE
    }

    fn limits(self) -> Limits {
        let mut limits = Limits::default();
        limits.max_image_width = Some(self.width);
        limits.max_image_height = Some(self.height);
        limits.max_alloc = Some(self.largest_file() + DECODER_BYTES);
        limits
    }
}

/// Looks at the head of `path`: a plain file of at most the size that such an image can have, with the right columns
/// and rows.
///
/// # Errors
/// [`SourceError`] names the file.
pub(super) fn check(path: &Path, size: Size) -> Result<(), SourceError> {
    let file = open(path, size)?;
    let mut reader = BufReader::new(file);
    let failed = |cause: std::io::Error| SourceError::image(path, cause.into());
    let mut start = Vec::new();
    reader.by_ref().take(16).read_to_end(&mut start).map_err(failed)?;
    reader.rewind().map_err(failed)?;
    if format(path, &start)? == ImageFormat::Jpeg {
        // Its head can be of any length: the decoder reads all of the file, so it gets no more than there may be.
        let bytes = read(path, reader.into_inner(), size)?;
        return check_size(path, decoder(path, Cursor::new(bytes.as_slice()), &start)?.dimensions(), size);
    }
    if format(path, &start)? == ImageFormat::Png {
        // Not the decoder: it unpacks a colour profile that comes first, whatever that takes.
        let mut head = Vec::new();
        reader.take(PNG_HEAD as u64).read_to_end(&mut head).map_err(failed)?;
        let found = png_dimensions(&head).ok_or_else(|| SourceError::Damaged(path.into()))?;
        return check_size(path, found, size);
    }
    check_size(path, decoder(path, reader, &start)?.dimensions(), size)
}

/// Reads the image into `out`.
///
/// # Errors
/// [`SourceError`] names the file, and what is wrong with it.
pub(super) fn load_into(path: &Path, size: Size, out: &mut [u8]) -> Result<(), SourceError> {
    decode_into(path, &read(path, open(path, size)?, size)?, size, out)
}

/// Decodes the image in `bytes`, which came from `path`, into `out`: where its samples are grey levels of 8 bits, straight.
///
/// # Errors
/// [`SourceError`] names the file, and what is wrong with the image; `out` may hold a part of it then.
pub(super) fn decode_into(path: &Path, bytes: &[u8], size: Size, out: &mut [u8]) -> Result<(), SourceError> {
    let checked = |found| check_size(path, found, size).map(|()| size);
    with_decoder(path, bytes, checked, |decoder| {
        if decoder.color_type() == ColorType::L8 && decoder.total_bytes() == out.len() as u64 {
            return decoder.read_image_boxed(out);
        }
        let grey = DynamicImage::from_decoder(decoder)?.into_luma8();
        if let Some(out) = out.get_mut(..grey.len()) {
            out.copy_from_slice(&grey);
        }
        Ok(())
    })
}

/// What `read` makes of the image in `bytes`, as far as `allowed` lets its size pass.
fn with_decoder<T>(
    path: &Path,
    bytes: &[u8],
    allowed: impl Fn((u32, u32)) -> Result<Size, SourceError>,
    read: impl FnOnce(Box<dyn ImageDecoder + '_>) -> Result<T, ImageError>,
) -> Result<T, SourceError> {
    let whole = match format(path, bytes)? {
        ImageFormat::Jpeg => jpeg_is_whole(bytes),
        ImageFormat::Png => png_is_whole(bytes),
        _ => true,
    };
    if !whole {
        return Err(SourceError::Damaged(path.into()));
    }
    let bytes = png_without_profile(bytes);
    let mut decoder = decoder(path, Cursor::new(bytes.as_ref()), &bytes)?;
    let size = allowed(decoder.dimensions())?;
    let failed = |cause| SourceError::image(path, cause);
    decoder.set_limits(size.limits()).map_err(failed)?;
    read(Box::new(decoder)).map_err(failed)
}

/// Largest image, px. Chosen by hand: 64 megapixels are more than industrial cameras have, and a hostile header must not ask for more.
const LARGEST: Size = Size { width: 8192, height: 8192 };

/// Reads an image of any size up to 8192 x 8192 px, any depth and colour, as grey levels.
///
/// # Errors
/// [`SourceError`] names the file, and what is wrong with it.
pub fn load_image(path: &Path) -> Result<GrayImage, SourceError> {
    let bytes = read(path, open(path, LARGEST)?, LARGEST)?;
    let checked = |found: (u32, u32)| {
        let fits = found.0 <= LARGEST.width && found.1 <= LARGEST.height;
        if fits { Ok(LARGEST) } else { check_size(path, found, LARGEST).map(|()| LARGEST) }
    };
    with_decoder(path, &bytes, checked, |decoder| Ok(DynamicImage::from_decoder(decoder)?.into_luma8()))
}

/// The bytes of a PNG file of these pixels, row by row.
///
/// # Errors
/// When there are not as many bytes as such an image has, or it has no pixels.
pub fn encode_png(
    pixels: &[u8],
    width: u32,
    height: u32,
    colours: ExtendedColorType,
) -> Result<Vec<u8>, ImageError> {
    let wanted = u64::from(width) * u64::from(height) * u64::from(colours.bits_per_pixel() / 8);
    if pixels.len() as u64 != wanted {
        let cause = image::error::ParameterErrorKind::DimensionMismatch;
        return Err(ImageError::Parameter(image::error::ParameterError::from_kind(cause)));
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(pixels, width, height, colours)?;
    Ok(bytes)
}

/// Opens a plain file, or a link to one; never waits for the other end of a pipe, and does not touch devices.
fn open(path: &Path, size: Size) -> Result<File, SourceError> {
    let file = open_plain(path)?;
    let length = file.metadata().map_err(|cause| SourceError::image(path, cause.into()))?.len();
    check_length(path, length, size)?;
    Ok(file)
}

/// The same of any length.
pub(super) fn open_plain(path: &Path) -> Result<File, SourceError> {
    let failed = |cause: std::io::Error| SourceError::image(path, cause.into());
    plain(path, std::fs::metadata(path).map_err(failed)?.file_type())?;
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path).map_err(failed)?;
    let found = file.metadata().map_err(failed)?;
    crate::input::used::note(&found);
    plain(path, found.file_type())?; // another may have come to this path in between
    Ok(file)
}

fn plain(path: &Path, found: FileType) -> Result<(), SourceError> {
    let kind = if found.is_file() {
        return Ok(());
    } else if found.is_dir() {
        "a folder"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else {
        "a device"
    };
    Err(SourceError::NotAFile { file: path.into(), kind })
}

fn check_length(path: &Path, bytes: u64, size: Size) -> Result<(), SourceError> {
    let largest = size.largest_file();
    if bytes <= largest {
        return Ok(());
    }
    Err(SourceError::TooLarge { file: path.into(), mib: bytes >> 20, largest_mib: largest >> 20 })
}

/// All bytes, at most as many as there may be: a file can be longer than it says.
fn read(path: &Path, file: File, size: Size) -> Result<Vec<u8>, SourceError> {
    let mut bytes = Vec::new();
    let most = size.largest_file() + 1;
    file.take(most).read_to_end(&mut bytes).map_err(|e| SourceError::image(path, e.into()))?;
    check_length(path, bytes.len() as u64, size)?;
    Ok(bytes)
}

fn format(path: &Path, start: &[u8]) -> Result<ImageFormat, SourceError> {
    image::guess_format(start).map_err(|cause| SourceError::image(path, cause))
}

fn decoder<'a>(
    path: &Path,
    reader: impl std::io::BufRead + Seek + 'a,
    start: &[u8],
) -> Result<impl ImageDecoder + 'a, SourceError> {
    let mut reader = ImageReader::with_format(reader, format(path, start)?);
    reader.limits(Limits::default());
    reader.into_decoder().map_err(|cause| SourceError::image(path, cause))
}

pub(super) fn check_size(path: &Path, (width, height): (u32, u32), size: Size) -> Result<(), SourceError> {
    if (Size { width, height }) == size {
        return Ok(());
    }
    Err(SourceError::Size {
        file: path.into(),
        found_width: width,
        found_height: height,
        width: size.width,
        height: size.height,
    })
}

/// Whether a JPEG has its end: walks its segments, and the coded data between them, to `EOI` behind at least one scan.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    // Markers of the JPEG standard, ITU-T T.81, table B.1: SOI, EOI and SOS.
    const START: u8 = 0xD8;
    const END: u8 = 0xD9;
    const SCAN: u8 = 0xDA;
    let mut scanned = false;
    let mut at = 0;
    // Everything up to the next marker is coded data, or filling.
    while let Some(found) = bytes.get(at..).and_then(|rest| rest.iter().position(|b| *b == 0xFF)) {
        at += found + 1;
        match bytes.get(at).copied() {
            None => return false,
            // A coded 0xFF, filling, restart markers, and others without length.
            Some(0x00 | 0xFF | 0x01 | 0xD0..=0xD7 | START) => {}
            Some(END) => return scanned,
            Some(marker) => {
                scanned |= marker == SCAN;
                let Some([high, low]) = bytes.get(at + 1..at + 3) else { return false };
                at += usize::from(u16::from_be_bytes([*high, *low]));
            }
        }
    }
    false
}

/// Bytes of a PNG before its first chunk: the signature of the PNG specification, Sect. 5.2.
const PNG_SIGNATURE: usize = 8;
/// The signature, and the first chunk up to the image's size: length, type, width and height of the specification's IHDR.
const PNG_HEAD: usize = PNG_SIGNATURE + 16;

/// The chunks of a PNG, where each begins and ends, and of what kind it is; up to the first that the file does not hold whole.
fn png_chunks(bytes: &[u8]) -> impl Iterator<Item = (std::ops::Range<usize>, &[u8])> {
    // Length, type and CRC, four bytes each, by the specification.
    const LENGTH_TYPE_AND_SUM: usize = 12;
    let mut at = PNG_SIGNATURE;
    std::iter::from_fn(move || {
        let (length, kind) = bytes.get(at..at + 8)?.split_at(4);
        let length = length.iter().fold(0, |n, b| n << 8 | usize::from(*b));
        let next = at.checked_add(length + LENGTH_TYPE_AND_SUM).filter(|next| *next <= bytes.len())?;
        Some((std::mem::replace(&mut at, next)..next, kind))
    })
}

/// Whether a PNG has its end: `IEND`.
fn png_is_whole(bytes: &[u8]) -> bool {
    png_chunks(bytes).any(|(_, kind)| kind == b"IEND")
}

/// Columns and rows, from the head of a PNG.
fn png_dimensions(head: &[u8]) -> Option<(u32, u32)> {
    let number = |at: usize| Some(u32::from_be_bytes(head.get(at..at + 4)?.try_into().ok()?));
    let is_head = head.get(PNG_SIGNATURE + 4..PNG_SIGNATURE + 8)? == b"IHDR";
    is_head.then_some((number(PNG_SIGNATURE + 8)?, number(PNG_SIGNATURE + 12)?))
}

/// The file, of a PNG without its colour profiles: grey levels do not need them, and the decoder unpacks them before it can be told
/// how much memory it may take. 400 kB of a file can be 400 MB of a profile.
fn png_without_profile(bytes: &[u8]) -> Cow<'_, [u8]> {
    let is_png = bytes.starts_with(b"\x89PNG\r\n\x1a\n");
    if !is_png || !png_chunks(bytes).any(|(_, kind)| kind == b"iCCP") {
        return Cow::Borrowed(bytes);
    }
    let mut kept = bytes[..PNG_SIGNATURE].to_vec();
    for (chunk, _) in png_chunks(bytes).filter(|(_, kind)| *kind != b"iCCP") {
        kept.extend_from_slice(&bytes[chunk]);
    }
    Cow::Owned(kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_profile_is_left_out_before_anything_is_unpacked() {
        let image = GrayImage::from_fn(5, 3, |x, y| image::Luma([(40 * x + y) as u8]));
        let mut png = Vec::new();
        image.write_to(&mut Cursor::new(&mut png), ImageFormat::Png).unwrap();
        // Behind IHDR, with a sum that is wrong: whoever looks into it says so.
        let after_head = png_chunks(&png).next().unwrap().0.end;
        let mut with_profile = png[..after_head].to_vec();
        let profile = b"name\0\0no deflated data";
        with_profile.extend((profile.len() as u32).to_be_bytes());
        with_profile.extend(b"iCCP");
        with_profile.extend(profile);
        with_profile.extend([0; 4]);
        with_profile.extend(&png[after_head..]);
        assert_eq!(png_without_profile(&with_profile).as_ref(), png);
        assert!(matches!(png_without_profile(&png), Cow::Borrowed(_)));
        assert_eq!(png_dimensions(&with_profile), Some((5, 3)));
        for head in 0..PNG_HEAD {
            assert_eq!(png_dimensions(&with_profile[..head]), None);
        }
        let path = std::env::temp_dir().join(format!("vservo-profile-{}.png", std::process::id()));
        std::fs::write(&path, &with_profile).unwrap();
        let read = load_image(&path).unwrap();
        check(&path, Size { width: 5, height: 3 }).unwrap();
        assert!(matches!(check(&path, Size { width: 5, height: 4 }), Err(SourceError::Size { .. })));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read, image);
    }

    #[test]
    fn a_png_is_read_back_with_its_levels() {
        let png = encode_png(&[0, 50, 100, 150, 200, 250], 3, 2, ExtendedColorType::L8).unwrap();
        let read = image::load_from_memory(&png).unwrap().into_luma8();
        assert_eq!((read.width(), read.height(), read.as_raw()[4]), (3, 2, 200));
        assert!(encode_png(&[0; 5], 3, 2, ExtendedColorType::L8).is_err());
    }
}
