//! What lies between camera and target from the first tick to the last: an arm that waits for its target there waits in vain.

use super::Viewpoint;
use crate::config::{Config, Scene};
use crate::time::SpanNs;
use nalgebra::Point3;

/// The message of a target that its occluders hide at `start` for as long as the run lasts; `None` where enough of it is seen, or will be.
pub(super) fn covered(config: &Config, scene: &Scene, start: &Viewpoint) -> Option<String> {
    let lasts = |until: SpanNs| !config.serve && until >= config.duration;
    let mut lasting =
        scene.occluders.iter().filter(|one| one.from <= SpanNs(0) && lasts(one.until)).peekable();
    lasting.peek()?;
    let lasting: Vec<_> = lasting.collect();
    let camera_O = Point3::from(start.X_CO.inverse().translation.vector);
    let seen = &start.visibility;
    let points = scene.target.points().iter().zip(&seen.points).filter(|(_, seen)| seen.whole);
    let open =
        points.filter(|(point, _)| !lasting.iter().any(|one| one.hides(&camera_O, &point.p_O))).count();
    (seen.whole >= seen.needed && open < seen.needed).then(|| {
        format!(
            "its occluders leave {open} of the target's {} points to the camera through the whole run, as long as that is at the start, and {} are needed to find it: \
             let them come later (from_s), go earlier (until_s) or lie elsewhere (center_m)",
            seen.points.len(),
            seen.needed
        )
    })
}
