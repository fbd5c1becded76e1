//! `vservo stereo match`: conjugate points, searched along epipolar lines, Sect. 10.4.1.

use super::look::SideBySide;
use super::pairs::{Rig, intrinsic_matrix};
use crate::cli::detect::{image_file, refused};
use crate::cli::{StereoMatchArguments, json, shown, write_result};
use crate::imaging::ImageView;
use crate::imaging::corners::StructureDetector;
use crate::process::ProcessError;
use crate::rt::tell as say;
use crate::stereo::{
    ConjugateSearch, ConjugateSettings, epipolar_line_1, epipolar_line_2, essential_matrix,
    fundamental_matrix, line_distance,
};
use image::GrayImage;
use nalgebra::Vector2;
use serde::Serialize;

/// Colours, chosen by eye.
const FOUND: [u8; 3] = [0, 224, 74];
const LINE: [u8; 3] = [86, 180, 233];
const MISSED: [u8; 3] = [213, 94, 0];
/// Smallest strength of a corner, squared grey levels per px^2: the same number must stand as the default of `vservo process --steps corners`.
const CORNER_STRENGTH: f32 = 400.0;

#[derive(Serialize)]
struct Matched {
    id: usize,
    left_px: [f64; 2],
    /// `l . (u, v, 1) = 0` in the right image, its first two numbers a unit vector; of the lenses without distortion.
    epipolar_line: [f64; 3],
    /// The same of the match, in the left image.
    left_epipolar_line: Option<[f64; 3]>,
    right_px: Option<[f64; 2]>,
    correlation: Option<f64>,
    depth_m: Option<f64>,
    /// Of the match from its epipolar line, px; where a lens bends it, as far as it does.
    line_distance_px: Option<f64>,
    reason: Option<String>,
}

pub(super) fn find(arguments: &StereoMatchArguments) -> Result<u8, ProcessError> {
    match run(arguments) {
        Ok((matched, images)) => Ok(tell(arguments, &matched, &images)),
        Err((message, code)) => Ok(refused(&message, code)),
    }
}

type Images = (GrayImage, GrayImage);

fn run(arguments: &StereoMatchArguments) -> Result<(Vec<Matched>, Images), (String, u8)> {
    let rig = Rig::read(&arguments.pair).map_err(|e| (e, 3))?;
    let load = |path: &std::path::Path| {
        image_file::load(path).map_err(|reason| (format!("{}: {reason}", path.display()), 3))
    };
    let images = (load(&arguments.left)?, load(&arguments.right)?);
    let (left, right) = (view(&images.0)?, view(&images.1)?);
    for (view, camera, name) in [(&left, &rig.camera_1, "left"), (&right, &rig.camera_2, "right")] {
        let i = camera.intrinsics();
        let (found, wanted) = ((view.width(), view.height()), (i.width_px as usize, i.height_px as usize));
        if found != wanted {
            let (w, h) = wanted;
            return Err((format!("the {name} image is {}x{} px, its camera {w}x{h}", found.0, found.1), 3));
        }
    }
    let (near, far) = (arguments.nearest_m, arguments.farthest_m);
    if !(near > 0.0 && near < far) {
        let message = format!("--nearest-m is {near}, --farthest-m {far}: 0 < nearest < farthest is needed");
        return Err((message, 2));
    }
    let points = match &arguments.points {
        Some(text) => {
            let points = given(text).map_err(|e| (e, 2))?;
            if let Some(p) = points.iter().find(|p| !rig.camera_1.contains(p, 0.0)) {
                return Err((format!("--points: ({}, {}) is not in the left image", p.x, p.y), 2));
            }
            points
        }
        None => {
            let mut detector = StructureDetector::new(left.width(), left.height(), arguments.corners);
            let found = detector.find(&left, CORNER_STRENGTH);
            if found.is_empty() {
                let message = format!(
                    "no corners of strength {CORNER_STRENGTH} and more in the left image: name points by --points"
                );
                return Err((message, 5));
            }
            found.iter().map(|c| Vector2::new(c.x, c.y)).collect()
        }
    };
    let settings = ConjugateSettings {
        nearest_m: arguments.nearest_m,
        farthest_m: arguments.farthest_m,
        ..ConjugateSettings::default()
    };
    let F = fundamental_matrix(
        &essential_matrix(&rig.X_12),
        &intrinsic_matrix(&rig.camera_1),
        &intrinsic_matrix(&rig.camera_2),
    );
    let F = F.ok_or(("the cameras have no fundamental matrix".to_owned(), 3))?;
    let mut search = ConjugateSearch::default();
    let one = |(id, px): (usize, &Vector2<f64>)| {
        // the line of where the point would be seen without distortion
        let ideal = |camera: &crate::camera_model::CameraModel, px: &Vector2<f64>| {
            (intrinsic_matrix(camera) * camera.normalized_of(px).push(1.0)).xy()
        };
        let line = epipolar_line_2(&F, &ideal(&rig.camera_1, px));
        let line = line / line.xy().norm();
        let found = search.search((&rig.camera_1, &left), (&rig.camera_2, &right), &rig.X_12, px, &settings);
        let (found, reason) = match found {
            Ok(found) => (Some(found), None),
            Err(why) => (None, Some(why.to_string())),
        };
        Matched {
            id,
            left_px: (*px).into(),
            epipolar_line: line.into(),
            left_epipolar_line: found.map(|c| {
                let line = epipolar_line_1(&F, &ideal(&rig.camera_2, &c.px));
                (line / line.xy().norm()).into()
            }),
            right_px: found.map(|c| c.px.into()),
            correlation: found.map(|c| c.correlation),
            depth_m: found.map(|c| c.depth_m),
            line_distance_px: found.map(|c| line_distance(&line, &ideal(&rig.camera_2, &c.px))),
            reason,
        }
    };
    let matched = (0..).zip(&points).map(one).collect();
    Ok((matched, images))
}

pub(super) fn view(image: &GrayImage) -> Result<ImageView<'_>, (String, u8)> {
    let (width, height) = image.dimensions();
    ImageView::new(image.as_raw(), width as usize, height as usize)
        .map_err(|_| ("an image has no pixels".to_owned(), 3))
}

/// `u,v;u,v;...`
fn given(text: &str) -> Result<Vec<Vector2<f64>>, String> {
    let one = |part: &str| {
        let (u, v) = part.split_once(',')?;
        Some(Vector2::new(u.trim().parse().ok()?, v.trim().parse().ok()?))
    };
    let points = text.split(';').filter(|part| !part.trim().is_empty());
    points
        .map(|part| {
            one(part).ok_or_else(|| format!("--points: `{part}` is no point: u,v;u,v;... are expected, px"))
        })
        .collect()
}

fn tell(arguments: &StereoMatchArguments, matched: &[Matched], (left, right): &Images) -> u8 {
    let count = matched.iter().filter(|m| m.right_px.is_some()).count();
    let text = if arguments.json {
        json(&serde_json::json!({ "matches": matched }))
    } else {
        let mut text = String::from("id,u1_px,v1_px,u2_px,v2_px,correlation,depth_m\n");
        for m in matched {
            if let (Some([u, v]), Some(correlation), Some(depth_m)) = (m.right_px, m.correlation, m.depth_m) {
                let [a, b] = m.left_px;
                text += &format!("{},{a:.4},{b:.4},{u:.4},{v:.4},{correlation:.4},{depth_m:.6}\n", m.id);
            }
        }
        text
    };
    let mut exit_code = shown(&text, if count == 0 { 5 } else { 0 });
    if let Some(reason) = matched.iter().find_map(|m| m.reason.as_ref()).filter(|_| count == 0) {
        say(format_args!("vservo: none of {} points has a match; the first: {reason}", matched.len()));
    }
    if let Some(path) = &arguments.overlay {
        let mut both = SideBySide::new(left, right);
        for m in matched {
            both.right_line(&m.epipolar_line.into(), LINE);
        }
        for m in matched {
            both.cross(0, &m.left_px.into(), if m.right_px.is_some() { FOUND } else { MISSED });
            if let Some(px) = m.right_px {
                both.cross(1, &px.into(), FOUND);
            }
        }
        exit_code = both.png().map_or(1, |bytes| write_result(path, bytes, exit_code));
    }
    exit_code
}
