//! Bounds of the numbers in a robot's file: ranges that no real arm leaves, wide enough for a crane and for a fingertip,
//! and so narrow that no computation on them overflows. The numbers here are chosen by what exists, not by what the
//! program could bear: `tests/cores/plausible_numbers.rs` tries the ends of every range.

use super::error::Defect;
use nalgebra::Vector3;
use std::ops::RangeInclusive;

/// Largest joint position, either way: many turns, or rails of kilometres.
pub const POSITION_RAD_OR_M: f64 = 1e4;

/// Coordinates and offsets, m.
pub(super) const LENGTH_M: RangeInclusive<f64> = -100.0..=100.0;
/// Angles of frames, rad.
pub(super) const ANGLE_RAD: RangeInclusive<f64> = -100.0..=100.0;
/// Components of an axis, which is scaled to length one.
pub(super) const DIRECTION: RangeInclusive<f64> = -1e6..=1e6;
/// Position limits, and positions at which joints are held, rad or m.
pub(super) const POSITION: RangeInclusive<f64> = -POSITION_RAD_OR_M..=POSITION_RAD_OR_M;
/// Velocity limits, rad/s or m/s.
pub(super) const VELOCITY: RangeInclusive<f64> = 1e-6..=1e3;
/// Effort limits, N m or N.
pub(super) const EFFORT: RangeInclusive<f64> = 1e-6..=1e7;
/// Viscous (N m s/rad or N s/m) and Coulomb friction (N m or N).
pub(super) const FRICTION: RangeInclusive<f64> = 0.0..=1e6;
/// Masses, kg.
pub(super) const MASS_KG: RangeInclusive<f64> = 0.0..=1e5;
/// Least mass that counts as some: what is less is given as zero, or by mistake.
const MIN_MASS_KG: f64 = 1e-9;
/// Entries of inertia matrices, kg m^2.
pub(super) const MOMENT_KG_M2: RangeInclusive<f64> = -1e7..=1e7;
/// Inertias of rotors, and those on the diagonal of B(q) alone, kg m^2 or kg.
pub(super) const ROTOR: RangeInclusive<f64> = 0.0..=1e6;
/// Gear ratios, rad/rad or rad/m: some gears turn backwards.
pub(super) const GEAR_RATIO: RangeInclusive<f64> = -1e6..=1e6;
/// Components of gravity in B, m/s^2: on any planet, and in a centrifuge.
pub(super) const GRAVITY_M_S2: RangeInclusive<f64> = -100.0..=100.0;

/// The `value` of `key`, where it is allowed.
///
/// # Errors
/// [`Defect::OutOfRange`].
pub(super) fn within(key: &str, value: f64, allowed: &RangeInclusive<f64>) -> Result<f64, Defect> {
    if allowed.contains(&value) {
        return Ok(value);
    }
    Err(Defect::OutOfRange { what: key.to_owned(), value, low: *allowed.start(), high: *allowed.end() })
}

/// A length, m.
///
/// # Errors
/// [`Defect::Length`].
pub(super) fn length(key: &str, value: f64) -> Result<f64, Defect> {
    within(key, value, &LENGTH_M).map_err(|_| Defect::Length {
        what: key.to_owned(),
        value,
        most: *LENGTH_M.end(),
    })
}

/// The coordinates of a point, m.
///
/// # Errors
/// [`Defect::Length`] for the first that is none.
pub(super) fn lengths(key: &str, values: [f64; 3]) -> Result<Vector3<f64>, Defect> {
    for (i, value) in values.into_iter().enumerate() {
        length(&format!("{key}[{i}]"), value)?;
    }
    Ok(Vector3::from(values))
}

/// Three numbers of one key.
///
/// # Errors
/// [`Defect::OutOfRange`] for the first that is.
pub(super) fn all_within(
    key: &str,
    values: [f64; 3],
    allowed: &RangeInclusive<f64>,
) -> Result<Vector3<f64>, Defect> {
    for (i, value) in values.into_iter().enumerate() {
        within(&format!("{key}[{i}]"), value, allowed)?;
    }
    Ok(Vector3::from(values))
}

/// A mass in kg, none or a real one.
///
/// # Errors
/// [`Defect::OutOfRange`].
pub(super) fn mass(key: &str, mass_kg: f64) -> Result<f64, Defect> {
    within(key, mass_kg, &MASS_KG)?;
    if mass_kg == 0.0 { Ok(mass_kg) } else { within(key, mass_kg, &(MIN_MASS_KG..=*MASS_KG.end())) }
}
