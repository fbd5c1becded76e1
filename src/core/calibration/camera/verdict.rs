//! How good the calibration is, in words.

use super::{BoardBend, CameraCalibration, CrossValidation, ImageCoverage, ProjectionUncertainty};
use std::fmt;

/// The share of the image's width and height that is its middle. Chosen; the verdict tells of what lies outside of it, so that it may be small.
const MIDDLE: f64 = 0.8;
/// Corners of the image that are this many times worse than its centre are reported.
const MUCH_WORSE: f64 = 2.0;
/// Halves that differ by this many times the difference that noise predicts are reported.
const UNEXPLAINED: f64 = 1.5;
/// Fewer images are reported, since halves of them would be three or less (`halves`). Chosen by hand, for a wording.
const FEW_VIEWS: usize = 8;
/// Beyond this a camera is of no use for measuring, px: images or board must be wrong. Chosen by hand: tens of times
/// what a usual calibration reaches.
const USELESS_PX: f64 = 3.0;

/// What the numbers say.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationVerdict {
    /// Depth at which uncertainties are stated, m.
    pub distance_m: f64,
    /// Uncertainty in the middle of the image, px: one standard deviation in the worst direction.
    pub center_px: f64,
    /// Of the worst of the four corners, px.
    pub corner_px: f64,
    /// The worst in the middle 80 % of the image's width and height, px.
    pub middle_px: f64,
    /// The worst where corners of the board were seen, px.
    pub seen_px: f64,
    /// Factor by which halves of the images differ more than the noise explains, where that could be tried.
    pub unexplained: Option<f64>,
    /// Edges and corners of the image that hold no corners of the board.
    pub uncovered: Vec<&'static str>,
    /// The bend of the board that the residuals show, where it was taken to be flat.
    pub bend: Option<BoardBend>,
    /// Images that took part.
    pub views: usize,
}

impl CalibrationVerdict {
    /// From all that is known.
    #[must_use]
    pub fn new(
        calibration: &CameraCalibration,
        uncertainty: &ProjectionUncertainty,
        halves: Option<&CrossValidation>,
        coverage: &ImageCoverage,
    ) -> Self {
        let i = calibration.camera.intrinsics();
        let (right, bottom) = (f64::from(i.width_px) - 1.0, f64::from(i.height_px) - 1.0);
        let at = |x: f64, y: f64| uncertainty.sd_px(&nalgebra::Vector2::new(x, y));
        let corners = [at(0.0, 0.0), at(right, 0.0), at(0.0, bottom), at(right, bottom)];
        Self {
            distance_m: uncertainty.distance_m(),
            center_px: at(0.5 * right, 0.5 * bottom),
            corner_px: corners.into_iter().fold(0.0, f64::max),
            middle_px: uncertainty.worst_px(MIDDLE),
            seen_px: calibration.points_used().map(|p| uncertainty.sd_px(&p.px)).fold(0.0, f64::max),
            unexplained: halves.map(|halves| halves.ratio).filter(|ratio| *ratio > UNEXPLAINED),
            uncovered: coverage.uncovered(),
            bend: None,
            views: calibration.views_used(),
        }
    }

    /// With what the residuals say of the board's shape.
    #[must_use]
    pub fn with_bend(self, bend: Option<BoardBend>) -> Self {
        Self { bend, ..self }
    }

    /// Whether measurements with this camera mean anything where the board was seen. What lies beyond, a board that is shown there tells.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.seen_px * self.unexplained.unwrap_or(1.0) < USELESS_PX
    }
}

/// Two digits that count.
fn px(value: f64) -> String {
    // Two significant digits after rounding: 0.095 becomes 0.10 and 9.5 becomes 10. This needs the bounds below the round numbers.
    let digits = if value < 0.095 {
        3
        // as the first bound, since 9.5 becomes 10
    } else if value < 9.5 {
        2
    } else {
        0
    };
    format!("{value:.digits$} px")
}

impl fmt::Display for CalibrationVerdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let factor = self.unexplained.unwrap_or(1.0);
        let [seen, middle, corner] = [self.seen_px, self.middle_px, self.corner_px].map(|px| px * factor);
        let at = format!("at {} m", significant(self.distance_m));
        let share = MIDDLE * 100.0;
        if self.is_usable() {
            if corner < MUCH_WORSE * middle {
                write!(f, "good to {} in the whole image {at}", px(middle.max(corner)))?;
            } else {
                write!(
                    f,
                    "good to {} where the board was seen, to {} in the middle {share:.0} % of the image, to {} in its corners, {at}",
                    px(seen),
                    px(middle),
                    px(corner)
                )?;
            }
        } else {
            write!(f, "of no use: off by {} even where the board was seen, {at}", px(seen))?;
        }
        match self.uncovered.as_slice() {
            [] => {}
            [_, _, _, _] if self.uncovered.iter().all(|name| name.ends_with("edge")) => {
                write!(f, "; no edge of the image is covered")?;
            }
            [one] => write!(f, "; the {one} is not covered")?,
            [rest @ .., last] => write!(f, "; the {} and the {last} are not covered", rest.join(", the "))?,
        }
        if let Some(ratio) = self.unexplained {
            write!(
                f,
                "; halves of the images differ {ratio:.1} times more than the noise of the corners explains (a board that is not \
                 flat, a lens of another model, motion), which is counted in"
            )?;
        }
        if let Some(BoardBend { bend_m, sd_m }) = &self.bend {
            let (x, y, sd) = (bend_m.x * 1e3, bend_m.y * 1e3, sd_m.max() * 1e3);
            write!(
                f,
                "; the residuals show a board that is bent, by {x:.2} mm along x and {y:.2} mm along y (+- {sd:.2} mm), which is not \
                 counted in: calibrate with --warp, or glue it onto something flat"
            )?;
        }
        if self.views < FEW_VIEWS {
            let are = if self.views == 1 { "image is" } else { "images are" };
            write!(f, "; {} {are} few, take {FEW_VIEWS} and more", self.views)?;
        }
        Ok(())
    }
}

fn significant(value: f64) -> String {
    if value < 1.0 { format!("{value:.2}") } else { format!("{value:.1}") }
}
