use super::*;
use crate::motion::Reference;
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::Vector4;
use proptest::prelude::*;

const TICKS: usize = (DURATION.0 / TICK.0) as usize;

fn limits<const N: usize>(robot: &Robot<N>) -> MotionLimits<N> {
    MotionLimits {
        lower: SVector::from_fn(|i, _| robot.limits()[i].lower),
        upper: SVector::from_fn(|i, _| robot.limits()[i].upper),
        velocity: SVector::from_fn(|i, _| robot.limits()[i].velocity),
        acceleration: SVector::repeat(10.0),
        jerk: SVector::repeat(500.0),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    /// The motion passes through the reference, whose limits must not act, and ends where it began, at rest.
    #[test]
    fn it_ends_where_it_began_and_no_limit_acts(
        start in prop::array::uniform4(0.02..0.98f64), reach in prop::array::uniform4(-0.5..0.5f64),
        strength in 0.02..1.0f64
    ) {
        let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        let mut limits = limits(&robot);
        limits.velocity *= strength;
        limits.acceleration *= strength;
        limits.jerk *= strength;
        let q = Vector4::from_fn(|i, _| limits.lower[i] + start[i] * (limits.upper[i] - limits.lower[i]));
        let mut motion = ExcitationMotion::new(&q, &Vector4::from(reach), &limits);
        let mut reference = Reference::new(limits.clone(), q);
        let (mut farthest, mut ticks) = (Vector4::zeros(), 0);
        while !motion.is_over() || reference.state().qd.amax() > 1e-9 {
            let qd = motion.advance(TICK);
            let state = reference.advance(&qd, TICK);
            prop_assert_eq!(state.limits, crate::motion::ActingLimits::default());
            farthest = farthest.sup(&(state.q - q).abs());
            ticks += 1;
            prop_assert!(ticks < 2 * TICKS, "comes to rest");
        }
        prop_assert!((reference.state().q - q).amax() < 1e-9, "{}", reference.state().q - q);
        for i in 0..4 {
            let a = motion.amplitude()[i];
            prop_assert!(farthest[i] <= a.abs() + 1e-6, "{i}: {} {a}", farthest[i]);
            prop_assert!(farthest[i] >= 0.6 * a.abs(), "{i}: {} {a}", farthest[i]);
            prop_assert!(a * reach[i] >= 0.0 && a.abs() <= reach[i].abs());
            let end = limits.room(i, &q, a);
            prop_assert!(a.abs() <= RANGE_SHARE * end);
        }
    }
}

#[test]
fn a_joint_at_the_end_of_its_range_stays() {
    let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
    let limits = limits(&robot);
    let q = limits.upper;
    let out = ExcitationMotion::new(&q, &Vector4::repeat(0.1), &limits);
    assert_eq!(out.amplitude(), &Vector4::zeros());
    let back = ExcitationMotion::new(&(q * 1.1), &Vector4::repeat(-0.1), &limits);
    assert!(back.amplitude().iter().all(|a| *a <= 0.0 && a.is_finite()));
}
