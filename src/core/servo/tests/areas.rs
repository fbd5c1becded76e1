//! Features of an area in the laws, against dense least squares.

use super::{goal, pose, seen, square};
use crate::features::{AreaFeature, EllipseFeature, Feature, ImageMoments, MomentFeature, point_rows};
use crate::geometry::Pose;
use crate::servo::*;
use nalgebra::{DMatrix, DVector, Vector2, Vector3};
use proptest::prelude::*;

const ESTIMATED: Interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };

proptest! {
    /// An area's features, with the object's plane from its pose, beside a point: against dense least squares.
    #[test]
    fn features_of_an_area(now in pose(), X_DO in pose(), w in 0.2..3.0f64) {
        let plane = |X: &Pose| {
            let n = X.rotation * Vector3::z();
            n / n.dot(&X.translation.vector)
        };
        let area = |s: &[Vector2<f64>], X: &Pose| AreaFeature::new(ImageMoments::of_polygon(s), plane(X));
        let view = seen(&now, &square());
        for feature in [OutlineFeature::Area, OutlineFeature::Moments, OutlineFeature::Ellipse] {
            let kinds = [(FeatureKind::Outline(feature), w), (FeatureKind::Point(2), 1.0)];
            let selection = Selection::new(kinds).unwrap().with_outline([3, 0, 1, 2]).unwrap();
            let set_point = goal(&X_DO).with_selection(selection).unwrap();
            let (s, s_d) = (view.features(), set_point.features());
            let (a, b) = (area(s, &now), area(s_d, &X_DO));
            let a = a.in_sense_of(&b);
            let reference_m = b.depth_m().unwrap() * b.moments().area().sqrt();
            let normalized = |a: &AreaFeature| MomentFeature::new(*a, reference_m);
            let dense = |L: DMatrix<f64>, e: DVector<f64>| {
                let (L_p, e_p) = (point_rows(&s[2], (now * square()[2]).z), s_d[2] - s[2]);
                (L.transpose() * &L * w + DMatrix::from_row_slice(6, 6, (L_p.transpose() * L_p).as_slice()),
                 L.transpose() * e * w + DVector::from_column_slice((L_p.transpose() * e_p).as_slice()))
            };
            let rows = |L: &[f64]| DMatrix::from_column_slice(L.len() / 6, 6, L);
            let (A, y) = match feature {
                OutlineFeature::Area => {
                    let e = a.error(&b.value());
                    dense(rows(a.interaction().unwrap().as_slice()), DVector::from_column_slice(e.as_slice()))
                }
                OutlineFeature::Moments => {
                    let (a, b) = (normalized(&a), normalized(&b));
                    let e = a.error(&b.value());
                    dense(rows(a.interaction().unwrap().as_slice()), DVector::from_column_slice(e.as_slice()))
                }
                OutlineFeature::Ellipse => {
                    let (a, b) = (EllipseFeature::of_area(&a), EllipseFeature::of_area(&b));
                    let e = a.error(&b.value());
                    dense(rows(a.interaction().unwrap().as_slice()), DVector::from_column_slice(e.as_slice()))
                }
            };
            let task = image_task(&set_point, &view, ESTIMATED).unwrap();
            let matrix = DMatrix::from_column_slice(6, 6, task.matrix.as_slice());
            let vector = DVector::from_column_slice(task.vector.as_slice());
            prop_assert!((&matrix - &A).norm() < 1e-8 * (1.0 + A.norm()), "{feature:?} {matrix} {A}");
            prop_assert!((&vector - &y).norm() < 1e-8 * (1.0 + y.norm()), "{feature:?} {vector} {y}");
            let gains = FeatureGains { K_P: PoseGains::repeat(2.0), rest: 1.0 };
            let wrench = preconditioned_wrench(&set_point, &view, &gains, &PoseGains::repeat(1.0), ESTIMATED);
            prop_assert!(wrench.is_some_and(|task| task.wrench.iter().all(|x| x.is_finite())));
        }
    }
}
