//! Figs. 10.1 to 10.4: a rendered scene of a dark and a lighter object on a light ground, processed as in Sect. 10.2.
//!
//! Everything is done by the steps of [`crate::pipeline`], as `vservo process` does them; the truth is the object's outline, projected.

use super::findings::{Findings, StepFigure};
use super::plot::{Panel, Series, Symbol, figure};
use super::{ExperimentError, feature_source};
use crate::geometry::Pose;
use crate::imaging::{ImageView, Moments};
use crate::pipeline::{Pipeline, StepOutcome};
use crate::scene::{Occluder, Renderer, SceneLook, SensorModel};
use crate::target::{Mark, Shape};
use crate::time::SpanNs;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// After Sect. 10.2.
const NAME: &str = "figures-10-2";
/// The dark object, m, chosen by hand: an angle piece, which no turn takes into itself, so that its axes are defined.
const OUTLINE_M: [[f64; 2]; 6] =
    [[-0.03, -0.07], [0.01, -0.07], [0.01, 0.03], [0.05, 0.03], [0.05, 0.06], [-0.03, 0.06]];
/// Levels in the order of Fig. 10.1, from left to right: the darkest object, the lightest one, the ground. Chosen by hand, so that the textbook's
/// threshold, 152, lies between the last two.
const LEVELS: [f64; 3] = [45.0, 125.0, 205.0];
/// One grey level of noise, so that the text's thresholds, 7.4 levels of the Roberts operator, stand above it.
const NOISE_SD_LEVELS: f64 = 1.0;
/// Thresholds of Fig. 10.3, from the textbook, on gradients that are normalized to 1 for white beside black.
const ROBERTS: &str = "roberts | magnitude | threshold:0.0146:normalized";
const SOBEL: &str = "sobel | magnitude | threshold:0.02:normalized";

/// A rendered image.
struct RenderedScene {
    pixels: Vec<u8>,
    /// Width and height, px.
    size: (usize, usize),
    /// Corners of the object's outline in the image, px, projected from its shape.
    outline: Vec<[f64; 2]>,
}

/// The scene and the object's outline in it.
fn scene() -> Result<RenderedScene, ExperimentError> {
    let failed = |cause: String| ExperimentError::Computation { experiment: NAME, cause };
    let camera = feature_source::camera()?;
    let corners = OUTLINE_M.map(Vector2::from);
    let shape = Shape::polygon(&corners, 0.01).map_err(|e| failed(e.to_string()))?;
    // a plate of the ground's own level is not seen
    let [dark, light, ground] = LEVELS;
    let look = SceneLook { background: ground, plate: ground, dots: dark };
    let sensor = SensorModel { noise_sd_levels: NOISE_SD_LEVELS, vignetting: 0.05, ..SensorModel::default() };
    let mark = shape.mark().clone();
    let mut renderer = Renderer::new(camera, shape, look, sensor).map_err(|e| failed(e.to_string()))?;
    renderer.occlude([Occluder {
        centre_m: Vector2::new(0.11, -0.02),
        size_m: Vector2::new(0.05, 0.09),
        height_m: 0.001,
        level: light,
        from: SpanNs::ZERO,
        until: SpanNs::from_s(1.0),
    }]);
    // a little aslant, the objects about the middle of the image
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.15, -0.1, 0.5));
    let X_CO = Pose::from_parts(Translation3::new(-0.04, 0.0, 0.45), turn);
    let i = *camera.intrinsics();
    let size = (i.width_px as usize, i.height_px as usize);
    let mut pixels = vec![0; size.0 * size.1];
    renderer.render(&[X_CO], 0, &mut pixels);
    let Mark::Polygon(loops) = mark else { return Err(failed("the mark is no polygon".into())) };
    let places = loops.iter().flat_map(|outline| outline.iter());
    let outline = places
        .map(|c| camera.project(&(X_CO * Point3::new(c.x, c.y, 0.0))).map(Into::into))
        .collect::<Option<Vec<_>>>();
    let outline = outline.ok_or_else(|| failed("the object is behind the camera".into()))?;
    Ok(RenderedScene { pixels, size, outline })
}

/// All four figures.
pub(super) fn figures() -> Result<Findings, ExperimentError> {
    let failed = |cause: String| ExperimentError::Computation { experiment: NAME, cause };
    let RenderedScene { pixels, size: (width, height), outline } = scene()?;
    let view = ImageView::new(&pixels, width, height).map_err(|e| failed(e.to_string()))?;
    let run = |steps: &str| -> Result<Vec<StepOutcome>, ExperimentError> {
        let pipeline = Pipeline::parse(steps).map_err(|e| failed(e.to_string()))?;
        pipeline.run(&view).map_err(|e| failed(e.to_string()))
    };
    let mut findings = Findings::default();

    // 10.1 and 10.2
    let steps = run("histogram:dark | threshold:valley | regions | moments | axes")?;
    let [histogram, binary, _, _, axes] = steps.as_slice() else {
        return Err(failed("steps are missing".into()));
    };
    let threshold = fact(histogram, "valley_threshold");
    let levels = histogram.table.as_ref().ok_or_else(|| failed("no histogram".into()))?;
    findings.table("histogram", levels.csv());
    findings.metric("threshold_level", threshold);
    let (background, object) = (fact(histogram, "background_level"), fact(histogram, "object_level"));
    findings.metric("background_mode_level", background);
    findings.metric("object_mode_level", object);
    let shares: Vec<_> = levels.column("level").into_iter().zip(levels.column("share")).collect();
    let most = shares.iter().fold(0.0f64, |m, s| m.max(s.1));
    let panel = Panel::new("", "grey level", "share of the pixels")
        .with(Series::new(Symbol::Bars, 0, shares.iter().copied().chain([(256.0, 0.0)])))
        .with(
            Series::new(Symbol::Dashed, 1, [(threshold + 0.5, 0.0), (threshold + 0.5, most)])
                .label("threshold"),
        );
    let says = format!(
        "Three modes: the dark object, the lighter one ({object:.0}) and the ground ({background:.0}); the valley beside the ground lies at {threshold:.0}."
    );
    findings.telling_figure(
        "figure-10-1-histogram",
        "Normalized histogram of the scene (Fig. 10.1): share of the pixels at each level",
        says,
        figure(1, [panel]),
    );
    findings.image(StepFigure {
        file: "figure-10-1.png".into(),
        title: "Scene (Fig. 10.1)".into(),
        says: "A dark and a lighter object on a light ground, rendered with noise of one grey level.".into(),
        drawn: crate::pipeline::ColourImage::of_image(&view),
    });
    findings.image(StepFigure {
        file: "figure-10-2.png".into(),
        title: "Binary image (Fig. 10.2)".into(),
        says: format!("At most {threshold:.0}: both objects, white."),
        drawn: binary.drawn.clone(),
    });

    // 10.3
    for (file, word, steps) in [("roberts", "Roberts", ROBERTS), ("sobel", "Sobel", SOBEL)] {
        let outcomes = run(steps)?;
        let edges = outcomes.last().ok_or_else(|| failed("no edges".into()))?;
        findings.metric(&format!("{file}_edge_pixels"), fact(edges, "object_pixels"));
        findings.image(StepFigure {
            file: format!("figure-10-3-{file}.png"),
            title: format!("Contours by the {word} operator (Fig. 10.3)"),
            says: format!("{steps}: {} pixels of edges.", fact(edges, "object_pixels")),
            drawn: edges.drawn.clone(),
        });
    }

    // 10.4: the dark object is the one whose centroid is the outline's
    let truth = Moments::of_polygon(&outline).ok_or_else(|| failed("the outline has no area".into()))?;
    let table = axes.table.as_ref().ok_or_else(|| failed("no axes".into()))?;
    findings.table("axes", table.csv());
    let (x, y) = (table.column("x_px"), table.column("y_px"));
    let far = |i: usize| Some((x.get(i)? - truth.x).hypot(y.get(i)? - truth.y));
    let own = (0..x.len()).min_by(|a, b| {
        let at = |i: usize| far(i).unwrap_or(f64::INFINITY);
        at(*a).total_cmp(&at(*b))
    });
    let own = own.ok_or_else(|| failed("there is no region".into()))?;
    let off_px = far(own).unwrap_or(f64::NAN);
    let alpha = table.column("axis_rad").get(own).copied().unwrap_or(f64::NAN);
    let wanted = truth.axis_rad().unwrap_or(f64::NAN);
    findings.metric("centroid_px", [x.get(own), y.get(own)]);
    findings.metric("centroid_error_px", off_px);
    findings.metric("alpha_rad", alpha);
    findings.metric("alpha_error_rad", alpha - wanted);
    findings.image(StepFigure {
        file: "figure-10-4.png".into(),
        title: "Regions, centroids and principal axes (Fig. 10.4)".into(),
        says: format!(
            "Of the dark object: centroid {off_px:.3} px and angle alpha {:.3} degrees from those of its projected outline.",
            (alpha - wanted).to_degrees().abs()
        ),
        drawn: axes.drawn.clone(),
    });
    findings.lines = vec![
        format!("threshold at the valley: {threshold:.0}, between the modes {object:.0} and {background:.0}"),
        format!(
            "dark object: centroid ({:.2}, {:.2}) px, off by {off_px:.3} px; alpha {:.2} degrees, off by {:.3}",
            x.get(own).copied().unwrap_or(f64::NAN),
            y.get(own).copied().unwrap_or(f64::NAN),
            alpha.to_degrees(),
            (alpha - wanted).to_degrees()
        ),
    ];
    Ok(findings)
}

fn fact(outcome: &StepOutcome, name: &str) -> f64 {
    outcome.facts.iter().find(|(n, _)| *n == name).map_or(f64::NAN, |(_, v)| *v)
}
