//! The numbers of a lens: `[camera.lens]` and, where the true lens differs from it, `[scene.camera.lens]`.
//!
//! The numbers here are ranges wider than any use, chosen, so that a slip of the pen is reported; `tests/cores/plausible_numbers.rs` tries their ends.

use crate::camera_model::{Intrinsics, Lens, LensModel};
use crate::config::check::Validation;
use crate::config::raw::{RawLens, RawTrueLens};
use std::ops::RangeInclusive;

/// Focal lengths. Chosen by hand: outside of them a number has another unit.
const FOCAL_PX: RangeInclusive<f64> = 1.0..=1e6;
/// Range of the principal point. Chosen by hand: that of a cropped image may lie outside of the image.
const CENTRE_PX: RangeInclusive<f64> = -1e5..=1e5;

/// Ranges of coefficients. Chosen by hand: long lenses see small radii only, so that their higher coefficients are large. A coefficient of r^2k
/// grows with (f / w)^2k.
fn allowed(coefficient: &str) -> RangeInclusive<f64> {
    let most = match coefficient {
        "k1" | "k4" => 1e3,
        "k2" | "k5" => 1e4,
        "k3" | "k6" => 1e6,
        _ => 10.0,
    };
    -most..=most
}

/// The lens of the camera at key `at`, before a whole image of `(width_px, height_px)`.
pub(super) fn believed(
    at: &str,
    lens: &RawLens,
    (width_px, height_px): (u32, u32),
    check: &mut Validation<'_>,
) -> (Intrinsics, Lens) {
    let middle = |side_px: u32| 0.5 * (f64::from(side_px) - 1.0);
    let mut number =
        |key: &str, value: f64, allowed| check.range(&format!("{at}.lens.{key}"), value, allowed);
    let intrinsics = Intrinsics {
        fx_px: number("fx_px", lens.fx_px, FOCAL_PX),
        fy_px: number("fy_px", lens.fy_px, FOCAL_PX),
        cx_px: lens.cx_px.map_or(middle(width_px), |c| number("cx_px", c, CENTRE_PX)),
        cy_px: lens.cy_px.map_or(middle(height_px), |c| number("cy_px", c, CENTRE_PX)),
        width_px,
        height_px,
    };
    let model = lens.model.into();
    for (name, value) in lens.coefficients() {
        number(name, value, allowed(name));
    }
    for (name, value) in lens.coefficients() {
        if value != 0.0 {
            unused(&format!("{at}.lens.{name}"), name, model, check);
        }
    }
    (intrinsics, Lens::of(model, |name| lens.coefficient(name)))
}

/// `[scene.camera.lens]`: the nominal lens with the given values replaced. With another lens model only the given values count.
pub(super) fn true_one(
    lens: &RawTrueLens,
    (i, d): (Intrinsics, Lens),
    check: &mut Validation<'_>,
) -> (Intrinsics, Lens) {
    let model = lens.model.map_or(d.model(), LensModel::from);
    let mut number = |key: &str, given: Option<f64>, believed: f64, allowed| {
        given.map_or(believed, |value| check.range(&format!("scene.camera.lens.{key}"), value, allowed))
    };
    let intrinsics = Intrinsics {
        fx_px: number("fx_px", lens.fx_px, i.fx_px, FOCAL_PX),
        fy_px: number("fy_px", lens.fy_px, i.fy_px, FOCAL_PX),
        cx_px: number("cx_px", lens.cx_px, i.cx_px, CENTRE_PX),
        cy_px: number("cy_px", lens.cy_px, i.cy_px, CENTRE_PX),
        ..i
    };
    let believed = if model == d.model() { d.coefficients() } else { Vec::new() };
    let believed = |name: &str| believed.iter().find(|(n, _)| *n == name).map_or(0.0, |(_, value)| *value);
    for (name, given) in lens.coefficients() {
        number(name, given, 0.0, allowed(name));
    }
    for (name, given) in lens.coefficients() {
        if given.is_some_and(|value| value != 0.0) {
            unused(&format!("scene.camera.lens.{name}"), name, model, check);
        }
    }
    let given = lens.coefficients();
    let made = Lens::of(model, |name| {
        given.iter().find(|(n, _)| *n == name).and_then(|(_, value)| *value).unwrap_or_else(|| believed(name))
    });
    (intrinsics, made)
}

/// A coefficient that is given, and that the model does not have, is hardly meant to be without effect.
fn unused(key: &str, name: &str, model: LensModel, check: &mut Validation<'_>) {
    if model.coefficients().contains(&name) {
        return;
    }
    let has = model.coefficients().join(", ");
    let other = LensModel::ALL.into_iter().find(|other| other.coefficients().contains(&name));
    let instead = other.map_or_else(String::new, |m| format!(", or choose model = \"{}\"", m.name()));
    check.wrong(
        key,
        format!("is no coefficient of a {} lens, which has {has}: leave it out{instead}", model.name()),
    );
}
