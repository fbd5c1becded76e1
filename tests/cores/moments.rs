//! Moments of real shapes: each is oriented as its name says, whichever way the moments are computed; contours of nested shapes.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use std::path::{Path, PathBuf};
use vservo::imaging::{
    Components, Connectivity, Contours, Histogram, ImageView, MomentSums, Moments, Nesting, Polarity, Runs,
    Window,
};

fn shared(folder: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(folder);
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: no ../shared");
    None
}

fn load(path: &Path) -> (Vec<u8>, usize, usize) {
    let image = image::open(path).unwrap().into_luma8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    (image.into_raw(), width, height)
}

/// Difference of two angles modulo `period`, degrees.
fn apart_deg(a: f64, b: f64, period: f64) -> f64 {
    let d = (a - b).rem_euclid(period);
    d.min(period - d)
}

/// The moments of the largest light region: of its pixels, of its borders, weighted with levels, of the polygon through its border.
fn ways(path: &Path) -> [(&'static str, Moments); 4] {
    let (pixels, width, height) = load(path);
    let image = ImageView::new(&pixels, width, height).unwrap();
    let window = Window::whole(&image);
    let threshold = Histogram::of(&image).otsu().unwrap().threshold;
    let (mut runs, mut components) = (Runs::with_limit(10_000), Components::with_limit(10_000));
    runs.binarize(&image, &window, threshold, Polarity::Light);
    components.find(&runs, &window, Connectivity::Eight);
    let list = components.as_slice();
    let largest = (0..list.len()).max_by_key(|&i| list[i].m00).unwrap();
    let region = components.sums(&runs, largest);
    let mut grey = Vec::new();
    components.grey_sums(&image, &runs, &mut grey);
    let mut contours = Contours::with_limits(10_000, 100_000);
    contours.find(&runs, Connectivity::Eight);
    let (mut borders, mut corners) = (MomentSums::default(), Vec::new());
    for contour in contours.as_slice().iter().filter(|c| c.region as usize == largest) {
        borders += MomentSums::of_border(contours.points(contour));
        if !contour.hole {
            corners.extend(contours.points(contour).iter().map(|p| [f64::from(p.x), f64::from(p.y)]));
        }
    }
    assert_eq!(borders, region, "{}", path.display());
    [
        ("region", region.central().unwrap()),
        ("borders", borders.central().unwrap()),
        ("grey", grey[largest].central().unwrap()),
        ("polygon", Moments::of_polygon(&corners).unwrap()),
    ]
}

#[test]
fn shapes_are_oriented_as_their_names_say() {
    let Some(folder) = shared("visp-moments") else { return };
    let (mut arrows, mut ellipses) = (0, 0);
    let mut names: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    for path in names.iter().filter(|p| p.extension().is_some_and(|e| e == "pgm")) {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let wanted: f64 = name.rsplit('-').next().unwrap().trim_end_matches("deg").parse().unwrap();
        for (way, m) in ways(path) {
            let (got, period) = if name.starts_with("arrow") {
                arrows += 1;
                assert!(apart_deg(m.skew_direction_rad().unwrap().to_degrees(), wanted, 360.0) < 1.0);
                (m.direction_rad(), 360.0)
            } else {
                ellipses += 1;
                assert_eq!(m.direction_rad(), None, "{name} {way}: {}", m.asymmetry());
                (m.axis_rad(), 180.0)
            };
            let error = apart_deg(got.unwrap().to_degrees(), wanted, period);
            println!("{name} by {way}: off by {error:.3} deg, asymmetry {:.4}", m.asymmetry());
            assert!(error < 1.0, "{name} {way}: {error}");
        }
    }
    assert_eq!((arrows, ellipses), (8 * 4, 4 * 4));
}

#[test]
fn nested_shapes_have_their_hierarchy() {
    let Some(folder) = shared("visp-blobs") else { return };
    for name in ["components.pgm", "contours_tree.pgm"] {
        let (pixels, width, height) = load(&folder.join(name));
        let image = ImageView::new(&pixels, width, height).unwrap();
        let window = Window::whole(&image);
        let (mut runs, mut nesting) = (Runs::with_limit(10_000), Nesting::with_limit(10_000));
        runs.binarize(&image, &window, 127, Polarity::Light);
        let mut contours = Contours::with_limits(10_000, 100_000);
        contours.find(&runs, Connectivity::Eight);
        // two bars; a frame, in it a frame, in it a plate with two holes
        let depths: Vec<u32> = contours.as_slice().iter().map(|c| c.depth).collect();
        assert_eq!(depths, [0, 0, 0, 1, 2, 3, 4, 5, 5], "{name}");
        let parents: Vec<_> = contours.as_slice().iter().map(|c| c.parent()).collect();
        assert_eq!(
            parents,
            [None, None, None, Some(2), Some(3), Some(4), Some(5), Some(6), Some(6)],
            "{name}"
        );
        nesting.find(&runs, Connectivity::Eight);
        let regions: Vec<_> = nesting.as_slice().iter().map(|n| (n.parent, n.holes)).collect();
        assert_eq!(regions, [(None, 0), (None, 0), (None, 1), (Some(2), 1), (Some(3), 2)], "{name}");
    }
}
