//! The stability condition after (10.91) against what happens: scheme D with a wrong depth, a wrong lens or a wrong mount, in six degrees
//! of freedom.
//!
//! The set-point is taught through the same wrong camera, so that the goal is an equilibrium whatever is wrong. At the goal and at the start the
//! margin is computed ([`StabilityMargin`]), and the camera is let go from near the goal and from the start. The condition of the text turns out to
//! be far from necessary; the eigenvalues of the same product tell what happens.
//!
//! The numbers here are the study's settings, chosen; its page tells them, and what it shows is shown for them.

use super::cell::POINTS;
use super::findings::Findings;
use super::plot::{Panel, Series, Symbol, figure};
use super::{ExperimentError, Options};
use crate::geometry::{Pose, integrate_body_twist, rotate_twist};
use crate::servo::{
    Gain, Interaction, Law, SetPoint, StabilityMargin, Task, View, error_motion, weighted_rows,
};
use nalgebra::{DVector, Point3, Rotation3, Vector3, Vector6};
use serde_json::json;

/// Depths, focal lengths and turns of the camera in the hand that are believed; the true ones are 1 and 0.
const DEPTH_RATIOS: [f64; 13] = [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 20.0];
const FOCAL_RATIOS: [f64; 11] = [0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0];
const TURNS_DEG: [f64; 13] =
    [0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0, 95.0, 105.0, 120.0, 135.0, 150.0, 180.0];
/// The law is computed so often, with the gain 1/s, for so long.
const STEP_S: f64 = 0.02;
const SPAN_S: f64 = 200.0;
/// Errors this much smaller than at the beginning have died out.
const DIED_OUT: f64 = 1e-3;
/// Errors this much larger, or a camera this far away, m, have no end.
const GROWN: f64 = 1e3;
/// Half a difference, m or rad.
const STEP: f64 = 1e-5;

/// What is wrong with the law's knowledge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrongKnowledge {
    /// Believed size of the target over the true one: the ratio of all depths.
    pub depth_ratio: f64,
    /// Believed focal length over the true one.
    pub focal_ratio: f64,
    /// How the camera is turned in the hand against what is believed: axis times angle, rad.
    pub turn_rad: Vector3<f64>,
}

impl WrongKnowledge {
    /// Nothing is wrong.
    pub const NONE: Self = Self { depth_ratio: 1.0, focal_ratio: 1.0, turn_rad: Vector3::new(0.0, 0.0, 0.0) };
}

/// What became of one error of knowledge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StabilityFinding {
    /// The margin at the goal and at the start; `None` where a law has none.
    pub margin: [Option<StabilityMargin>; 2],
    /// Whether errors die out from near the goal, and from the start.
    pub dies_out: [bool; 2],
}

impl StabilityFinding {
    /// Share of the gain at which the slowest error near the goal falls.
    #[must_use]
    pub fn slowest(&self) -> Option<f64> {
        self.margin[0].map(|margin| margin.slowest)
    }
}

/// The desired pose of the square.
fn goal() -> Pose {
    Pose::new(Vector3::new(-0.04, -0.06, 0.5), Vector3::new(0.25, -0.15, 0.2))
}

/// A pose beside it: all six motions have a part, here so much.
fn beside(share: f64) -> Pose {
    let V = Vector6::new(0.08, -0.06, 0.15, 0.15, -0.2, 0.35);
    integrate_body_twist(&Pose::identity(), &V, share) * goal()
}

struct StudiedLoop {
    wrong: WrongKnowledge,
    set_point: SetPoint,
    law: Law,
    interaction: Interaction,
}

impl StudiedLoop {
    fn new(wrong: WrongKnowledge) -> Result<Self, ExperimentError> {
        let fail = || ExperimentError::Cell { cause: "the goal is not seen".into() };
        let interaction = Interaction::TEXTBOOK;
        let law = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction };
        let seen = view(&goal(), wrong.focal_ratio).ok_or_else(fail)?;
        let points = POINTS.map(|p| Point3::from(p.coords * wrong.depth_ratio));
        let set_point =
            SetPoint::from_features(seen.features(), &points, goal().translation.z * wrong.depth_ratio)
                .ok_or_else(fail)?;
        Ok(Self { wrong, set_point, law, interaction })
    }

    /// The object after the camera has moved for `dt` as the law asks of the camera that it believes in.
    fn moved(&self, X_CO: &Pose, V: &Vector6<f64>, dt: f64) -> Pose {
        let R = Rotation3::from_scaled_axis(self.wrong.turn_rad);
        integrate_body_twist(&Pose::identity(), &rotate_twist(&R, V), dt).inverse() * X_CO
    }

    fn margin(&self, X_CO: &Pose) -> Option<StabilityMargin> {
        let error = |X_CO: &Pose| -> Option<DVector<f64>> {
            let seen = view(X_CO, self.wrong.focal_ratio)?;
            weighted_rows(&self.set_point, &seen, self.interaction).map(|(_, e)| e)
        };
        let motion = error_motion(6, STEP, |j, step| {
            let V = Vector6::from_fn(|i, _| if i == j { 1.0 } else { 0.0 });
            error(&self.moved(X_CO, &V, step))
        })?;
        let seen = view(X_CO, self.wrong.focal_ratio)?;
        let (L, _) = weighted_rows(&self.set_point, &seen, self.interaction)?;
        StabilityMargin::of(&motion, &L)
    }

    fn dies_out(&self, start: Pose) -> bool {
        let mut X_CO = start;
        let mut first = None;
        for _ in 0..(SPAN_S / STEP_S) as usize {
            let Some(seen) = view(&X_CO, self.wrong.focal_ratio) else { return false };
            let Ok(Task::Twist(task)) = self.law.task(&self.set_point, &seen) else { return false };
            let first = *first.get_or_insert(task.error);
            if task.error < DIED_OUT * first {
                // an error that is small while the camera is elsewhere is another equilibrium
                return (goal().inv_mul(&X_CO)).translation.vector.norm()
                    < (goal().inv_mul(&start)).translation.vector.norm();
            }
            let Some(V) = task.twist(1.0) else { return false };
            if task.error > GROWN * first || !(X_CO.translation.vector.norm() < GROWN) {
                return false;
            }
            X_CO = self.moved(&X_CO, &V, STEP_S);
        }
        false
    }
}

/// What the camera sees, as a law believes that takes its focal length for so much longer.
fn view(X_CO: &Pose, focal_ratio: f64) -> Option<View> {
    let points: Vec<_> = POINTS.iter().map(|p| X_CO * p).collect();
    let before = points.iter().all(|p| p.z > 0.0);
    before.then(|| View::new(points.iter().map(|p| p.coords.xy() / (p.z * focal_ratio)), None)).flatten()
}

/// The margins, and whether errors die out, with what is `wrong`.
///
/// # Errors
/// [`ExperimentError::Cell`] when the goal is not seen.
pub fn stability_of(wrong: WrongKnowledge) -> Result<StabilityFinding, ExperimentError> {
    let studied = StudiedLoop::new(wrong)?;
    let places = [beside(0.02), beside(1.0)];
    Ok(StabilityFinding {
        margin: [studied.margin(&goal()), studied.margin(&beside(1.0))],
        dies_out: places.map(|place| studied.dies_out(place)),
    })
}

/// A kind of error of what is believed.
struct KnowledgeError {
    name: &'static str,
    /// Axis of the figure.
    axis: &'static str,
    /// Each value, and what is wrong with it.
    cases: Vec<(f64, WrongKnowledge)>,
}

fn kinds() -> [KnowledgeError; 4] {
    let none = WrongKnowledge::NONE;
    let turned = |axis: Vector3<f64>| {
        let of = |deg: f64| (deg, WrongKnowledge { turn_rad: axis * deg.to_radians(), ..none });
        TURNS_DEG.map(of).to_vec()
    };
    let depths = DEPTH_RATIOS.map(|r| (r, WrongKnowledge { depth_ratio: r, ..none }));
    let lenses = FOCAL_RATIOS.map(|r| (r, WrongKnowledge { focal_ratio: r, ..none }));
    let [z, x] = [Vector3::z(), Vector3::x()];
    [
        KnowledgeError { name: "depth", axis: "believed depth / true depth", cases: depths.to_vec() },
        KnowledgeError { name: "lens", axis: "believed focal length / true one", cases: lenses.to_vec() },
        KnowledgeError {
            name: "mount_about_z",
            axis: "turn of the camera about its axis [deg]",
            cases: turned(z),
        },
        KnowledgeError {
            name: "mount_about_x",
            axis: "turn of the camera across its axis [deg]",
            cases: turned(x),
        },
    ]
}

pub(super) fn stability(options: &Options<'_>) -> Result<Findings, ExperimentError> {
    let mut out = Findings::default();
    let mut table = String::from(
        "error,value,definite_at_goal,definite_at_start,slowest_at_goal,dies_out_near,dies_out_far\n",
    );
    let (mut entries, mut panels) = (Vec::new(), Vec::new());
    for KnowledgeError { name, axis, cases } in kinds() {
        let mut found = Vec::new();
        for (value, wrong) in cases {
            (options.progress)(&format!("{name} {value}"));
            found.push((value, stability_of(wrong)?));
        }
        for (value, finding) in &found {
            let number = |m: Option<f64>| m.map_or_else(String::new, |m| format!("{m:.9}"));
            let [goal, start] = finding.margin.map(|m| number(m.map(|m| m.definite)));
            let slowest = number(finding.slowest());
            let [near, far] = finding.dies_out;
            table += &format!("{name},{value},{goal},{start},{slowest},{near},{far}\n");
        }
        let range = |fits: &dyn Fn(&StabilityFinding) -> bool| {
            let values = || found.iter().filter(|(_, finding)| fits(finding)).map(|(value, _)| *value);
            [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
        };
        let definite = range(&|finding| finding.margin[0].is_some_and(|m| m.definite > 0.0));
        let stable = range(&|finding| finding.slowest().is_some_and(|slowest| slowest > 0.0));
        let [near, far] = [0, 1].map(|k| range(&|finding| finding.dies_out[k]));
        out.lines.push(format!(
            "{name:14} positive definite at the goal from {} to {}, eigenvalues positive from {} to {}; errors die out near it from {} to {}, from \
             the start from {} to {}",
            definite[0], definite[1], stable[0], stable[1], near[0], near[1], far[0], far[1]
        ));
        entries.push(json!({
            "error": name, "positive_definite": definite, "positive_eigenvalues": stable, "dies_out_near": near, "dies_out_far": far,
        }));
        let line = |of: &dyn Fn(&StabilityFinding) -> Option<f64>| {
            found.iter().filter_map(|(value, f)| Some((*value, of(f)?))).collect::<Vec<_>>()
        };
        let mut panel = Panel::new(name, axis, "at the goal [-]")
            .with(
                Series::line(0, line(&|f| Some(f.margin[0]?.definite)))
                    .label("smallest eigenvalue, symmetric part"),
            )
            .with(
                Series::line(1, line(&StabilityFinding::slowest))
                    .label("smallest real part of an eigenvalue"),
            );
        for (k, label) in [(0, "does not die out near the goal"), (1, "does not from the start")] {
            let marks = line(&|f| f.slowest().filter(|_| !f.dies_out[k]));
            if !marks.is_empty() {
                panel.push(
                    Series::new(if k == 0 { Symbol::Cross } else { Symbol::Circle }, k + 2, marks)
                        .label(label),
                );
            }
        }
        panels.push(panel);
    }
    out.metric("errors", entries);
    out.table("stability", table);
    out.figure(
        "stability",
        "L_s times the inverse of its estimate, under scheme D with wrong knowledge: where its eigenvalues are positive errors die out, long after it \
         has ceased to be positive definite.",
        figure(2, panels),
    );
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text's condition is enough, the eigenvalues' is exact: errors near the goal die out where they are positive, and nowhere else.
    #[test]
    fn the_eigenvalues_decide_and_the_condition_is_enough() {
        let (mut lost, mut indefinite) = (0, 0);
        for KnowledgeError { name, cases, .. } in kinds() {
            for (value, wrong) in cases {
                let StabilityFinding { margin: [margin, _], dies_out: [near, _] } =
                    stability_of(wrong).unwrap();
                let StabilityMargin { definite, slowest } = margin.unwrap();
                assert_eq!(near, slowest > 0.0, "{name} {value}: {slowest}");
                assert!(near || definite <= 0.0, "{name} {value}: {definite}");
                lost += usize::from(!near);
                indefinite += usize::from(near && definite <= 0.0);
            }
        }
        assert!(lost > 5 && indefinite > 5, "{lost} do not die out, {indefinite} do without the condition");
    }

    #[test]
    fn exact_knowledge_has_margin_one_and_a_turned_camera_is_lost() {
        let exact = stability_of(WrongKnowledge::NONE).unwrap();
        let StabilityMargin { definite, slowest } = exact.margin[0].unwrap();
        assert!((definite - 1.0).abs() < 1e-5 && (slowest - 1.0).abs() < 1e-5, "{exact:?}");
        assert_eq!(exact.dies_out, [true, true]);
        for axis in [Vector3::z(), Vector3::x()] {
            let turned = |deg: f64| {
                stability_of(WrongKnowledge { turn_rad: axis * deg.to_radians(), ..WrongKnowledge::NONE })
                    .unwrap()
            };
            assert!(turned(100.0).slowest().unwrap() < 0.0 && !turned(100.0).dies_out[0], "{axis}");
        }
    }

    /// Known without the matrices: depths of r times the truth make translations r times as fast and leave rotations, and velocities that come
    /// out turned by an angle act along what was meant by its cosine.
    #[test]
    fn depths_act_by_their_ratio_and_turns_by_their_cosine() {
        for ratio in [0.3, 0.8, 3.0, 20.0_f64] {
            let found = stability_of(WrongKnowledge { depth_ratio: ratio, ..WrongKnowledge::NONE }).unwrap();
            assert!((found.slowest().unwrap() - ratio.min(1.0)).abs() < 1e-5, "{ratio}: {found:?}");
            assert!(found.margin[1].is_some(), "{ratio}");
        }
        for (axis, deg) in
            [(Vector3::z(), 40.0_f64), (Vector3::x(), 130.0), (Vector3::new(0.6, 0.0, 0.8), 70.0)]
        {
            let turn_rad = axis * deg.to_radians();
            let found = stability_of(WrongKnowledge { turn_rad, ..WrongKnowledge::NONE }).unwrap();
            assert!(
                (found.slowest().unwrap() - deg.to_radians().cos()).abs() < 1e-5,
                "{axis} {deg}: {found:?}"
            );
        }
    }
}
