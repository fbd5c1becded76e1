//! Whether the joints that a drive names are those of the robot file, in its order.
//!
//! One of both lists may have all its names behind one more prefix, as descriptions of cells with several arms have it: `left_elbow_joint` is
//! `elbow_joint`. `left_` and `right_` are two arms.

use crate::messages::DriveTextMsg;
use thiserror::Error;

/// Joints whose zero lies farther from that of the robot file, rad or m, are refused. Chosen by hand: makers' calibrations move a zero by less, and a drive that
/// counts from another posture is off by far more.
const ZERO_DIFFERS: f64 = 1e-3;

/// Why the joints that a drive names are not those of the robot file.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum JointNamesError {
    /// Other names, another order, or another count.
    #[error(
        "the drive's joints are not those of the robot file: {how}. The drive has {drive}; the robot file has {robot}. Name the robot of this drive in robot.model, or map \
         the joints in the drive; where only the names differ, give the drive those of the robot file (--joint-names of vservo's own drives)"
    )]
    Names {
        /// What differs.
        how: String,
        /// The drive's names, in its order.
        drive: String,
        /// The robot file's.
        robot: String,
    },
    /// A joint that turns the other way.
    #[error(
        "joint {number} of the drive (`{name}`) counts the other way round (sign {sign}) than that of the robot file: turn the sign of its commands and its states in the drive"
    )]
    Sign {
        /// Which, from 1.
        number: usize,
        /// Its name.
        name: String,
        /// The sign that the drive tells.
        sign: f64,
    },
    /// A joint with another zero.
    #[error(
        "joint {number} of the drive (`{name}`) has its zero at {offset} rad or m of the robot file's: add that to its states and take it from its commands in the drive, or \
         turn the zero in the robot file"
    )]
    Zero {
        /// Which, from 1.
        number: usize,
        /// Its name.
        name: String,
        /// Where its zero lies.
        offset: f64,
    },
}

impl JointNamesError {
    /// What differs, without how to mend it.
    #[must_use]
    pub fn brief(&self) -> String {
        match self {
            Self::Names { how, drive, robot } => {
                format!("{how}: the drive has {drive}; the robot file has {robot}")
            }
            Self::Sign { number, name, sign } => format!("joint {number} (`{name}`) has sign {sign}"),
            Self::Zero { number, name, offset } => {
                format!("joint {number} (`{name}`) has its zero at {offset}")
            }
        }
    }
}

/// Compares the joints that a drive names with `robot`, those of the robot file.
///
/// # Errors
/// When they are not the same, with both lists.
pub fn check_joint_names<S: AsRef<str>>(told: &DriveTextMsg, robot: &[S]) -> Result<(), JointNamesError> {
    let drive = told.names();
    compare_joint_names(&drive, robot)?;
    for (number, name) in (1..).zip(&drive) {
        let of = |values: &[f64]| values.get(number - 1).copied().unwrap_or_default();
        let (sign, offset) = (of(&told.signs), of(&told.zero_offsets));
        // 0 is not told.
        if !(sign == 0.0 || sign == 1.0) {
            return Err(JointNamesError::Sign { number, name: name.clone(), sign });
        }
        // In this form NaN is refused too.
        if !(offset.abs() <= ZERO_DIFFERS) {
            return Err(JointNamesError::Zero { number, name: name.clone(), offset });
        }
    }
    Ok(())
}

/// Compares two lists of names: the drive's, and the robot file's.
///
/// # Errors
/// [`JointNamesError::Names`].
pub fn compare_joint_names<A: AsRef<str>, B: AsRef<str>>(
    drive: &[A],
    robot: &[B],
) -> Result<(), JointNamesError> {
    let drive: Vec<_> = drive.iter().map(AsRef::as_ref).collect();
    let robot: Vec<_> = robot.iter().map(AsRef::as_ref).collect();
    if drive.len() == robot.len()
        && (is_behind_a_prefix(&drive, &robot) || is_behind_a_prefix(&robot, &drive))
    {
        return Ok(());
    }
    let how = if drive.len() != robot.len() {
        format!("{} joints, not {}", drive.len(), robot.len())
    } else if is_reordered(&drive, &robot) {
        "the same names in another order".into()
    } else {
        let differs = |(_, (drive, robot)): &(usize, (&&str, &&str))| drive != robot;
        (1..)
            .zip(drive.iter().zip(&robot))
            .find(differs)
            .map_or_else(String::new, |(number, (drive, robot))| {
                format!("joint {number} is `{drive}` there and `{robot}` here")
            })
    };
    Err(JointNamesError::Names { how, drive: drive.join(", "), robot: robot.join(", ") })
}

/// Whether each name of `long` is that of `short` behind one and the same prefix, or without any.
fn is_behind_a_prefix(long: &[&str], short: &[&str]) -> bool {
    let mut pairs =
        long.iter().zip(short).map(|(long, short)| long.strip_suffix(*short).filter(|_| !short.is_empty()));
    let Some(Some(prefix)) = pairs.next() else { return false };
    pairs.all(|other| other == Some(prefix))
}

fn is_reordered(drive: &[&str], robot: &[&str]) -> bool {
    let mut drive = drive.to_vec();
    let mut robot = robot.to_vec();
    drive.sort_unstable();
    robot.sort_unstable();
    is_behind_a_prefix(&drive, &robot) || is_behind_a_prefix(&robot, &drive)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UR: [&str; 3] = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"];

    fn told(names: &[&str]) -> DriveTextMsg {
        DriveTextMsg::of_joints(names)
    }

    #[test]
    fn the_same_joints_agree_behind_one_prefix() {
        assert_eq!(check_joint_names(&told(&UR), &UR), Ok(()));
        let left = UR.map(|name| format!("left_{name}"));
        assert_eq!(check_joint_names(&told(&UR), &left), Ok(()));
        let [a, b, c] = &left;
        assert_eq!(check_joint_names(&told(&[a, b, c]), &UR), Ok(()));
        let right = UR.map(|name| format!("right_{name}"));
        assert!(check_joint_names(&told(&[a, b, c]), &right).is_err(), "that is the other arm");
        let mixed = [left[0].as_str(), right[1].as_str(), left[2].as_str()];
        assert!(check_joint_names(&told(&mixed), &UR).is_err());
    }

    #[test]
    fn other_joints_are_refused_with_both_lists() {
        for (names, how) in [
            (
                &["shoulder_lift_joint", "shoulder_pan_joint", "elbow_joint"][..],
                "the same names in another order",
            ),
            (
                &["r_elbow_joint", "r_shoulder_pan_joint", "r_shoulder_lift_joint"],
                "the same names in another order",
            ),
            (&UR[..2], "2 joints, not 3"),
            (
                &["shoulder_pan_joint", "shoulder_lift_joint", "knee"],
                "joint 3 is `knee` there and `elbow_joint` here",
            ),
            (&["", "x", "y"], "joint 1 is `` there"),
            (&[], "0 joints, not 3"),
        ] {
            let words = check_joint_names(&told(names), &UR).unwrap_err().to_string();
            assert!(words.contains(how), "{words}");
            for name in UR.iter().chain(names) {
                assert!(words.contains(name), "{name}: {words}");
            }
            assert!(words.contains("robot.model"), "{words}");
        }
    }

    #[test]
    fn signs_and_zeros_that_differ_are_refused_and_untold_ones_pass() {
        let untold = DriveTextMsg { signs: [0.0; 7], ..told(&UR) };
        assert_eq!(check_joint_names(&untold, &UR), Ok(()));
        for wrong in [-1.0, 2.0, f64::NAN] {
            let mut turned = told(&UR);
            turned.signs[1] = wrong;
            let words = check_joint_names(&turned, &UR).unwrap_err().to_string();
            assert!(words.contains("joint 2 of the drive (`shoulder_lift_joint`)"), "{words}");
        }
        for wrong in [1.57, -0.01, f64::NAN, f64::INFINITY] {
            let mut moved = told(&UR);
            moved.zero_offsets[2] = wrong;
            let words = check_joint_names(&moved, &UR).unwrap_err().to_string();
            assert!(words.contains("joint 3 of the drive (`elbow_joint`) has its zero at"), "{words}");
        }
        let mut calibrated = told(&UR);
        calibrated.zero_offsets[0] = 4e-4;
        assert_eq!(check_joint_names(&calibrated, &UR), Ok(()));
    }
}
