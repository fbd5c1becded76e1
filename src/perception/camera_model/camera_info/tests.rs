use super::super::{Distortion, Equidistant, RationalPolynomial};
use super::*;
use proptest::prelude::*;

/// As ROS's calibrator writes it.
const FILE: &str = "image_width: 640
image_height: 480
camera_name: narrow_left
camera_matrix:
  rows: 3
  cols: 3
  data: [612.25, 0, 318.5, 0, 613.5, 242.75, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.21, 0.0625, 1.5e-03, -.001, 0.]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [600, 0, 318.5, 0, 0, 600, 242.75, 0, 0, 0, 1, 0]
";

fn vga() -> Intrinsics {
    Intrinsics { fx_px: 612.25, fy_px: 613.5, cx_px: 318.5, cy_px: 242.75, width_px: 640, height_px: 480 }
}

fn refused(text: &str, line: usize, words: &[&str]) {
    let error = CameraInfo::read(text).unwrap_err();
    assert_eq!(error.line, line, "{error}");
    for word in words {
        assert!(error.to_string().contains(word), "{error}");
    }
}

#[test]
fn a_file_is_read() {
    let info = CameraInfo::read(FILE).unwrap();
    assert_eq!(info.camera_name, "narrow_left");
    assert_eq!(info.intrinsics, vga());
    let lens = Distortion { k1: -0.21, k2: 0.0625, p1: 0.0015, p2: -0.001, k3: 0.0 };
    assert_eq!(info.lens, Lens::PlumbBob(lens));
    assert_eq!(info.projection[0], 600.0);
    assert!(info.camera().is_ok());
}

#[test]
fn other_spellings_are_understood() {
    let info = CameraInfo::read(FILE).unwrap();
    let four = FILE.replace("cols: 5", "cols: 4").replace(", 0.]", "]");
    assert_eq!(CameraInfo::read(&four).unwrap(), info);
    let block = FILE.replace(
        "data: [-0.21, 0.0625, 1.5e-03, -.001, 0.]",
        "data:\n    - -0.21\n    - 0.0625\n    - 0.0015\n    - -1e-3\n    - 0",
    );
    assert_eq!(CameraInfo::read(&block).unwrap(), info);
    let head = format!(
        "%YAML:1.0\n---\n# calibrated on Monday\n{FILE}binning_x: 0\nroi: {{x: [1, [2]], y: {{}}}}\n"
    );
    assert_eq!(CameraInfo::read(&head).unwrap(), info);
    let named = head.replace("narrow_left", "\"Ann\\'s\"");
    assert_eq!(CameraInfo::read(&named).unwrap().camera_name, "Ann's");
    let alone = &FILE[..FILE.find("rectification").unwrap()];
    let alone = CameraInfo::read(alone).unwrap();
    assert_eq!((alone.lens, alone.intrinsics), (info.lens, info.intrinsics));
    assert_eq!(alone, CameraInfo::new("narrow_left", &info.camera().unwrap()));
}

#[test]
fn wide_lenses_are_read() {
    let of = |model: &str, count: usize, data: &str| {
        let text = FILE.replace("plumb_bob", model).replace("cols: 5", &format!("cols: {count}"));
        CameraInfo::read(&text.replace("-0.21, 0.0625, 1.5e-03, -.001, 0.", data)).unwrap().lens
    };
    let fisheye = Equidistant { k1: -0.01, k2: 0.02, k3: -0.03, k4: 0.04 };
    for word in ["equidistant", "fisheye"] {
        assert_eq!(of(word, 4, "-0.01, 0.02, -0.03, 0.04"), Lens::Equidistant(fisheye));
    }
    let rational =
        RationalPolynomial { k1: 1.0, k2: 2.0, p1: 3.0, p2: 4.0, k3: 5.0, k4: 6.0, k5: 7.0, k6: 8.0 };
    assert_eq!(of("rational_polynomial", 8, "1, 2, 3, 4, 5, 6, 7, 8"), Lens::RationalPolynomial(rational));
}

/// As OpenCV's calibration gives them when it is asked for more than the lens needs.
#[test]
fn longer_rows_of_opencv_are_read_where_the_rest_is_zero() {
    let of = |model: &str, data: &[&str]| {
        let text = FILE.replace("distortion_model: plumb_bob\n", model);
        let text = text.replace("cols: 5", &format!("cols: {}", data.len()));
        CameraInfo::read(&text.replace("-0.21, 0.0625, 1.5e-03, -.001, 0.", &data.join(", ")))
    };
    let row = |count: usize| ["1", "2", "3", "4", "5", "6", "7", "8"].into_iter().chain(["0"; 6]).take(count);
    let eight = of("", &row(8).collect::<Vec<_>>()).unwrap().lens;
    for count in [12, 14] {
        for model in ["", "distortion_model: rational_polynomial\n"] {
            assert_eq!(of(model, &row(count).collect::<Vec<_>>()).unwrap().lens, eight);
        }
        let mut bent: Vec<_> = row(count).collect();
        bent[count - 1] = "0.01";
        let told = of("", &bent).unwrap_err().message;
        assert!(told.contains("thin prism") && told.contains(&format!("{count} entries")), "{told}");
    }
    let plain = ["-0.21", "0.0625", "1.5e-03", "-.001", "0."].into_iter().chain(["0"; 9]);
    let plain = of("distortion_model: plumb_bob\n", &plain.collect::<Vec<_>>()).unwrap().lens;
    assert_eq!(plain, CameraInfo::read(FILE).unwrap().lens);
    assert!(of("distortion_model: plumb_bob\n", &row(8).collect::<Vec<_>>()).is_err(), "a rational lens");
}

#[test]
fn what_is_wrong_is_told_with_its_line() {
    refused(&FILE.replace("640", "wide"), 1, &["image_width is `wide`", "whole number"]);
    refused(&FILE.replace("480", "0"), 2, &["image_height is 0", "1 to 65536"]);
    refused(&FILE.replace("image_height: 480\n", ""), 19, &["image_height is missing"]);
    refused(
        &FILE.replace("0, 0, 1]\ndis", "0, 1]\ndis"),
        7,
        &["camera_matrix.data has 8 entries, 3 rows of 3"],
    );
    refused(&FILE.replace("612.25, 0,", "612.25, 0.1,"), 4, &["camera_matrix", "without skew"]);
    refused(&FILE.replace("612.25", "long"), 7, &["camera_matrix.data", "`long` as entry 1"]);
    refused(&FILE.replace("612.25", ".nan"), 7, &["`.nan` as entry 1"]);
    refused(&FILE.replace("plumb_bob", "thin_prism"), 8, &["`thin_prism`", "equidistant"]);
    refused(&FILE.replace("plumb_bob", "rational_polynomial"), 9, &["has 5 entries", "has 8", "k6"]);
    refused(&FILE.replace("cols: 5", "cols: 4"), 12, &["has 5 entries, 1 rows of 4"]);
    refused(&FILE.replace("cols: 4", "cols: 3"), 20, &["projection_matrix.data has 12 entries"]);
    refused(&FILE.replace("camera_matrix:", "matrix:"), 20, &["camera_matrix is missing"]);
    refused(&FILE.replace("camera_name: narrow_left", "image_width: 3"), 3, &["image_width is given twice"]);
    refused("- 1\n- 2\n", 1, &["no calibration file"]);
    refused("", 1, &["no calibration file"]);
    refused("image_width: [", 2, &["not valid YAML"]);
    refused("a: &x [1, 2]\nb: *x\n", 2, &["refers to another part"]);
}

#[test]
fn numbers_and_names_are_those_of_every_reader() {
    for (value, text) in
        [(1.0, "1.0"), (-0.5, "-0.5"), (1e-7, "1.0e-7"), (2.5e-9, "2.5e-9"), (1e17, "1.0e+17")]
    {
        assert_eq!(yaml::number(value), text);
    }
    for (name, text) in
        [("left_2", "left_2"), ("no", "\"no\""), ("2", "\"2\""), ("a: b", "\"a: b\""), ("", "\"\"")]
    {
        assert_eq!(yaml::word(name), text);
    }
}

/// Doubling references ("a billion laughs"), and nesting without end.
#[test]
fn hostile_files_stay_small() {
    let mut laughs = String::from("a0: &a0 [x, x]\n");
    for i in 1..40 {
        laughs += &format!("a{i}: &a{i} [*a{0}, *a{0}]\n", i - 1);
    }
    CameraInfo::read(&laughs).unwrap_err();
    for deep in ["[", "{", "- ", "? ", "a: [", "{a: "] {
        CameraInfo::read(&deep.repeat(20_000)).unwrap_err();
    }
    let many: String = (0..10_000).map(|i| format!("k{i}: 1\n")).collect();
    refused(&many, 257, &["more than 256 keys"]);
    let long = format!("{FILE}rest: [{}]\n", "1, ".repeat(100_000));
    assert!(CameraInfo::read(&long).is_ok());
}

fn lens() -> impl Strategy<Value = Lens> {
    let value = || prop_oneof![-1.0..1.0f64, Just(0.0), -1e-12..1e-12f64, -1e20..1e20f64];
    (prop::sample::select(LensModel::ALL.to_vec()), prop::collection::vec(value(), 8)).prop_map(
        |(model, c)| {
            let at = |name: &str| model.coefficients().iter().position(|n| *n == name).unwrap();
            Lens::of(model, |name| c[at(name)])
        },
    )
}

proptest! {
    #[test]
    fn what_is_written_is_read(
        lens in lens(),
        camera_name in ".{0,20}",
        fx_px in 1e-3..1e6f64,
        cx_px in -1e5..1e5f64,
        rectification in prop::array::uniform9(-1.0..1.0f64),
        projection in prop::array::uniform12(-1e3..1e3f64),
    ) {
        let camera_name = camera_name.replace(|c: char| c.is_control(), " ");
        let intrinsics = Intrinsics { fx_px, cx_px, ..vga() };
        let info = CameraInfo { camera_name, intrinsics, lens, rectification, projection };
        let text = info.write();
        prop_assert_eq!(CameraInfo::read(&text), Ok(info), "{}", text);
    }

    #[test]
    fn damaged_files_do_not_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), "[ -~\n\t]|[&*!%@\"'{}\\[\\]:,#|>?-]"), 1..10),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut text: Vec<char> = FILE.chars().collect();
        for (at, c) in changes {
            let at = at.index(text.len());
            text[at] = c.chars().next().unwrap_or(' ');
        }
        let text: String = text.into_iter().take(cut.index(FILE.len()) + 1).collect();
        if let Err(error) = CameraInfo::read(&text) {
            prop_assert!((1..=text.lines().count() + 1).contains(&error.line), "{error}");
        }
    }
}

const OPENCV_YAML: &str = "%YAML:1.0\n---\ncalibration_time: \"Tue\"\nimage_width: 640\nimage_height: 480\nflags: 0\n\
    camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 6.5e+02, 0., 3.195e+02, 0., 6.6e+02,\n       2.395e+02, 0., 0., 1. ]\n\
    distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -1.0e-01, 2.0e-02, 1e-3, -2e-3, 0. ]\n\
    avg_reprojection_error: 0.3\n";
const OPENCV_XML: &str = "<?xml version=\"1.0\"?>\n<opencv_storage>\n<calibration_time>\"Tue\"</calibration_time>\n<image_width>640</image_width>\n\
    <image_height>480</image_height>\n<camera_matrix type_id=\"opencv-matrix\">\n<rows>3</rows>\n<cols>3</cols>\n<dt>d</dt>\n<data>\n\
    650. 0. 319.5 0. 660.\n    239.5 0. 0. 1.</data></camera_matrix>\n<distortion_coefficients type_id=\"opencv-matrix\">\n<rows>5</rows>\n\
    <cols>1</cols>\n<dt>d</dt>\n<data>\n    -0.1 0.02 1e-3 -2e-3 0.</data></distortion_coefficients>\n</opencv_storage>\n";
const VISP_XML: &str = "<?xml version=\"1.0\"?>\n<root>\n  <!--This file stores intrinsic camera parameters-->\n  <camera>\n    <name>Camera</name>\n\
    <image_width>640</image_width>\n    <image_height>480</image_height>\n    <model>\n      <type>perspectiveProjWithoutDistortion</type>\n\
    <px>648</px><py>658</py><u0>320</u0><v0>240</v0>\n    </model>\n    <model>\n      <type>perspectiveProjWithDistortion</type>\n\
    <px>650</px>\n<py>660</py>\n<u0>319.5</u0>\n<v0>239.5</v0>\n<kud>0.1</kud>\n<kdu>-0.1</kdu>\n    </model>\n  </camera>\n</root>\n";

#[test]
fn files_of_opencv_and_visp_are_read() {
    let intrinsics =
        Intrinsics { fx_px: 650.0, fy_px: 660.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    let of = |text: &str| CameraInfo::read(text).unwrap().camera().unwrap();
    for text in [OPENCV_YAML, OPENCV_XML] {
        let camera = of(text);
        assert_eq!(*camera.intrinsics(), intrinsics);
        let lens = Distortion { k1: -0.1, k2: 0.02, p1: 1e-3, p2: -2e-3, k3: 0.0 };
        assert_eq!(*camera.lens(), lens.into());
    }
    let camera = of(VISP_XML);
    assert_eq!(*camera.intrinsics(), intrinsics);
    // vpMeterPixelConversion::convertPointWithDistortion of ViSP: u = u0 + px x (1 + kud r^2).
    let (x, y) = (0.2, -0.15);
    let scale = 1.0 + 0.1 * (x * x + y * y);
    let seen = camera.project(&nalgebra::Point3::new(x, y, 1.0)).unwrap();
    assert!(
        (seen.x - (319.5 + 650.0 * x * scale)).abs() < 1e-9
            && (seen.y - (239.5 + 660.0 * y * scale)).abs() < 1e-9
    );
}

#[test]
fn what_such_files_lack_is_told() {
    let told = |text: &str| CameraInfo::read(text).unwrap_err().to_string();
    let four = OPENCV_YAML.replace("rows: 5", "rows: 4").replace("-2e-3, 0. ]", "-2e-3 ]");
    assert!(told(&four).contains("has 4 entries, which tell no model"), "{}", told(&four));
    let other = VISP_XML.replace("perspectiveProjWith", "ProjWithKannalaBrandt");
    assert!(told(&other).contains("line 4: has no <model> of type"), "{}", told(&other));
    let worded = VISP_XML.replace("<kud>0.1", "<kud>x");
    assert!(told(&worded).contains("line 18: <kud> is `x`, no number"), "{}", told(&worded));
    assert!(told("<a/>").contains("<opencv_storage> of OpenCV or <root> of ViSP"), "{}", told("<a/>"));
    assert!(told("<root>").contains("not valid XML"), "{}", told("<root>"));
    let two = VISP_XML.replace("</root>", "<camera/></root>");
    assert!(told(&two).contains("a second <camera>"), "{}", told(&two));
    let no_matrix = OPENCV_XML.replace("camera_matrix", "matrix");
    assert!(told(&no_matrix).contains("camera_matrix is missing"), "{}", told(&no_matrix));
}
