//! The numbers of a lens, whoever says them: `[camera.lens]` and, where it is not as believed, `[scene.camera.lens]`.

use crate::camera_model::{Distortion, Intrinsics};
use crate::config::check::Check;
use crate::config::raw::{RawLens, RawTrueLens};
use std::ops::RangeInclusive;

const FOCAL_PX: RangeInclusive<f64> = 1.0..=1e6;
/// The principal point of a cropped picture may lie outside of it.
const CENTRE_PX: RangeInclusive<f64> = -1e5..=1e5;
/// Long lenses see small radii only: their higher factors are large.
const K1: RangeInclusive<f64> = -1e3..=1e3;
const K2: RangeInclusive<f64> = -1e4..=1e4;
const K3: RangeInclusive<f64> = -1e6..=1e6;
const TANGENTIAL: RangeInclusive<f64> = -10.0..=10.0;

/// The lens of the camera at key `at`, before an image of `(width_px, height_px)`.
pub(super) fn believed(
    at: &str,
    lens: &RawLens,
    (width_px, height_px): (u32, u32),
    check: &mut Check<'_>,
) -> (Intrinsics, Distortion) {
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
    let distortion = Distortion {
        k1: number("k1", lens.k1, K1),
        k2: number("k2", lens.k2, K2),
        p1: number("p1", lens.p1, TANGENTIAL),
        p2: number("p2", lens.p2, TANGENTIAL),
        k3: number("k3", lens.k3, K3),
    };
    (intrinsics, distortion)
}

/// `[scene.camera.lens]`: the believed lens but for what is given.
pub(super) fn true_one(
    lens: &RawTrueLens,
    (i, d): (Intrinsics, Distortion),
    check: &mut Check<'_>,
) -> (Intrinsics, Distortion) {
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
    let distortion = Distortion {
        k1: number("k1", lens.k1, d.k1, K1),
        k2: number("k2", lens.k2, d.k2, K2),
        p1: number("p1", lens.p1, d.p1, TANGENTIAL),
        p2: number("p2", lens.p2, d.p2, TANGENTIAL),
        k3: number("k3", lens.k3, d.k3, K3),
    };
    (intrinsics, distortion)
}
