//! The grey levels of the scene, and the other inputs of painting a row.

use super::profile::EdgeProfile;
use super::rays::Rays;
use crate::target::Plate;
use std::ops::RangeInclusive;

/// Grey levels of the scene's surfaces in the middle of the image, 0..=255.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneLook {
    /// Level of everything around the plate.
    pub background: f64,
    /// Level of what is light: the plate; of light dots on a dark plate the dots.
    pub plate: f64,
    /// Level of what is dark: the dots, and all other marks.
    pub dots: f64,
}

impl SceneLook {
    /// The levels of a plate and its marks.
    pub(super) fn of(&self, plate: &Plate) -> (f64, f64) {
        if plate.light { (self.plate, self.dots) } else { (self.dots, self.plate) }
    }

    /// What each level may be: frames have eight bits, and must hold it.
    pub const LEVEL: RangeInclusive<f64> = 0.0..=255.0;
}

impl Default for SceneLook {
    fn default() -> Self {
        Self { background: 90.0, plate: 220.0, dots: 30.0 }
    }
}

/// The inputs of painting a row.
#[derive(Clone, Copy)]
pub(super) struct Paint<'a> {
    pub(super) rays: &'a Rays,
    pub(super) profile: &'a EdgeProfile,
    pub(super) look: &'a SceneLook,
}
