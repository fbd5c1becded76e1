//! What the emulated camera shows: a smooth image with its own number and the time of its exposure in squares of black and
//! white, so that whoever receives a frame can say which one it is, when it was, and whether every pixel of it is right.
//!
//! ```text
//! row 0   number, 16 squares, and 4 that check them       square: 16 x 16 px, which a JPEG keeps apart
//! row 1   exposure, us of the monotonic clock, low 16 bits, and a check
//! row 2   its next 16 bits
//! ```

use vservo::time::MonoNs;

/// Side of a square, px.
const SQUARE: usize = 16;
const DATA_BITS: usize = 16;
const CHECK_BITS: usize = 4;
const BLACK: u8 = 16;
const WHITE: u8 = 235;
/// Colour of the whole image, added to red, green and blue; together they are no luminance.
const TINT: [i16; 3] = [20, -8, -12];

/// What is written into an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Marks {
    /// Counts the camera's exposures since it was plugged in.
    pub number: u16,
    /// Begin of its exposure, us of the monotonic clock, low 32 bits.
    pub exposed_us: u32,
}

impl Marks {
    pub fn new(number: u64, exposed: MonoNs) -> Self {
        Self { number: number as u16, exposed_us: (exposed.0 / 1000) as u32 }
    }

    fn rows(self) -> [u16; 3] {
        [self.number, self.exposed_us as u16, (self.exposed_us >> 16) as u16]
    }
}

/// Grey levels of an image.
pub fn draw(marks: Marks, width: usize, height: usize) -> Vec<u8> {
    let mut grey = background(width, height);
    mark(&mut grey, 1, width, marks);
    grey
}

/// An image without marks.
pub fn background(width: usize, height: usize) -> Vec<u8> {
    let mut grey = Vec::with_capacity(width * height);
    for y in 0..height {
        let down = 40 + y * 40 / height;
        grey.extend((0..width).map(|x| (down + x * 150 / width) as u8));
    }
    grey
}

/// Writes `marks` into an image whose pixels have so many bytes each, the first of which is the grey level.
pub fn mark(image: &mut [u8], pixel_bytes: usize, width: usize, marks: Marks) {
    for (row, value) in marks.rows().into_iter().enumerate() {
        for bit in 0..DATA_BITS + CHECK_BITS {
            let level = if squares(value) >> bit & 1 == 1 { WHITE } else { BLACK };
            for y in row * SQUARE..(row + 1) * SQUARE {
                let start = (y * width + bit * SQUARE) * pixel_bytes;
                let line = &mut image[start..start + SQUARE * pixel_bytes];
                line.iter_mut().step_by(pixel_bytes).for_each(|grey| *grey = level);
            }
        }
    }
}

/// What is written in an image; `None` where a square is neither black nor white, or the check does not hold.
pub fn read(grey: &[u8], width: usize) -> Option<Marks> {
    let row = |row: usize| {
        let mut bits = 0;
        for bit in 0..DATA_BITS + CHECK_BITS {
            let middle = (row * SQUARE + SQUARE / 2) * width + bit * SQUARE + SQUARE / 2;
            match grey.get(middle)? {
                0..=60 => {}
                190.. => bits |= 1 << bit,
                _ => return None,
            }
        }
        let value = bits as u16;
        (squares(value) == bits).then_some(value)
    };
    Some(Marks { number: row(0)?, exposed_us: u32::from(row(1)?) | u32::from(row(2)?) << 16 })
}

/// A value with its check behind it.
fn squares(value: u16) -> u32 {
    let nibbles: u32 = (0..4).map(|i| u32::from(value >> (4 * i) & 15) * (i + 1)).sum();
    u32::from(value) | ((nibbles ^ 0b1010) & 15) << DATA_BITS
}

/// The same image as YUYV: luminance and a constant colour in turn.
pub fn yuyv(grey: &[u8]) -> Vec<u8> {
    grey.chunks_exact(2).flat_map(|pair| [pair[0], 90, pair[1], 200]).collect()
}

/// The same image, tinted, as JPEG.
pub fn jpeg(grey: &[u8], width: usize, height: usize) -> Vec<u8> {
    let rgb: Vec<u8> = grey
        .iter()
        .flat_map(|level| TINT.map(|tint| (i16::from(*level) + tint).clamp(0, 255) as u8))
        .collect();
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90)
        .encode(&rgb, width as u32, height as u32, image::ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// The largest difference of two images in grey levels.
pub fn difference(a: &[u8], b: &[u8]) -> u8 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}
