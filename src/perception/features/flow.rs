//! A number together with its row of an interaction matrix. The row of a function of such numbers follows by the rules of derivatives.

use nalgebra::SVector;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number and its rate per unit of each of the camera's velocities `[v; w]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Flow {
    pub(super) value: f64,
    pub(super) row: SVector<f64, 6>,
}

impl Flow {
    /// The number and rates of a function of this value, given the function's result and derivative.
    fn chain(self, value: f64, derivative: f64) -> Self {
        Self { value, row: self.row * derivative }
    }

    pub(super) fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }

    pub(super) fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }

    /// The angle of `(x, self)`, rad.
    pub(super) fn atan2(self, x: Self) -> Self {
        let r2 = self.value * self.value + x.value * x.value;
        Self { value: self.value.atan2(x.value), row: (self.row * x.value - x.row * self.value) / r2 }
    }

    pub(super) fn plus(self, constant: f64) -> Self {
        Self { value: self.value + constant, ..self }
    }
}

impl Add for Flow {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, row: self.row + other.row }
    }
}

impl Sub for Flow {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, row: self.row - other.row }
    }
}

impl Neg for Flow {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, row: -self.row }
    }
}

impl Mul for Flow {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, row: self.row * other.value + other.row * self.value }
    }
}

impl Mul<f64> for Flow {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        self.chain(self.value * factor, factor)
    }
}

impl Div for Flow {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let ratio = self.value / other.value;
        Self { value: ratio, row: (self.row - other.row * ratio) / other.value }
    }
}
