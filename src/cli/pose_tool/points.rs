//! The file of points: where they are on the object, and where they are seen.

use crate::camera_model::{CameraModel, Distortion, Intrinsics};
use crate::input::file;
use crate::pose::{Correspondence, Correspondence3, PixelCorrespondence};
use crate::report::csv_table::CsvTable;
use nalgebra::{Matrix2, Point3, Vector2};
use std::path::Path;

/// Longest file of points, bytes. Chosen by hand, far more than the points that a solver uses.
const LARGEST: u64 = 16 << 20;
/// Focal length of the camera that replaces a missing one where points are normalized, px. Chosen by hand: any would do, because an ideal camera
/// only scales them.
const STAND_IN_F_PX: f64 = 1000.0;

/// Bound of normalized coordinates. Derived: they are tangents, and those of a camera that sees farther to the side than 89 degrees are beyond 57.
const MAX_NORMALIZED: f64 = 57.0;

/// Normalized coordinates, in columns of the names `columns`.
///
/// # Errors
/// Where one of them is none.
pub(in crate::cli) fn normalized(
    seen: Vector2<f64>,
    columns: [&str; 2],
    line: usize,
) -> Result<Vector2<f64>, String> {
    match columns.iter().zip(seen.iter()).find(|(_, value)| value.abs() > MAX_NORMALIZED) {
        None => Ok(seen),
        Some((column, value)) => Err(format!(
            "line {line}: `{column}` is {value}: normalized coordinates are x / z and y / z, within {MAX_NORMALIZED}; pixels stand in columns whose names end in _px"
        )),
    }
}

/// A pixel of `camera`, which the user calls `name`.
///
/// # Errors
/// Where it lies outside of the image.
pub(in crate::cli) fn within_image(
    px: Vector2<f64>,
    camera: &CameraModel,
    name: &str,
    line: usize,
) -> Result<Vector2<f64>, String> {
    let i = camera.intrinsics();
    camera.contains(&px, 0.0).then_some(px).ok_or_else(|| {
        format!(
            "line {line}: ({}, {}) px lies outside of the image of {} x {} px that {name} has: are they of the same camera, in the same resolution?",
            px.x, px.y, i.width_px, i.height_px
        )
    })
}

/// Points of an object and where they are seen.
pub(super) struct Points {
    pub(super) camera: CameraModel,
    /// In pixels of [`Self::camera`]; the unit matrix as covariance where no deviation is stated.
    pub(super) pixels: Vec<PixelCorrespondence>,
    /// Whether each point has a stated deviation.
    pub(super) stated: bool,
    /// What one pixel of [`Self::camera`] is in the unit of the file: 1, or 1/f where its points are normalized.
    pub(super) unit: f64,
}

impl Points {
    /// Reads a CSV file; `sd` is one standard deviation of each coordinate where the file has none, in the file's unit.
    pub(super) fn read(path: &Path, camera: Option<CameraModel>, sd: Option<f64>) -> Result<Self, String> {
        let named = |e: String| format!("{}: {e}", path.display());
        let text = file::read(path, LARGEST).map_err(|e| named(e.to_string()))?;
        Self::parse(&text, camera, sd).map_err(named)
    }

    fn parse(text: &str, camera: Option<CameraModel>, sd: Option<f64>) -> Result<Self, String> {
        let table = CsvTable::parse(text);
        let has = |name: &str| table.names().iter().any(|n| n == name);
        for name in ["x_m", "y_m"] {
            if !has(name) {
                return Err(format!(
                    "there is no column `{name}`; the first line names the columns, as {COLUMNS}"
                ));
            }
        }
        let (u, v, sd_column, camera, unit) = match (has("u_px") && has("v_px"), has("X") && has("Y")) {
            (true, false) => {
                let camera = camera.ok_or("points in px need the camera: --camera FILE, as ROS has it")?;
                ("u_px", "v_px", "sd_px", camera, 1.0)
            }
            (false, true) => ("X", "Y", "sd", stand_in()?, 1.0 / STAND_IN_F_PX),
            (true, true) => return Err("columns u_px,v_px and X,Y exclude each other".into()),
            (false, false) => {
                return Err(format!("there are neither columns u_px,v_px nor X,Y; columns are {COLUMNS}"));
            }
        };
        let mut points = Self { camera, pixels: Vec::new(), stated: true, unit };
        for row in 0..table.rows() {
            let number = |name: &str| {
                let value = table.number(name, row);
                let problem = || format!("line {}: `{name}` is no number", row + 2);
                value.is_finite().then_some(value).ok_or_else(problem)
            };
            let z = if has("z_m") { number("z_m")? } else { 0.0 };
            let seen = Vector2::new(number(u)?, number(v)?);
            let deviation = if has(sd_column) { Some(number(sd_column)?) } else { sd };
            if deviation.is_some_and(|sd| !(sd > 0.0)) {
                return Err(format!("line {}: a standard deviation is greater than 0", row + 2));
            }
            points.stated &= deviation.is_some();
            let px = if unit == 1.0 {
                within_image(seen, &points.camera, "--camera", row + 2)?
            } else {
                points.camera.pixel_of(&normalized(seen, [u, v], row + 2)?)
            };
            let sd_px = deviation.map_or(1.0, |sd| sd / unit);
            points.pixels.push(PixelCorrespondence {
                r: Point3::new(number("x_m")?, number("y_m")?, z),
                px,
                covariance_px2: Matrix2::identity() * (sd_px * sd_px),
            });
        }
        Ok(points)
    }

    /// How many there are on the object: one that stands in several lines counts once.
    pub(super) fn distinct(&self) -> usize {
        let mut places: Vec<[u64; 3]> =
            self.pixels.iter().map(|p| [p.r.x, p.r.y, p.r.z].map(f64::to_bits)).collect();
        places.sort_unstable();
        places.dedup();
        places.len()
    }

    /// Normalized, without the lens.
    pub(super) fn spatial(&self) -> Vec<Correspondence3> {
        let one = |p: &PixelCorrespondence| Correspondence3 { r: p.r, s: self.camera.normalized_of(&p.px) };
        self.pixels.iter().map(one).collect()
    }

    /// The same in the plane z = 0.
    pub(super) fn planar(&self) -> Result<Vec<Correspondence>, String> {
        if self.pixels.iter().any(|p| p.r.z != 0.0) {
            return Err("`planar` takes points of the plane z_m = 0; `pnp` takes points of any plane".into());
        }
        Ok(self.spatial().iter().map(|p| Correspondence { r: p.r.coords.xy(), s: p.s }).collect())
    }
}

const COLUMNS: &str = "id,x_m,y_m,z_m,u_px,v_px,sd_px or id,x_m,y_m,z_m,X,Y,sd";

fn stand_in() -> Result<CameraModel, String> {
    let (f, size, centre) = (STAND_IN_F_PX, 1001, 500.0);
    let intrinsics =
        Intrinsics { fx_px: f, fy_px: f, cx_px: centre, cy_px: centre, width_px: size, height_px: size };
    CameraModel::new(intrinsics, Distortion::default()).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        Points::parse(text, None, None).err().unwrap_or_default()
    }

    #[test]
    fn columns_are_named_and_numbers_are_numbers() {
        assert!(refusal("id,u_px,v_px\n").contains("no column `x_m`"));
        assert!(refusal("x_m,y_m\n").contains("neither columns u_px,v_px nor X,Y"));
        assert!(refusal("x_m,y_m,u_px,v_px\n0,0,1,1\n").contains("--camera"));
        assert!(refusal("x_m,y_m,u_px,v_px,X,Y\n").contains("exclude"));
        assert!(refusal("x_m,y_m,X,Y\n0,0,1,1\n0,zero,1,1\n").contains("line 3: `y_m`"));
        assert!(refusal("x_m,y_m,X,Y,sd\n0,0,1,1,0\n").contains("greater than 0"));
        let pixels = refusal("x_m,y_m,X,Y\n0,0,1,1\n0,0,0.5,312.5\n");
        assert!(pixels.contains("line 3: `Y` is 312.5") && pixels.contains("_px"), "{pixels}");
    }

    #[test]
    fn a_point_outside_of_the_cameras_image_is_refused() {
        let told =
            |u: f64| Points::parse(&format!("x_m,y_m,u_px,v_px\n0,0,{u},9\n"), stand_in().ok(), None).err();
        assert_eq!((told(1000.4), told(-0.4)), (None, None));
        let outside = told(1280.0).unwrap();
        assert!(
            outside.contains("line 2: (1280, 9) px lies outside") && outside.contains("1001 x 1001"),
            "{outside}"
        );
    }

    #[test]
    fn normalized_points_keep_their_places_and_deviations() {
        let points =
            Points::parse("id,x_m,y_m,z_m,X,Y,sd\n7,0.1,0.2,0.3,0.25,-0.5,0.002\n", None, None).unwrap();
        let one = points.spatial()[0];
        assert!((one.s - Vector2::new(0.25, -0.5)).norm() < 1e-12 && one.r == Point3::new(0.1, 0.2, 0.3));
        assert!((points.pixels[0].covariance_px2[(0, 0)] - 4.0).abs() < 1e-9 && points.stated);
        assert!(points.planar().is_err());
        assert!(!Points::parse("x_m,y_m,X,Y\n0,0,0,0\n", None, None).unwrap().stated);
    }
}
