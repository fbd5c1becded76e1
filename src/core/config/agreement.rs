//! The values that the camera, vision and control processes of one run must have in common, wherever they are started: clock, cameras, target and robot.

use super::Config;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// Keys of a camera that concern only the process which produces its frames.
const OF_THE_SOURCE: [&str; 4] = ["source", "replay", "synthetic", "v4l2"];

impl Config {
    /// These keys with their values. Two processes of a run whose values differ would use another camera, arm or target than they
    /// have.
    #[must_use]
    pub fn agreement(&self) -> BTreeMap<String, String> {
        let mut all = Table::try_from(&self.effective).unwrap_or_default();
        let mut part = |name: &str| all.remove(name).unwrap_or(Value::Table(Table::new()));
        let (cameras, camera) = (part("cameras"), part("camera"));
        let listed = cameras.as_array().is_some_and(|list| !list.is_empty());
        let mut keys = BTreeMap::new();
        if listed {
            flatten("cameras", cameras, &mut keys);
        } else {
            flatten("camera", camera, &mut keys); // else the first of the list
        }
        for name in ["target", "stereo", "second_view"] {
            flatten(name, part(name), &mut keys);
        }
        // What stands under a name is one value: clients read it.
        for table in ["goals", "postures", "targets"] {
            let Value::Table(named) = part(table) else { continue };
            keys.extend(named.into_iter().filter_map(|(name, value)| {
                Some((format!("{table}.{name}"), serde_json::to_string(&value).ok()?))
            }));
        }
        for (table, key) in [("run", "clock"), ("robot", "model")] {
            if let Some(value) = part(table).get(key) {
                keys.insert(format!("{table}.{key}"), value.to_string());
            }
        }
        // What joints are called, for clients.
        keys.extend(
            serde_json::to_string(&self.robot.joint_names()).map(|names| ("robot.joints".into(), names)),
        );
        // Where they may be, for clients; null of a joint without an end.
        let ranges: Vec<_> =
            self.robot.joints.iter().map(|joint| [joint.limits.lower, joint.limits.upper]).collect();
        keys.extend(serde_json::to_string(&ranges).map(|ranges| ("robot.ranges_rad_or_m".into(), ranges)));
        keys
    }
}

fn flatten(name: &str, value: Value, keys: &mut BTreeMap<String, String>) {
    match value {
        Value::Table(table) => {
            for (key, value) in table {
                let is_of_a_camera = name == "camera" || name.starts_with("cameras[") && !name.contains("].");
                if !(is_of_a_camera && OF_THE_SOURCE.contains(&key.as_str())) {
                    flatten(&format!("{name}.{key}"), value, keys);
                }
            }
        }
        Value::Array(list) if list.iter().all(Value::is_table) => {
            for (i, value) in list.into_iter().enumerate() {
                flatten(&format!("{name}[{i}]"), value, keys);
            }
        }
        value => {
            keys.insert(name.into(), value.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agreement(set: &[&str]) -> BTreeMap<String, String> {
        let set: Vec<_> = set.iter().map(ToString::to_string).collect();
        Config::load(None, &set).unwrap().agreement()
    }

    #[test]
    fn what_one_process_alone_needs_is_left_out() {
        let own =
            ["camera.synthetic.noise_sd_levels=5", "run.seed=7", "servo.gain_1_s=3", "scene.plate_level=200"];
        assert_eq!(agreement(&own), agreement(&[]));
    }

    #[test]
    fn what_all_need_is_there() {
        let plain = agreement(&[]);
        for (set, key) in [
            ("camera.rate_hz=50", "camera.rate_hz"),
            ("camera.lens.fx_px=810", "camera.lens.fx_px"),
            ("camera.response=srgb", "camera.response"),
            ("run.clock=lockstep", "run.clock"),
            ("target.side_m=0.095", "target.side_m"),
        ] {
            let changed = agreement(&[set]);
            let differing: Vec<_> = plain.keys().filter(|key| plain.get(*key) != changed.get(*key)).collect();
            assert_eq!(differing, [key], "{set}");
        }
    }
}
