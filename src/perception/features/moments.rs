//! Moments of the image of a planar object, (10.1) in normalized coordinates, and features made of them.
//!
//! ```text
//! m_ij = integral of x^i y^j over the image       1/z_c = A x + B y + C: the object's plane
//! ```
//! The rates of moments are those of Chaumette, "Image moments: a general and useful set of features for visual servoing", IEEE T-RO
//! 20 (2004); with the derivatives of a point's coordinates (10.27) under the integral, and of the area's border:
//!
//! ```text
//! v_x: -i (A m_ij + B m_(i-1)(j+1) + C m_(i-1)j) - A m_ij        w_x:  (i+j+3) m_i(j+1) + j m_i(j-1)
//! v_y: -j (A m_(i+1)(j-1) + B m_ij + C m_i(j-1)) - B m_ij        w_y: -(i+j+3) m_(i+1)j - i m_(i-1)j
//! v_z: (i+j+3)(A m_(i+1)j + B m_i(j+1) + C m_ij) - C m_ij        w_z:  i m_(i-1)(j+1) - j m_(i+1)(j-1)
//! ```
//! Those of all other features follow by the rules of derivatives. Angles in rad, depths in m.

use super::flow::Flow;
use super::{Feature, wrap_rad};
use nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector4, Vector6};

/// Orders of the moments that are known, 0 to 4, because those of third order move with those of the fourth.
const ORDERS: usize = 5;
/// Asymmetry below which the two senses of the axis cannot be distinguished. Chosen by hand: above rounding of sums over an outline, below noise.
const MIN_ASYMMETRY: f64 = 1e-6;

/// Moments `m_ij` of an image, `i + j` up to 4, in normalized coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImageMoments {
    m: [[f64; ORDERS]; ORDERS],
}

impl ImageMoments {
    /// Moments of the area within a polygon, by its corners in normalized coordinates in either order; the last one is joined to the
    /// first. All zero where it encloses nothing.
    #[must_use]
    pub fn of_polygon(corners: &[Vector2<f64>]) -> Self {
        let mut m = [[0.0; ORDERS]; ORDERS];
        for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let cross = a.perp(b);
            for (i, row) in m.iter_mut().enumerate() {
                for (j, sum) in row.iter_mut().enumerate().take(ORDERS - i) {
                    *sum += cross * side(a, b, i, j);
                }
            }
        }
        if m[0][0] < 0.0 {
            m.iter_mut().flatten().for_each(|m| *m = -*m);
        }
        Self { m }
    }

    /// Moments of an image of known area, centroid and central moments to third order; those of fourth order are 0, so that only
    /// features of moments to second order can be made of it.
    #[must_use]
    pub(super) fn of_second_order(area: f64, centre: &Vector2<f64>, [n20, n11, n02]: [f64; 3]) -> Self {
        let (x, y) = (centre.x, centre.y);
        let mut m = [[0.0; ORDERS]; ORDERS];
        m[0][0] = area;
        m[1][0] = area * x;
        m[0][1] = area * y;
        m[2][0] = area * (n20 + x * x);
        m[1][1] = area * (n11 + x * y);
        m[0][2] = area * (n02 + y * y);
        // central moments of third order are those of a figure symmetric about its centre: 0
        m[3][0] = area * (3.0 * x * n20 + x * x * x);
        m[2][1] = area * (y * n20 + 2.0 * x * n11 + x * x * y);
        m[1][2] = area * (x * n02 + 2.0 * y * n11 + x * y * y);
        m[0][3] = area * (3.0 * y * n02 + y * y * y);
        Self { m }
    }

    /// `m_ij`; 0 beyond the fourth order.
    #[must_use]
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.m.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0)
    }

    /// The area `m_00`.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.m[0][0]
    }

    /// The rates of `m_ij` for the camera's velocities before the plane `1/z_c = A x + B y + C`, for `i + j` up to 3: its row of the
    /// interaction matrix.
    #[must_use]
    pub fn rates(&self, i: usize, j: usize, plane: &Vector3<f64>) -> Vector6<f64> {
        let (A, B, C) = (plane.x, plane.y, plane.z);
        // moments of negative order come with a factor 0
        let below = |k: usize| k.checked_sub(1);
        let m = |i: Option<usize>, j: Option<usize>| match (i, j) {
            (Some(i), Some(j)) => self.get(i, j),
            _ => 0.0,
        };
        let (own, p, q) = (self.get(i, j), i as f64, j as f64);
        let (right, down) = (self.get(i + 1, j), self.get(i, j + 1));
        let (swapped_x, swapped_y) = (m(below(i), Some(j + 1)), m(Some(i + 1), below(j)));
        let (less_x, less_y) = (m(below(i), Some(j)), m(Some(i), below(j)));
        let order = p + q + 3.0;
        Vector6::new(
            -p * (A * own + B * swapped_x + C * less_x) - A * own,
            -q * (A * swapped_y + B * own + C * less_y) - B * own,
            order * (A * right + B * down + C * own) - C * own,
            order * down + q * less_y,
            -order * right - p * less_x,
            p * swapped_x - q * swapped_y,
        )
    }

    fn flow(&self, i: usize, j: usize, plane: &Vector3<f64>) -> Flow {
        Flow { value: self.get(i, j), row: self.rates(i, j, plane) }
    }

    /// Whether there is an area before the camera.
    pub(super) fn is_there(&self, plane: &Vector3<f64>) -> bool {
        let a = self.area();
        let depth = plane.x * self.get(1, 0) + plane.y * self.get(0, 1) + plane.z * a;
        a > 0.0 && depth > 0.0 && self.m.iter().flatten().all(|m| m.is_finite())
    }
}

/// The integral of `x^i y^j` over the triangle of 0, a and b, over twice its area.
fn side(a: &Vector2<f64>, b: &Vector2<f64>, i: usize, j: usize) -> f64 {
    let mut sum = 0.0;
    for k in 0..=i {
        for l in 0..=j {
            let terms = binomial(k + l, l) * binomial(i + j - k - l, j - l);
            let power = |x: f64, n: usize| x.powi(n as i32);
            sum += terms * power(b.x, k) * power(a.x, i - k) * power(b.y, l) * power(a.y, j - l);
        }
    }
    let n = i + j;
    sum / (((n + 2) * (n + 1)) as f64 * binomial(n, i))
}

fn binomial(n: usize, k: usize) -> f64 {
    (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product()
}

/// Centroid and central moments with their rates.
pub(super) struct Central {
    pub(super) area: Flow,
    pub(super) x: Flow,
    pub(super) y: Flow,
    pub(super) mu20: Flow,
    pub(super) mu11: Flow,
    pub(super) mu02: Flow,
}

impl Central {
    pub(super) fn of(m: &ImageMoments, plane: &Vector3<f64>) -> Self {
        let m = |i, j| m.flow(i, j, plane);
        let area = m(0, 0);
        let (x, y) = (m(1, 0) / area, m(0, 1) / area);
        Self {
            area,
            x,
            y,
            mu20: m(2, 0) - x * m(1, 0),
            mu11: m(1, 1) - x * m(0, 1),
            mu02: m(0, 2) - y * m(0, 1),
        }
    }

    /// Orientation (10.2) of the greater principal axis, in (-pi/2, pi/2].
    fn axis(&self) -> Flow {
        (self.mu11 * 2.0).atan2(self.mu20 - self.mu02) * 0.5
    }

    /// `(mu30 + mu12, mu21 + mu03) sqrt(m00) / (mu20 + mu02)^(3/2)`: a direction in the image, free of place and size.
    fn skew(&self, m: &ImageMoments, plane: &Vector3<f64>) -> [Flow; 2] {
        let (x, y, area) = (self.x, self.y, self.area);
        let m = |i, j| m.flow(i, j, plane);
        let mu30 = m(3, 0) - x * self.mu20 * 3.0 - x * x * x * area;
        let mu03 = m(0, 3) - y * self.mu02 * 3.0 - y * y * y * area;
        let mu21 = m(2, 1) - x * self.mu11 * 2.0 - y * self.mu20 - x * x * y * area;
        let mu12 = m(1, 2) - y * self.mu11 * 2.0 - x * self.mu02 - x * y * y * area;
        let size = self.mu20 + self.mu02;
        let scale = (area / size).sqrt() / size;
        [(mu30 + mu12) * scale, (mu21 + mu03) * scale]
    }

    /// Orientation, over the full turn where third moments distinguish the two senses of the axis, and the skew in the axes of the object. Of
    /// the two senses the one whose skew lies on the side of `sense` is taken.
    fn orientation(&self, m: &ImageMoments, plane: &Vector3<f64>, sense: &Vector2<f64>) -> (Flow, [Flow; 2]) {
        let [a, b] = self.skew(m, plane);
        let mut alpha = self.axis();
        let (sin, cos) = alpha.sin_cos();
        let (mut along, mut across) = (a * cos + b * sin, b * cos - a * sin);
        let side = along.value * sense.x + across.value * sense.y;
        if side < 0.0 && a.value.hypot(b.value) >= MIN_ASYMMETRY {
            alpha = alpha.plus(if alpha.value > 0.0 { -std::f64::consts::PI } else { std::f64::consts::PI });
            (along, across) = (-along, -across);
        }
        (alpha, [along, across])
    }
}

/// The sense of the axis that points towards the heavy end, as in `imaging`. The sense of a shape that extends as far to one side as to the
/// other, such as a flat isosceles triangle, comes from [`AreaFeature::in_sense_of`] alone.
const HEAVY_END: Vector2<f64> = Vector2::new(-1.0, 0.0);

/// The error of an angle; for a shape without sense it is taken modulo half a turn.
fn angle_error(error_rad: f64, skew: &Vector2<f64>) -> f64 {
    if skew.norm() >= MIN_ASYMMETRY { wrap_rad(error_rad) } else { 0.5 * wrap_rad(2.0 * error_rad) }
}

pub(super) fn rows<const K: usize>(flows: [Flow; K]) -> SMatrix<f64, K, 6> {
    SMatrix::from_fn(|k, j| flows.get(k).map_or(0.0, |flow| flow.row[j]))
}

pub(super) fn values<const K: usize>(flows: [Flow; K]) -> SVector<f64, K> {
    SVector::from(flows.map(|flow| flow.value))
}

/// The interaction matrix, where all of its numbers are finite.
pub(super) fn finite<const K: usize>(L: SMatrix<f64, K, 6>) -> Option<SMatrix<f64, K, 6>> {
    L.iter().all(|x| x.is_finite()).then_some(L)
}

/// `[x_g, y_g, a, alpha]`: centroid, area and orientation (10.2) of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AreaFeature {
    pub(super) moments: ImageMoments,
    pub(super) plane: Vector3<f64>,
    sense: Vector2<f64>,
}

impl AreaFeature {
    /// The area with these moments in the image. `plane` is `[A, B, C]` of the object's plane `1/z_c = A x + B y + C`, 1/m: an estimate of it,
    /// or the plane at the goal, is sufficient. The orientation points towards the heavy end of the area.
    #[must_use]
    pub fn new(moments: ImageMoments, plane: Vector3<f64>) -> Self {
        Self { moments, plane, sense: HEAVY_END }
    }

    /// The same area, with the sense of its axis in which it is more like `goal`: third moments along the axis may be small, so that noise
    /// determines their sign, where those across it are not small.
    #[must_use]
    pub fn in_sense_of(self, goal: &Self) -> Self {
        let (_, skew) = goal.flows();
        Self { sense: if skew.norm() >= MIN_ASYMMETRY { skew } else { HEAVY_END }, ..self }
    }

    /// Moments of the image.
    #[must_use]
    pub fn moments(&self) -> &ImageMoments {
        &self.moments
    }

    /// Depth of the object's plane at the centroid, m; `None` where there is no area before the camera.
    #[must_use]
    pub fn depth_m(&self) -> Option<f64> {
        let (m, plane) = (&self.moments, &self.plane);
        let depths = plane.x * m.get(1, 0) + plane.y * m.get(0, 1) + plane.z * m.area();
        m.is_there(plane).then(|| m.area() / depths)
    }

    fn flows(&self) -> ([Flow; 4], Vector2<f64>) {
        let c = Central::of(&self.moments, &self.plane);
        let (alpha, skew) = c.orientation(&self.moments, &self.plane, &self.sense);
        ([c.x, c.y, c.area, alpha], Vector2::from(skew.map(|s| s.value)))
    }
}

impl Feature<4> for AreaFeature {
    fn value(&self) -> Vector4<f64> {
        values(self.flows().0)
    }

    fn interaction(&self) -> Option<SMatrix<f64, 4, 6>> {
        finite(self.moments.is_there(&self.plane).then(|| rows(self.flows().0))?)
    }

    /// With alpha's difference wrapped.
    fn error(&self, desired: &Vector4<f64>) -> Vector4<f64> {
        let (flows, skew) = self.flows();
        let mut e = desired - values(flows);
        e.w = angle_error(e.w, &skew);
        e
    }
}

/// `[x_n, y_n, a_n, p_x, p_y, alpha]`: normalized moments, each of which changes mainly with one motion where the object is nearly parallel
/// to the image.
///
/// ```text
/// a_n = z_d sqrt(a_d / a)    x_n = a_n x_g    y_n = a_n y_g       go with v_z, v_x, v_y; in m, where the object is parallel
/// p_x, p_y: (mu30 + mu12, mu21 + mu03) sqrt(a) / (mu20 + mu02)^(3/2) in the object's axes: free of place, size and turn
/// alpha: orientation (10.2)                                           goes with w_z
/// ```
/// `p_x`, `p_y` are 0, and contain no information, for an object that looks the same after half a turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MomentFeature {
    area: AreaFeature,
    reference_m: f64,
}

impl MomentFeature {
    /// The features of an area; `reference_m` is `z_d sqrt(a_d)`, m, with the depth and the image area at the goal.
    #[must_use]
    pub fn new(area: AreaFeature, reference_m: f64) -> Self {
        Self { area, reference_m }
    }

    fn flows(&self) -> [Flow; 6] {
        let AreaFeature { moments, plane, sense } = &self.area;
        let c = Central::of(moments, plane);
        let (alpha, [along, across]) = c.orientation(moments, plane, sense);
        let root = c.area.sqrt();
        let of = |flow: Flow| flow / root * self.reference_m;
        let one = Flow { value: 1.0, row: Vector6::zeros() };
        [of(c.x), of(c.y), of(one), along, across, alpha]
    }
}

impl Feature<6> for MomentFeature {
    fn value(&self) -> Vector6<f64> {
        values(self.flows())
    }

    fn interaction(&self) -> Option<SMatrix<f64, 6, 6>> {
        finite(self.area.moments.is_there(&self.area.plane).then(|| rows(self.flows()))?)
    }

    /// With alpha's difference wrapped.
    fn error(&self, desired: &Vector6<f64>) -> Vector6<f64> {
        let value = self.value();
        let mut e = desired - value;
        e[5] = angle_error(e[5], &Vector2::new(value[3], value[4]));
        e
    }
}

#[cfg(test)]
mod tests;
