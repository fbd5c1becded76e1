use super::super::MotionAgreement;
use super::super::strain::{CREDIBLE, OF_MOUNT, explained};
use super::super::wrong_mount::wrong_mounts;
use super::*;
use crate::linalg::Random;
use nalgebra::{Point3, Vector2};

const POINTS: [(f64, f64); 4] = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)];
/// Noise of a dot, normalized: 0.05 px of a lens of 800 px.
const NOISE: f64 = 6.25e-5;

/// A cell: where the object is, and what is told that is not so.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct DrawnMount {
    X_WO: Pose,
    /// The believed camera in the true one.
    mount: Pose,
    depth: f64,
    pub(in super::super) focal: f64,
}

pub(in super::super) fn vector(random: &mut Random, longest: f64) -> Vector3<f64> {
    let mut by = || random.between(-1.0, 1.0);
    let direction = Vector3::new(by(), by(), by());
    direction * (random.between(0.0, longest) / direction.norm().max(0.1))
}

fn set_point() -> SetPoint {
    let points = POINTS.map(|(x, y)| Point3::new(x, y, 0.0));
    let goal = Pose::new([-0.05, -0.05, 0.4].into(), [0.0; 3].into());
    SetPoint::from_pose(&goal, &points).unwrap()
}

impl DrawnMount {
    pub(in super::super) fn drawn(random: &mut Random, mount: Pose, depth: f64, focal: f64) -> Self {
        let by = vector(random, 0.05);
        let before = Pose::new(Vector3::new(-0.05, -0.05, 0.42) + by, vector(random, 0.5));
        // Before the true camera while the believed one is in the origin.
        Self { X_WO: mount.inverse() * before, mount, depth, focal }
    }

    /// A mount by up to 20 degrees and 5 cm off, a target that is up to twice as far or as near, a lens by up to a fifth longer or shorter.
    pub(in super::super) fn askew(random: &mut Random) -> Self {
        let mount = Pose::new(vector(random, 0.05), vector(random, 0.35));
        let (depth, focal) = (random.between(-0.69, 0.69).exp(), random.between(0.8, 1.2));
        Self::drawn(random, mount, depth, focal)
    }

    /// What is seen while the believed camera is at `X_WB`.
    fn view(&self, X_WB: &Pose, random: &mut Random) -> View {
        // `mount` takes coordinates of the believed camera into the true one.
        let X_CO = (self.mount * X_WB.inverse()) * self.X_WO;
        let mut noise = || random.gaussian() * NOISE;
        let s = POINTS.map(|(x, y)| {
            let p = X_CO * Point3::new(x, y, 0.0);
            (p.coords.xy() / p.z + Vector2::new(noise(), noise())) * self.focal
        });
        let believed = Pose::new(X_CO.translation.vector * self.depth, X_CO.rotation.scaled_axis());
        View::new(s.into_iter(), Some(believed)).unwrap()
    }
}

/// Of any first motion of 2 mm: with one more of 1 mm that a probe would make, a description that is askew explains both where it is so, and not where the mount is wrong.
#[test]
fn two_motions_tell_askew_mounts_from_wrong_ones() {
    let set_point = set_point();
    let mut random = Random::new(57);
    let wrong: Vec<_> = wrong_mounts().filter_map(|(mount, error)| Some((mount, error?))).collect();
    let strain_of = |cell: &DrawnMount, suspect: (WrongMount, CameraError), random: &mut Random| {
        let X_WB = Pose::new(vector(random, 0.002), vector(random, 0.02));
        let (base, view) = (cell.view(&Pose::identity(), random), cell.view(&X_WB, random));
        let first = SeenMotion { base, X_CB: X_WB.inverse(), view };
        let now = Sighting { exposure: MonoNs::ZERO, view, X_WC: X_WB };
        let probe = MountProbe::new(suspect, first, &now, &set_point).unwrap();
        let mut X_WC = X_WB;
        X_WC.translation.vector += probe.direction_W * 1e-3;
        let (X_CB, after) = (X_WC.inv_mul(&X_WB), cell.view(&X_WC, random));
        let second = SeenMotion { base: view, X_CB, view: after };
        explained(&[first, second], OF_MOUNT, &set_point).unwrap().strain
    };
    let (mut of_askew, mut of_wrong) = (Vec::new(), Vec::new());
    for k in 0..400 {
        let suspect = wrong[k % wrong.len()];
        let askew = DrawnMount::askew(&mut random);
        of_askew.push(strain_of(&askew, suspect, &mut random));
        let WrongMount::Turned(R) = suspect.0 else { continue };
        let beside = Pose::new(vector(&mut random, 0.01), vector(&mut random, 0.07));
        let cell = DrawnMount::drawn(&mut random, R.inverse() * beside, 1.0, 1.0);
        of_wrong.push(strain_of(&cell, suspect, &mut random));
    }
    of_askew.sort_by(f64::total_cmp);
    of_wrong.sort_by(f64::total_cmp);
    let share =
        |of: &[f64], is: &dyn Fn(f64) -> bool| of.iter().filter(|x| is(**x)).count() as f64 / of.len() as f64;
    let (most, least) = (of_askew.last(), of_wrong.first());
    assert!(share(&of_askew, &|x| x < CREDIBLE) >= 0.995, "{most:?}");
    assert!(share(&of_wrong, &|x| x > CREDIBLE) >= 0.98, "{least:?}, {:?}", &of_wrong[..20]);
}

/// The first motion of an arm that does what is asked of it, with the velocity `v`, `w` of the believed camera, for up to 1.6 s: what is judged, how far the camera was from its start, and whether a probe of the mount was made, and one of the lens. A share of
/// the measurements leaps by 4 px.
pub(in super::super) fn first_motion(
    cell: &DrawnMount,
    (v, w): (&Vector3<f64>, &Vector3<f64>),
    leaps: f64,
    random: &mut Random,
) -> (MotionAgreement, f64, [bool; 2]) {
    let set_point = set_point();
    let step = Pose::new(v * 0.04, w * 0.04);
    let mut agreement = MotionAgreement::new(true);
    let (mut X_WB, mut farthest, mut probed) = (Pose::identity(), 0.0f64, [false; 2]);
    for i in -4..40i64 {
        let time = MonoNs(1_000_000_000 + i * 40_000_000);
        let view = cell.view(&X_WB, random);
        let towards = TAU * random.between(0.0, 1.0);
        let leap = Vector2::new(towards.cos(), towards.sin()) * 0.005;
        let leap = if random.between(0.0, 1.0) < leaps { leap } else { Vector2::zeros() };
        let view = view.moved(|k| Some(view.feature(k)? + leap)).unwrap();
        agreement.note(time, &view, &X_WB, &set_point);
        if i < 0 {
            continue;
        }
        agreement.begin();
        if agreement.error().is_some() {
            break;
        }
        match agreement.probe_twist_C(&X_WB) {
            Some((v_C, w_C)) => {
                X_WB *= Pose::new(v_C * 0.04, w_C * 0.04);
                probed[usize::from(agreement.tries_lens())] = true;
            }
            None if !agreement.pauses() => X_WB *= step,
            None => {}
        }
        farthest = farthest.max(X_WB.translation.vector.norm());
    }
    (agreement, farthest, probed)
}

/// An arm along a straight screw, as the first motion of a law is, that does what is asked of it: of wrong mounts some are told within a centimetre, and none that is askew is.
#[test]
fn probes_tell_wrong_mounts_and_let_askew_ones_go_on() {
    let mut random = Random::new(58);
    let wrong: Vec<_> = wrong_mounts().filter_map(|(mount, error)| Some((mount, error?))).collect();
    let (mut told_by_probe, mut probes) = (0, [0; 2]);
    for k in 0..9000 {
        let suspect = wrong[k / 2 % wrong.len()];
        let is_wrong = k % 2 == 0;
        let cell = match suspect.0 {
            WrongMount::Turned(R) if is_wrong => {
                let beside = Pose::new(vector(&mut random, 0.01), vector(&mut random, 0.07));
                DrawnMount::drawn(&mut random, R.inverse() * beside, 1.0, 1.0)
            }
            _ if is_wrong => continue,
            _ => DrawnMount::askew(&mut random),
        };
        // As a law does it: it turns the camera, so that its target stays in view.
        let (v, by) = (vector(&mut random, 0.04), random.between(0.3, 1.5) / 0.4);
        let w = Vector3::new(v.y, -v.x, 0.0) * by + vector(&mut random, 0.05);
        let (agreement, farthest, [probed, _]) = first_motion(&cell, (&v, &w), 0.0, &mut random);
        probes[usize::from(is_wrong)] += u32::from(probed);
        if is_wrong {
            let is_told = agreement.error().is_some() && farthest < 0.01;
            told_by_probe += u32::from(is_told && probed);
        } else {
            assert_eq!(agreement.error(), None, "{k}: {cell:?}, {v:?} {w:?}");
        }
    }
    let [of_askew, of_wrong] = probes;
    assert!(of_askew >= 3 && of_wrong >= 500, "{probes:?}");
    // Measured: 413 of 1147. Why the others are not told within a centimetre was not looked into.
    assert!(told_by_probe * 3 >= of_wrong, "{told_by_probe} of {of_wrong}");
}

/// Where three measurements of ten leap, a camera that is turned by a quarter is hardly ever taken for one that is askew.
#[test]
fn leaps_make_no_wrong_mount_an_askew_one() {
    let mut random = Random::new(59);
    let (mut probes, mut askew) = (0, 0);
    for k in 0..2000 {
        let turn = Vector3::z() * (TAU / 4.0 * f64::from(1 + k % 3));
        let cell = DrawnMount::drawn(&mut random, Pose::new(Vector3::zeros(), turn), 1.0, 1.0);
        let v = vector(&mut random, 0.04);
        let w = Vector3::new(v.y, -v.x, 0.0) * 2.0 + vector(&mut random, 0.05);
        let (agreement, _, [probed, _]) = first_motion(&cell, (&v, &w), 0.3, &mut random);
        probes += u32::from(probed);
        askew += u32::from(probed && agreement.is_judged() && agreement.error().is_none());
    }
    assert!(probes >= 100 && askew * 50 <= probes, "{askew} of {probes}");
}
