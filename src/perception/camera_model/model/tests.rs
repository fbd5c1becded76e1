use super::super::LensModel;
use super::super::{Distortion, Equidistant, RationalPolynomial};
use super::*;
use proptest::prelude::*;

const VGA: Intrinsics =
    Intrinsics { fx_px: 600.0, fy_px: 610.0, cx_px: 322.5, cy_px: 238.0, width_px: 640, height_px: 480 };

fn ideal() -> CameraModel {
    CameraModel::new(VGA, Distortion::default()).unwrap()
}

#[test]
fn ideal_camera_is_5_45() {
    let px = ideal().project(&Point3::new(0.1, -0.05, 0.5)).unwrap();
    assert!((px - Vector2::new(322.5 + 120.0, 238.0 - 61.0)).norm() < 1e-12);
    assert!(ideal().project(&Point3::new(0.1, 0.0, -0.5)).is_none());
    assert!(ideal().project(&Point3::new(0.1, 0.0, 0.0)).is_none());
    assert!(ideal().project(&Point3::new(0.1, 0.0, f64::NAN)).is_none());
}

/// Value computed by hand from the definition in OpenCV's documentation.
#[test]
fn distortion_follows_the_plumb_bob_definition() {
    let d = Distortion { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.002, k3: 0.01 };
    let s = d.apply(&Vector2::new(0.3, -0.4));
    let radial = 1.0 - 0.2 * 0.25 + 0.05 * 0.0625 + 0.01 * 0.015625;
    let x = 0.3 * radial + 2.0 * 0.001 * 0.3 * -0.4 - 0.002 * (0.25 + 2.0 * 0.09);
    let y = -0.4 * radial + 0.001 * (0.25 + 2.0 * 0.16) + 2.0 * -0.002 * 0.3 * -0.4;
    assert!((s - Vector2::new(x, y)).norm() < 1e-15);
}

#[test]
fn folding_distortion_is_refused_with_the_pixel() {
    let d = Distortion { k1: -0.9, ..Distortion::default() };
    let error = CameraModel::new(Intrinsics { fx_px: 300.0, fy_px: 300.0, ..VGA }, d).unwrap_err();
    assert!(
        matches!(error, CameraModelError::Folded { fold_radius, .. } if (fold_radius - 0.4057).abs() < 1e-3),
        "{error}"
    );
    // the same lens is fine on a camera that sees only its middle
    assert!(CameraModel::new(Intrinsics { fx_px: 1500.0, fy_px: 1500.0, ..VGA }, d).is_ok());
    // strong tangential parts fold too
    let d = Distortion { p1: 0.9, ..Distortion::default() };
    assert!(CameraModel::new(VGA, d).is_err());
}

#[test]
fn points_beyond_the_fold_are_not_in_the_image() {
    let d = Distortion { k1: -0.2, ..Distortion::default() };
    let model = CameraModel::new(VGA, d).unwrap();
    // r = 2.236 is a zero of 1 + k1 r^2: the polynomial alone would put it on the principal point
    assert!(model.project(&Point3::new(5f64.sqrt(), 0.0, 1.0)).is_none());
    assert!(model.project(&Point3::new(0.5, 0.0, 1.0)).is_some());
}

#[test]
fn nonsense_is_refused() {
    for bad in [
        Intrinsics { fx_px: f64::NAN, ..VGA },
        Intrinsics { fy_px: 0.0, ..VGA },
        Intrinsics { fx_px: -600.0, ..VGA },
        Intrinsics { cx_px: f64::INFINITY, ..VGA },
        Intrinsics { width_px: 0, ..VGA },
        Intrinsics { height_px: 70_000, ..VGA },
    ] {
        assert!(CameraModel::new(bad, Distortion::default()).is_err(), "{bad:?}");
    }
    assert!(CameraModel::new(VGA, Distortion { k3: f64::NAN, ..Distortion::default() }).is_err());
}

#[test]
fn contains_counts_from_the_outer_edges() {
    let m = ideal();
    assert!(m.contains(&Vector2::new(-0.5, -0.5), 0.0));
    assert!(!m.contains(&Vector2::new(-0.6, 0.0), 0.0));
    assert!(m.contains(&Vector2::new(639.5, 479.5), 0.0));
    assert!(!m.contains(&Vector2::new(639.5, 479.5), 1.0));
    assert!(!m.contains(&Vector2::new(f64::NAN, 3.0), 0.0));
}

/// Of every model: the derivative by each coefficient against differences.
#[test]
fn derivatives_by_coefficients_are_those_of_differences() {
    let values = [-0.21, 0.06, 0.002, -0.003, -0.01, 0.04, 0.02, 0.005];
    for model in LensModel::ALL {
        let names = model.coefficients();
        let lens = |moved: usize, by: f64| {
            let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
            Lens::of(model, |name| values[at(name)] + if at(name) == moved { by } else { 0.0 })
        };
        for s in [[0.0, 0.0], [1e-5, -2e-5], [0.3, -0.2], [-0.7, 0.5]].map(Vector2::from) {
            let columns = lens(0, 0.0).by_coefficients(&s);
            for (i, column) in columns.iter().enumerate() {
                let h = 1e-5;
                let difference = (lens(i, h).apply(&s) - lens(i, -h).apply(&s)) / (2.0 * h);
                assert!(
                    (column - difference).norm() < 1e-9,
                    "{} of {}: {column} {difference}",
                    i,
                    model.name()
                );
            }
        }
    }
}

proptest! {
    #[test]
    fn normalized_of_inverts_pixel_of(
        u in -0.5..639.5f64, v in -0.5..479.5f64,
        k1 in -0.3..0.3f64, k2 in -0.1..0.1f64, p1 in -0.005..0.005f64, p2 in -0.005..0.005f64, k3 in -0.05..0.05f64,
    ) {
        let model = CameraModel::new(VGA, Distortion { k1, k2, p1, p2, k3 });
        prop_assume!(model.is_ok());
        let model = model.unwrap();
        let px = Vector2::new(u, v);
        let s = model.normalized_of(&px);
        prop_assert!((model.pixel_of(&s) - px).norm() < 1e-9);
        // the other way round, in normalized units
        prop_assert!((model.normalized_of(&model.pixel_of(&s)) - s).norm() < 1e-12);
    }

    #[test]
    fn jacobian_agrees_with_finite_differences(
        x in -0.6..0.6f64, y in -0.5..0.5f64,
        k1 in -0.3..0.3f64, k2 in -0.1..0.1f64, p1 in -0.01..0.01f64, p2 in -0.01..0.01f64, k3 in -0.05..0.05f64,
    ) {
        let model = CameraModel { lens: Distortion { k1, k2, p1, p2, k3 }.into(), ideal: false, ..ideal() };
        let s = Vector2::new(x, y);
        let J = model.pixel_jacobian(&s);
        let h = 1e-6;
        for (column, axis) in [(0, Vector2::x()), (1, Vector2::y())] {
            let difference = (model.pixel_of(&(s + axis * h)) - model.pixel_of(&(s - axis * h))) / (2.0 * h);
            prop_assert!((difference - J.column(column)).norm() < 1e-5, "{difference} {J}");
        }
    }

    #[test]
    fn wild_parameters_never_panic(
        k1 in -1e3..1e3f64, k2 in -1e3..1e3f64, p1 in -10.0..10.0f64, p2 in -10.0..10.0f64, k3 in -1e3..1e3f64,
        u in -1e6..1e6f64, v in -1e6..1e6f64,
    ) {
        if let Ok(model) = CameraModel::new(VGA, Distortion { k1, k2, p1, p2, k3 }) {
            let _ = model.normalized_of(&Vector2::new(u, v));
        }
    }
}

/// Computed by OpenCV 5.0.0: `cv2.projectPoints` with eight coefficients, `cv2.fisheye.projectPoints` with four.
#[test]
fn wide_lenses_are_those_of_opencv() {
    let points = [[0.3, -0.4], [1.2, 0.7], [-0.8, 0.05], [2.5, -2.0], [8.0, -7.5]];
    let rational = RationalPolynomial {
        k1: 0.35,
        k2: 0.12,
        p1: 0.001,
        p2: -0.002,
        k3: 0.01,
        k4: 0.7,
        k5: 0.25,
        k6: 0.03,
    };
    let rational_px = [
        [487.3417709563164, 14.293654925882208],
        [769.422456573499, 505.60066244011676],
        [-72.56909732251415, 263.4462832673681],
        [917.6273952849248, -249.7884481650721],
    ];
    let equidistant = Equidistant { k1: -0.03, k2: 0.006, k3: -0.002, k4: 0.0004 };
    let equidistant_px = [
        [488.37981056773367, 13.140701230405455],
        [801.8308688926122, 522.2698347460353],
        [-77.0197062814641, 263.38614800330134],
        [893.814841136453, -226.66940412431507],
        [938.7009825220134, -349.31656146629405],
    ];
    for (lens, px) in
        [(Lens::from(rational), rational_px.as_slice()), (Lens::from(equidistant), &equidistant_px)]
    {
        let model = CameraModel::new(VGA, lens).unwrap();
        for (s, px) in points.iter().zip(px) {
            let off = model.pixel_of(&Vector2::from(*s)) - Vector2::from(*px);
            assert!(off.norm() < 1e-9, "{lens:?} {s:?}: {off}");
        }
    }
}

/// A fisheye that sees 85 degrees from its axis in the corners of the image.
#[test]
fn wide_views_keep_their_directions() {
    let equidistant = Equidistant { k1: -0.01, k2: 0.002, ..Equidistant::default() };
    let wide = Intrinsics { fx_px: 268.0, fy_px: 268.0, cx_px: 319.5, cy_px: 239.5, ..VGA };
    let model = CameraModel::new(wide, equidistant).unwrap();
    let corner = model.normalized_of(&Vector2::zeros());
    assert!(corner.norm().atan().to_degrees() > 84.5, "{}", corner.norm().atan().to_degrees());
    for i in 0..=64 {
        for j in 0..=48 {
            let px = Vector2::new(f64::from(i), f64::from(j)) * 10.0 - Vector2::repeat(0.5);
            let s = model.normalized_of(&px);
            assert!((model.pixel_of(&s) - px).norm() < 1e-10, "{px} {s}");
            let point = Point3::new(2.0 * s.x, 2.0 * s.y, 2.0);
            assert!((model.project(&point).unwrap() - px).norm() < 1e-9);
        }
    }
    // a longer sensor would see behind the camera
    let wider = Intrinsics { fx_px: 240.0, fy_px: 240.0, ..wide };
    assert!(matches!(CameraModel::new(wider, equidistant), Err(CameraModelError::Folded { .. })));
}

#[test]
fn lenses_that_fold_are_refused() {
    let wide = Intrinsics { fx_px: 200.0, fy_px: 200.0, ..VGA };
    for lens in [
        // the factor's pole lies in the image, at r = 1
        Lens::from(RationalPolynomial { k4: -1.0, ..RationalPolynomial::default() }),
        RationalPolynomial { k4: 1.0, ..RationalPolynomial::default() }.into(),
        Equidistant { k1: -0.3, ..Equidistant::default() }.into(),
    ] {
        let error = CameraModel::new(wide, lens).unwrap_err();
        assert!(matches!(error, CameraModelError::Folded { .. }), "{lens:?} {error}");
        assert!(CameraModel::new(Intrinsics { fx_px: 2000.0, fy_px: 2000.0, ..VGA }, lens).is_ok());
    }
    let lens = Equidistant { k4: f64::NAN, ..Equidistant::default() };
    assert!(matches!(CameraModel::new(VGA, lens), Err(CameraModelError::NotFinite { name: "k4", .. })));
    for absurd in [1e308, 1e8, -1e308] {
        let long = CameraModel::new(Intrinsics { fx_px: absurd, ..VGA }, Distortion::default());
        assert!(matches!(long, Err(CameraModelError::FocalLength { name: "fx_px", .. })), "{absurd}");
        let far = CameraModel::new(Intrinsics { cy_px: absurd, ..VGA }, Distortion::default());
        assert!(matches!(far, Err(CameraModelError::NotFinite { name: "cy_px", .. })), "{absurd}");
    }
}

#[test]
fn a_region_has_the_same_directions() {
    let lens = RationalPolynomial { k1: 0.2, k4: 0.6, k5: 0.1, p1: 0.002, ..RationalPolynomial::default() };
    let whole = CameraModel::new(VGA, lens).unwrap();
    let region = Region { x_px: 100, y_px: 40, width_px: 320, height_px: 240 };
    let part = whole.cropped(&region).unwrap();
    assert_eq!((part.intrinsics().width_px, part.intrinsics().height_px), (320, 240));
    assert_eq!((part.region(), part.full_size_px()), (&region, (640, 480)));
    let corner = Vector2::new(100.0, 40.0);
    for px in [Vector2::new(0.0, 0.0), Vector2::new(319.0, 12.5), Vector2::new(150.0, 239.0)] {
        assert!((part.normalized_of(&px) - whole.normalized_of(&(px + corner))).norm() < 1e-14);
    }
    // a part of a part is counted from the whole
    let whole_again = part.cropped(&Region::whole(640, 480)).unwrap();
    assert_eq!(whole_again.intrinsics(), whole.intrinsics());
    for bad in [
        Region { x_px: 321, ..region },
        Region { y_px: u32::MAX, ..region },
        Region { width_px: 0, ..region },
    ] {
        let error = whole.cropped(&bad).unwrap_err().to_string();
        assert!(error.contains("is not inside the image of 640x480 px"), "{error}");
    }
}

fn wide_lens() -> impl Strategy<Value = Lens> {
    let rational = prop::array::uniform8(-0.4..0.4f64).prop_map(|c| {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = c;
        let (p1, p2) = (0.02 * p1, 0.02 * p2);
        RationalPolynomial { k1, k2: 0.3 * k2, p1, p2, k3: 0.1 * k3, k4, k5: 0.3 * k5, k6: 0.1 * k6 }.into()
    });
    let equidistant = prop::array::uniform4(-0.1..0.1f64).prop_map(|c| {
        let [k1, k2, k3, k4] = c;
        Equidistant { k1, k2: 0.3 * k2, k3: 0.1 * k3, k4: 0.03 * k4 }.into()
    });
    prop_oneof![rational, equidistant]
}

proptest! {
    #[test]
    fn wide_lenses_are_inverted(lens in wide_lens(), u in -0.5..639.5f64, v in -0.5..479.5f64, f in 270.0..900.0f64) {
        let model = CameraModel::new(Intrinsics { fx_px: f, fy_px: 1.1 * f, ..VGA }, lens);
        prop_assume!(model.is_ok());
        let model = model.unwrap();
        let px = Vector2::new(u, v);
        let s = model.normalized_of(&px);
        let d = model.lens().apply(&s) - model.plane_of(&px);
        prop_assert!(d.norm() < 1e-12, "{d}");
    }

    #[test]
    fn wide_jacobians_agree_with_finite_differences(lens in wide_lens(), x in -0.9..0.9f64, y in -0.8..0.8f64) {
        let s = Vector2::new(x, y);
        let J = lens.jacobian(&s);
        let h = 1e-6;
        for (column, axis) in [(0, Vector2::x()), (1, Vector2::y())] {
            let difference = (lens.apply(&(s + axis * h)) - lens.apply(&(s - axis * h))) / (2.0 * h);
            let scale = 1.0 + J.norm() * J.norm();
            prop_assert!((difference - J.column(column)).norm() < 1e-6 * scale, "{difference} {J}");
        }
    }

    #[test]
    fn wild_lenses_never_panic(c in prop::array::uniform8(-1e3..1e3f64), which in 0usize..3, u in -1e6..1e6f64) {
        let model = LensModel::ALL[which];
        let value = |name: &str| {
            model.coefficients().iter().position(|n| *n == name).map_or(0.0, |i| c[i])
        };
        if let Ok(model) = CameraModel::new(VGA, Lens::of(model, value)) {
            let _ = model.normalized_of(&Vector2::new(u, -u));
        }
    }
}

/// Near the axis and on it, where the formula is 0 / 0.
#[test]
fn equidistant_is_smooth_at_the_axis() {
    let lens = Lens::from(Equidistant { k1: 0.1, ..Equidistant::default() });
    for r in [0.0f64, 1e-9, 9.9e-5, 1.01e-4, 1e-3] {
        let s = Vector2::new(0.6 * r, 0.8 * r);
        let theta = r.atan();
        let wanted = theta * (1.0 + 0.1 * theta * theta);
        assert!((lens.apply(&s).norm() - wanted).abs() < 1e-15, "{r}");
        let J = lens.jacobian(&s);
        assert!((J - Matrix2::identity()).norm() < 2.0 * r * r + 1e-15, "{r} {J}");
        let (back, rest) = lens.undistort(&lens.apply(&s), f64::INFINITY);
        assert!((back - s).norm() < 1e-15 && rest < 1e-15, "{r}");
    }
}
