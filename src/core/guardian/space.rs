//! Where the guardian sees the parts of an arm, and the half spaces that they must stay in: kinematics of its own, by turning points about the axes of
//! the joints as those stand with all joints at zero (a product of exponentials), where control goes from link to link.

use crate::messages::MAX_JOINTS;

/// A place or a direction in B, m.
pub type GuardedVector = [f64; 3];

/// A joint as it stands with all joints at zero.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GuardedAxis {
    /// A point of its axis.
    pub point: GuardedVector,
    /// Its direction, of length 1.
    pub direction: GuardedVector,
    /// Whether it slides along its axis, in the place of turning about it.
    pub slides: bool,
}

/// A sphere on the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuardedSphere {
    /// Its centre with all joints at zero.
    pub center: GuardedVector,
    /// How many joints, from the base on, move it.
    pub joints: usize,
    /// Its radius, m.
    pub radius_m: f64,
}

/// A half space that no sphere may leave: `normal . p >= offset_m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuardedSide {
    /// Unit normal, into it.
    pub normal: GuardedVector,
    /// Distance of its plane from the origin along the normal, m.
    pub offset_m: f64,
}

/// What is limited in space.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GuardedSpace {
    /// The joints' axes.
    pub axes: [GuardedAxis; MAX_JOINTS],
    /// The spheres; no more are looked at where there are no sides.
    pub spheres: Vec<GuardedSphere>,
    /// The half spaces.
    pub sides: Vec<GuardedSide>,
}

impl GuardedSpace {
    /// Where the sphere is with the joints at `q`, rad or m.
    fn place(&self, sphere: &GuardedSphere, q: &[f64; MAX_JOINTS]) -> GuardedVector {
        let moved_by = self.axes.iter().zip(q).take(sphere.joints).rev();
        moved_by.fold(sphere.center, |p, (axis, q)| axis.moved(p, *q))
    }

    /// The farthest of the spheres beyond a side, m, and its number; not positive where all are inside.
    #[must_use]
    pub fn farthest(&self, q: &[f64; MAX_JOINTS]) -> (f64, usize) {
        let mut farthest = (f64::NEG_INFINITY, 0);
        for (i, sphere) in self.spheres.iter().enumerate() {
            let p = self.place(sphere, q);
            for side in &self.sides {
                let beyond = sphere.radius_m + side.offset_m - dot(side.normal, p);
                // A number that is none is judged where commands and states are.
                if beyond > farthest.0 {
                    farthest = (beyond, i);
                }
            }
        }
        farthest
    }
}

impl GuardedAxis {
    /// Where this joint moves the point `p` by `q`, rad or m: Rodrigues' formula.
    fn moved(&self, p: GuardedVector, q: f64) -> GuardedVector {
        let a = self.direction;
        if self.slides {
            return std::array::from_fn(|k| p[k] + q * a[k]);
        }
        let (sin, cos) = q.sin_cos();
        let r: GuardedVector = std::array::from_fn(|k| p[k] - self.point[k]);
        let (across, along) = (cross(a, r), dot(a, r) * (1.0 - cos));
        std::array::from_fn(|k| self.point[k] + r[k] * cos + across[k] * sin + a[k] * along)
    }
}

fn dot(a: GuardedVector, b: GuardedVector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: GuardedVector, b: GuardedVector) -> GuardedVector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_near(a: GuardedVector, b: GuardedVector) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    /// A third of a turn about the diagonal of a cube takes each of its edges to the next, and a quarter of one about an edge takes the second to the third.
    #[test]
    fn turns_about_edges_and_diagonals_exchange_edges() {
        let (point, arm) = ([0.3, -0.2, 0.7], [0.5, 0.11, -0.4]);
        let p: GuardedVector = std::array::from_fn(|k| point[k] + arm[k]);
        let axis = |direction| GuardedAxis { point, direction, slides: false };
        let diagonal = axis([1.0 / 3.0_f64.sqrt(); 3]);
        let turned = diagonal.moved(p, std::f64::consts::TAU / 3.0);
        assert!(is_near(turned, [point[0] + arm[2], point[1] + arm[0], point[2] + arm[1]]), "{turned:?}");
        for k in 0..3 {
            let (next, last) = ((k + 1) % 3, (k + 2) % 3);
            let mut direction = [0.0; 3];
            direction[k] = 1.0;
            let mut expected = p;
            (expected[next], expected[last]) = (point[next] - arm[last], point[last] + arm[next]);
            let turned = axis(direction).moved(p, std::f64::consts::FRAC_PI_2);
            assert!(is_near(turned, expected), "{k}: {turned:?}");
            let mut expected = p;
            expected[k] += 0.25;
            let slid = GuardedAxis { slides: true, ..axis(direction) }.moved(p, 0.25);
            assert!(is_near(slid, expected), "{k}: {slid:?}");
        }
    }

    /// The joint next to the point moves it first: one that slides out and is then turned by a quarter is elsewhere than one that is turned first.
    #[test]
    fn joints_move_a_sphere_from_the_last_to_the_first() {
        let axis = |direction, slides| GuardedAxis { point: [0.0; 3], direction, slides };
        let mut space = GuardedSpace::default();
        (space.axes[0], space.axes[1]) = (axis([0.0, 0.0, 1.0], false), axis([1.0, 0.0, 0.0], true));
        let sphere = |joints| GuardedSphere { center: [0.5, 0.0, 0.2], joints, radius_m: 0.1 };
        let mut q = [0.0; MAX_JOINTS];
        (q[0], q[1]) = (std::f64::consts::FRAC_PI_2, 0.25);
        assert!(is_near(space.place(&sphere(2), &q), [0.0, 0.75, 0.2]));
        assert!(is_near(space.place(&sphere(1), &q), [0.0, 0.5, 0.2]), "the second joint does not move it");
        // Of three planes and two spheres the farthest counts: 0.75 and the radius beyond y = 0.4.
        space.spheres = vec![sphere(1), sphere(2)];
        space.sides = vec![
            GuardedSide { normal: [0.0, -1.0, 0.0], offset_m: -0.4 },
            GuardedSide { normal: [0.0, 0.0, 1.0], offset_m: 0.15 },
            GuardedSide { normal: [-1.0, 0.0, 0.0], offset_m: -1.0 },
        ];
        let (beyond_m, sphere) = space.farthest(&q);
        assert!((beyond_m - 0.45).abs() < 1e-12 && sphere == 1, "{beyond_m} {sphere}");
    }
}
