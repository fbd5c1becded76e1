//! What the emulated camera says of itself: descriptors of USB 2.0 and of the video class (UVC 1.0 and 1.1), and the control
//! blocks that the host reads and writes. All numbers are those of the two specifications.

/// Sizes of images, px; the number of a frame descriptor is its place here, from 1.
pub const SIZES: [(u16, u16); 2] = [(640, 480), (320, 240)];
/// Time between frames, in units of 100 ns: 30, 25 and 15 Hz.
pub const INTERVALS: [u32; 3] = [333_333, 400_000, 666_666];
/// Bytes of one transfer of the stream, header included.
pub const PAYLOAD: usize = 16384;
/// Streaming endpoint, to the host.
pub const ENDPOINT: u8 = 0x81;

/// Form of the images; the number of a format descriptor is its place here, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    Yuyv,
    Mjpg,
    Grey,
}

pub const FORMATS: [Format; 3] = [Format::Yuyv, Format::Mjpg, Format::Grey];

impl Format {
    /// The most bytes of an image.
    pub fn largest(self, (width, height): (u16, u16)) -> u32 {
        let pixels = u32::from(width) * u32::from(height);
        if self == Self::Yuyv { 2 * pixels } else { pixels }
    }
}

/// A camera as it is sold: two of the same model differ in their serial number only.
#[derive(Debug, Clone)]
pub struct Model {
    pub name: &'static str,
    pub serial: &'static str,
    pub product: u16,
    /// Version of the video class, as BCD: 0x0100 or 0x0110.
    pub uvc: u16,
}

impl Default for Model {
    fn default() -> Self {
        Self { name: "Emulated Camera", serial: "0001", product: 0x0001, uvc: 0x0100 }
    }
}

impl Model {
    /// A string descriptor; `None` for one that there is not.
    pub fn string(&self, index: u8) -> Option<Vec<u8>> {
        let text = match index {
            0 => return Some(vec![4, 3, 0x09, 0x04]),
            1 => "vservo",
            2 => self.name,
            3 => self.serial,
            _ => return None,
        };
        let body: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        Some(descriptor(3, &[&body]))
    }

    /// The device descriptor.
    pub fn device(&self) -> Vec<u8> {
        let [product_low, product_high] = self.product.to_le_bytes();
        // USB 2.0, a device of several interfaces, packets of 64 bytes, vendor 0x1209, version 1.0, strings 1 to 3.
        let body = [0, 2, 0xef, 2, 1, 64, 0x09, 0x12, product_low, product_high, 0, 1, 1, 2, 3, 1];
        descriptor(1, &[&body])
    }

    /// The configuration with everything below it.
    pub fn configuration(&self) -> Vec<u8> {
        let association = descriptor(0x0b, &[&[0, 2, 0x0e, 3, 0, 0]]);
        let control = descriptor(4, &[&[0, 0, 0, 0x0e, 1, 0, 2]]);
        let streaming = descriptor(4, &[&[1, 0, 1, 0x0e, 2, 0, 0]]);
        let endpoint = descriptor(5, &[&[ENDPOINT, 2, 0, 2, 0]]);
        let all =
            [association, control, self.control_class(), streaming, streaming_class(), endpoint].concat();
        let total = (9 + all.len() as u16).to_le_bytes();
        [descriptor(2, &[&total, &[2, 1, 0, 0x80, 50]]), all].concat()
    }

    /// Camera (1) to processing unit (2) to the stream (3).
    fn control_class(&self) -> Vec<u8> {
        let camera = class(2, &[&[1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0b1010, 0, 0]]);
        let video_standards: &[u8] = if self.uvc >= 0x0110 { &[0] } else { &[] };
        let processing = class(5, &[&[2, 1, 0, 0, 2, 0b1, 0b10, 0], video_standards]);
        let stream = class(3, &[&[3, 0x01, 0x01, 0, 2, 0]]);
        let units = [camera, processing, stream].concat();
        let clock_hz = 48_000_000_u32.to_le_bytes();
        let total = (13 + units.len() as u16).to_le_bytes();
        [class(1, &[&self.uvc.to_le_bytes(), &total, &clock_hz, &[1, 1]]), units].concat()
    }

    /// Answer to a question about the negotiated stream.
    pub fn probe(&self, stream: &Stream) -> Vec<u8> {
        let format = 1 + FORMATS.iter().position(|f| *f == stream.format).unwrap_or(0) as u8;
        let size = 1 + SIZES.iter().position(|s| *s == stream.size).unwrap_or(0) as u8;
        let mut block = vec![1, 0, format, size];
        block.extend(stream.interval.to_le_bytes());
        block.extend([0; 10]);
        block.extend(stream.format.largest(stream.size).to_le_bytes());
        block.extend((PAYLOAD as u32).to_le_bytes());
        if self.uvc >= 0x0110 {
            block.extend(48_000_000_u32.to_le_bytes());
            block.extend([0; 4]);
        }
        block
    }
}

/// What the host has asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stream {
    pub format: Format,
    pub size: (u16, u16),
    /// 100 ns.
    pub interval: u32,
}

impl Default for Stream {
    fn default() -> Self {
        Self { format: Format::Yuyv, size: SIZES[0], interval: INTERVALS[0] }
    }
}

impl Stream {
    /// The nearest that the camera has to what a host's block asks for.
    pub fn nearest(block: &[u8]) -> Self {
        let number = |at: usize| usize::from(block.get(at).copied().unwrap_or(1)).wrapping_sub(1);
        let interval = block.get(4..8).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let nearest = INTERVALS.into_iter().min_by_key(|i| i.abs_diff(interval));
        Self {
            format: FORMATS.get(number(2)).copied().unwrap_or(Format::Yuyv),
            size: SIZES.get(number(3)).copied().unwrap_or(SIZES[0]),
            interval: nearest.unwrap_or(INTERVALS[0]),
        }
    }
}

/// Formats, sizes and intervals.
fn streaming_class() -> Vec<u8> {
    let mut formats = Vec::new();
    for (place, format) in FORMATS.into_iter().enumerate() {
        let (number, sizes) = (place as u8 + 1, SIZES.len() as u8);
        let frame_subtype = if format == Format::Mjpg {
            formats.extend(class(6, &[&[number, sizes, 1, 1, 0, 0, 0, 0]]));
            7
        } else {
            let (name, bits) = if format == Format::Yuyv { (b"YUY2", 16) } else { (b"Y800", 8) };
            let guid_end = [0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71];
            formats.extend(class(4, &[&[number, sizes], name, &guid_end, &[bits, 1, 0, 0, 0, 0]]));
            5
        };
        for (place, size) in SIZES.into_iter().enumerate() {
            formats.extend(frame(frame_subtype, place as u8 + 1, size, format.largest(size)));
        }
    }
    let total = (16 + formats.len() as u16).to_le_bytes();
    [class(1, &[&[3], &total, &[ENDPOINT, 0, 3, 0, 0, 0, 1, 0, 0, 0]]), formats].concat()
}

fn frame(subtype: u8, number: u8, (width, height): (u16, u16), bytes: u32) -> Vec<u8> {
    let bits_a_second = |hz: u32| (bytes * 8 * hz).to_le_bytes();
    let mut body = vec![number, 0];
    body.extend(width.to_le_bytes());
    body.extend(height.to_le_bytes());
    body.extend(
        [bits_a_second(15), bits_a_second(30), bytes.to_le_bytes(), INTERVALS[0].to_le_bytes()].concat(),
    );
    body.push(INTERVALS.len() as u8);
    body.extend(INTERVALS.into_iter().flat_map(u32::to_le_bytes));
    class(subtype, &[&body])
}

/// A descriptor: its length, its type, its parts.
fn descriptor(kind: u8, parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    [&[2 + body.len() as u8, kind][..], &body].concat()
}

/// A descriptor of the video class.
fn class(subtype: u8, parts: &[&[u8]]) -> Vec<u8> {
    descriptor(0x24, &[&[subtype], &parts.concat()])
}
