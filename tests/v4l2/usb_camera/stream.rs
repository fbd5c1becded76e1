//! The stream thread of the emulated camera: an image at every interval, in transfers with a header of two bytes each.

use super::descriptors::{Format, PAYLOAD, Stream};
use super::test_image::{self, Marks};
use super::usbip::Answers;
use super::{Device, Fault};
use std::time::Duration;
use vservo::rt;
use vservo::time::SpanNs;

/// Length of a transfer's header.
const HEADER: usize = 2;
/// Bits of a header: it ends; an error; the last of its frame; whether the frame is an even or an odd one.
const END_OF_HEADER: u8 = 0x80;
const ERROR: u8 = 0x40;
const LAST: u8 = 0x02;
/// JPEGs are made beforehand, so many; after that they come again.
pub const JPEGS: u64 = 16;

/// Streams while the host wants it, until the plug is pulled.
pub(super) fn run(device: &Device, answers: &Answers) {
    let mut made: Option<(Stream, Images)> = None;
    let mut parity = 0;
    while let Some((session, stream)) = wait_for_stream(device) {
        let (_, images) = match made.take_if(|(of, _)| *of == stream) {
            Some(same) => made.insert(same),
            None => made.insert((stream, Images::of(&stream))),
        };
        let mut due = rt::now();
        while device.goes_on(session) {
            // It is exposed as its interval begins, and sent when that is over.
            let exposed = due;
            due = due + SpanNs(i64::from(stream.interval) * 100);
            let number = {
                let mut state = device.state();
                state.exposed += 1;
                state.exposed
            };
            let bytes = images.draw(Marks::new(number, exposed));
            rt::sleep_until(due);
            let fault = device.state().faults.pop_front();
            let mut bytes = bytes.as_slice();
            match fault {
                Some(Fault::Lost) => continue,
                Some(Fault::Short) => bytes = &bytes[..bytes.len() / 2],
                Some(Fault::Stall(lasts)) => {
                    let back = rt::now() + SpanNs(lasts.as_nanos() as i64);
                    while rt::now() < back && device.goes_on(session) {
                        rt::sleep_until(rt::now() + SpanNs::from_s(0.01));
                    }
                    due = rt::now();
                }
                Some(Fault::ErrorBit) | None => {}
            }
            let error = if fault == Some(Fault::ErrorBit) { ERROR } else { 0 };
            send(device, answers, session, bytes, END_OF_HEADER | parity | error);
            parity ^= 1;
        }
    }
}

/// The number and the form of the next stream; `None` when the plug was pulled.
fn wait_for_stream(device: &Device) -> Option<(u64, Stream)> {
    let state = device.state();
    let state = device.changed.wait_while(state, |s| !s.streaming && !s.unplugged).unwrap();
    (!state.unplugged).then_some((state.session, state.negotiated))
}

impl Device {
    fn goes_on(&self, session: u64) -> bool {
        let state = self.state();
        state.streaming && state.session == session && !state.unplugged
    }

    /// A transfer that the kernel has prepared; `None` when the stream is over.
    fn transfer(&self, session: u64) -> Option<u32> {
        let mut state = self.state();
        while state.streaming && state.session == session && !state.unplugged {
            if let Some(transfer) = state.transfers.pop_front() {
                return Some(transfer);
            }
            state = self.changed.wait_timeout(state, Duration::from_millis(50)).unwrap().0;
        }
        None
    }
}

fn send(device: &Device, answers: &Answers, session: u64, image: &[u8], header: u8) {
    let mut parts = image.chunks(PAYLOAD - HEADER).peekable();
    while let Some(part) = parts.next() {
        let Some(transfer) = device.transfer(session) else { return };
        let last = if parts.peek().is_none() { LAST } else { 0 };
        let data = [&[HEADER as u8, header | last][..], part].concat();
        answers.end(transfer, 0, data.len(), &data);
    }
}

/// Images in the form of a stream; what takes too long to make between two frames is made beforehand.
enum Images {
    /// An image without marks, its columns, and the bytes of a pixel.
    Raw { background: Vec<u8>, width: usize, pixel_bytes: usize },
    /// One for each number.
    Jpeg(Vec<Vec<u8>>),
}

impl Images {
    fn of(stream: &Stream) -> Self {
        let (width, height) = (usize::from(stream.size.0), usize::from(stream.size.1));
        let grey = test_image::background(width, height);
        match stream.format {
            Format::Grey => Self::Raw { background: grey, width, pixel_bytes: 1 },
            Format::Yuyv => Self::Raw { background: test_image::yuyv(&grey), width, pixel_bytes: 2 },
            Format::Mjpg => {
                let grey = |number| test_image::draw(jpeg_marks(number), width, height);
                Self::Jpeg((0..JPEGS).map(|number| test_image::jpeg(&grey(number), width, height)).collect())
            }
        }
    }

    fn draw(&self, marks: Marks) -> Vec<u8> {
        match self {
            Self::Raw { background, width, pixel_bytes } => {
                let mut image = background.clone();
                test_image::mark(&mut image, *pixel_bytes, *width, marks);
                image
            }
            Self::Jpeg(all) => all[(u64::from(marks.number) % JPEGS) as usize].clone(),
        }
    }
}

/// What is written into a JPEG: its number alone, which comes again after [`JPEGS`].
pub(super) fn jpeg_marks(number: u64) -> Marks {
    Marks { number: (number % JPEGS) as u16, exposed_us: 0 }
}
