use super::super::probe::tests::{DrawnMount, first_motion, vector};
use super::*;
use crate::linalg::Random;

/// A first motion as a law makes it: towards somewhere, with the turn that keeps a target in view, and another one.
fn motion(random: &mut Random) -> (Vector3<f64>, Vector3<f64>) {
    let (v, by) = (vector(random, 0.04), random.between(0.3, 1.5) / 0.4);
    (v, Vector3::new(v.y, -v.x, 0.0) * by + vector(random, 0.05))
}

/// What is told of 400 drawn cells with such a lens, whose mounts are a little off: shares that were told as an error, and that were told within a centimetre.
fn told(focal: f64, error: CameraError, random: &mut Random) -> (f64, f64) {
    let (mut all, mut near) = (0, 0);
    for _ in 0..400 {
        let beside = Pose::new(vector(random, 0.01), vector(random, 0.07));
        let cell = DrawnMount::drawn(random, beside, focal.recip(), focal);
        let (v, w) = motion(random);
        let (agreement, farthest, _) = first_motion(&cell, (&v, &w), 0.0, random);
        let is_told = agreement.error() == Some(error);
        assert!(is_told || agreement.error().is_none(), "{:?}", agreement.error());
        all += u32::from(is_told);
        near += u32::from(is_told && farthest < 0.01);
    }
    (f64::from(all) / 400.0, f64::from(near) / 400.0)
}

#[test]
fn lenses_of_half_and_twice_the_length_are_told() {
    let mut random = Random::new(81);
    let longer = told(2.0, CameraError::LongerLens, &mut random);
    let shorter = told(0.5, CameraError::ShorterLens, &mut random);
    assert!(longer.1 > 0.88 && shorter.1 > 0.88, "{longer:?} {shorter:?}");
}

/// A start after a fault judges anew, as that of a mount does: what was wrong may have been mended.
#[test]
fn a_lens_that_was_told_is_judged_anew() {
    let mut random = Random::new(84);
    let told = (0..20).find_map(|_| {
        let cell = DrawnMount::drawn(&mut random, Pose::identity(), 0.5, 2.0);
        let (v, w) = motion(&mut random);
        let (agreement, ..) = first_motion(&cell, (&v, &w), 0.0, &mut random);
        agreement.error().map(|_| agreement)
    });
    let mut agreement = told.unwrap();
    assert!(agreement.interrupt());
    assert_eq!(agreement.error(), None);
    assert!(!agreement.is_judged() && !agreement.tries_lens());
}

#[test]
fn lenses_that_are_a_little_off_are_no_error() {
    let mut random = Random::new(82);
    let mut probes = 0;
    for k in 0..4000 {
        let mut cell = DrawnMount::askew(&mut random);
        cell.focal = random.between(0.7, 1.3);
        let (v, w) = motion(&mut random);
        let (agreement, _, [_, probed]) = first_motion(&cell, (&v, &w), 0.0, &mut random);
        assert_eq!(agreement.error(), None, "{k}: {cell:?}, {v:?} {w:?}");
        probes += u32::from(probed);
    }
    assert!(probes > 100);
}

#[test]
fn what_is_as_told_is_not_tried() {
    let mut random = Random::new(83);
    for k in 0..1000 {
        let cell = DrawnMount::drawn(&mut random, Pose::identity(), 1.0, 1.0);
        let (v, w) = motion(&mut random);
        let (_, _, [of_mount, of_lens]) = first_motion(&cell, (&v, &w), 0.0, &mut random);
        assert!(!of_mount && !of_lens, "{k}: {v:?} {w:?}");
    }
}
