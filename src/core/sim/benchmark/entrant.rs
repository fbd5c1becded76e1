//! Programs that take part: the messages between the benchmark and an entrant, JSON objects of one line each, and who commands the arm by its answers.
//!
//! ```text
//! begin: the task as the cell believes it  ──►  entrant  ──►  {"about": .., "settings": {..}, "frames": false}
//! see: what was measured in a frame        ──►  entrant  ──►  {"twist": [..]}, {"joints": [..]} or null
//! ```
//! Nothing of what is true of the cell alone is in a message. How lines travel is up to an [`EntrantLink`].

use super::BenchmarkTask;
use crate::config::{Config, assemble};
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::report::page::base64;
use crate::robot::Mount;
use crate::sim::{Commander, CommanderSight, WantedMotion};
use crate::time::MonoNs;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::ops::ControlFlow::{self, Break, Continue};

/// Version of the messages.
pub const ENTRANT_PROTOCOL: u32 = 1;
/// Largest number of an answer, m/s, rad/s. Chosen by hand: a hundred times what any shipped arm can do, which limits cut; beyond it stands a mistake.
const MAX_SPEED: f64 = 1e3;
/// Longest words and settings of an entrant, letters. Chosen by hand: they stand in tables.
const MAX_ABOUT: usize = 200;
/// As many letters of an answer are told when it is refused. Chosen by hand: a line of a terminal.
const QUOTED: usize = 80;

/// The way to an entrant and back.
pub trait EntrantLink {
    /// Sends a line; the line that answers it.
    ///
    /// # Errors
    /// Why there is none, as the end of a sentence that begins with the entrant.
    fn exchange(&mut self, line: &str) -> Result<String, String>;

    /// The last line of a run, which nobody answers.
    fn end(&mut self, line: &str);
}

/// What an entrant says of itself.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct EntrantCard {
    /// What it is called, where the command line does not say.
    #[serde(default)]
    pub name: String,
    /// What it is.
    pub about: String,
    /// Its settings, by their names.
    #[serde(default)]
    pub settings: Map<String, Value>,
    /// Whether it looks at frames.
    #[serde(default)]
    pub frames: bool,
    /// How it was started.
    #[serde(default, skip_deserializing)]
    pub command: String,
}

impl EntrantCard {
    /// The answer to the task.
    ///
    /// # Errors
    /// Why it is none, as the end of a sentence.
    pub fn parse(line: &str) -> Result<Self, String> {
        let card: Self = serde_json::from_str(line).map_err(|e| {
            format!(
                "answers the task with {}, not with {{\"about\": .., \"settings\": {{..}}}}: {e}",
                quoted(line)
            )
        })?;
        let settings = serde_json::to_string(&card.settings).unwrap_or_default();
        let longest = card.about.chars().count().max(settings.chars().count());
        if longest > MAX_ABOUT {
            return Err(format!(
                "says {longest} letters of itself or its settings, which may be {MAX_ABOUT}"
            ));
        }
        Ok(card)
    }

    /// Its settings in words.
    #[must_use]
    pub fn settings_in_words(&self) -> String {
        let words: Vec<String> =
            self.settings.iter().map(|(key, value)| format!("{key} = {value}")).collect();
        words.join(", ")
    }
}

fn quoted(line: &str) -> String {
    let short: String = line.trim_end().chars().take(QUOTED).collect();
    format!("`{short}`")
}

/// A number of the cell as JSON: a range without an end is null.
fn numbers(values: impl IntoIterator<Item = f64>) -> Value {
    values.into_iter().map(Value::from).collect()
}

fn pose(X: &Pose) -> Value {
    let p = X.translation.vector;
    let c = X.rotation.coords;
    json!({ "position_m": [p.x, p.y, p.z], "rotation_xyzw": [c.x, c.y, c.z, c.w] })
}

/// The task, as the cell of `config` believes it.
///
/// # Errors
/// When the run file does not fit its arm, in words.
pub fn begin_message(config: &Config, task: &BenchmarkTask) -> Result<String, String> {
    let arm = crate::dispatch_robot!(config.robot, |robot| {
        assemble::motion_limits(config, &robot).map(|limits| {
            let joint = |i: usize| {
                json!({
                    "name": robot.joint_names()[i],
                    "kind": if robot.is_prismatic(i) { "prismatic" } else { "revolute" },
                    "lower": limits.lower[i],
                    "upper": limits.upper[i],
                    "velocity": limits.velocity[i],
                    "acceleration": limits.acceleration[i],
                    "jerk": limits.jerk[i],
                })
            };
            let joints: Vec<Value> = (0..robot.limits().len()).map(joint).collect();
            json!({ "name": robot.name(), "joints": joints })
        })
    });
    let arm = arm.map_err(|e| e.to_string())?.map_err(|e| e.to_string())?;
    let message = json!({
        "vservo": "begin",
        "protocol": ENTRANT_PROTOCOL,
        "camera": camera(config),
        "target": { "points": points(config) },
        "goal": goal(config, task),
        "arm": arm,
    });
    Ok(message.to_string())
}

fn camera(config: &Config) -> Value {
    let (camera, i) = (&config.camera, config.camera.model.intrinsics());
    let lens = camera.model.lens();
    let distortion: Map<String, Value> =
        lens.coefficients().into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
    let mount = match &camera.mount {
        Mount::EyeInHand { .. } => "eye_in_hand",
        Mount::EyeOnLink { .. } => "eye_on_link",
        Mount::EyeToHand { .. } => "eye_to_hand",
    };
    json!({
        "width_px": i.width_px,
        "height_px": i.height_px,
        "fx_px": i.fx_px,
        "fy_px": i.fy_px,
        "cx_px": i.cx_px,
        "cy_px": i.cy_px,
        "lens": lens.model().name(),
        "distortion": distortion,
        "rate_hz": camera.rate_hz,
        "latency_s": camera.latency.as_s(),
        "mount": mount,
        "mount_pose": pose(camera.mount.pose()),
    })
}

fn points(config: &Config) -> Vec<Value> {
    let set_point = &config.set_point;
    let point = |(id, p): (&u32, &nalgebra::Point3<f64>)| json!({ "id": id, "position_m": [p.x, p.y, p.z] });
    set_point.ids().iter().zip(set_point.points()).map(point).collect()
}

fn goal(config: &Config, task: &BenchmarkTask) -> Value {
    let (set_point, model) = (&config.set_point, &config.camera.model);
    let depth_m = |i: usize| set_point.depths_m().get(i).copied();
    let feature = |(i, (id, s)): (usize, (&u32, &nalgebra::Vector2<f64>))| {
        let px = model.pixel_of(s);
        json!({ "id": id, "u_px": px.x, "v_px": px.y, "x": s.x, "y": s.y, "depth_m": depth_m(i) })
    };
    let features: Vec<Value> =
        set_point.ids().iter().zip(set_point.features()).enumerate().map(feature).collect();
    json!({
        "features": features,
        "pose": set_point.X_DO().map(pose),
        "tolerance_px": task.tolerance_px,
        "hold_s": task.hold_s,
        "duration_s": task.duration_s,
        "measurement_timeout_s": config.safety.measurement_timeout.as_s(),
    })
}

/// What an entrant gets to see.
fn see_message(sight: &CommanderSight<'_>, frames: bool) -> String {
    let m: &Measurement = sight.measurement;
    let feature = |f: &crate::messages::FeaturePoint| json!({ "id": f.id, "u_px": f.u_px, "v_px": f.v_px, "x": f.x, "y": f.y, "sd_px": f.sd_px });
    let features: Vec<Value> =
        if m.found() { m.features().iter().map(feature).collect() } else { Vec::new() };
    let row = |k: usize| numbers(sight.J.iter().filter_map(|column| column.get(k)).copied());
    let mut message = json!({
        "vservo": "see",
        "time_s": (sight.now - MonoNs::ZERO).as_s(),
        "exposure_s": (m.exposure - MonoNs::ZERO).as_s(),
        "frame_id": m.frame_id,
        "found": m.found(),
        "status": m.target_status().as_str(),
        "features": features,
        "q": sight.q,
        "qd": sight.qd,
        "camera": pose(&sight.X_WC),
        "camera_at_exposure": pose(&sight.X_WC_exposure),
        "jacobian": (0..6).map(row).collect::<Vec<_>>(),
    });
    if let (true, Some(object)) = (frames, message.as_object_mut()) {
        object.insert("frame".into(), sight.frame.map(base64).into());
    }
    message.to_string()
}

/// The end of a run.
const END: &str = r#"{"vservo":"end"}"#;

/// What an answer wants.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EntrantAnswer {
    twist: Option<Vec<f64>>,
    joints: Option<Vec<f64>>,
}

/// An answer to what was seen, of an arm with as many joints.
///
/// # Errors
/// Why it is none, as the end of a sentence.
fn answer(line: &str, joints: usize) -> Result<WantedMotion, String> {
    let wrong = |why: &str| format!("answers {}: {why}", quoted(line));
    const EXPECTED: &str = "{\"twist\": [vx, vy, vz, wx, wy, wz]}, {\"joints\": [..]} or null is expected";
    let answer: Option<EntrantAnswer> =
        serde_json::from_str(line).map_err(|e| wrong(&format!("{EXPECTED} ({e})")))?;
    let Some(answer) = answer else { return Ok(WantedMotion::None) };
    let sound = |numbers: &[f64]| {
        let absurd = numbers.iter().find(|x| !(x.abs() <= MAX_SPEED));
        absurd.map_or(Ok(()), |x| Err(wrong(&format!("{x} is beyond {MAX_SPEED} m/s or rad/s"))))
    };
    match (answer.twist, answer.joints) {
        (Some(twist), None) => {
            let twist: [f64; 6] = twist
                .try_into()
                .map_err(|t: Vec<f64>| wrong(&format!("a twist has 6 numbers, not {}", t.len())))?;
            sound(&twist).map(|()| WantedMotion::Twist(twist))
        }
        (None, Some(qd)) if qd.len() == joints => sound(&qd).map(|()| WantedMotion::Joints(qd)),
        (None, Some(qd)) => Err(wrong(&format!("the arm has {joints} joints, not {}", qd.len()))),
        _ => Err(wrong(EXPECTED)),
    }
}

/// Commands the arm of a run by an entrant's answers. What goes wrong with it ends the run, and is kept.
pub(super) struct EntrantCommander<'a> {
    link: &'a mut dyn EntrantLink,
    frames: bool,
    failure: Option<String>,
}

impl<'a> EntrantCommander<'a> {
    /// A commander that has been told the task of `config`.
    pub(super) fn new(
        link: &'a mut dyn EntrantLink,
        config: &Config,
        task: &BenchmarkTask,
    ) -> Result<Self, String> {
        let begin = begin_message(config, task)?;
        let card = link.exchange(&begin).and_then(|line| EntrantCard::parse(&line));
        let (frames, failure) = match card {
            Ok(card) => (card.frames, None),
            Err(why) => (false, Some(why)),
        };
        Ok(Self { link, frames, failure })
    }

    /// The end of the run: why the entrant failed, where it did.
    pub(super) fn end(self) -> Option<String> {
        if self.failure.is_none() {
            self.link.end(END);
        }
        self.failure
    }
}

impl Commander for EntrantCommander<'_> {
    fn wants_frames(&self) -> bool {
        self.frames
    }

    fn command(&mut self, sight: &CommanderSight<'_>) -> ControlFlow<(), WantedMotion> {
        if self.failure.is_some() {
            return Break(());
        }
        let told = self.link.exchange(&see_message(sight, self.frames));
        match told.and_then(|line| answer(&line, sight.q.len())) {
            Ok(motion) => Continue(motion),
            Err(why) => {
                self.failure = Some(why);
                Break(())
            }
        }
    }
}

#[cfg(test)]
mod tests;
