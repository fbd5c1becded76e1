//! The object-space error of a set of points as a quadratic form of the rotation alone, and its minima.
//!
//! For a point at `p = R r + t` with the image (X, Y), the part of p that is not on its ray has the size `(p_x - X p_z, p_y - Y p_z)`:
//! the reprojection error (10.36) times the depth. The sum of squares is quadratic in R and t together. The best t is linear
//! in R; with it the sum is `r^T O r`, r the nine entries of R, column by column. Its minima over all rotations are found from
//! a grid ([`super::rotation_grid`]) by Newton's method. The rotation searched for is that of the principal axes of the
//! points; lengths are in units of their size.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use super::PointSource;
use super::rotation_grid::{COLUMNS, COUNT, PRODUCTS, minima};
use crate::linalg::Ldlt;

/// The form and the best position.
#[derive(Debug, Clone)]
pub(super) struct RotationForm {
    /// O, symmetric.
    form: [[f64; 9]; 9],
    /// The best position is `T r`, three rows.
    position: [[f64; 9]; 3],
}

/// One rotation (columns one after the other) and the value of the form.
#[derive(Debug, Clone, Copy)]
pub(super) struct RotationCandidate {
    pub(super) columns: [f64; 9],
    pub(super) value: f64,
}

/// Where the points lie: mean, principal axes as rows, size.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axes {
    pub(super) mean: [f64; 3],
    /// Greatest extent first, right-handed.
    pub(super) rows: [[f64; 3]; 3],
    /// Root of the mean squared distance from the mean, m.
    pub(super) size: f64,
}

impl Axes {
    /// Coordinates of an object point along the axes, in units of the size.
    #[inline(always)]
    fn apply(&self, r: [f64; 3], over: f64) -> [f64; 3] {
        let d = [r[0] - self.mean[0], r[1] - self.mean[1], r[2] - self.mean[2]];
        self.rows.map(|row| (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) * over)
    }
}

impl RotationForm {
    /// The sums over all points; `None` when all have the same image.
    #[inline]
    pub(super) fn new<P: PointSource>(points: &[P], axes: &Axes) -> Option<Self> {
        // Sums of {1, X, Y, X^2 + Y^2} times {1, r_a, r_a r_b}; the sums of r_a vanish, those of r_a r_b are one matrix.
        let mut q = [0.0; 4];
        let mut b = [[0.0; 4]; 3];
        let mut c = [[[0.0; 4]; 3]; 3];
        let over = 1.0 / axes.size;
        for point in points {
            let (r, [X, Y]) = (axes.apply(point.object(), over), point.image());
            let s = [1.0, X, Y, X * X + Y * Y];
            for k in 0..4 {
                q[k] += s[k];
            }
            for i in 0..3 {
                let rs = s.map(|s| r[i] * s);
                for k in 0..4 {
                    b[i][k] += rs[k];
                }
                for j in 0..=i {
                    for k in 0..4 {
                        c[i][j][k] += r[j] * rs[k];
                    }
                }
            }
        }
        let spread = |s: &[f64; 4]| [[s[0], 0.0, -s[1]], [0.0, s[0], -s[2]], [-s[1], -s[2], s[3]]];
        let factors = Ldlt::new(&spread(&q), &[0.0; 3])?;
        let mut position = [[0.0; 9]; 3];
        let blocks = b.map(|b| spread(&b));
        for (a, block) in blocks.iter().enumerate() {
            for j in 0..3 {
                let t = factors.solve(&block[j]);
                for i in 0..3 {
                    position[i][3 * a + j] = -t[i];
                }
            }
        }
        let mut form = [[0.0; 9]; 9];
        for a in 0..3 {
            for d in 0..=a {
                let own = spread(&c[a][d]);
                for i in 0..3 {
                    for j in 0..3 {
                        let mut x = own[i][j];
                        for k in 0..3 {
                            x += blocks[a][i][k] * position[k][3 * d + j];
                        }
                        form[3 * a + i][3 * d + j] = x;
                        form[3 * d + j][3 * a + i] = x;
                    }
                }
            }
        }
        Some(Self { form, position })
    }

    /// The position of the points' mean for a rotation, in units of their size.
    pub(super) fn position(&self, columns: &[f64; 9]) -> [f64; 3] {
        self.position.map(|row| row.iter().zip(columns).map(|(a, b)| a * b).sum())
    }

    /// Local minima on the grid, the lowest first.
    #[inline]
    pub(super) fn starts<const MOST: usize>(&self) -> ([usize; MOST], usize) {
        let mut values = [0.0; COUNT];
        let mut k = 0;
        for i in 0..9 {
            for j in i..9 {
                let x = self.form[i][j];
                for (value, product) in values.iter_mut().zip(&PRODUCTS[k]) {
                    *value += x * product;
                }
                k += 1;
            }
        }
        let (mut best, mut len) = ([0; MOST], 0);
        for i in minima(&values) {
            let mut at = len;
            while at > 0 && values[best[at - 1]] > values[i] {
                if at < MOST {
                    best[at] = best[at - 1];
                }
                at -= 1;
            }
            if at < MOST {
                best[at] = i;
                len = (len + 1).min(MOST);
            }
        }
        (best, len)
    }

    /// The rotation of the grid.
    pub(super) fn start(index: usize) -> [f64; 9] {
        COLUMNS[index.min(COUNT - 1)]
    }

    /// The form times `r`.
    #[inline(always)]
    fn times(&self, r: &[f64; 9]) -> [f64; 9] {
        let mut y = [0.0; 9];
        for j in 0..9 {
            for i in 0..9 {
                y[i] += self.form[j][i] * r[j];
            }
        }
        y
    }

    /// Newton's method from `columns`, until the step is below `last_step` rad or 12 steps are done.
    #[inline]
    pub(super) fn descend(&self, columns: [f64; 9], last_step: f64) -> RotationCandidate {
        let mut r = columns;
        let mut y = self.times(&r);
        let mut value = dot(&r, &y);
        let mut damping = 0.0;
        for _ in 0..12 {
            let (gradient, curvature, flat) = self.model(&r, &y);
            // Beside a saddle the curvature is not positive: then the part that is, which every step can trust.
            let (matrix, damp) = match Ldlt::new(&curvature, &[damping; 3]) {
                Some(factors) => (factors, damping),
                None => {
                    let damp = 0.05 * (flat[0][0] + flat[1][1] + flat[2][2]) + damping;
                    match Ldlt::new(&flat, &[damp; 3]) {
                        Some(factors) => (factors, damp),
                        None => break,
                    }
                }
            };
            let w = matrix.solve(&gradient.map(|x| -x));
            let next = turned(&r, &w);
            let next_y = self.times(&next);
            let next_value = dot(&next, &next_y);
            if next_value <= value {
                (r, y, value, damping) = (next, next_y, next_value, 0.1 * damping);
            } else {
                // Chosen by hand: a tenth of the sum is a third of the mean curvature, which shortens a step by a quarter; four times, tried again
                // and again, makes it as short as it must be.
                damping = (4.0 * damp).max(0.1 * (flat[0][0] + flat[1][1] + flat[2][2]));
            }
            if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < last_step * last_step {
                break;
            }
        }
        RotationCandidate { columns: r, value }
    }

    /// Half of the gradient and of the Hessian at `r` over small turns about the camera's axes, and the Hessian's part that
    /// is never negative.
    #[inline(always)]
    fn model(&self, r: &[f64; 9], y: &[f64; 9]) -> ([f64; 3], [[f64; 3]; 3], [[f64; 3]; 3]) {
        // d r / d w_k = e_k x R_a for the columns R_a.
        let mut d = [[0.0; 9]; 3];
        for a in [0, 3, 6] {
            let (x, y, z) = (r[a], r[a + 1], r[a + 2]);
            (d[0][a + 1], d[0][a + 2]) = (-z, y);
            (d[1][a], d[1][a + 2]) = (z, -x);
            (d[2][a], d[2][a + 1]) = (-y, x);
        }
        let gradient = d.map(|d| dot(&d, y));
        let products = [self.times(&d[0]), self.times(&d[1]), self.times(&d[2])];
        let mut flat = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..=i {
                flat[i][j] = dot(&d[i], &products[j]);
            }
        }
        // w x (w x R_a) . y_a = (w . y_a) (w . R_a) - |w|^2 y_a . R_a, half of it by Taylor.
        let value = dot(r, y);
        let mut curvature = flat;
        for i in 0..3 {
            for j in 0..=i {
                for a in [0, 3, 6] {
                    curvature[i][j] += 0.5 * (y[a + i] * r[a + j] + y[a + j] * r[a + i]);
                }
            }
            curvature[i][i] -= value;
        }
        (gradient, curvature, flat)
    }
}

#[inline(always)]
fn dot(a: &[f64; 9], b: &[f64; 9]) -> f64 {
    let mut sum = 0.0;
    for i in 0..9 {
        sum += a[i] * b[i];
    }
    sum
}

/// The rotation turned by `w`, to second order, and exactly a rotation (Cayley's map).
#[inline(always)]
fn turned(r: &[f64; 9], w: &[f64; 3]) -> [f64; 9] {
    let u = w.map(|x| 0.5 * x);
    let uu = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
    let over = 1.0 / (1.0 + uu);
    let mut out = [0.0; 9];
    for a in [0, 3, 6] {
        let (x, y, z) = (r[a], r[a + 1], r[a + 2]);
        let along = u[0] * x + u[1] * y + u[2] * z;
        let cross = [u[1] * z - u[2] * y, u[2] * x - u[0] * z, u[0] * y - u[1] * x];
        for (i, v) in [x, y, z].into_iter().enumerate() {
            out[a + i] = ((1.0 - uu) * v + 2.0 * cross[i] + 2.0 * u[i] * along) * over;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::testing::{gauss, poses, see_3d};
    use super::super::{Correspondence3, reprojection_rms};
    use super::*;
    use crate::geometry::Pose;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    const PLAIN: Axes =
        Axes { mean: [0.0; 3], rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], size: 1.0 };

    fn sum_of_squares(points: &[Correspondence3], R: &Matrix3<f64>, t: &Vector3<f64>) -> f64 {
        let one = |c: &Correspondence3| {
            let p = R * c.r.coords + t;
            (p.x - c.s.x * p.z).powi(2) + (p.y - c.s.y * p.z).powi(2)
        };
        points.iter().map(one).sum()
    }

    proptest! {
        #[test]
        fn the_form_is_the_sum_of_squares_at_its_best_position(
            X in poses(1.0), w in prop::array::uniform3(-2.0..2.0f64), d in prop::array::uniform3(-0.1..0.1f64)
        ) {
            let mut random = gauss(5);
            let object: Vec<_> = (0..7).map(|_| [0.1 * random(), 0.1 * random(), 0.1 * random()]).collect();
            let points = see_3d(&X, &object, || 0.0);
            prop_assume!(reprojection_rms(&X, &points).is_finite());
            prop_assume!(points.iter().all(|p| (X * p.r).z > 0.1));
            let form = RotationForm::new(&points, &PLAIN).unwrap();
            let R = nalgebra::Rotation3::from_scaled_axis(Vector3::from(w));
            let r: [f64; 9] = R.matrix().as_slice().try_into().unwrap();
            let (value, t) = (dot(&r, &form.times(&r)), Vector3::from(form.position(&r)));
            let sum = sum_of_squares(&points, R.matrix(), &t);
            prop_assert!((value - sum).abs() < 1e-9 * (1.0 + sum), "{value} {sum}");
            prop_assert!(sum <= sum_of_squares(&points, R.matrix(), &(t + Vector3::from(d))));
            // The model against differences.
            let (gradient, curvature, _) = form.model(&r, &form.times(&r));
            let at = |w: [f64; 3]| { let r = turned(&r, &w); dot(&r, &form.times(&r)) };
            let h = 1e-4;
            for i in 0..3 {
                let unit = |k: f64| { let mut w = [0.0; 3]; w[i] = k * h; w };
                let slope = (at(unit(1.0)) - at(unit(-1.0))) / (2.0 * h);
                prop_assert!((slope - 2.0 * gradient[i]).abs() < 1e-5 * (1.0 + sum));
                let second = (at(unit(1.0)) - 2.0 * value + at(unit(-1.0))) / (h * h);
                prop_assert!((second - 2.0 * curvature[i][i]).abs() < 1e-4 * (1.0 + sum));
            }
            let exact: [f64; 9] = X.rotation.to_rotation_matrix().matrix().as_slice().try_into().unwrap();
            prop_assert!((Vector3::from(form.position(&exact)) - X.translation.vector).norm() < 1e-9);
            let near = X.rotation * nalgebra::UnitQuaternion::from_scaled_axis(Vector3::from(d) * 0.2);
            let near: [f64; 9] = near.to_rotation_matrix().matrix().as_slice().try_into().unwrap();
            prop_assert!(form.descend(near, 1e-9).value < 1e-14);
        }
    }

    #[test]
    fn grid_minima_come_in_order() {
        let mut random = gauss(9);
        let object: Vec<_> = (0..6).map(|_| [0.1 * random(), 0.1 * random(), 0.1 * random()]).collect();
        let points = see_3d(&Pose::translation(0.1, 0.0, 0.8), &object, || 0.0);
        let form = RotationForm::new(&points, &PLAIN).unwrap();
        let value = |i: usize| dot(&COLUMNS[i], &form.times(&COLUMNS[i]));
        let (all, len) = form.starts::<12>();
        assert!(len >= 1 && all[..len].is_sorted_by(|&a, &b| value(a) <= value(b)));
        let (few, two) = form.starts::<2>();
        assert_eq!(&few[..two], &all[..two.min(len)]);
        assert!((0..COUNT).all(|i| value(i) >= value(all[0]) - 1e-12));
    }
}
