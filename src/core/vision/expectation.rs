//! Prediction of the target's points in the next frame, which gives the tracking windows.
//!
//! Data flow: with a predicted pose each point is projected from it, and the part of the last image motion that this pose does not explain is
//! added. Without one, visible points are extrapolated with their velocity in the image, and hidden ones with the velocity of the visible ones
//! from their projection by the last pose. Positions are pixels of the distorted image.

use super::{Prior, Vision};
use crate::detect::{Detection, PredictedPoint, dot_covariance_px2};
use crate::geometry::Pose;
use crate::time::MonoNs;
use nalgebra::Vector2;

/// Share by which the extrapolated motion may be wrong, which widens the search windows. Chosen by hand: the window has to cover a change of
/// speed by 30 % from frame to frame; a wider one costs time and contains more clutter.
const SHARE_OF_MOTION: f64 = 0.3;

impl Vision {
    /// Fills `expected` with predictions for the frame of time `exposure`, ids rising. Returns whether there are any: without a last estimate, from
    /// which the threshold is taken too, there are none.
    pub(super) fn expect(&mut self, exposure: MonoNs, prior: &Prior) -> bool {
        self.expected.clear();
        let Some(last) = &self.last else { return false };
        let (dots, estimator) = (&last.estimate.dots, &self.estimator);
        // where the target is partly hidden the arm may slow down, which the velocity of the last frames does not contain
        let whole = dots.len() == estimator.target.points().len();
        let slack_px = estimator.settings.slack_px * if whole { 1.0 } else { 2.0 };
        let mean = dots.iter().map(|d| d.dark_level + d.plate_level).sum::<f64>() / dots.len().max(1) as f64;
        let level = |sum: f64| (0.5 * sum).clamp(0.0, 255.0) as u8;
        // one step ahead at the last velocity; over a gap at most three steps
        let before = self.before.as_ref();
        let ratio = before.map_or(0.0, |before| {
            let step = (last.exposure - before.exposure).as_s();
            let ahead = (exposure - last.exposure).as_s();
            // Chosen by hand: three steps bridge two lost frames. Half would leave the window behind after one, the double sends it
            // further astray where the velocity has changed meanwhile.
            if step > 0.0 && ahead > 0.0 { (ahead / step).min(3.0) } else { 0.0 }
        });
        let motion = |dot: &Detection| {
            let old = before.and_then(|before| find(&before.estimate.dots, dot.id));
            old.map_or(Vector2::zeros(), |old| (dot.px - old.px) * ratio)
        };
        let common = dots.iter().map(motion).sum::<Vector2<f64>>() / dots.len().max(1) as f64;
        // three dots determine the affine motion of the plane
        let plane = |id: u32| estimator.target.points().get(id as usize).map(|point| point.p_O.coords.xy());
        let hidden_motion = |id: u32| match dots.as_slice() {
            [a, b, c] => {
                let weights = barycentric(&plane(id)?, &plane(a.id)?, &plane(b.id)?, &plane(c.id)?)?;
                Some(motion(a) * weights[0] + motion(b) * weights[1] + motion(c) * weights[2])
            }
            _ => Some(common),
        };
        let placed = |i: usize, X_CO: &Pose| {
            let px = estimator.camera.project(&(X_CO * estimator.target.points().get(i)?.p_O))?;
            let Some((X_OF, disc)) = estimator.target.dot(i) else { return Some((px, [0.0; 3], 0.0)) };
            let (covariance, area_px2) =
                dot_covariance_px2(&(X_CO * X_OF), &estimator.camera, &disc.centre_m, disc.radius_m)?;
            Some((px, covariance.map(|c| c + 1.0 / 12.0), area_px2))
        };
        // The motion of the object itself, which the camera's motion did not explain in the last frame, continues.
        let surprise = || {
            let X_CO = before?.carried(last.X_WC.as_ref())?;
            let off = |dot: &Detection| Some(dot.px - placed(dot.id as usize, &X_CO)?.0);
            let sum = dots.iter().map(off).sum::<Option<Vector2<f64>>>()?;
            Some(sum * (ratio / dots.len().max(1) as f64))
        };
        let surprise = surprise().unwrap_or_default();
        for (i, point) in estimator.target.points().iter().enumerate() {
            let seen = find(dots, point.id);
            let threshold = level(seen.map_or(mean, |dot| dot.dark_level + dot.plate_level));
            let expected = if let Some(X_CO) = &prior.predicted_X_CO {
                if !estimator.target.is_turned_to_camera(i, X_CO) {
                    continue;
                }
                placed(i, X_CO).map(|(px, covariance_px2, area_px2)| PredictedPoint {
                    id: point.id,
                    px: px + surprise,
                    covariance_px2,
                    area_px2,
                    slack_px: slack_px + SHARE_OF_MOTION * surprise.norm(),
                    threshold,
                })
            } else if let Some(dot) = seen {
                let motion = motion(dot);
                Some(PredictedPoint {
                    id: point.id,
                    px: dot.px + motion,
                    covariance_px2: dot.covariance_px2,
                    area_px2: dot.area_px2,
                    slack_px: slack_px + SHARE_OF_MOTION * motion.norm(),
                    threshold,
                })
            } else {
                let motion = hidden_motion(point.id).unwrap_or(common);
                last.estimate.pose.and_then(|pose| placed(i, &pose.X_CO)).map(
                    |(px, covariance_px2, area_px2)| PredictedPoint {
                        id: point.id,
                        px: px + motion,
                        covariance_px2,
                        area_px2,
                        slack_px: slack_px + SHARE_OF_MOTION * motion.norm(),
                        threshold,
                    },
                )
            };
            self.expected.extend(expected);
        }
        true
    }
}

/// Barycentric coordinates of `p`: weights of sum 1 of three points; `None` when these are collinear.
fn barycentric(p: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>) -> Option<[f64; 3]> {
    let (u, v, w) = (b - a, c - a, p - a);
    let area = u.perp(&v);
    let (second, third) = (w.perp(&v) / area, u.perp(&w) / area);
    (area != 0.0).then_some([1.0 - second - third, second, third])
}

/// The dot of point `id`, among dots whose ids rise.
pub(super) fn find(dots: &[Detection], id: u32) -> Option<&Detection> {
    dots.binary_search_by_key(&id, |dot| dot.id).ok().and_then(|i| dots.get(i))
}
