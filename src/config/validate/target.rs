//! The target, as believed and as it is.

use crate::config::check::Check;
use crate::config::raw::{RawConfig, RawTarget, TargetKind};
use crate::target::DotTarget;
use std::ops::RangeInclusive;

pub(super) const LENGTH_M: RangeInclusive<f64> = 1e-6..=100.0;

/// `[target]`.
pub(super) fn target(raw: &RawConfig, check: &mut Check<'_>) -> Option<DotTarget> {
    let t = &raw.target;
    let before = check.count_problems();
    for (key, length_m) in [
        ("target.side_m", t.side_m),
        ("target.radius_m", t.radius_m),
        ("target.radius_p1_m", t.radius_p1_m),
        ("target.margin_m", t.margin_m),
    ] {
        check.range(key, length_m, LENGTH_M);
    }
    if check.count_problems() > before {
        return None;
    }
    made("target", t, check)
}

/// The target that lengths within their ranges make; what they do not make is told at `key`.
pub(super) fn made(key: &str, t: &RawTarget, check: &mut Check<'_>) -> Option<DotTarget> {
    let made = match t.kind {
        TargetKind::FourDots => DotTarget::new(t.side_m, t.radius_p1_m, t.radius_m, t.margin_m),
    };
    made.map_err(|e| check.wrong(key, e.to_string())).ok()
}
