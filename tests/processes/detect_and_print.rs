//! `vservo target` and `vservo detect` as real processes: what is printed is found, what cannot be read is told, and exit codes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::vservo;
use serde_json::Value;
use std::path::{Path, PathBuf};

struct Ended {
    code: Option<i32>,
    out: String,
    err: String,
}

fn ended(arguments: &[&str]) -> Ended {
    let output = vservo().args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert!(!err.contains("panicked"), "{err}");
    Ended { code: output.status.code(), out, err }
}

fn answers(out: &str) -> Vec<Value> {
    out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn printed(folder: &Path, kind: &str, name: &str) -> PathBuf {
    let path = folder.join(name);
    let ended = ended(&["target", kind, "--out", path.to_str().unwrap()]);
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(ended.out.contains("mm"), "{}", ended.out);
    path
}

/// The sheet as a camera with so many pixels per mm would see it from above, softly.
fn shrunk(path: &Path, factor: u32) {
    let sheet = image::open(path).unwrap().into_luma8();
    let (width, height) = (sheet.width() / factor, sheet.height() / factor);
    let small = image::GrayImage::from_fn(width, height, |x, y| {
        let all = (0..factor * factor)
            .map(|i| u32::from(sheet.get_pixel(x * factor + i % factor, y * factor + i / factor).0[0]));
        image::Luma([(all.sum::<u32>() / (factor * factor)) as u8])
    });
    small.save(path).unwrap();
}

#[test]
fn what_is_printed_is_found() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, factor, count) in [
        ("chessboard:9x6:0.02", 4, 54),
        ("dots:7x5:0.02", 4, 35),
        ("four_dots", 4, 4),
        ("tag:36h11:0.05:7", 3, 4),
    ] {
        let path = printed(folder.path(), kind, "sheet.png");
        shrunk(&path, factor);
        let path = path.to_str().unwrap();
        let ended = ended(&["detect", path, "--target", kind, "--json"]);
        assert_eq!(ended.code, Some(0), "{kind}: {} {}", ended.out, ended.err);
        let all = answers(&ended.out);
        let [answer] = all.as_slice() else { panic!("{}", ended.out) };
        assert_eq!(answer["status"], "found");
        assert_eq!(answer["features"].as_array().unwrap().len(), count, "{kind}");
        assert!(answer["pose"].is_null() && answer["reason"].is_null());
        // ids rise, and neighbours in a row lie as far apart as the sheet says
        let px_per_m = 300.0 / 0.0254 / f64::from(factor);
        let at = |i: usize| {
            let f = &answer["features"][i];
            (f["u_px"].as_f64().unwrap(), f["v_px"].as_f64().unwrap())
        };
        let wanted_m = if kind.starts_with("tag") {
            0.05
        } else if kind == "four_dots" {
            0.1
        } else {
            0.02
        };
        let (dx, dy) = (at(1).0 - at(0).0, at(1).1 - at(0).1);
        assert!((dx / px_per_m - wanted_m).abs() < 0.01 * wanted_m && dy.abs() < 1.0, "{kind}: {dx} {dy}");
        assert_eq!(answer["tags"].is_array(), kind.starts_with("tag"));
    }
}

#[test]
fn a_calibration_yields_the_pose_and_the_overlay_image() {
    let folder = tempfile::tempdir().unwrap();
    let path = printed(folder.path(), "tag:36h11:0.05:7", "sheet.png");
    shrunk(&path, 3);
    let size = image::image_dimensions(&path).unwrap();
    // looked at from straight above: the size in px tells the distance
    let camera = folder.path().join("camera.yaml");
    let text = format!(
        "image_width: {}\nimage_height: {}\ncamera_name: eye\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
         data: [600.0, 0.0, {cx}, 0.0, 600.0, {cy}, 0.0, 0.0, 1.0]\ndistortion_model: plumb_bob\n\
         distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.0, 0.0, 0.0, 0.0, 0.0]\nrectification_matrix:\n  rows: 3\n  \
         cols: 3\n  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  \
         data: [600.0, 0.0, {cx}, 0.0, 0.0, 600.0, {cy}, 0.0, 0.0, 0.0, 1.0, 0.0]\n",
        size.0,
        size.1,
        cx = f64::from(size.0) / 2.0,
        cy = f64::from(size.1) / 2.0
    );
    std::fs::write(&camera, text).unwrap();
    let overlay = folder.path().join("seen.png");
    let mut told = Vec::new();
    for kind in ["tag:36h11:0.05:7", "tag:36h11:0.05"] {
        let ended = ended(&[
            "detect",
            path.to_str().unwrap(),
            "--target",
            kind,
            "--camera",
            camera.to_str().unwrap(),
            "--json",
            "--overlay",
            overlay.to_str().unwrap(),
        ]);
        assert_eq!(ended.code, Some(0), "{} {}", ended.out, ended.err);
        let answer = &answers(&ended.out)[0];
        let z_m = answer["pose"]["position_m"][2].as_f64().unwrap();
        let wanted = 600.0 * 0.0254 * 3.0 / 300.0;
        assert!((z_m - wanted).abs() < 0.005 * wanted, "{z_m} instead of {wanted}");
        assert_eq!(answer["pose"]["covariance"].as_array().unwrap().len(), 36);
        assert_eq!(
            (answer["tags"][0]["id"].as_u64(), answer["tags"][0]["hamming"].as_u64()),
            (Some(7), Some(0))
        );
        assert!(answer["reprojection_rms_px"].as_f64().unwrap() < 0.2);
        assert_eq!(image::image_dimensions(&overlay).unwrap(), size);
        let features = answer["features"].as_array().unwrap().iter();
        told.push(
            features.map(|f| ["u_px", "v_px", "sigma_px"].map(|key| f[key].clone())).collect::<Vec<_>>(),
        );
    }
    // With and without an id the response of the camera is taken as unknown, and the corners are the same.
    assert_eq!(told[0], told[1]);
    // a camera of another size
    let other = printed(folder.path(), "tag:16h5:0.03:7", "other.png");
    let camera = camera.to_str().unwrap();
    let ended = ended(&["detect", other.to_str().unwrap(), "--target", "tag:16h5:0.03", "--camera", camera]);
    assert_eq!(ended.code, Some(3), "{} {}", ended.out, ended.err);
}

#[test]
fn a_grid_of_equal_dots_is_found_and_its_turn_left_open() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dots.png");
    image::GrayImage::from_fn(640, 480, |x, y| {
        let (u, v) = ((f64::from(x) - 100.0) / 60.0, (f64::from(y) - 90.0) / 60.0);
        let (i, j) = (u.round().clamp(0.0, 6.0), v.round().clamp(0.0, 4.0));
        image::Luma([if (u - i).hypot(v - j) < 0.3 { 40 } else { 200 }])
    })
    .save(&path)
    .unwrap();
    let path = path.to_str().unwrap();
    let found = ended(&["detect", path, "--target", "dots:7x5:0.02", "--json"]);
    assert_eq!(found.code, Some(0), "{} {}", found.out, found.err);
    let answer = &answers(&found.out)[0];
    assert_eq!(answer["features"].as_array().unwrap().len(), 35);
    for (i, feature) in answer["features"].as_array().unwrap().iter().enumerate() {
        let (u, v) = (100.0 + 60.0 * (i % 7) as f64, 90.0 + 60.0 * (i / 7) as f64);
        assert_eq!(feature["id"], i);
        let off = (feature["u_px"].as_f64().unwrap() - u).hypot(feature["v_px"].as_f64().unwrap() - v);
        assert!(off < 0.1, "{i}: {off} px");
    }
    assert!(answer["note"].as_str().unwrap().contains("turn"), "{answer}");
    assert_eq!(ended(&["detect", path, "--target", "dots:6x5:0.02"]).code, Some(5));
}

#[test]
fn what_cannot_be_read_is_told_and_the_rest_is_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let sheet = printed(folder.path(), "tag:36h11:0.05:7", "sheet.png");
    let bytes = std::fs::read(&sheet).unwrap();
    std::fs::write(at("short.png"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(at("text.png"), "no image").unwrap();
    std::fs::write(at("empty.pgm"), "").unwrap();
    std::fs::write(at("huge.pgm"), "P5 20000 20000 255\n").unwrap();
    // 16 bits and colour are turned into grey levels
    let tag = image::open(&sheet).unwrap();
    image::DynamicImage::from(tag.to_luma16()).save(at("deep.png")).unwrap();
    image::DynamicImage::from(tag.to_rgb8()).save(at("colour.png")).unwrap();
    image::GrayImage::from_pixel(1, 1, image::Luma([7])).save(at("one.png")).unwrap();
    image::GrayImage::from_pixel(320, 240, image::Luma([0])).save(at("black.png")).unwrap();
    let names = [
        "short.png",
        "text.png",
        "empty.pgm",
        "huge.pgm",
        "absent.png",
        "deep.png",
        "colour.png",
        "one.png",
        "black.png",
    ];
    let paths: Vec<_> = names.iter().map(|name| at(name)).collect();
    for kind in ["tag:36h11:0.05:7", "chessboard:9x6:0.02", "dots:7x5:0.02", "four_dots"] {
        let mut arguments = vec!["detect", "--target", kind, "--json"];
        arguments.extend(paths.iter().map(String::as_str));
        let ended = ended(&arguments);
        assert_eq!(ended.code, Some(3), "{} {}", ended.out, ended.err);
        let all = answers(&ended.out);
        let status: Vec<_> = all.iter().map(|a| a["status"].as_str().unwrap()).collect();
        assert!(status[..5].iter().all(|s| *s == "unreadable"), "{status:?}");
        let found = if kind.starts_with("tag") { 2 } else { 0 };
        assert_eq!(status.iter().filter(|s| **s == "found").count(), found, "{kind}: {status:?}");
        assert!(
            all.iter().all(|a| a["status"] == "found" || a["reason"].as_str().is_some_and(|r| !r.is_empty()))
        );
        assert!(ended.err.contains("20000x20000 px"), "{}", ended.err);
    }
    let nothing = ended(&["detect", &at("black.png"), "--target", "four_dots"]);
    assert_eq!(nothing.code, Some(5), "{}", nothing.out);
}

#[test]
fn wrong_words_are_told_with_what_is_accepted() {
    for arguments in [
        &["detect", "a.png", "--target", "cheese"][..],
        &["target", "chessboard:9x6", "--out", "a.svg"],
        &["target", "tag:36h11:0.05:9999", "--out", "a.svg"],
        &["target", "four_dots", "--out", "a.gif"],
        &["target", "chessboard:30x30:0.5", "--out", "a.png"],
        &["detect", "a.png", "b.png", "--target", "four_dots", "--overlay", "o.png"],
    ] {
        let ended = ended(arguments);
        assert_eq!(ended.code, Some(2), "{arguments:?}: {}", ended.err);
        let told = ["accepted", "ids 0 to", ".svg", "mm", "one image"];
        assert!(told.iter().any(|words| ended.err.contains(words)), "{}", ended.err);
        assert!(!Path::new("a.svg").exists() && !Path::new("a.png").exists());
    }
    let nowhere = ended(&["target", "four_dots", "--out", "/nowhere/at/all.svg"]);
    assert_eq!(nowhere.code, Some(3), "{}", nowhere.err);
}

#[test]
fn tags_of_other_ids_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = printed(folder.path(), "tag:36h11:0.05:8", "sheet.png");
    shrunk(&path, 3);
    let path = path.to_str().unwrap();
    let told = ended(&["detect", path, "--target", "tag:36h11:0.05:5", "--json"]);
    assert_eq!(told.code, Some(5), "{} {}", told.out, told.err);
    let answer = &answers(&told.out)[0];
    assert_eq!(
        (answer["status"].as_str(), answer["reason"].as_str()),
        (Some("other_tags"), Some("saw tag 8, not 5"))
    );
}

/// A flipped image of a tag is no tag, and is told as what it is.
#[test]
fn a_mirrored_image_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = printed(folder.path(), "tag:tag36h11:0.08:5", "tag.png");
    let image = image::open(&path).unwrap().to_luma8();
    image::imageops::flip_horizontal(&image).save(&path).unwrap();
    shrunk(&path, 4);
    let path = path.to_str().unwrap();
    let told = ended(&["detect", path, "--target", "tag:tag36h11:0.08:5", "--json"]);
    let answer = &answers(&told.out)[0];
    assert_eq!(answer["status"], "mirrored", "{answer}");
}

#[test]
fn a_paper_is_filled_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("board.pdf");
    let out = out.to_str().unwrap();
    let refused = ended(&["target", "chessboard:9x6:0.025", "--paper", "a4", "--out", out]);
    assert_eq!(refused.code, Some(2));
    assert!(refused.err.contains("do not fit on A4: make the target 93 % of its size"), "{}", refused.err);
    assert!(!Path::new(out).exists());
    let fits = ended(&["target", "chessboard:9x6:0.023", "--paper", "a4", "--out", out]);
    assert_eq!(fits.code, Some(0), "{}", fits.err);
    assert!(fits.out.contains("; on A4; print it at 100 %"), "{}", fits.out);
    let text = String::from_utf8_lossy(&std::fs::read(out).unwrap()).into_owned();
    let media = text.split("/MediaBox [0 0 ").nth(1).unwrap().split(']').next().unwrap();
    let points: Vec<f64> = media.split(' ').map(|x| x.parse().unwrap()).collect();
    // 297 x 210 mm in units of 1/72 inch
    assert!((points[0] - 841.89).abs() < 0.01 && (points[1] - 595.28).abs() < 0.01, "{points:?}");
    let alone = ended(&["target", "chessboard:9x6:0.025", "--out", out]);
    assert!(alone.out.contains("; fits on A3;"), "{}", alone.out);
}
