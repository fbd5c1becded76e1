//! Torque laws whose gains are for a larger arm.
//!
//! The gains of the text are for a SCARA of half a metre and 10 kg. An arm of some centimetres has a thousandth of its torques: efforts cut such a law joint by joint, so that the camera goes
//! another way than the law leads it, slowly, or not at all, and limits on its speed in space are passed by what the arm does then.

use crate::config::Camera;
use crate::config::check::Validation;
use crate::config::raw::{Gains, RawPd};
use crate::robot::{Mount, Robot, RobotDescription, joint_in_words};
use crate::servo::{Damping, Law, PoseGains};
use nalgebra::SVector;

/// How many times its effort the law's damping may ask of a joint at the joint's velocity limit. Chosen by hand: the shipped arms, which converge with the default gains, have less (the test below). Two arms of 20 cm
/// have 82 to 4500: with the default gains one of eight runs under A and C converged, with the gains that are told all eight.
const TOO_STRONG: f64 = 30.0;

/// How many times its effort a part of the law's damping asks of a joint, the one of which it asks most.
#[derive(Debug, Clone, Copy)]
struct Demand {
    joint: usize,
    times: f64,
}

/// Warns of gains of a torque law that ask joints for many times their effort at the start `q`, with gains that do not.
pub(super) fn doubtful_strength(
    law: &Law,
    pd: &RawPd,
    (robot, q): (&RobotDescription, &[f64]),
    camera: &Camera,
    check: &mut Validation<'_>,
) {
    let found = crate::dispatch_robot!(robot, |arm| demands(&arm, law, &camera.mount, q));
    let Ok(Some(found)) = found else { return };
    let keys = [
        ["servo.pd.position_stiffness_n_m", "servo.pd.position_damping_ns_m"],
        ["servo.pd.orientation_stiffness_nm_rad", "servo.pd.orientation_damping_nms_rad"],
    ];
    let gains = [
        [&pd.position_stiffness_n_m, &pd.position_damping_ns_m],
        [&pd.orientation_stiffness_nm_rad, &pd.orientation_damping_nms_rad],
    ];
    for ((Demand { joint, times }, [stiffness_key, damping_key]), [stiffness, damping]) in
        found.into_iter().zip(keys).zip(gains)
    {
        if times > TOO_STRONG {
            let message = format!(
                "this gain is for a larger arm: at the velocity limit of {} the damping that goes with it asks for {} times the joint's effort at the start, so that efforts cut the law and the \
                 camera goes another way than it leads; {stiffness_key} = {} and {damping_key} = {} ask for no more than the effort",
                joint_in_words(&robot.joint_names(), joint),
                short(times),
                lowered(stiffness, times),
                lowered(damping, times),
            );
            check.doubtful(stiffness_key, message);
        }
    }
}

/// A number above zero with two digits that mean something, or all before its point.
fn short(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

/// These gains, so many times lower, as a run file has them.
fn lowered(gains: &Gains, times: f64) -> String {
    let one = |gain: &f64| short(gain / times);
    let list = |gains: &[f64]| format!("[{}]", gains.iter().map(one).collect::<Vec<_>>().join(", "));
    match gains {
        Gains::One(gain) => one(gain),
        Gains::Each(gains) => list(gains),
        Gains::Matrix(rows) => {
            format!("[{}]", rows.iter().map(|row| list(row)).collect::<Vec<_>>().join(", "))
        }
    }
}

/// What the damping of position and orientation ask of the joints: of each joint `(J^T K_D J)_ii` times its velocity limit, by its effort. `None` where a law has no damping of the camera's motion.
fn demands<const N: usize>(robot: &Robot<N>, law: &Law, mount: &Mount, q: &[f64]) -> Option<[Demand; 2]> {
    let (Law::PositionTorque { damping: Damping::Task(K_D), .. }
    | Law::PreconditionedTorque { damping: Damping::Task(K_D), .. }) = law
    else {
        return None;
    };
    let q = SVector::<f64, N>::from_iterator(q.iter().copied().chain(std::iter::repeat(0.0)).take(N));
    let (J, K_D) = (mount.camera(robot, &q).1, PoseGains::matrix(K_D));
    let demand = |first: usize| {
        let K = K_D.fixed_view::<3, 3>(first, first);
        let of = |joint: usize| {
            let motion = J.matrix().fixed_view::<3, 1>(first, joint);
            let limits = &robot.limits()[joint];
            let torque = motion.dot(&(K * motion)) * limits.velocity;
            Demand { joint, times: if limits.effort > 0.0 { torque / limits.effort } else { 0.0 } }
        };
        (0..N).map(of).max_by(|a, b| a.times.total_cmp(&b.times))
    };
    Some([demand(0)?, demand(3)?]).filter(|both| both.iter().all(|demand| demand.times.is_finite()))
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    fn warnings(file: &str, set: &[&str]) -> Vec<String> {
        let set: Vec<String> = set.iter().map(|s| (*s).into()).collect();
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{file}.toml"));
        let config = Config::load(Some(&path), &set).unwrap();
        let told = config.warnings.iter().map(ToString::to_string);
        told.filter(|warning| warning.contains("is for a larger arm")).collect()
    }

    #[test]
    fn gains_for_a_larger_arm_are_told_with_ones_that_suit() {
        for file in ["ur5", "panda", "xarm7", "scara-a", "scara-c", "default"] {
            for scheme in ["servo.scheme=position_pd", "servo.scheme=image_pd"] {
                assert_eq!(warnings(file, &[scheme]), Vec::<String>::new(), "{file} {scheme}");
            }
        }
        // As an arm of a fiftieth of the torques has them, by gains that are as much higher.
        let strong = [
            "servo.scheme=position_pd",
            "servo.pd.position_stiffness_n_m=25000",
            "servo.pd.position_damping_ns_m=[25000,25000,500]",
        ];
        let told = warnings("ur5", &strong);
        let [told] = told.as_slice() else { panic!("{told:?}") };
        assert!(
            told.contains("servo.pd.position_stiffness_n_m") && told.contains("times the joint's effort"),
            "{told}"
        );
        let take = |key: &str| {
            let (_, value) = told.rsplit_once(&format!("{key} = ")).unwrap();
            let end =
                if value.starts_with('[') { value.find(']').unwrap() + 1 } else { value.find(' ').unwrap() };
            format!("{key}={}", &value[..end])
        };
        let suits =
            ["position_stiffness_n_m", "position_damping_ns_m"].map(|key| take(&format!("servo.pd.{key}")));
        assert_eq!(
            warnings("ur5", &["servo.scheme=position_pd", &suits[0], &suits[1]]),
            Vec::<String>::new()
        );
    }
}
