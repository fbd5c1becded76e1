//! The gains of the servo laws (in a run file a number, a list for a diagonal, or a matrix row by row), and the law with its gains.

use super::check::Validation;
use super::raw::{DampingOn, Depth, FeatureGain, Gains, PoseFrom, RawServo, SchemeKind};
use crate::messages::MAX_JOINTS;
pub(super) use crate::mission::requests::GAIN_1_S;
use crate::servo::{
    Damping, DepthSource, FeatureGains, FeatureMatrix, Gain, GainMatrix, HybridGains, Interaction, Law,
    NoGainMatrix, OperationalSpace, OrientationError, PoseGains, TwistWeights, eigenvalue_range,
};
use nalgebra::{DMatrix, Matrix6, SMatrix, SVector, Vector6};
use std::ops::RangeInclusive;

/// Ranges of gains, of numbers and of the eigenvalues of matrices; `tests/cores/plausible_numbers.rs` tries their ends. Chosen by hand: outside of
/// them a number has another unit; whether a gain is stable is a matter of the run.
const PD_GAIN: RangeInclusive<f64> = 0.0..=1e6;

/// Keys of gains of which a law uses some.
const VELOCITY_KEY: &str = "servo.gain_1_s";
const STIFFNESS_KEY: &str = "servo.pd.feature_stiffness_nm";
const DAMPING_KEY: &str = "servo.pd.feature_damping_nms";

/// A diagonal or a whole matrix as a file has it.
#[derive(Debug, Clone, Copy)]
enum GainForm<const M: usize> {
    Diagonal(SVector<f64, M>),
    Full(SMatrix<f64, M, M>),
}

impl<const M: usize> GainForm<M> {
    fn matrix(&self) -> SMatrix<f64, M, M> {
        match self {
            Self::Diagonal(k) => SMatrix::from_diagonal(k),
            Self::Full(K) => *K,
        }
    }

    /// Rows and columns `from` and on.
    fn block<const B: usize>(&self, from: usize) -> GainForm<B> {
        match self {
            Self::Diagonal(k) => GainForm::Diagonal(k.fixed_rows::<B>(from).into()),
            Self::Full(K) => GainForm::Full(K.fixed_view::<B, B>(from, from).into()),
        }
    }

    /// The gains; an invalid one has been reported, so that no run has it.
    fn gains(&self) -> GainMatrix<M> {
        match self {
            Self::Diagonal(k) => (*k).into(),
            Self::Full(K) => GainMatrix::full(*K).unwrap_or_else(|_| GainMatrix::zeros()),
        }
    }
}

/// The law; an image-based one compares `numbers` numbers.
pub(super) fn law(s: &RawServo, numbers: Option<usize>, check: &mut Validation<'_>) -> Law {
    let orientation = s.orientation_error;
    let position_based = matches!(s.scheme, SchemeKind::PositionPd | SchemeKind::PositionResolvedVelocity);
    let space = match s.dimension {
        6 if s.pose_from == PoseFrom::Homography && position_based => OperationalSpace::Homography,
        4 => OperationalSpace::Four,
        6 => OperationalSpace::Six,
        other => {
            check.wrong("servo.dimension", format!("{other} is neither 4 nor 6"));
            OperationalSpace::Six
        }
    };
    let constant_depth_m = check.range("servo.constant_depth_m", s.constant_depth_m, 1e-3..=1e3);
    let pd = pd_gains(s, check);
    let gain = common_gain(s, check);
    let interaction = Interaction {
        at: s.interaction,
        depth: match s.depth {
            Depth::Desired => DepthSource::Desired,
            Depth::Estimated => DepthSource::Estimated,
            Depth::Known => DepthSource::Known,
            Depth::Initial => DepthSource::Initial,
            Depth::Constant => DepthSource::Constant(constant_depth_m),
        },
    };
    match s.scheme {
        SchemeKind::PositionPd => {
            unused(&[VELOCITY_KEY, STIFFNESS_KEY, DAMPING_KEY], s, check);
            Law::PositionTorque { K_P: pd.K_P, damping: pd.damping(s, pd.K_D), orientation, space }
        }
        SchemeKind::PositionResolvedVelocity => {
            unused(&[STIFFNESS_KEY, DAMPING_KEY], s, check);
            let (K, weights) = (velocity_gains(s, check).gains(), TwistWeights::Unit);
            Law::PositionVelocity { K, gain, orientation, space, weights }
        }
        // Its views are judged as those of scheme B, which goes by the pose too; the arm follows no law.
        SchemeKind::LookAndMove => {
            unused(&[VELOCITY_KEY, STIFFNESS_KEY, DAMPING_KEY], s, check);
            let (K, weights) = (PoseGains::repeat(1.0), TwistWeights::Unit);
            Law::PositionVelocity { K, gain, orientation, space, weights }
        }
        SchemeKind::ImagePd if s.pd.feature_gain == FeatureGain::Preconditioned => {
            unused(&[VELOCITY_KEY, DAMPING_KEY], s, check);
            let rest = only_number(&s.pd.feature_stiffness_nm, STIFFNESS_KEY, check);
            let K_Ps = FeatureGains { K_P: pd.K_P, rest };
            Law::PreconditionedTorque { K_Ps, damping: pd.damping(s, pd.K_D), interaction }
        }
        SchemeKind::ImagePd => {
            unused(&[VELOCITY_KEY], s, check);
            let [K_Ps, K_D] = feature_pd(s, numbers, check);
            Law::ImageTorque { K_Ps, damping: pd.damping(s, K_D), interaction }
        }
        SchemeKind::ImageResolvedVelocity => {
            unused(&[STIFFNESS_KEY, DAMPING_KEY], s, check);
            let (K_s, gain) = match feature_matrix((VELOCITY_KEY, &s.gain_1_s), numbers, &GAIN_1_S, check) {
                FeatureMatrix::Scalar(gain_1_s) => (1.0.into(), scaled(gain, gain_1_s)),
                K_s @ FeatureMatrix::Entries(_) => (K_s, gain),
            };
            Law::ImageVelocity { K_s, gain, interaction }
        }
        SchemeKind::Hybrid => {
            unused(&[STIFFNESS_KEY, DAMPING_KEY], s, check);
            let K = velocity_gains(s, check);
            if K.matrix().fixed_view::<3, 3>(0, 3).amax() > 0.0 {
                let message = "couples position and orientation: the hybrid law has a matrix K_p and a matrix K_o; write 0 in rows 1 to 3 from \
                               column 4 on, and in the rows below up to column 3";
                check.wrong(VELOCITY_KEY, message);
            }
            let gains = HybridGains { K_p: K.block(0).gains(), K_o: K.block(3).gains() };
            Law::Hybrid { gains, gain, orientation, space, depth: interaction.depth }
        }
    }
}

/// Gains of the torque laws A and C over poses, and on the joints.
struct PdGains {
    K_P: PoseGains,
    K_D: PoseGains,
    joints: [f64; MAX_JOINTS],
}

impl PdGains {
    fn damping<K>(&self, s: &RawServo, K_D: K) -> Damping<K> {
        match s.pd.damping {
            DampingOn::Task => Damping::Task(K_D),
            DampingOn::Joints => Damping::Joints(self.joints),
        }
    }
}

/// All of them, whichever law is used: a wrong number is reported before it is needed.
fn pd_gains(s: &RawServo, check: &mut Validation<'_>) -> PdGains {
    let pd = &s.pd;
    PdGains {
        K_P: pose_gains(
            check,
            ("servo.pd.position_stiffness_n_m", &pd.position_stiffness_n_m),
            ("servo.pd.orientation_stiffness_nm_rad", &pd.orientation_stiffness_nm_rad),
        ),
        K_D: pose_gains(
            check,
            ("servo.pd.position_damping_ns_m", &pd.position_damping_ns_m),
            ("servo.pd.orientation_damping_nms_rad", &pd.orientation_damping_nms_rad),
        ),
        joints: joint_damping(s, check),
    }
}

/// K_Ps and K_Ds of scheme C.
fn feature_pd(s: &RawServo, numbers: Option<usize>, check: &mut Validation<'_>) -> [FeatureMatrix; 2] {
    let pd = &s.pd;
    let keys = [(STIFFNESS_KEY, &pd.feature_stiffness_nm), (DAMPING_KEY, &pd.feature_damping_nms)];
    if pd.feature_gain != FeatureGain::Matrix {
        return keys.map(|(key, gains)| only_number(gains, key, check).into());
    }
    if !s.weights.is_empty() {
        let message = "have no part in a matrix K_Ps (servo.pd.feature_gain = \"matrix\"): multiply its diagonal by them, and leave them out";
        check.wrong("servo.weights", message);
    }
    keys.map(|key| feature_matrix(key, numbers, &PD_GAIN, check))
}

/// A wrong number is reported before it is needed: the gains under `keys`, which the law does not use.
fn unused(keys: &[&str], s: &RawServo, check: &mut Validation<'_>) {
    for key in keys {
        let (gains, range) = match *key {
            VELOCITY_KEY => (&s.gain_1_s, GAIN_1_S),
            STIFFNESS_KEY => (&s.pd.feature_stiffness_nm, PD_GAIN),
            _ => (&s.pd.feature_damping_nms, PD_GAIN),
        };
        match gains {
            Gains::One(gain) => {
                check.range(key, *gain, range);
            }
            Gains::Each(list) => in_range(key, list, &range, check),
            Gains::Matrix(rows) => rows_in_range(key, rows, &range, check),
        }
    }
}

/// The gain of a law that supports a single number only.
fn only_number(gains: &Gains, key: &str, check: &mut Validation<'_>) -> f64 {
    match gains {
        Gains::One(gain) => check.range(key, *gain, PD_GAIN),
        Gains::Each(_) | Gains::Matrix(_) => {
            check.wrong(key, "is one number; a list or a matrix needs servo.pd.feature_gain = \"matrix\"");
            0.0
        }
    }
}

/// A gain over the law's so many `numbers`.
fn feature_matrix(
    (key, gains): (&str, &Gains),
    numbers: Option<usize>,
    range: &RangeInclusive<f64>,
    check: &mut Validation<'_>,
) -> FeatureMatrix {
    let found = match gains {
        Gains::One(gain) => Some(check.range(key, *gain, range.clone()).into()),
        Gains::Each(list) => {
            in_range(key, list, range, check);
            match numbers.filter(|n| *n != list.len()) {
                None => FeatureMatrix::diagonal(list).map_err(|why| told(key, why, None, check)).ok(),
                Some(n) => {
                    let message = format!(
                        "has {} entries; the law compares {n} numbers (x and y of each point, four of a segment, then the area's): write one gain \
                         for all, {n} in a list, or a matrix of {n} lists",
                        list.len()
                    );
                    check.wrong(key, message);
                    None
                }
            }
        }
        Gains::Matrix(rows) => numbers
            .and_then(|n| dense((key, rows), &[n], range, check))
            .and_then(|K| FeatureMatrix::full(&K).ok()),
    };
    found.unwrap_or(FeatureMatrix::Scalar(1.0))
}

/// The gain times `factor`.
fn scaled(gain: Gain, factor: f64) -> Gain {
    match gain {
        Gain::Constant(gain) => Gain::Constant(gain * factor),
        Gain::Adaptive { at_zero_1_s, at_infinity_1_s, slope_1_s } => Gain::Adaptive {
            at_zero_1_s: at_zero_1_s * factor,
            at_infinity_1_s: at_infinity_1_s * factor,
            slope_1_s: slope_1_s * factor,
        },
    }
}

/// The common factor: the adaptive one, or 1.
fn common_gain(s: &RawServo, check: &mut Validation<'_>) -> Gain {
    s.adaptive_gain.as_ref().map_or(Gain::Constant(1.0), |a| Gain::Adaptive {
        at_zero_1_s: check.range("servo.adaptive_gain.at_zero", a.at_zero, 1e-3..=100.0),
        at_infinity_1_s: check.range("servo.adaptive_gain.at_infinity", a.at_infinity, 1e-3..=100.0),
        slope_1_s: check.range("servo.adaptive_gain.slope", a.slope, 0.0..=1e4),
    })
}

/// K of the laws that go by poses: x, y, z and the three numbers of the orientation.
fn velocity_gains(s: &RawServo, check: &mut Validation<'_>) -> GainForm<6> {
    let one = GainForm::Diagonal(Vector6::repeat(1.0));
    match &s.gain_1_s {
        Gains::One(gain) => GainForm::Diagonal(Vector6::repeat(check.range(VELOCITY_KEY, *gain, GAIN_1_S))),
        Gains::Each(list) => {
            in_range(VELOCITY_KEY, list, &GAIN_1_S, check);
            match *list.as_slice() {
                [x, y, z, alpha] => GainForm::Diagonal(Vector6::new(x, y, z, alpha, alpha, alpha)),
                [x, y, z, a, b, c] => GainForm::Diagonal(Vector6::new(x, y, z, a, b, c)),
                _ => {
                    check.wrong(VELOCITY_KEY, format!("has {} entries, needs 1, 4 or 6", list.len()));
                    one
                }
            }
        }
        Gains::Matrix(rows) => match dense((VELOCITY_KEY, rows), &[4, 6], &GAIN_1_S, check) {
            Some(K) if K.nrows() == 4 => GainForm::Full(of_four(&K, s.orientation_error)),
            Some(K) => GainForm::Full(K.fixed_view::<6, 6>(0, 0).into()),
            None => one,
        },
    }
}

/// The matrix over x, y, z and the rotation about the optical axis, which is the first of the Euler angles z, y, x and the last of the
/// other errors' numbers; the other two have its gain.
fn of_four(K: &DMatrix<f64>, orientation: OrientationError) -> Matrix6<f64> {
    let about_z = if orientation == OrientationError::EulerZyx { 3 } else { 5 };
    let mut six = Matrix6::identity() * K[(3, 3)];
    for i in 0..4 {
        for j in 0..4 {
            let place = |i: usize| if i == 3 { about_z } else { i };
            six[(place(i), place(j))] = K[(i, j)];
        }
    }
    six
}

fn pose_gains(
    check: &mut Validation<'_>,
    position: (&str, &Gains),
    orientation: (&str, &Gains),
) -> PoseGains {
    match [position, orientation].map(|key| three(key, check)) {
        [GainForm::Diagonal(p), GainForm::Diagonal(o)] => {
            PoseGains::from(Vector6::new(p.x, p.y, p.z, o.x, o.y, o.z))
        }
        [p, o] => {
            let mut K = Matrix6::zeros();
            K.fixed_view_mut::<3, 3>(0, 0).copy_from(&p.matrix());
            K.fixed_view_mut::<3, 3>(3, 3).copy_from(&o.matrix());
            GainForm::Full(K).gains()
        }
    }
}

fn three((key, gains): (&str, &Gains), check: &mut Validation<'_>) -> GainForm<3> {
    match gains {
        Gains::One(gain) => GainForm::Diagonal(SVector::repeat(check.range(key, *gain, PD_GAIN))),
        Gains::Each(list) => {
            in_range(key, list, &PD_GAIN, check);
            match *list.as_slice() {
                [x, y, z] => GainForm::Diagonal(SVector::from([x, y, z])),
                _ => {
                    check.wrong(key, format!("has {} entries, needs 1 or 3", list.len()));
                    GainForm::Diagonal(SVector::zeros())
                }
            }
        }
        Gains::Matrix(rows) => match dense((key, rows), &[3], &PD_GAIN, check) {
            Some(K) => GainForm::Full(K.fixed_view::<3, 3>(0, 0).into()),
            None => GainForm::Diagonal(SVector::zeros()),
        },
    }
}

fn joint_damping(s: &RawServo, check: &mut Validation<'_>) -> [f64; MAX_JOINTS] {
    let key = "servo.pd.joint_damping_nms_rad_or_ns_m";
    let mut damping = [0.0; MAX_JOINTS];
    match &s.pd.joint_damping_nms_rad_or_ns_m {
        Gains::One(gain) => damping = [check.range(key, *gain, PD_GAIN); MAX_JOINTS],
        Gains::Each(list) if list.len() > MAX_JOINTS => {
            check.wrong(key, format!("has {} entries, more than {MAX_JOINTS} joints", list.len()));
        }
        Gains::Each(list) => {
            in_range(key, list, &PD_GAIN, check);
            for (place, gain) in damping.iter_mut().zip(list) {
                *place = *gain;
            }
        }
        Gains::Matrix(_) => check.wrong(key, "is one number, or a list of one for each joint"),
    }
    damping
}

fn in_range(key: &str, list: &[f64], range: &RangeInclusive<f64>, check: &mut Validation<'_>) {
    for (i, gain) in list.iter().enumerate() {
        check.range(&format!("{key}[{i}]"), *gain, range.clone());
    }
}

/// No entry of a positive definite matrix is greater than its largest eigenvalue.
fn rows_in_range(key: &str, rows: &[Vec<f64>], range: &RangeInclusive<f64>, check: &mut Validation<'_>) {
    for (i, row) in rows.iter().enumerate() {
        in_range(&format!("{key}[{i}]"), row, &(-range.end()..=*range.end()), check);
    }
}

/// A symmetric and positive definite matrix of one of the `sizes`, its eigenvalues in `range`; `None` for another, which is reported.
fn dense(
    (key, rows): (&str, &[Vec<f64>]),
    sizes: &[usize],
    range: &RangeInclusive<f64>,
    check: &mut Validation<'_>,
) -> Option<DMatrix<f64>> {
    let n = rows.len();
    if let Some((i, row)) = rows.iter().enumerate().find(|(_, row)| row.len() != n) {
        let message = format!(
            "has {n} rows, but row {} has {} entries; a matrix has as many of both",
            i + 1,
            row.len()
        );
        check.wrong(key, message);
        return None;
    }
    if !sizes.contains(&n) {
        let needed: Vec<_> = sizes.iter().map(|n| format!("{n} x {n}")).collect();
        check.wrong(key, format!("is {n} x {n}, needs {}", needed.join(" or ")));
        return None;
    }
    let before = check.count_problems();
    rows_in_range(key, rows, range, check);
    if check.count_problems() > before {
        return None;
    }
    let K = DMatrix::from_row_iterator(n, n, rows.iter().flatten().copied());
    match eigenvalue_range(&K) {
        Ok([smallest, largest]) if range.contains(&smallest) && range.contains(&largest) => Some(K),
        Ok([smallest, largest]) => {
            let message = format!(
                "has the eigenvalues {smallest:.4} to {largest:.4}, allowed is {} to {}: its gains along some directions are too small or too large",
                range.start(),
                range.end()
            );
            check.wrong(key, message);
            None
        }
        Err(why) => {
            told(key, why, Some(&K), check);
            None
        }
    }
}

/// Reports what is wrong with the matrix `K`, with a remedy.
fn told(key: &str, why: NoGainMatrix, K: Option<&DMatrix<f64>>, check: &mut Validation<'_>) {
    let entry = |i: usize, j: usize| K.map_or(0.0, |K| K[(i, j)]);
    let message = match why {
        NoGainMatrix::NoMatrix => "is no matrix of numbers".into(),
        NoGainMatrix::Asymmetric(i, j) => format!(
            "is not symmetric: {} in row {}, column {}, but {} in row {}, column {}; write the same number in both",
            entry(i, j),
            i + 1,
            j + 1,
            entry(j, i),
            j + 1,
            i + 1
        ),
        NoGainMatrix::NotPositive(smallest) => format!(
            "is not positive definite: its smallest eigenvalue is {smallest:.4}, so that some error would not fall; raise the diagonal or lower \
             what is beside it (it suffices that each diagonal entry is greater than the sum of the others of its row, without their signs)"
        ),
    };
    check.wrong(key, message);
}

#[cfg(test)]
mod tests;
