//! Centres of dots by their rims, for dots that are partly occluded or unevenly lit.
//!
//! An occluder or a spot of light on a dot shifts its centroid, but it changes only a part of its rim, which a robust fit of an ellipse leaves
//! out. Where centroid and rim contradict each other, the rim is used.

use crate::detect::Detection;
use crate::detect::ellipse::{EllipseSettings, RimMeter};
use crate::imaging::{Ellipse, ImageView};

/// Shortest half axis of a dot whose rim is scanned, px. Chosen by hand: a rim of 31 px; a shorter one has too few scans to leave some out, and
/// its edge bends within the blur.
const MIN_AXIS_PX: f64 = 5.0;
/// A step of the rim is at least this share of the dot's contrast. Chosen by hand: the rim is still one in a shadow that leaves a
/// quarter of the light; half of it takes the shadow's own edges, twice of it loses the rim within the shadow.
const MIN_STEP: f32 = 0.25;
/// The least share of a rim that determines its ellipse. Chosen by hand: less than the half beyond a straight cover through the centre, for scans fail.
const MIN_SHARE: f64 = 0.35;
/// How far beyond the centroid's ellipse the rim is searched first, px. Chosen by hand: an occluder that hides a part of a small dot shifts its ellipse
/// by a pixel or two; half fails more often, after which [`FAR`] is used, the double meets more edges of other things.
const SLACK_PX: f64 = 2.0;
/// How far it is searched then, as a share of the half axis. Chosen by hand: the centroid of a dot of which half is hidden is 0.42 of its radius off;
/// half loses such dots, the double reaches to the neighbouring dots of a grid.
const FAR: f64 = 0.5;
/// Centroid and rim contradict each other from so many standard deviations on. Derived: of two normal coordinates chance makes it once in 25 000.
const MAX_SDS: f64 = 4.5;
/// Both are this good at the most where light and lens are not as simple as both take them to be, px. Chosen by hand: without it rims of large
/// dots, known to thousandths, contradict every centroid under uneven light; twice of it hides covers that move a centroid by 0.18 px.
const MODEL_PX: f64 = 0.02;
/// Of what moved a centroid a part moves the rim's scans too: those over a shadow's slope, and those beside the corner that a cover makes, as far as a
/// corner is seen as one. By a share of it, and by another one that falls with the cube of the half axis. Measured over 950 rims of dots under
/// shadows, covers and glare: per coordinate 0.07 of what moved centroids (root mean square), 0.25 at a half axis of 6 px under covers, a twentieth at 13 px.
const MOVED_SHARE: f64 = 0.07;
const SHORT_SHARE: f64 = 0.25; // measured with the one above, at a half axis of
const SHORT_PX: f64 = 6.0; // this, of the same measurement
/// From so many standard deviations on what centroid and rim differ by is no chance, and the one that is told is not told more exactly. Derived: of
/// two normal coordinates chance makes it once in 90.
const CHANCE_SDS: f64 = 3.0;

/// Below this half axis, px, the fit of a rim whose part is hidden may take the cover's edge for rim, and the centroid follows it. Measured: 4 of 317 covers of
/// dots with half axes of 5.9 to 7.9 px, none above.
const SHORT_RIM_PX: f64 = 10.0;
/// Squared residuals per degree of freedom of a short rim that is none of a whole dot. Measured: those of 3 000 whole dots were 3.9 at most, those of the four 13 to 81.
const MISSHAPEN: f64 = 6.0;
/// Measured: their centroids were 3 to 4 times as far off as the rim's points lie from its ellipse (root mean square).
const MISSHAPEN_SDS: f64 = 3.0;

/// Replaces the centres of dots that are partly occluded or unevenly lit by those of the rest of their rims; adds their ids to `harmed`.
pub(super) fn examine_occlusion(
    image: &ImageView<'_>,
    found: &mut [Detection],
    light_on_dark: bool,
    harmed: &mut Vec<u32>,
) {
    for dot in found {
        let start = Ellipse { centre_px: dot.px, shape_px2: dot.covariance_px2.map(|c| 4.0 * c) };
        if !start.is_real() || start.axes_px().1 < MIN_AXIS_PX {
            without_rim(dot);
            continue;
        }
        let contrast = (dot.plate_level - dot.dark_level).abs() as f32;
        let settings = EllipseSettings {
            min_axis_px: 0.8 * MIN_AXIS_PX,
            min_share: MIN_SHARE,
            min_step: MIN_STEP * contrast,
            ..EllipseSettings::default()
        };
        // a centroid that was drawn far off leaves the rim further away
        let far = FAR * start.axes_px().0;
        let mut meter = RimMeter::new(&settings);
        let mut measure = |slack_px| meter.measure(image, &start, light_on_dark, slack_px);
        let Ok(rim) = measure(SLACK_PX).or_else(|_| measure(far)) else {
            without_rim(dot);
            continue;
        };
        // an object beside a dot is measured better at its rim than on its ring
        dot.disturbance_px = 0.0;
        let covariance = rim.fit.centre_covariance_px2();
        let noise = 0.5 * covariance.trace();
        let off = rim.fit.ellipse.centre_px - dot.px;
        let off2 = off.norm_squared();
        let axis_px = rim.fit.ellipse.axes_px().1;
        let is_short = axis_px < SHORT_RIM_PX;
        let variance = noise + MODEL_PX * MODEL_PX;
        if off2 > MAX_SDS * MAX_SDS * (variance + dot.sd_px * dot.sd_px) {
            harmed.push(dot.id);
            dot.px = rim.fit.ellipse.centre_px;
            let share = MOVED_SHARE.hypot(SHORT_SHARE * (SHORT_PX / axis_px).powi(3));
            dot.sd_px = (variance + share * share * off2).sqrt();
            dot.covariance_px2 = rim.fit.ellipse.shape_px2.map(|c| 0.25 * c);
        } else if is_short && rim.fit.chi2 > MISSHAPEN {
            // the mean square distance of the rim's points from its ellipse, from the variance of a centre by so many points
            let misfit2 = 0.5 * noise * rim.fit.used as f64;
            dot.sd_px = (dot.sd_px * dot.sd_px + MISSHAPEN_SDS * MISSHAPEN_SDS * misfit2).sqrt();
        } else if off2 > CHANCE_SDS * CHANCE_SDS * (noise / rim.fit.chi2.max(1.0) + dot.sd_px * dot.sd_px) {
            // either may be what is wrong
            dot.sd_px = (dot.sd_px * dot.sd_px + off2).sqrt();
        }
    }
}

/// Where no rim says whether what is dark beside a dot moved its centroid, it may have.
fn without_rim(dot: &mut Detection) {
    dot.sd_px = dot.sd_px.hypot(dot.disturbance_px);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    const CENTRE: Vector2<f64> = Vector2::new(40.3, 31.6);

    /// A dark disc with noise; of another `power` than 2 it has flat sides (Lame's curve).
    fn disc(radius: f64, power: f64) -> Vec<u8> {
        let mut random = Random::new(8);
        let share = |i: usize| {
            let inside = (0..64).filter(|k| {
                // blurred over a square of 2.4 px: a standard deviation of 0.7 px
                let within = Vector2::new((k % 8) as f64 - 3.5, (k / 8) as f64 - 3.5) * 0.3;
                let d = Vector2::new((i % 80) as f64, (i / 80) as f64) + within - CENTRE;
                d.x.abs().powf(power) + d.y.abs().powf(power) < radius.powf(power)
            });
            inside.count() as f64 / 64.0
        };
        (0..80 * 64).map(|i| (200.0 - 150.0 * share(i) + random.gaussian()).round() as u8).collect()
    }

    fn told(radius: f64, px: Vector2<f64>, disturbance_px: f64) -> (Detection, bool) {
        told_of(&disc(radius, 2.0), radius, px, disturbance_px)
    }

    fn told_of(pixels: &[u8], radius: f64, px: Vector2<f64>, disturbance_px: f64) -> (Detection, bool) {
        let image = ImageView::new(pixels, 80, 64).unwrap();
        let moment = 0.25 * radius * radius;
        let mut dots = [Detection {
            id: 2,
            px,
            sd_px: 0.005,
            area_px2: std::f64::consts::PI * radius * radius,
            covariance_px2: [moment, 0.0, moment],
            dark_level: 50.0,
            plate_level: 200.0,
            disturbance_px,
        }];
        let mut harmed = Vec::new();
        examine_occlusion(&image, &mut dots, false, &mut harmed);
        (dots[0], !harmed.is_empty())
    }

    #[test]
    fn a_centroid_that_its_rim_bears_out_stays() {
        for radius in [4.0, 7.0, 20.0] {
            let (dot, by_rim) = told(radius, CENTRE, 0.0);
            assert!(dot.px == CENTRE && dot.sd_px == 0.005 && !by_rim, "{radius}: {dot:?}");
        }
    }

    #[test]
    fn what_differs_beyond_chance_is_told_as_uncertain() {
        // less than what makes the rim the better of both
        for radius in [7.0, 20.0] {
            let (dot, by_rim) = told(radius, CENTRE + Vector2::new(0.06, 0.04), 0.0);
            assert!(!by_rim && dot.sd_px > 0.04 && dot.sd_px < 0.12, "{radius}: {dot:?}");
        }
    }

    #[test]
    fn a_shadow_beside_a_dot_without_rim_is_in_its_deviation() {
        let (dot, by_rim) = told(4.0, CENTRE, 0.3);
        assert!(!by_rim && dot.sd_px > 0.3 && dot.sd_px < 0.31, "{dot:?}");
    }

    /// Nothing but the misfit of the rim says that something is wrong: its centre is that of the dot.
    #[test]
    fn a_short_rim_that_is_no_ellipse_is_in_the_deviation() {
        let (dot, by_rim) = told_of(&disc(8.0, 2.4), 8.0, CENTRE, 0.0);
        assert!(dot.px == CENTRE && !by_rim && dot.sd_px > 0.02, "{dot:?}");
    }
}
