//! `vservo process` as a real process, against what OpenCV and numpy find in the same picture (`tests/fixtures/image_tools`, made by
//! `tools/image_tool_fixtures.py`), and against closed forms.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::vservo;
use serde_json::Value;
use std::path::{Path, PathBuf};

pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/image_tools").join(name)
}

pub(crate) fn numbers() -> Value {
    serde_json::from_str(&std::fs::read_to_string(fixture("numbers.json")).unwrap()).unwrap()
}

/// The command's exit code, stdout and stderr.
pub(crate) fn ended(arguments: &[&str]) -> (i32, String, String) {
    let output = vservo().args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "{err}");
    (output.status.code().unwrap(), out, err)
}

/// The steps of the answer about the picture of the fixtures.
fn steps(steps: &str) -> Vec<Value> {
    let (code, out, err) =
        ended(&["process", fixture("scene.png").to_str().unwrap(), "--steps", steps, "--json"]);
    assert_eq!(code, 0, "{steps}: {err}");
    let answer: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((answer["width_px"].as_u64(), answer["height_px"].as_u64()), (Some(200), Some(150)));
    answer["steps"].as_array().unwrap().clone()
}

fn fact(step: &Value, name: &str) -> f64 {
    step["facts"][name].as_f64().unwrap_or_else(|| panic!("no {name} in {step}"))
}

#[track_caller]
fn near(ours: f64, theirs: f64, share: f64) {
    assert!((ours - theirs).abs() <= share * theirs.abs().max(1.0), "{ours} against {theirs}");
}

#[test]
fn histogram_and_thresholds_are_those_of_opencv() {
    let theirs = &numbers()["image"];
    let done = steps("histogram | threshold:otsu");
    let counts: Vec<u64> = done[0]["rows"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["pixels"].as_f64().unwrap() as u64)
        .collect();
    let wanted: Vec<u64> =
        theirs["histogram"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert_eq!(counts, wanted);
    let shares: f64 =
        done[0]["rows"].as_array().unwrap().iter().map(|row| row["share"].as_f64().unwrap()).sum();
    near(shares, 1.0, 1e-12);
    // of thresholds between which there is no pixel all are as good: ours is the middle one, OpenCV's the first
    let (ours, first) =
        (fact(&done[1], "threshold") as usize, theirs["otsu_threshold"].as_f64().unwrap() as usize);
    let between: u64 = wanted[ours.min(first) + 1..=ours.max(first)].iter().sum();
    assert_eq!(between, 0, "{ours} against {first}");
    // the valley lies between the lighter object (120) and the ground (205), as in Fig. 10.1
    let valley = fact(&done[0], "valley_threshold");
    assert!((130.0..195.0).contains(&valley), "{valley}");
}

#[test]
fn gradients_are_those_of_opencv() {
    let theirs = &numbers()["image"];
    for (chain, name) in [
        ("sobel | magnitude", "sobel"),
        ("sobel | magnitude:sum", "sobel_sum"),
        ("roberts | magnitude", "roberts"),
        ("differences | magnitude", "differences"),
        ("laplacian", "laplacian"),
    ] {
        let done = steps(chain);
        let last = done.last().unwrap();
        for what in ["least", "greatest", "mean"] {
            near(fact(last, what), theirs[name][what].as_f64().unwrap(), 1e-6);
        }
    }
    let done = steps("sobel | magnitude | threshold:60");
    assert_eq!(fact(&done[2], "object_pixels"), theirs["sobel_above_60"].as_f64().unwrap());
    // 60.5 of 8 * 255, between two magnitudes that there are
    let (plain, normalized) = (
        steps("sobel | magnitude | threshold:60.5"),
        steps("sobel | magnitude | threshold:0.02965686275:normalized"),
    );
    assert_eq!(fact(&normalized[2], "object_pixels"), fact(&plain[2], "object_pixels"));
    let done = steps("gaussian:1.0");
    near(fact(&done[0], "mean_level"), theirs["blurred_mean"].as_f64().unwrap(), 2e-3);
}

#[test]
fn moments_and_orientation_are_those_of_opencv() {
    let theirs = &numbers()["image"];
    let chain = format!("threshold:{} | regions | moments | grey_moments | axes", theirs["level"]);
    let done = steps(&chain);
    let regions = theirs["regions"].as_array().unwrap();
    for step in &done[1..] {
        assert_eq!(step["rows"].as_array().unwrap().len(), regions.len());
    }
    let by_borders = steps(&format!("threshold:{} | contours | moments", theirs["level"]));
    for (i, region) in regions.iter().enumerate() {
        let own = |step: usize, name: &str| done[step]["rows"][i][name].as_f64().unwrap();
        for name in
            ["m00", "m10", "m01", "m20", "m11", "m02", "mu20", "mu11", "mu02", "mu30", "mu21", "mu12", "mu03"]
        {
            near(own(2, name), region["m"][name].as_f64().unwrap(), 1e-6);
            let border = by_borders[2]["rows"][i][name].as_f64().unwrap();
            near(border, own(2, name), 1e-12);
        }
        for name in ["m00", "m10", "m01", "mu20", "mu11", "mu02"] {
            near(own(3, name), region["grey"][name].as_f64().unwrap(), 1e-5);
        }
    }
    // the rectangle of 70 x 30 px turned by 25 degrees, and the ellipse of half axes 40 and 22 px along x: the scene's own numbers
    let axes = |x: f64| {
        let rows = done[4]["rows"].as_array().unwrap();
        rows.iter().find(|row| (row["x_px"].as_f64().unwrap() - x).abs() < 2.0).unwrap().clone()
    };
    let rectangle = axes(60.0);
    near(rectangle["axis_rad"].as_f64().unwrap().to_degrees(), 25.0, 0.01);
    near(rectangle["major_px"].as_f64().unwrap(), 70.0 / 3f64.sqrt(), 0.02);
    let ellipse = axes(110.0);
    near(ellipse["axis_rad"].as_f64().unwrap(), 0.0, 0.01);
    near(ellipse["major_px"].as_f64().unwrap(), 40.0, 0.01);
    // the level lies below half of the ellipse's step, which makes it a quarter of a pixel smaller
    near(ellipse["minor_px"].as_f64().unwrap(), 22.0, 0.02);
}

#[test]
fn contours_edges_and_shapes_are_those_of_the_scene() {
    let theirs = &numbers()["image"];
    let chain = format!("threshold:{} | contours | perimeter | polygons:2", theirs["level"]);
    let done = steps(&chain);
    assert_eq!(fact(&done[1], "contours"), theirs["contours"].as_f64().unwrap());
    let rows = done[2]["rows"].as_array().unwrap();
    let holes: f64 = rows.iter().map(|row| row["is_hole"].as_f64().unwrap()).sum();
    assert_eq!(holes, theirs["holes"].as_f64().unwrap());
    // the disc's radius is 28 px, its perimeter 2 pi r, and it is round
    let disc = rows.iter().find(|row| row["circularity"].as_f64().is_some_and(|c| c > 0.95)).unwrap();
    near(disc["perimeter_px"].as_f64().unwrap(), 28.0 * std::f64::consts::TAU, 0.02);
    // the rectangle's corners are four
    let rectangle =
        rows.iter().position(|row| row["circularity"].as_f64().is_some_and(|c| c < 0.75)).unwrap();
    let corners = done[3]["rows"].as_array().unwrap();
    let own = corners.iter().filter(|row| row["contour"].as_f64() == Some(rectangle as f64)).count();
    assert_eq!(own, 4, "{corners:?}");

    let done = steps("ellipses:9");
    let find = |x: f64, major: f64| {
        let rows = done[0]["rows"].as_array().unwrap();
        let is = |row: &&Value| {
            (row["x_px"].as_f64().unwrap() - x).abs() < 1.0
                && (row["major_px"].as_f64().unwrap() - major).abs() < 1.0
        };
        rows.iter().find(is).unwrap_or_else(|| panic!("none at {x}: {rows:?}")).clone()
    };
    for (x, y, major, minor) in
        [(110.0, 112.0, 40.0, 22.0), (150.0, 45.0, 28.0, 28.0), (150.0, 45.0, 10.0, 10.0)]
    {
        let ellipse = find(x, major);
        near(ellipse["y_px"].as_f64().unwrap(), y, 0.003);
        near(ellipse["minor_px"].as_f64().unwrap(), minor, 0.01);
    }
    let done = steps("segments:20");
    let long = done[0]["rows"].as_array().unwrap();
    let lengths: Vec<f64> = long.iter().map(|row| row["length_px"].as_f64().unwrap()).collect();
    assert_eq!(lengths.iter().filter(|l| (**l - 70.0).abs() < 3.0).count(), 2, "{lengths:?}");
    let done = steps("gaussian:1 | edges | chains:20");
    assert!((3.0..=12.0).contains(&fact(&done[2], "chains")), "{}", done[2]["facts"]);
    let corners = steps("corners");
    let near_corner = |x: f64, y: f64| {
        corners[0]["rows"]
            .as_array()
            .unwrap()
            .iter()
            .any(|row| (row["x_px"].as_f64().unwrap() - x).hypot(row["y_px"].as_f64().unwrap() - y) < 2.0)
    };
    let (sin, cos) = 25f64.to_radians().sin_cos();
    for (u, v) in [(35.0, 15.0), (35.0, -15.0), (-35.0, 15.0), (-35.0, -15.0)] {
        assert!(near_corner(60.0 + u * cos - v * sin, 50.0 + u * sin + v * cos), "corner {u} {v}");
    }
}

#[test]
fn region_merging_finds_the_surfaces() {
    // ground, rectangle, disc, its hole, ellipse
    let done = steps("gaussian:1.0 | merge:interval:60:80");
    let rows = done[1]["rows"].as_array().unwrap();
    let levels: Vec<f64> = rows.iter().map(|row| row["mean_level"].as_f64().unwrap()).collect();
    for wanted in [40.0, 50.0, 120.0, 205.0] {
        assert!(levels.iter().any(|level| (level - wanted).abs() < 15.0), "{wanted}: {levels:?}");
    }
    let all: f64 = rows.iter().map(|row| row["area_px2"].as_f64().unwrap()).sum();
    assert_eq!(all, 200.0 * 150.0, "each pixel belongs to one region");
}

#[test]
fn local_thresholds_and_pyramids_have_their_own_numbers() {
    let done = steps("pyramid:2");
    assert_eq!((fact(&done[0], "width_px"), fact(&done[0], "height_px")), (50.0, 38.0));
    let ground = numbers()["image"]["blurred_mean"].as_f64().unwrap();
    near(fact(&done[0], "mean_level"), ground, 0.01);
    let done = steps("local_mean:15:-8");
    // inside a border of 15 px all squares are whole, so that numpy's count is a part of ours
    let inner = numbers()["image"]["local_mean_inner_dark"].as_f64().unwrap();
    assert!(fact(&done[0], "object_pixels") >= inner);
    let extremes = steps("local_extremes:60");
    assert!((5000.0..9000.0).contains(&fact(&extremes[0], "object_pixels")), "{}", extremes[0]["facts"]);
}

#[test]
fn pictures_tables_and_a_page_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("steps");
    let scene = fixture("scene.png");
    let chain = "histogram | sobel | magnitude | threshold:60 | regions | axes";
    let arguments =
        ["process", scene.to_str().unwrap(), "--steps", chain, "--csv", "--out", out.to_str().unwrap()];
    let (code, table, err) = ended(&arguments);
    assert_eq!(code, 0, "{err}");
    assert!(table.starts_with("region,x_px,y_px,major_px,minor_px,axis_rad"), "{table}");
    assert_eq!(table, std::fs::read_to_string(out.join("6-axes.csv")).unwrap());
    for (name, size) in [
        ("1-histogram", (512, 200)),
        ("2-sobel", (400, 150)),
        ("3-magnitude", (200, 150)),
        ("4-threshold", (200, 150)),
    ] {
        let picture = image::open(out.join(format!("{name}.png"))).unwrap();
        assert_eq!((picture.width(), picture.height()), size, "{name}");
    }
    let binary = image::open(out.join("4-threshold.png")).unwrap().into_luma8();
    let white = binary.pixels().filter(|p| p.0[0] == 255).count() as f64;
    assert_eq!(white, numbers()["image"]["sobel_above_60"].as_f64().unwrap());
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert_eq!(
        page.matches("data:image/png;base64,").count(),
        6,
        "the image and five steps; the histogram is a chart"
    );
    assert!(page.contains("class=\"chart wide\"") && !page.contains("src=\"http"));
}

#[test]
fn what_does_not_fit_says_what_would() {
    let scene = fixture("scene.png");
    let refused = |steps: &str| {
        let (code, _, err) = ended(&["process", scene.to_str().unwrap(), "--steps", steps]);
        assert_eq!(code, 2, "{steps}: {err}");
        err
    };
    let err = refused("gaussian:1 | magnitude");
    assert!(err.contains("step 2 `magnitude` takes a gradient, and `gaussian:1` gives an image"), "{err}");
    assert!(err.contains("a gradient is given by differences, roberts, sobel"), "{err}");
    assert!(refused("sobell").contains("did you mean `sobel`?"));
    assert!(refused("gaussian:x").contains("a number from 0.05 to 20, not `x`"));
    assert!(refused("gaussian").contains("the standard deviation is missing; it is written gaussian:SD_PX"));
    assert!(refused("sobel | | magnitude").contains("step 2 is empty"));
    assert!(refused("threshold:otsu:grey").contains("`dark`, `light`"));
    assert!(refused("threshold:300").contains("0 to 255"));
    assert!(refused("moments").contains("regions or contours"));
    let (code, _, err) = ended(&["process", "/nonexistent.png", "--steps", "sobel"]);
    assert!(code == 3 && err.contains("/nonexistent.png"), "{err}");
    // one grey level alone has no threshold
    let folder = tempfile::tempdir().unwrap();
    let flat = folder.path().join("flat.png");
    image::GrayImage::from_pixel(40, 30, image::Luma([90])).save(&flat).unwrap();
    let (code, _, err) = ended(&["process", flat.to_str().unwrap(), "--steps", "threshold:otsu"]);
    assert!(code == 5 && err.contains("one grey level"), "{err}");
    let (code, list, _) = ended(&["process", "--list"]);
    assert!(code == 0 && list.contains("sobel") && list.contains("grey_moments"), "{list}");
}

#[test]
fn detect_finds_segments_and_ellipses() {
    let scene = fixture("scene.png");
    let folder = tempfile::tempdir().unwrap();
    let overlay = folder.path().join("over.png");
    let arguments = |kind: &'static str| ["detect", "", "--target", kind, "--json", "--overlay", ""];
    let answer = |kind| {
        let mut arguments = arguments(kind);
        (arguments[1], arguments[6]) = (scene.to_str().unwrap(), overlay.to_str().unwrap());
        let (code, out, err) = ended(&arguments);
        assert_eq!(code, 0, "{err}");
        serde_json::from_str::<Value>(&out).unwrap()
    };
    let ellipses = answer("ellipses:9");
    assert_eq!((ellipses["status"].as_str(), ellipses["pose"].is_null()), (Some("found"), true));
    let (features, shapes) =
        (ellipses["features"].as_array().unwrap(), ellipses["ellipses"].as_array().unwrap());
    assert_eq!(features.len(), shapes.len());
    // the lighter ellipse at (110, 112): within four of its own standard deviations, and a tenth of a pixel
    let at = (0..features.len())
        .find(|i| (shapes[*i]["axes_px"][0].as_f64().unwrap() - 40.0).abs() < 1.0)
        .expect("the ellipse");
    let error = (features[at]["u_px"].as_f64().unwrap() - 110.0)
        .hypot(features[at]["v_px"].as_f64().unwrap() - 112.0);
    assert!(error < 0.1, "{error}");
    assert_eq!(shapes[at]["covariance"].as_array().unwrap().len(), 25);
    let segments = answer("segments");
    let shapes = segments["segments"].as_array().unwrap();
    let long: Vec<_> = shapes.iter().filter(|s| s["length_px"].as_f64().unwrap() > 60.0).collect();
    assert!(long.len() >= 2, "{shapes:?}");
    for segment in long {
        // modulo half a turn, 25 degrees
        let off = (segment["orientation_rad"].as_f64().unwrap().to_degrees() - 25.0).rem_euclid(180.0);
        let off = off.min(180.0 - off);
        assert!(off < 0.5, "{off}");
    }
    assert_eq!(image::open(&overlay).unwrap().width(), 200);
    let (code, _, err) = ended(&["detect", scene.to_str().unwrap(), "--target", "segments:2"]);
    assert!(code == 2 && err.contains("from 8"), "{err}");
}
