//! XCDR1, little-endian (OMG DDS-XTypes 1.3, 7.4.1): what ROS 2 calls `cdr`. Each number lies at a multiple of its size from the end of the four bytes
//! that name the encoding.

use crate::record::CDR_LITTLE_ENDIAN;
use crate::time::MonoNs;

/// Nanoseconds in a second, which follows from the unit.
const NS_PER_S: i64 = 1_000_000_000;

/// One message.
#[derive(Debug)]
pub(super) struct CdrOutput {
    bytes: Vec<u8>,
}

impl CdrOutput {
    pub(super) fn new() -> Self {
        Self { bytes: CDR_LITTLE_ENDIAN.to_vec() }
    }

    pub(super) fn bytes(self) -> Vec<u8> {
        self.bytes
    }

    fn number<const N: usize>(&mut self, number: [u8; N]) {
        let behind = self.bytes.len() - CDR_LITTLE_ENDIAN.len();
        self.bytes.resize(self.bytes.len() + behind.next_multiple_of(N) - behind, 0);
        self.bytes.extend_from_slice(&number);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.number([value]);
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.number(value.to_le_bytes());
    }

    pub(super) fn f64s(&mut self, values: impl IntoIterator<Item = f64>) {
        values.into_iter().for_each(|value| self.f64(value));
    }

    /// The length of a sequence, whose entries follow.
    pub(super) fn length(&mut self, entries: usize) {
        self.u32(u32::try_from(entries).unwrap_or_default());
    }

    pub(super) fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// A sequence of bytes.
    pub(super) fn octets(&mut self, bytes: &[u8]) {
        self.length(bytes.len());
        self.bytes.extend_from_slice(bytes);
    }

    /// `builtin_interfaces/Time`.
    pub(super) fn time(&mut self, stamp: MonoNs) {
        let seconds = i32::try_from(stamp.0.div_euclid(NS_PER_S)).unwrap_or_default();
        self.number(seconds.to_le_bytes());
        self.u32(stamp.0.rem_euclid(NS_PER_S) as u32);
    }

    /// `std_msgs/Header`.
    pub(super) fn header(&mut self, stamp: MonoNs, frame: &str) {
        self.time(stamp);
        self.text(frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_lie_at_multiples_of_their_sizes() {
        let mut out = CdrOutput::new();
        out.u8(1);
        out.u32(2);
        out.text("ab");
        out.f64(1.0);
        let bytes = out.bytes();
        let wanted = [0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        assert_eq!(bytes[..19], wanted);
        // text ends at 15 behind the four bytes, and the next multiple of eight is 16
        assert_eq!((bytes.len(), &bytes[20..]), (28, &1_f64.to_le_bytes()[..]));
    }
}
