//! From space to paper, in a true isometric view.

use nalgebra::{Point3, Vector3};

/// From space to paper: along a diagonal of a cube whose upright edge is up.
#[derive(Debug, Clone, Copy)]
pub struct Isometric {
    /// Rightwards on paper, in B.
    pub right: Vector3<f64>,
    /// Upwards on paper, in B.
    pub up: Vector3<f64>,
}

impl Isometric {
    /// Looking down, from the quarter `quarter` (0 to 3) about the upright axis `upright` of B, which is one of its axes.
    #[must_use]
    pub fn new(upright: &Vector3<f64>, quarter: usize) -> Self {
        let a = if upright.x.abs() > 0.5 { Vector3::y() } else { Vector3::x() };
        let b = upright.cross(&a);
        let (a, b) = match quarter % 4 {
            0 => (a, b),
            1 => (b, -a),
            2 => (-a, -b),
            _ => (-b, a),
        };
        // The eye is at a + b + upright.
        Self { right: (b - a) / 2f64.sqrt(), up: (upright * 2.0 - a - b) / 6f64.sqrt() }
    }

    /// Where the point is on paper: rightwards and upwards, in the unit of space. Lengths along the axes of B are foreshortened by the root of 2/3.
    #[must_use]
    pub fn flat(&self, p: &Point3<f64>) -> [f64; 2] {
        [self.right.dot(&p.coords), self.up.dot(&p.coords)]
    }
}
