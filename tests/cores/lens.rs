//! The lens of a run file: its models, calibration files, and regions of the image.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use std::path::Path;
use vservo::camera_model::camera_info::CameraInfo;
use vservo::camera_model::{
    CameraModel, Distortion, Equidistant, Intrinsics, Lens, RationalPolynomial, Region,
};
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::geometry::Pose;
use vservo::scene::{Renderer, SceneLook, SensorModel};
use vservo::sim::simulate_system;
use vservo::target::FourDots;

/// A wide lens: the whole motion fits into the region.
const WIDE: [&str; 2] = ["camera.lens.fx_px=400", "camera.lens.fy_px=400"];
const RATIONAL: &str = "camera.lens={model='rational_polynomial', fx_px=380.0, fy_px=380.0, k1=0.35, k2=0.12, k3=0.01, k4=0.6, k5=0.2, p1=0.001}";
const EQUIDISTANT: &str = "camera.lens={model='equidistant', fx_px=380.0, fy_px=380.0, k1=-0.03, k2=0.006}";
const REGION: &str = "camera.roi={x_px=120, y_px=100, width_px=320, height_px=240}";

fn load(set: &[&str]) -> Result<Config, String> {
    let set: Vec<_> = set.iter().map(ToString::to_string).collect();
    Config::load(None, &set).map_err(|e| e.to_string())
}

fn refused(set: &[&str], words: &[&str]) {
    let error = load(set).unwrap_err();
    for word in words {
        assert!(error.contains(word), "{word}: {error}");
    }
}

fn converges(set: &[&str]) {
    let config = load(&[set, &["goal.hold_s=0.2"]].concat()).unwrap();
    let run = simulate_system(&config, &mut |_| std::ops::ControlFlow::Continue(())).unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{set:?}: {run:?}");
    let error_m = run.errors.position_error_m.unwrap();
    assert!(error_m < 1e-3, "{set:?}: {error_m} m");
}

#[test]
fn the_arm_finds_its_goal_with_every_lens_and_with_a_region() {
    converges(&[RATIONAL]);
    converges(&[EQUIDISTANT]);
    converges(&[REGION, WIDE[0], WIDE[1]]);
}

#[test]
fn each_model_has_its_own_coefficients() {
    let lens = *load(&[RATIONAL]).unwrap().camera.model.lens();
    let wanted = RationalPolynomial {
        k1: 0.35,
        k2: 0.12,
        k3: 0.01,
        k4: 0.6,
        k5: 0.2,
        p1: 0.001,
        ..Default::default()
    };
    assert_eq!(lens, Lens::from(wanted));
    // the defaults are those of a plumb-bob lens alone
    let lens = *load(&["camera.lens={model='equidistant', k2=0.01}"]).unwrap().camera.model.lens();
    assert_eq!(lens, Lens::from(Equidistant { k2: 0.01, ..Default::default() }));
    refused(
        &["camera.lens.k4=0.1"],
        &["camera.lens.k4", "no coefficient of a plumb_bob lens", "rational_polynomial"],
    );
    refused(
        &["camera.lens={model='equidistant', p1=0.1}"],
        &["camera.lens.p1", "k1, k2, k3, k4", "leave it out"],
    );
    refused(&["camera.lens.model='fish'"], &["camera.lens.model", "equidistant"]);
    refused(&["scene.camera.lens.k6=1"], &["scene.camera.lens.k6", "no coefficient of a plumb_bob lens"]);
    let truth = load(&["scene.camera.lens={model='equidistant', k1=0.02}"]).unwrap().scene.unwrap();
    assert_eq!(*truth.camera.lens(), Lens::from(Equidistant { k1: 0.02, ..Default::default() }));
}

#[test]
fn the_effective_configuration_needs_no_calibration_file() {
    for set in [[RATIONAL, REGION], [EQUIDISTANT, REGION]] {
        let config = load(&set).unwrap();
        let again = Config::parse("again", &config.to_toml().unwrap(), Path::new("/elsewhere"), &[]).unwrap();
        assert_eq!(again.effective, config.effective);
        assert_eq!(again.camera.model, config.camera.model);
    }
}

fn written(folder: &tempfile::TempDir, camera: &str) -> Result<Config, String> {
    let path = folder.path().join("cell.toml");
    std::fs::write(&path, camera).unwrap();
    Config::load(Some(&path), &[]).map_err(|e| e.to_string())
}

#[test]
fn a_calibration_file_is_the_lens() {
    let folder = tempfile::tempdir().unwrap();
    let intrinsics =
        Intrinsics { fx_px: 512.5, fy_px: 513.5, cx_px: 401.25, cy_px: 299.0, width_px: 800, height_px: 600 };
    let lens = RationalPolynomial { k1: 0.35, k2: 0.12, k3: 0.01, k4: 0.6, k5: 0.2, ..Default::default() };
    let camera = CameraModel::new(intrinsics, lens).unwrap();
    let text = CameraInfo::new("wrist", &camera).write();
    std::fs::write(folder.path().join("wrist.yaml"), &text).unwrap();
    let config = written(&folder, "[camera.lens]\nfile = 'wrist.yaml'\n").unwrap();
    assert_eq!(config.camera.model, camera);
    let again = Config::parse("again", &config.to_toml().unwrap(), Path::new("/elsewhere"), &[]).unwrap();
    assert_eq!((again.camera.model, again.effective), (camera, config.effective));
    let listed = written(&folder, "[[cameras]]\nlens.file = 'wrist.yaml'\n").unwrap();
    assert_eq!(listed.camera.model, camera);

    let refused = |text: &str, words: &[&str]| {
        let error = written(&folder, text).unwrap_err();
        for word in words {
            assert!(error.contains(word), "{word}: {error}");
        }
    };
    refused(
        "[camera.lens]\nfile = 'wrist.yaml'\nk1 = 0.1\n",
        &["cell.toml:3:1: camera.lens.k1", "leave out one"],
    );
    refused(
        "[camera]\nwidth_px = 640\n[camera.lens]\nfile = 'wrist.yaml'\n",
        &["cell.toml:2:1: camera.width_px: is 640", "image with 800", "leave width_px out"],
    );
    refused(
        "[camera.lens]\nfile = 'none.yaml'\n",
        &["cell.toml:2:1: camera.lens.file", "none.yaml cannot be read"],
    );
    std::fs::write(folder.path().join("bad.yaml"), text.replace("rows: 1", "rows: 2")).unwrap();
    refused("[camera.lens]\nfile = 'bad.yaml'\n", &["camera.lens.file", "bad.yaml: line 12", "2 rows of 8"]);
    refused("[camera.lens]\nfile = '.'\n", &["camera.lens.file", "not a regular file"]);
}

#[test]
fn a_region_must_lie_in_the_image() {
    let config = load(&[REGION, WIDE[0], WIDE[1]]).unwrap();
    assert_eq!(config.camera.full_size_px(), (640, 480));
    let region = Region { x_px: 120, y_px: 100, width_px: 320, height_px: 240 };
    assert_eq!(config.camera.roi(), Some(region));
    let i = config.camera.model.intrinsics();
    assert_eq!((i.width_px, i.height_px, i.cx_px, i.cy_px), (320, 240, 199.5, 139.5));
    assert_eq!(load(&[]).unwrap().camera.roi(), None);
    let roi = |text: &str| format!("camera.roi={{{text}}}");
    refused(
        &[&roi("x_px=400, width_px=320, height_px=240")],
        &["camera.roi.width_px", "at most 240", "x_px smaller"],
    );
    refused(&[&roi("y_px=4294967295, width_px=320, height_px=240")], &["camera.roi.height_px", "outside"]);
    refused(&[&roi("width_px=320")], &["camera.roi.height_px", "give the region a size"]);
    refused(&[&roi("widht_px=320")], &["camera.roi.widht_px", "unknown field"]);
    // what is true of the lens is of the whole image too
    let truth = load(&[REGION, WIDE[0], WIDE[1], "scene.camera.lens.cx_px=330"]).unwrap().scene.unwrap();
    assert_eq!(truth.camera.intrinsics().cx_px, 210.0);
    assert_eq!(truth.camera.region(), &region);
}

/// Pixels of a region are those of the whole image, vignetting included; but for noise, which there is none of.
#[test]
fn a_region_shows_the_same_pixels() {
    let intrinsics =
        Intrinsics { fx_px: 500.0, fy_px: 500.0, cx_px: 310.0, cy_px: 250.0, width_px: 640, height_px: 480 };
    let region = Region { x_px: 101, y_px: 53, width_px: 320, height_px: 240 };
    let lenses: [Lens; 4] = [
        Lens::default(),
        Distortion { k1: -0.2, k2: 0.05, p1: 0.002, p2: -0.001, k3: 0.0 }.into(),
        RationalPolynomial { k1: 0.35, k2: 0.12, k3: 0.01, k4: 0.6, k5: 0.2, ..Default::default() }.into(),
        Equidistant { k1: -0.03, k2: 0.006, ..Default::default() }.into(),
    ];
    for lens in lenses {
        let whole = CameraModel::new(intrinsics, lens).unwrap();
        let part = whole.cropped(&region).unwrap();
        let sensor = SensorModel { noise_sd_levels: 0.0, blur_sd_px: 0.5, vignetting: 0.4, seed: 3 };
        let pose = Pose::from_parts(
            nalgebra::Translation3::new(-0.08, -0.06, 0.4),
            nalgebra::UnitQuaternion::from_euler_angles(0.3, -0.2, 0.4),
        );
        let image = |camera: CameraModel| {
            let i = *camera.intrinsics();
            let mut pixels = vec![0; (i.width_px * i.height_px) as usize];
            let mut renderer =
                Renderer::new(camera, FourDots::default(), SceneLook::default(), sensor).unwrap();
            renderer.render(&[pose], 1, &mut pixels);
            pixels
        };
        let (all, some) = (image(whole), image(part));
        let mut differ = 0;
        for (y, row) in some.chunks(320).enumerate() {
            for (x, level) in row.iter().enumerate() {
                let same = all[(y + 53) * 640 + x + 101];
                assert!(level.abs_diff(same) <= 1, "{lens:?} {x} {y}: {level} {same}");
                differ += usize::from(*level != same);
            }
        }
        let (least, most) = (some.iter().min().unwrap(), some.iter().max().unwrap());
        assert!(most - least > 100, "the target is in the region");
        // rounding, where a level lies half-way between two
        assert!(differ < some.len() / 100, "{lens:?}: {differ} pixels differ by a level");
    }
}
