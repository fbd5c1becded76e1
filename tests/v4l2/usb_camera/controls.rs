//! The emulated camera's controls: exposure mode and time, brightness, gain. Under automatic exposure the time is the camera's
//! own, as in real ones.

use std::collections::HashMap;

/// Units of the camera that have controls, and their selectors.
const EXPOSURE_MODE: (u8, u8) = (1, 2);
const EXPOSURE_TIME: (u8, u8) = (1, 4);
const BRIGHTNESS: (u8, u8) = (2, 2);
const GAIN: (u8, u8) = (2, 4);
/// Values of the exposure mode.
const MANUAL: u32 = 1;
const BY_THE_CAMERA: u32 = 8;
/// The time that the camera takes of its own accord, 100 us.
pub const OWN_EXPOSURE: u32 = 200;

/// A control's length in bytes and its bounds.
struct Bounds {
    bytes: usize,
    least: u32,
    most: u32,
    step: u32,
    default: u32,
}

fn bounds(control: (u8, u8)) -> Option<Bounds> {
    let (bytes, least, most, step, default) = match control {
        // Of the mode, the "step" is the set of those that there are.
        EXPOSURE_MODE => (1, MANUAL, BY_THE_CAMERA, MANUAL | BY_THE_CAMERA, BY_THE_CAMERA),
        EXPOSURE_TIME => (4, 1, 5000, 1, 157),
        BRIGHTNESS => (2, 0, 255, 1, 128),
        GAIN => (2, 0, 100, 1, 10),
        _ => return None,
    };
    Some(Bounds { bytes, least, most, step, default })
}

/// What was set.
#[derive(Default)]
pub struct Controls(HashMap<(u8, u8), u32>);

impl Controls {
    /// Sets a control; `None` where there is none such, or the value is out of its bounds.
    pub fn set(&mut self, control: (u8, u8), data: &[u8]) -> Option<()> {
        let b = bounds(control)?;
        let value = data.iter().take(b.bytes).rev().fold(0, |v, byte| v << 8 | u32::from(*byte));
        let own = control == EXPOSURE_TIME && self.get(EXPOSURE_MODE)? == BY_THE_CAMERA;
        if own || !(b.least..=b.most).contains(&value) {
            return None;
        }
        self.0.insert(control, value);
        Some(())
    }

    fn get(&self, control: (u8, u8)) -> Option<u32> {
        if control == EXPOSURE_TIME && self.get(EXPOSURE_MODE)? == BY_THE_CAMERA {
            return Some(OWN_EXPOSURE);
        }
        Some(self.0.get(&control).copied().unwrap_or(bounds(control)?.default))
    }

    /// The answer to a request of the video class; `None` where there is none.
    pub fn answer(&self, request: u8, control: (u8, u8)) -> Option<Vec<u8>> {
        let b = bounds(control)?;
        let value = match request {
            0x81 => self.get(control)?,
            0x82 => b.least,
            0x83 => b.most,
            0x84 => b.step,
            0x85 => return Some(vec![b.bytes as u8, 0]),
            // Can be read and set; the exposure time changes of its own accord.
            0x86 => return Some(vec![if control == EXPOSURE_TIME { 0b1011 } else { 0b11 }]),
            0x87 => b.default,
            _ => return None,
        };
        Some(value.to_le_bytes()[..b.bytes].to_vec())
    }

    /// Length of the exposure, 100 us.
    pub fn exposure(&self) -> u32 {
        self.get(EXPOSURE_TIME).unwrap_or(OWN_EXPOSURE)
    }
}
