//! The second camera of a simulated run, with a vision, a target and a goal of its own.
//!
//! A tick takes in one measurement: where both cameras have one, that of the second waits for the next tick. The lockstep control process does the same.

use crate::config::assemble::{self, AssembleError};
use crate::config::{Camera, Config};
use crate::imaging::{ImageSizeError, ImageView};
use crate::messages::{FrameHeader, JointState, Measurement};
use crate::scene::{Exposure, SyntheticCamera};
use crate::time::{MonoNs, TICK};
use crate::vision::{Carrier, Frame, Prior, TargetChoice, TargetSet};
use std::collections::VecDeque;

/// The second camera, from its images to its measurements.
pub(super) struct SecondEye<const N: usize> {
    cell: Config,
    camera: SyntheticCamera<N>,
    carrier: Box<dyn Carrier>,
    choice: TargetChoice,
    vision: TargetSet,
    pixels: Vec<u8>,
    /// Measurements with the ticks from which on they may be used.
    on_their_way: VecDeque<(u64, Measurement)>,
}

impl<const N: usize> SecondEye<N> {
    /// The second camera of `config`, where it has one that controls the arm.
    pub(super) fn of(config: &Config) -> Result<Option<Self>, AssembleError> {
        let Some(second) = &config.second_view else { return Ok(None) };
        let cell = Config::clone(&second.cell);
        let i = cell.camera.model.intrinsics();
        Ok(Some(Self {
            camera: assemble::synthetic_camera(&cell)?,
            carrier: assemble::carrier(&cell)?,
            choice: TargetChoice::default(),
            vision: assemble::target_set(&cell),
            pixels: vec![0; i.width_px as usize * i.height_px as usize],
            on_their_way: VecDeque::new(),
            cell,
        }))
    }

    /// Takes in the arm.
    pub(super) fn note(&mut self, state: &JointState) {
        self.camera.arm(state);
        self.carrier.note(state);
        self.choice.note(state);
    }

    /// Exposes and measures the frame of `tick`, where there is one. The measurement that control takes in at this tick: the one of the `first` camera, or else the newest of this one.
    pub(super) fn see(
        &mut self,
        tick: u64,
        first: Option<Measurement>,
    ) -> Result<Option<Measurement>, ImageSizeError> {
        let (camera, mid) = (&self.cell.camera, MonoNs(TICK.0 * tick as i64));
        let schedule = &camera.schedule;
        if let Some(frame_id) = schedule.frame_at(tick).filter(|id| !schedule.is_lost(*id)) {
            let exposure = Exposure { frame_id, mid, span: camera.exposure };
            let frame = exposed(camera, &mut self.camera, &exposure, &mut self.pixels)?;
            let X_WC = self.carrier.X_WC(mid.min(frame.header.exposure));
            let measurement =
                self.vision.process(self.choice.at(mid), &frame, &Prior { X_WC, ..Prior::default() });
            self.on_their_way.push_back((schedule.usable_tick(frame_id), measurement));
        }
        if first.is_some() {
            return Ok(first);
        }
        let mut newest = None;
        while let Some((_, seen)) = self.on_their_way.pop_front_if(|(usable, _)| *usable <= tick) {
            newest = Some(seen);
        }
        Ok(newest)
    }
}

/// Exposes `exposure`: the header of the frame, and its image.
pub(super) fn exposed<'a, const N: usize>(
    camera: &Camera,
    source: &mut SyntheticCamera<N>,
    exposure: &Exposure,
    pixels: &'a mut [u8],
) -> Result<Frame<'a>, ImageSizeError> {
    source.expose(exposure, pixels);
    let i = camera.model.intrinsics();
    let image = ImageView::new(pixels, i.width_px as usize, i.height_px as usize)?;
    let header = FrameHeader {
        frame_id: exposure.frame_id,
        exposure: camera.stamp(source.stamped()),
        camera: camera.id.into(),
        width_px: i.width_px,
        height_px: i.height_px,
        ..FrameHeader::default()
    };
    Ok(Frame { header, image })
}

#[cfg(test)]
mod tests;
