//! What the commands read: conjugate points, and the pair of cameras.

use crate::camera_model::CameraModel;
use crate::camera_model::camera_info::PairInfo;
use crate::cli::detect::calibration;
use crate::cli::pose_tool::points::{normalized, within_image};
use crate::geometry::Pose;
use crate::input::file;
use crate::report::csv_table::CsvTable;
use crate::stereo::Conjugates;
use nalgebra::{Matrix2, Matrix3, Vector2};
use std::path::{Path, PathBuf};

/// Longest file of points and of a pair, bytes. Chosen by hand, far more than the points that a solver uses.
const LARGEST: u64 = 16 << 20;

/// Two calibrated cameras and where the second is in the first, m.
pub(super) struct Rig {
    pub(super) camera_1: CameraModel,
    pub(super) camera_2: CameraModel,
    pub(super) X_12: Pose,
}

impl Rig {
    /// From the file of `vservo calibrate stereo`; the calibration files lie beside it.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let named = |e: String| format!("--pair: {}: {e}", path.display());
        let text = file::read(path, LARGEST).map_err(|e| named(e.to_string()))?;
        let info = PairInfo::read(&text).map_err(|e| named(e.to_string()))?;
        let camera = |name: &str| calibration(&path.with_file_name(name)).map_err(|e| format!("--pair: {e}"));
        Ok(Self { camera_1: camera(&info.left)?, camera_2: camera(&info.right)?, X_12: info.X_LR })
    }
}

/// The camera's intrinsic parameters, (5.45).
pub(super) fn intrinsic_matrix(camera: &CameraModel) -> Matrix3<f64> {
    let i = camera.intrinsics();
    Matrix3::new(i.fx_px, 0.0, i.cx_px, 0.0, i.fy_px, i.cy_px, 0.0, 0.0, 1.0)
}

/// Covariance of a normalized point `s` whose pixel has the standard deviation `sd_px`.
pub(super) fn normalized_noise(camera: &CameraModel, s: &Vector2<f64>, sd_px: f64) -> Option<Matrix2<f64>> {
    let back = camera.pixel_jacobian(s).try_inverse()?;
    Some(back * back.transpose() * (sd_px * sd_px))
}

/// The files of conjugate points: `u1_px,v1_px,u2_px,v2_px` in pixels, or `X1,Y1,X2,Y2` normalized.
pub(super) struct PairFile {
    path: PathBuf,
    /// Numbers of the points: column `id`, or the rows' own.
    pub(super) ids: Vec<u64>,
    /// As in the file.
    pub(super) pairs: Vec<Conjugates>,
    /// Whether in pixels.
    pub(super) in_px: bool,
}

impl PairFile {
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let named = |e: String| format!("{}: {e}", path.display());
        let text = file::read(path, LARGEST).map_err(|e| named(e.to_string()))?;
        Self::parse(&text, path).map_err(named)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, String> {
        const PX: [&str; 4] = ["u1_px", "v1_px", "u2_px", "v2_px"];
        const NORMALIZED: [&str; 4] = ["X1", "Y1", "X2", "Y2"];
        let table = CsvTable::parse(text);
        let has = |name: &&str| table.names().iter().any(|n| n == name);
        let (columns, in_px) = match (PX.iter().all(has), NORMALIZED.iter().all(has)) {
            (true, false) => (PX, true),
            (false, true) => (NORMALIZED, false),
            _ => {
                return Err(format!(
                    "the first line names the columns: either {} or {}, with id if wanted",
                    PX.join(","),
                    NORMALIZED.join(",")
                ));
            }
        };
        let (mut ids, mut pairs) = (Vec::new(), Vec::new());
        for row in 0..table.rows() {
            let [a, b, c, d] = columns.map(|name| table.number(name, row));
            if ![a, b, c, d].iter().all(|v| v.is_finite()) {
                return Err(format!("line {}: four numbers are expected", row + 2));
            }
            let id = table.number("id", row);
            ids.push(if id >= 0.0 { id as u64 } else { row as u64 });
            let (s_1, s_2) = (Vector2::new(a, b), Vector2::new(c, d));
            if !in_px {
                let [x_1, y_1, x_2, y_2] = columns;
                normalized(s_1, [x_1, y_1], row + 2)?;
                normalized(s_2, [x_2, y_2], row + 2)?;
            }
            pairs.push(Conjugates { s_1, s_2 });
        }
        Ok(Self { path: path.to_owned(), ids, pairs, in_px })
    }

    /// Normalized, without the lenses.
    ///
    /// # Errors
    /// Where points in pixels have no cameras, or lie outside of their images.
    pub(super) fn normalized(
        &self,
        cameras: Option<(&CameraModel, &CameraModel)>,
    ) -> Result<Vec<Conjugates>, String> {
        match (self.in_px, cameras) {
            (false, _) => Ok(self.pairs.clone()),
            (true, None) => Err("points in px need the cameras".into()),
            (true, Some((a, b))) => {
                let one = |(row, p): (usize, &Conjugates)| {
                    let s_1 = a.normalized_of(&within_image(p.s_1, a, "the first camera", row + 2)?);
                    let s_2 = b.normalized_of(&within_image(p.s_2, b, "the second camera", row + 2)?);
                    Ok(Conjugates { s_1, s_2 })
                };
                let pairs: Result<_, String> = self.pairs.iter().enumerate().map(one).collect();
                pairs.map_err(|e| format!("{}: {e}", self.path.display()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};

    fn parse(text: &str) -> Result<PairFile, String> {
        PairFile::parse(text, Path::new("pairs.csv"))
    }

    #[test]
    fn pairs_are_named_by_their_columns() {
        let file = parse("id,u1_px,v1_px,u2_px,v2_px\n7,1,2,3,4\n").unwrap();
        assert!(file.in_px && file.ids == [7] && file.normalized(None).is_err());
        assert_eq!(file.pairs[0].s_2, Vector2::new(3.0, 4.0));
        let file = parse("X1,Y1,X2,Y2\n0,0.5,0.25,1\n1,1,1,1\n").unwrap();
        assert!(!file.in_px && file.ids == [0, 1] && file.normalized(None).unwrap() == file.pairs);
        assert!(parse("X1,Y1,X2\n").is_err());
        let pixels = parse("X1,Y1,X2,Y2\n0,0.5,0.25,1\n1,1,310,240\n").err().unwrap();
        assert!(pixels.contains("line 3: `X2` is 310") && pixels.contains("_px"), "{pixels}");
        assert!(parse("X1,Y1,X2,Y2\n0,0,x,0\n").err().unwrap().contains("line 2"));
    }
    #[test]
    fn a_point_outside_of_one_of_the_images_is_refused() {
        let camera = |width_px| {
            let i = Intrinsics {
                fx_px: 500.0,
                fy_px: 500.0,
                cx_px: 320.0,
                cy_px: 240.0,
                width_px,
                height_px: 480,
            };
            CameraModel::new(i, Distortion::default()).unwrap()
        };
        let file = parse("u1_px,v1_px,u2_px,v2_px\n639,0,639,479\n639,1,700,2\n").unwrap();
        assert_eq!(file.normalized(Some((&camera(640), &camera(800)))).unwrap().len(), 2);
        let told = file.normalized(Some((&camera(640), &camera(640)))).unwrap_err();
        assert!(
            told.contains("pairs.csv: line 3: (700, 2) px lies outside") && told.contains("second"),
            "{told}"
        );
    }
}
