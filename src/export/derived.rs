//! What viewers know by themselves, from the records of a run: transforms, joint states, calibrations, annotations of images, a log.
//!
//! Frames of the transforms are those of `docs/frames.md`: `base` (B), the links by the names of the robot file, `flange` (E), `camera_N` (C), `target` (O) and
//! `goal` (D).

use super::cdr::CdrOutput;
use super::derived_message::{
    AnnotationColour, BASE, DerivedMessage, FLANGE, camera_frame, target_and_goal, target_frame,
};
use super::scene::scene;
use crate::config::Config;
use crate::control::lifecycle::Request;
use crate::control::safety::Fault;
use crate::control::trace::event_words;
use crate::geometry::Pose;
use crate::messages::{
    CameraId, CommandForm, ControlState, FrameHeader, JointState, Measurement, RequestMsg, TargetStatus,
    TraceMsg,
};
use crate::robot::Mount;
use crate::time::{MonoNs, SpanNs};
use nalgebra::{Quaternion, UnitQuaternion, Vector2};
use std::collections::BTreeMap;

/// Period of joint states and transforms. Chosen by hand: viewers draw a hundred a second at most, and all 1000 stand on `/control/joint_state`.
const PERIOD: SpanNs = SpanNs(10_000_000);
/// Diameter of the signs in an image, px. Chosen by hand, to be seen and to hide little.
const SIGN_PX: f64 = 12.0;
/// Width of their lines, px. Chosen by hand, for the same.
const LINE_PX: f64 = 2.0;
/// Levels of `rcl_interfaces/Log`, as its definition has them.
const INFO: u8 = 20;
const WARN: u8 = 30;
const ERROR: u8 = 40;

/// Colours of points that were seen, of where they are to be, and none. Chosen by hand, to be told apart also by those who do not see red from green.
const SEEN: AnnotationColour = [1.0, 0.75, 0.0, 1.0];
const WANTED: AnnotationColour = [0.2, 0.6, 1.0, 1.0];
const NOTHING: AnnotationColour = [0.0; 4];

/// Makes them as the records of a run pass by.
#[derive(Debug)]
pub struct DerivedMessages {
    config: Config,
    next: MonoNs,
    before: Option<(u32, u32)>,
    /// What the first camera sees, and a second one that controls the arm too.
    first: CameraView,
    second: Option<CameraView>,
}

/// What one camera sees and is to see.
#[derive(Debug)]
struct CameraView {
    /// The run as this camera has it.
    cell: Config,
    /// Where each point of the goal is to be, px; `None` where it is not known.
    goal_px: Option<BTreeMap<u32, Vector2<f64>>>,
    target: TargetStatus,
    /// Number of the target that the goal is of.
    target_number: u32,
}

impl CameraView {
    fn new(cell: Config) -> Self {
        let mut view = Self { cell, goal_px: None, target: TargetStatus::Found, target_number: 0 };
        if !view.cell.goal.is_taught && view.cell.stereo.is_none() {
            let set_point = &view.cell.set_point;
            let features = set_point.features().iter().map(|s| (*s).into());
            let points: Vec<_> = set_point.ids().iter().copied().zip(features).collect();
            view.set_goal(points.into_iter());
        }
        view
    }

    fn set_goal(&mut self, features: impl Iterator<Item = (u32, [f64; 2])>) {
        let px = features.map(|(id, s)| (id, self.cell.camera.model.pixel_of(&Vector2::from(s))));
        self.goal_px = Some(px.collect());
    }

    fn annotations(&self, m: &Measurement) -> DerivedMessage {
        let mut out = CdrOutput::new();
        let circle = |out: &mut CdrOutput, at: [f64; 2], colour: AnnotationColour| {
            out.time(m.exposure);
            out.f64s(at);
            out.f64s([SIGN_PX, LINE_PX]);
            out.f64s(NOTHING.into_iter().chain(colour));
        };
        let goals = self.goal_px.iter().flatten();
        let seen = m.features();
        out.length(seen.len() + goals.clone().count());
        seen.iter().for_each(|feature| circle(&mut out, [feature.u_px, feature.v_px], SEEN));
        goals.clone().for_each(|(_, px)| circle(&mut out, (*px).into(), WANTED));
        // From each point to where it is to be.
        let ways = seen.iter().filter_map(|feature| {
            let goal = self.goal_px.as_ref()?.get(&u32::try_from(feature.id).ok()?)?;
            Some([[feature.u_px, feature.v_px], (*goal).into()])
        });
        const LINE_LIST: u8 = 4; // as the definition has it
        let ends: Vec<[f64; 2]> = ways.flatten().collect();
        out.length(usize::from(!ends.is_empty()));
        if !ends.is_empty() {
            out.time(m.exposure);
            out.u8(LINE_LIST);
            out.length(ends.len());
            out.f64s(ends.into_iter().flatten());
            out.f64s(WANTED);
            out.length(0);
            out.f64s(NOTHING);
            out.f64(LINE_PX);
        }
        out.length(seen.len());
        for feature in seen {
            out.time(m.exposure);
            out.f64s([feature.u_px + SIGN_PX, feature.v_px]);
            out.text(&feature.id.to_string());
            out.f64(SIGN_PX);
            out.f64s(SEEN.into_iter().chain(NOTHING));
        }
        DerivedMessage {
            topic: format!("/camera/{}/annotations", m.camera),
            definition: "foxglove_msgs/ImageAnnotations",
            stamp: m.exposure,
            data: out.bytes(),
        }
    }

    fn goal_of(&mut self, request: &RequestMsg) {
        let values = request.values;
        self.target_number = request.target.checked_sub(1).unwrap_or(self.target_number);
        if request.form == 0 {
            // The last one of its target, which no record says again.
            self.goal_px = None;
        }
        if request.form == CommandForm::Features as u32 {
            let (points, _) = values.as_chunks::<2>();
            let count = request.count as usize / 2;
            self.set_goal(request.ids.into_iter().zip(points.iter().copied()).take(count));
        } else if request.form == CommandForm::Pose as u32 {
            let [x, y, z, i, j, k, w, ..] = values;
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
            let X_DO = Pose::from_parts([x, y, z].into(), rotation);
            let target = self.cell.targets().nth(self.target_number as usize);
            let (points, camera) =
                (target.map_or(&[][..], |(_, target)| target.points()), &self.cell.camera.model);
            let px = points.iter().filter_map(|p| Some((p.id, camera.project(&(X_DO * p.p_O))?)));
            self.goal_px = Some(px.collect());
        }
    }
}

impl DerivedMessages {
    /// Of a run with this run file.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let second = config.second_view.as_ref().map(|second| CameraView::new((*second.cell).clone()));
        let first = CameraView::new(config.clone());
        Self { config, next: MonoNs(i64::MIN), before: None, first, second }
    }

    fn views(&self) -> impl Iterator<Item = &CameraView> {
        std::iter::once(&self.first).chain(&self.second)
    }

    /// What the camera with this number sees; of a pair there is one measurement for both.
    fn view(&mut self, camera: u32) -> &mut CameraView {
        match &mut self.second {
            Some(second) if u32::from(second.cell.camera.id) == camera => second,
            _ => &mut self.first,
        }
    }

    /// From here on the points of the goal of the first camera are to be there, px.
    pub fn set_goal_px(&mut self, points: impl IntoIterator<Item = (u32, [f64; 2])>) {
        self.first.goal_px = Some(points.into_iter().map(|(id, px)| (id, px.into())).collect());
    }

    /// What holds for the whole run: transforms, and the cell in 3D.
    #[must_use]
    pub fn fixed(&self, stamp: MonoNs) -> Vec<DerivedMessage> {
        let config = &self.config;
        let carrier = |mount: &Mount| match mount {
            Mount::EyeInHand { .. } => FLANGE,
            Mount::EyeOnLink { joints, .. } => {
                config.robot.joints.get(joints - 1).map_or(BASE, |joint| &joint.link)
            }
            Mount::EyeToHand { .. } => BASE,
        };
        let cameras = config.cameras().map(|camera| (&camera.mount, camera_frame(camera.id)));
        let mut transforms: Vec<_> =
            cameras.map(|(mount, frame)| (carrier(mount).to_owned(), frame, *mount.pose())).collect();
        let last = config.robot.joints.last().map_or(BASE, |joint| &joint.link);
        transforms.push((last.to_owned(), FLANGE.to_owned(), config.robot.X_LE));
        for cell in self.views().map(|view| &view.cell).filter(|cell| !cell.goal.is_taught) {
            let (target, goal) = target_and_goal(cell);
            transforms.extend(cell.set_point.X_DO().map(|X_DO| (target, goal, X_DO.inverse())));
        }
        vec![transform_message("/tf_static", stamp, transforms), scene(config, stamp, [SEEN, WANTED])]
    }

    /// Joint states and transforms of the arm, a hundred times a second.
    #[must_use]
    pub fn joint_state(&mut self, state: &JointState) -> Vec<DerivedMessage> {
        if state.stamp < self.next {
            return Vec::new();
        }
        self.next = state.stamp + PERIOD;
        let robot = &self.config.robot;
        let n = robot.joint_count();
        let mut out = CdrOutput::new();
        out.header(state.stamp, BASE);
        out.length(n);
        robot.joints.iter().for_each(|joint| out.text(&joint.name));
        for values in [&state.q, &state.qd, &state.tau] {
            out.length(n);
            out.f64s(values.iter().take(n).copied());
        }
        let joints = DerivedMessage {
            topic: "/joint_states".into(),
            definition: "sensor_msgs/JointState",
            stamp: state.stamp,
            data: out.bytes(),
        };
        let parents = std::iter::once(BASE).chain(robot.joints.iter().map(|joint| joint.link.as_str()));
        let links = robot.joints.iter().zip(state.q).zip(parents);
        let transforms =
            links.map(|((joint, q), parent)| (parent.to_owned(), joint.link.clone(), joint.X_PL(q)));
        vec![joints, transform_message("/tf", state.stamp, transforms.collect())]
    }

    /// The calibration of the camera, beside each frame.
    #[must_use]
    pub fn frame(&self, header: &FrameHeader) -> Option<DerivedMessage> {
        let camera = self.config.cameras().find(|camera| u32::from(camera.id.0) == header.camera)?;
        let (i, lens) = (camera.model.intrinsics(), camera.model.lens());
        let mut out = CdrOutput::new();
        out.header(header.exposure, &camera_frame(camera.id));
        out.u32(i.height_px);
        out.u32(i.width_px);
        out.text(lens.model().name());
        let coefficients = lens.coefficients();
        out.length(coefficients.len());
        out.f64s(coefficients.into_iter().map(|(_, value)| value));
        out.f64s([i.fx_px, 0.0, i.cx_px, 0.0, i.fy_px, i.cy_px, 0.0, 0.0, 1.0]);
        out.f64s([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        out.f64s([i.fx_px, 0.0, i.cx_px, 0.0, 0.0, i.fy_px, i.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]);
        // no binning, and the whole of what is sent
        (0..6).for_each(|_| out.u32(0));
        out.u8(0);
        Some(DerivedMessage {
            topic: format!("/camera/{}/camera_info", camera.id),
            definition: "sensor_msgs/CameraInfo",
            stamp: header.exposure,
            data: out.bytes(),
        })
    }

    /// Where the target is, what is drawn on its frame, and whether it was found.
    #[must_use]
    pub fn measurement(&mut self, m: &Measurement) -> Vec<DerivedMessage> {
        let view = self.view(m.camera);
        let mut messages = vec![view.annotations(m)];
        if let Some(X_CO) = m.pose() {
            let (first, _) = target_and_goal(&view.cell);
            let further = view.cell.targets().nth(m.target_number as usize).filter(|_| m.target_number > 0);
            let target = further.map_or(first, |(name, _)| target_frame(name));
            let camera = camera_frame(view.cell.camera.id);
            messages.push(transform_message("/tf", m.exposure, vec![(camera, target, X_CO)]));
        }
        let status = m.target_status();
        if std::mem::replace(&mut view.target, status) != status {
            let level = if status == TargetStatus::Found { INFO } else { WARN };
            let of = match view.cell.camera.id {
                CameraId::FIRST => String::new(),
                id => format!(" of {}", camera_frame(id)),
            };
            messages.push(log(m.exposure, level, "vision", &format!("target{of}: {}", status.as_str())));
        }
        messages
    }

    /// What happened at a tick.
    #[must_use]
    pub fn tick(&mut self, tick: &TraceMsg) -> Vec<DerivedMessage> {
        let mut messages = Vec::new();
        let before = self.before.replace((tick.state, tick.fault));
        let state = ControlState::from_code(tick.state).as_str();
        if before.map(|(state, _)| state) != Some(tick.state) {
            messages.push(log(tick.stamp, INFO, "control", &format!("state: {state}")));
        }
        let is_new = before.map(|(_, fault)| fault) != Some(tick.fault);
        if let Some(fault) = Fault::from_code(tick.fault).filter(|_| is_new) {
            messages.push(log(tick.stamp, ERROR, "control", &format!("fault: {}", fault.describe())));
        }
        for word in event_words(tick.events).filter(|word| *word != "fault") {
            if word == "taught" {
                // Where the goal is now is not in a tick.
                self.first.goal_px = None;
            }
            messages.push(log(tick.stamp, INFO, "control", &word.replace('_', " ")));
        }
        messages
    }

    /// A request of a client, which may change the goal.
    #[must_use]
    pub fn request(&mut self, request: &RequestMsg) -> Vec<DerivedMessage> {
        let word = Request::from_code(request.request).map_or("unknown", Request::as_str);
        let accepted = request.refusal == 0;
        let (level, what) = if accepted { (INFO, "accepted") } else { (WARN, "refused") };
        if accepted && Request::from_code(request.request) == Some(Request::Goal) {
            self.view(request.camera).goal_of(request);
        }
        vec![log(request.stamp, level, "client", &format!("{word}: {what}"))]
    }
}

fn log(stamp: MonoNs, level: u8, name: &str, what: &str) -> DerivedMessage {
    let mut out = CdrOutput::new();
    out.time(stamp);
    out.u8(level);
    out.text(name);
    out.text(what);
    out.text("");
    out.text("");
    out.u32(0);
    DerivedMessage { topic: "/rosout".into(), definition: "rcl_interfaces/Log", stamp, data: out.bytes() }
}

/// Transforms: parent, child, and the child's pose in the parent.
fn transform_message(topic: &str, stamp: MonoNs, transforms: Vec<(String, String, Pose)>) -> DerivedMessage {
    let mut out = CdrOutput::new();
    out.length(transforms.len());
    for (parent, child, X) in transforms {
        out.header(stamp, &parent);
        out.text(&child);
        out.f64s(X.translation.vector.iter().copied());
        out.f64s(X.rotation.coords.iter().copied());
    }
    DerivedMessage { topic: topic.into(), definition: "tf2_msgs/TFMessage", stamp, data: out.bytes() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn has(message: &DerivedMessage, text: &str) -> bool {
        let wanted = [text.as_bytes(), b"\0"].concat();
        message.data.windows(wanted.len()).any(|part| part == wanted)
    }

    fn has_numbers(message: &DerivedMessage, numbers: &[f64]) -> bool {
        let wanted: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
        message.data.windows(wanted.len()).any(|part| part == wanted)
    }

    #[test]
    fn each_of_two_cameras_has_its_own_target_and_goal() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5-two-cameras.toml");
        let config = Config::load(Some(&path), &[]).unwrap();
        let second = config.second_view.as_ref().unwrap().cell.clone();
        let mut derived = DerivedMessages::new(config.clone());
        let fixed = derived.fixed(MonoNs(5));
        for frame in ["camera_0", "camera_1", "goal", "goal_camera_1", "target", "target_camera_1"] {
            assert!(fixed.iter().all(|message| message.topic == "/scene" || has(message, frame)), "{frame}");
        }
        for (cell, camera, target) in
            [(&config, "camera_0", "target"), (&*second, "camera_1", "target_camera_1")]
        {
            let X_CO = *cell.set_point.X_DO().unwrap();
            let points: Vec<_> = cell.target.points().iter().map(|p| p.p_O).collect();
            let m = crate::sim::perfect_measurement(&points, &X_CO, MonoNs(7)).unwrap();
            let m = Measurement { camera: u32::from(cell.camera.id), ..m };
            let messages = derived.measurement(&m);
            let [annotations, transform] = &messages[..] else { panic!("{messages:?}") };
            assert_eq!(annotations.topic, format!("/camera/{}/annotations", cell.camera.id));
            let goal = cell.camera.model.pixel_of(&cell.set_point.features()[0]);
            assert!(has_numbers(annotations, &[goal.x, goal.y]), "the goal of its own camera");
            assert!(has(transform, camera) && has(transform, target));
            assert!(has_numbers(transform, X_CO.translation.vector.as_slice()));
        }
    }
}
