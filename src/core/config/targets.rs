//! `[targets.NAME]`: further targets of a run, of which vision looks for one at a time. That of `[target]` is the first one.

use super::Config;
use super::check::Validation;
use super::estimation::is_asked_for;
use super::gains::law;
use super::named_goal::{ProgramGoal, TargetGoal};
use super::raw::{RawConfig, SchemeKind, Task};
use super::selection::selection;
use super::target::target;
use crate::geometry::Pose;
use crate::input::nearest;
use crate::servo::{Law, MAX_TARGETS, Selection, SetPoint};
use crate::target::Target;
use crate::vision::PoseApproach;

/// Name of the target of `[target]`, where requests and programs name one.
pub const FIRST_TARGET: &str = "target";
/// Most further targets: all but the first.
const MAX_FURTHER: usize = MAX_TARGETS - 1;

/// A further target.
#[derive(Debug, Clone)]
pub struct FurtherTarget {
    /// Its name.
    pub name: String,
    /// The target.
    pub target: Target,
    /// Its goal until it is given another: the desired view of the run file.
    pub set_point: SetPoint,
}

impl Config {
    /// All targets with their names, by their numbers.
    pub fn targets(&self) -> impl Iterator<Item = (&str, &Target)> {
        let further = self.further_targets.iter().map(|further| (further.name.as_str(), &further.target));
        std::iter::once((FIRST_TARGET, &self.target)).chain(further)
    }

    /// The same cell, with the target `name` and the first one in each other's places: what looks at `[target]` alone then looks at that one. An error
    /// names the targets that there are.
    ///
    /// # Errors
    /// When the run file has no target of this name.
    pub fn led_by(&self, name: &str) -> Result<Self, String> {
        let names = self.further_targets.iter().map(|further| further.name.as_str());
        if let Some(why) = unknown(name, names.clone()) {
            return Err(why);
        }
        let mut config = self.clone();
        let Some(i) = names.into_iter().position(|one| one == name) else { return Ok(config) };
        if let Some(further) = config.further_targets.get_mut(i) {
            std::mem::swap(&mut further.target, &mut config.target);
            std::mem::swap(&mut further.set_point, &mut config.set_point);
            FIRST_TARGET.clone_into(&mut further.name);
        }
        if let Some(scene) = &mut config.scene
            && let Some(object) = scene.further_targets.get_mut(i)
        {
            std::mem::swap(&mut object.target, &mut scene.target);
            std::mem::swap(&mut object.X_WO, &mut scene.X_WO);
            std::mem::swap(&mut object.motion, &mut scene.motion);
        }
        Ok(config)
    }

    /// The cell whose goal is `goal`, with the target of that in place of the first one, where it lies; `None` where the goal is no view of it.
    #[must_use]
    pub fn with_goal(&self, goal: &TargetGoal) -> Option<Self> {
        let mut config = self.led_by(goal.target.as_deref().unwrap_or(FIRST_TARGET)).ok()?;
        config.set_point = match &goal.goal {
            ProgramGoal::Present => config.set_point,
            ProgramGoal::Taught(file) => {
                let s_d: Vec<_> = file.features.iter().map(|feature| feature.s.into()).collect();
                config.set_point.at_features(&s_d)?
            }
            ProgramGoal::Pose(X_DO) => config.set_point.at_pose(X_DO)?,
        };
        config.goal.is_taught = false;
        config.servo.path = None;
        Some(config)
    }

    /// The goals of `[goals]`, by name.
    pub fn named_goals(&self) -> impl Iterator<Item = (&str, TargetGoal)> {
        let goals = self.effective.goals.iter();
        goals.filter_map(|(name, raw)| Some((name.as_str(), raw.clone().checked()?)))
    }
}

/// What is wrong with `name` as the name of a target among `known`, the first one left out; `None` where it is one.
pub(super) fn unknown<'a>(name: &str, known: impl Iterator<Item = &'a str> + Clone) -> Option<String> {
    let mut all = std::iter::once(FIRST_TARGET).chain(known);
    if all.clone().any(|one| one == name) {
        return None;
    }
    let meant =
        nearest(name, all.clone()).map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
    let first = all.next().unwrap_or_default();
    let rest: String = all.map(|one| format!(", {one}")).collect();
    Some(format!("`{name}` is no target of the run file; there are {first}{rest}{meant}"))
}

/// The further targets; `None` where one of them is wrong, which was told.
pub(super) fn further_targets(
    raw: &RawConfig,
    (X_DO, first): (&Pose, Option<&Law>),
    check: &mut Validation<'_>,
) -> Option<Vec<FurtherTarget>> {
    let before = check.count_problems();
    if !raw.targets.is_empty() {
        refuse_what_has_one(raw, check);
    }
    for name in raw.scene.objects.keys().filter(|name| !raw.targets.contains_key(*name)) {
        let message = format!("there is no [targets.{name}] that could be there");
        check.wrong(&format!("scene.objects.{name}"), message);
    }
    let mut all = Vec::new();
    for (name, of) in &raw.targets {
        let key = format!("targets.{name}");
        if name == FIRST_TARGET {
            check.wrong(&key, "is the name of [target] itself: give it another");
        }
        if raw.camera.source.is_simulated() && !raw.scene.objects.contains_key(name) {
            check
                .wrong(&key, format!("is nowhere in the simulated scene: [scene.objects.{name}] says where"));
        }
        let Some(target) = target(&key, of, check) else { continue };
        if !target.is_flat() {
            in_space(&key, raw, check);
        }
        let (points, ids): (Vec<_>, Vec<_>) = target.features().map(|point| (point.p_O, point.id)).unzip();
        let chosen = selection(&raw.servo, points.len(), check);
        // Gains that are lists fit targets with as many numbers alone.
        let own = law(&raw.servo, chosen.as_ref().map(Selection::numbers), check);
        if first.is_some_and(|first| *first != own) {
            check.wrong(&key, "has other gains than [target] by servo.gain_1_s: use one number for all");
        }
        let made = SetPoint::from_pose(X_DO, &points).and_then(|s| s.with_ids(&ids)?.with_selection(chosen?));
        let Some(set_point) = made else {
            check.wrong(&key, "lies behind the camera in the desired view: servo.desired is its goal, too, until it has another");
            continue;
        };
        let set_point = set_point.with_target(all.len() as u32 + 1);
        all.push(FurtherTarget { name: name.clone(), target, set_point });
    }
    (check.count_problems() == before).then_some(all)
}

/// What takes a run with one target.
fn refuse_what_has_one(raw: &RawConfig, check: &mut Validation<'_>) {
    let mut refuse = |is_there: bool, why: &str| {
        if is_there {
            check.wrong("targets", format!("several targets do not go with {why}"));
        }
    };
    refuse(raw.stereo.is_some(), "a pair of cameras ([stereo])");
    refuse(is_asked_for(raw), "servo.interaction = \"estimated\": what is learnt is of one target");
    refuse(raw.servo.scheme == SchemeKind::LookAndMove, "servo.scheme = \"look_and_move\"");
    refuse(raw.run.task != Task::Servo, "a calibration (run.task)");
    if raw.targets.len() > MAX_FURTHER {
        check.wrong(
            "targets",
            format!("has {} targets, at most {MAX_FURTHER} are allowed", raw.targets.len()),
        );
    }
}

/// What takes a target in one plane.
fn in_space(key: &str, raw: &RawConfig, check: &mut Validation<'_>) {
    const FLAT: &str = "takes a target whose points lie in one plane";
    if raw.vision.pose == PoseApproach::Analytical {
        check.wrong(key, format!("is of kind \"points\": vision.pose = \"analytical\" {FLAT}"));
    }
    if raw.servo.scheme == SchemeKind::Hybrid {
        check.wrong(key, format!("is of kind \"points\": servo.scheme = \"hybrid\" {FLAT}"));
    }
    if raw.servo.dimension == 4 {
        check.wrong(key, format!("is of kind \"points\": servo.dimension = 4 {FLAT}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(set: &[&str]) -> Result<Config, String> {
        let bin = ["targets.bin.kind=tags", "scene.objects.bin.position_m=[1.1,1.2,1]"];
        let set: Vec<String> = bin.iter().chain(set).map(|set| (*set).to_owned()).collect();
        Config::load(None, &set).map_err(|error| error.to_string())
    }

    #[test]
    fn further_targets_have_numbers_and_goals_of_their_own() {
        let set = [
            "targets.above.side_m=0.05",
            "scene.objects.above.matrix=[[1,0,0,1],[0,1,0,1],[0,0,1,1.2],[0,0,0,1]]",
        ];
        let config = told(&set).unwrap();
        let names: Vec<_> = config.targets().map(|(name, target)| (name, target.points().len())).collect();
        assert_eq!(names, [("target", 4), ("above", 4), ("bin", 4)]);
        let numbers: Vec<_> = config.further_targets.iter().map(|f| f.set_point.target()).collect();
        assert_eq!((config.set_point.target(), numbers), (0, vec![1, 2]));
        let z_m: Vec<_> =
            config.scene.unwrap().further_targets.iter().map(|object| object.X_WO.translation.z).collect();
        assert_eq!(z_m, [1.2, 1.0]);
    }

    #[test]
    fn what_is_wrong_with_further_targets_is_told() {
        for (set, why) in [
            ("targets.lid.kind=tags", "targets.lid: is nowhere in the simulated scene: [scene.objects.lid]"),
            ("targets.target.kind=tags", "targets.target: is the name of [target] itself"),
            ("targets.bin.tags.size_m=1e9", "targets.bin.tags.size_m: 1000000000 is out of range"),
            ("targets.bin.tag.size_m=1", "targets.bin.tag: unknown field"),
            ("scene.objects.lid.position_m=[0,0,1]", "scene.objects.lid: there is no [targets.lid]"),
            ("scene.objects.bin.position_m=[0,0,1e9]", "scene.objects.bin.position_m[2]: "),
            ("scene.objects.bin.on=flange", "scene.objects.bin.on: must be that of scene.object"),
            (
                "scene.objects.bin.motion.frequency_hz=99",
                "scene.objects.bin.motion.frequency_hz: 99 is out of range",
            ),
            ("scene.objects.bin.motion.kind=conveyer", "scene.objects.bin.motion.kind: unknown variant"),
            ("scene.object.motion.kind=conveyor", "scene.object.motion: is that of further targets"),
            ("servo.scheme=look_and_move", "targets: several targets do not go with servo.scheme"),
            (
                "goals.a={position_m=[0,0,0.5],target='bim'}",
                "goals.a.target: `bim` is no target of the run file; there are target, bin; did you mean `bin`?",
            ),
            (
                "goals.a={taught={target='four_dots',features=[]},target='bin'}",
                "goals.a: is of a target of kind \"four_dots\", targets.bin.kind is \"tags\"",
            ),
        ] {
            let error = told(&[set]).expect_err(set);
            assert!(error.contains(why), "{set}: {error}");
        }
        // A real camera needs no scene.
        let real = ["camera.source=v4l2", "targets.lid.kind=tags"];
        let error = told(&real).err().unwrap_or_default();
        assert!(!error.contains("nowhere"), "{error}");
    }
}
