//! Limits of the joints: what the robot tells of itself in its URDF, or, where it does not, those of an FR3.
//!
//! ```text
//! v_max(q) = min(v, max(0, -offset + sqrt(2 deceleration (q_max - q))))       so that a joint can brake before its end; downwards alike
//! ```

use crate::{JOINTS, Joints};

/// Acceleration and jerk of commands, rad/s2 and rad/s3, and rise of torques, N m/s: the same for all joints of an FR3, by the maker's limits of its interface.
pub const MAX_ACCELERATION: f64 = 10.0;
/// Jerk of commands, rad/s3.
pub const MAX_JERK: f64 = 5000.0;
/// Rise of torques, N m/s.
pub const MAX_TORQUE_RATE: f64 = 1000.0;
/// Torques of the joints, N m, by the maker's data sheet of an FR3.
pub const MAX_TORQUE: Joints = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0];

/// Limits of one joint, rad, rad/s and rad/s2.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub struct JointLimit {
    pub lower: f64,
    pub upper: f64,
    pub velocity: f64,
    pub velocity_offset: f64,
    pub deceleration: f64,
}

/// Limits of the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits(pub [JointLimit; JOINTS]);

impl JointLimits {
    /// Those of an FR3, by the maker's limits of its interface.
    #[must_use]
    pub fn fr3() -> Self {
        let joint = |lower, upper, velocity, velocity_offset, deceleration| JointLimit {
            lower,
            upper,
            velocity,
            velocity_offset,
            deceleration,
        };
        Self([
            joint(-2.7501, 2.7501, 2.62, 0.30, 6.0),
            joint(-1.7918, 1.7918, 2.62, 0.20, 2.585),
            joint(-2.9065, 2.9065, 2.62, 0.20, 3.5),
            joint(-3.0481, -0.1458, 2.62, 0.30, 4.0),
            joint(-2.8101, 2.8101, 5.26, 0.35, 17.0),
            joint(0.54092, 4.5205, 4.18, 0.35, 5.5),
            joint(-3.0196, 3.0196, 5.26, 0.35, 17.0),
        ])
    }

    /// What a URDF of this maker says; none where a joint or a limit is missing, or makes no sense.
    #[must_use]
    pub fn of_urdf(text: &str) -> Option<Self> {
        let mut found = [None; JOINTS];
        for part in text.split("<joint").skip(1) {
            let body = part.split("</joint>").next().unwrap_or_default();
            let name = attribute(body.split('>').next().unwrap_or_default(), "name").unwrap_or_default();
            let Some(place) = (0..JOINTS).find(|i| name.ends_with(&format!("joint{}", i + 1))) else {
                continue;
            };
            let (Some(limit), Some(by_position)) =
                (element(body, "limit"), element(body, "position_based_velocity_limits"))
            else {
                continue;
            };
            let number =
                |tag: &str, name: &str| attribute(tag, name)?.parse::<f64>().ok().filter(|v| v.is_finite());
            let read = || {
                Some(JointLimit {
                    lower: number(limit, "lower")?,
                    upper: number(limit, "upper")?,
                    velocity: number(limit, "velocity")?,
                    velocity_offset: number(by_position, "velocity_offset")?,
                    deceleration: number(by_position, "deceleration_limit")?,
                })
            };
            let sound = |l: &JointLimit| l.lower < l.upper && l.velocity > 0.0 && l.deceleration > 0.0;
            if let Some(to) = found.get_mut(place) {
                *to = read().filter(sound);
            }
        }
        let mut limits = Self::fr3();
        for (to, from) in limits.0.iter_mut().zip(found) {
            *to = from?;
        }
        Some(limits)
    }

    /// A URDF that says these, and nothing of links and masses.
    #[must_use]
    pub fn urdf(&self) -> String {
        let mut text =
            String::from("<?xml version=\"1.0\"?>\n<robot name=\"fr3\">\n  <link name=\"fr3_link0\"/>\n");
        for (i, l) in (1..).zip(&self.0) {
            text += &format!(
                "  <link name=\"fr3_link{i}\"/>\n  <joint name=\"fr3_joint{i}\" type=\"revolute\">\n    \
                 <parent link=\"fr3_link{}\"/>\n    <child link=\"fr3_link{i}\"/>\n    <axis xyz=\"0 0 1\"/>\n    \
                 <limit effort=\"{}\" lower=\"{}\" upper=\"{}\" velocity=\"{}\"/>\n    \
                 <position_based_velocity_limits kind=\"fr3\" velocity_offset=\"{}\" deceleration_limit=\"{}\"/>\n  </joint>\n",
                i - 1,
                MAX_TORQUE.get(i - 1).copied().unwrap_or_default(),
                l.lower,
                l.upper,
                l.velocity,
                l.velocity_offset,
                l.deceleration
            );
        }
        text + "</robot>\n"
    }
}

impl JointLimit {
    /// Slowest and fastest that the joint may be commanded at a position, rad/s.
    #[must_use]
    pub fn velocities(&self, q: f64) -> (f64, f64) {
        let within = |room: f64| {
            let brakes = (2.0 * self.deceleration * room.max(0.0)).sqrt() - self.velocity_offset;
            brakes.clamp(0.0, self.velocity)
        };
        (-within(q - self.lower), within(self.upper - q))
    }
}

/// The tag of an element, without its name.
fn element<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = rest.get(at + 1..)?;
        if let Some(tag) =
            rest.strip_prefix(name).filter(|tag| !tag.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
        {
            return tag.split('>').next();
        }
    }
    None
}

/// The value of an attribute of a tag.
fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    tag.match_indices(name).find_map(|(at, _)| {
        let begins = tag.get(..at)?.ends_with(char::is_whitespace);
        let value = tag.get(at + name.len()..)?.trim_start().strip_prefix('=')?.trim_start();
        let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
        begins.then(|| value.get(1..)?.split(quote).next())?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_of_a_urdf_are_read_and_those_of_nonsense_are_not() {
        let mut limits = JointLimits::fr3();
        limits.0[3].velocity = 1.25;
        assert_eq!(JointLimits::of_urdf(&limits.urdf()), Some(limits));
        let text = limits.urdf();
        assert_eq!(JointLimits::of_urdf(&text.replace("velocity=\"1.25\"", "velocity=\"fast\"")), None);
        assert_eq!(JointLimits::of_urdf(&text.replace("fr3_joint5\"", "fr3_finger\"")), None);
        assert_eq!(JointLimits::of_urdf(&text.replace("position_based_velocity_limits", "mimic")), None);
        for text in ["", "<joint", "<joint name=", "<joint name=\"joint1\"><limit lower=\"", "no robot"] {
            assert_eq!(JointLimits::of_urdf(text), None);
        }
    }

    /// The maker's figures at the middle, near an end, and at it.
    #[test]
    fn velocities_shrink_towards_the_ends() {
        let limits = JointLimits::fr3();
        assert_eq!(limits.0[0].velocities(0.0), (-2.62, 2.62));
        let (slow, fast) = limits.0[0].velocities(2.7);
        assert_eq!(slow, -2.62);
        // -0.30 + sqrt(12 (2.7501 - 2.7)).
        assert!((fast - 0.475_4).abs() < 1e-4, "{fast}");
        assert_eq!(limits.0[0].velocities(2.76).1, 0.0);
    }
}
