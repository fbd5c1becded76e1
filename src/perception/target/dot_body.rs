//! Dots on the faces of a body: points in space, known by how they lie to each other.
//!
//! Nothing tells one dot from another but its place, so that no turn of the body may put its dots on one another. A face that has no such turn of its own is
//! identified alone; of others more than one must be seen.

use super::{Disc, Mark, Plate, Sheet, Symmetry, TargetError, TargetPoint};
use crate::geometry::Pose;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};

/// One face of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct DotFace {
    /// Its frame X_OF: the middle of the face, z_F pointing into the body.
    pub X_OF: Pose,
    /// Its width and height along x_F and y_F, m.
    pub size_m: [f64; 2],
    /// The centres of its dots, m.
    pub centres_m: Vec<Vector2<f64>>,
}

/// Dots of one radius on the faces of a body, in the object frame (m).
#[derive(Debug, Clone, PartialEq)]
pub struct DotBody {
    faces: Box<[DotFace]>,
    radius_m: f64,
    points: Box<[TargetPoint]>,
    /// Each point's face.
    face_of: Box<[usize]>,
    light_on_dark: bool,
}

/// Turns that put dots nearer to others than this share of the least distance between dots put them on one another. Chosen by hand: a fifth is what a printed
/// body may be off; with a tenth such bodies are identified by what is not true of them.
const ALIKE: f64 = 0.2;

impl DotBody {
    /// Fewest dots by which it can be identified. Derived: three fix a pose, a fourth is met by chance among clutter, of a fifth that happens once in 10 000 images.
    pub const LEAST: usize = 5;
    /// Most dots of a body. Chosen by hand: the time of a search grows with their cube.
    pub const MOST: usize = 24;

    /// A body with dots of `radius_m` on `faces`; ids in the order of the list.
    ///
    /// # Errors
    /// [`TargetError`] when there are fewer than 5 dots or more than 24, dots touch each other or reach beyond their face, a turn of the body puts its dots on
    /// one another, or a length is not positive.
    pub fn new(radius_m: f64, faces: &[DotFace]) -> Result<Self, TargetError> {
        TargetError::if_not_positive([("radius_m", radius_m)])?;
        let (mut points, mut face_of) = (Vec::new(), Vec::new());
        for (f, face) in faces.iter().enumerate() {
            TargetError::if_not_positive([("size_m", face.size_m[0]), ("size_m", face.size_m[1])])?;
            for (i, centre) in face.centres_m.iter().enumerate() {
                let p_O = face.X_OF * Point3::new(centre.x, centre.y, 0.0);
                if let Some(value_m) = p_O.iter().find(|x| !x.is_finite()) {
                    return Err(TargetError::Length { name: "a dot's place", value_m: *value_m });
                }
                let id = points.len();
                if [0, 1].into_iter().any(|k| centre[k].abs() + radius_m >= 0.5 * face.size_m[k]) {
                    return Err(TargetError::DotBeyondFace { dot: id, radius_m });
                }
                let touches = |other: &Vector2<f64>| (other - centre).norm() <= 2.0 * radius_m;
                if face.centres_m.iter().take(i).any(touches) {
                    return Err(TargetError::DotsTouch { dot: id, radius_m });
                }
                points.push(TargetPoint { id: id as u32, p_O });
                face_of.push(f);
            }
        }
        if !(Self::LEAST..=Self::MOST).contains(&points.len()) {
            return Err(TargetError::DotCount { count: points.len() });
        }
        let faces = faces.into();
        let body =
            Self { faces, radius_m, points: points.into(), face_of: face_of.into(), light_on_dark: false };
        if body.has_a_turn_onto_itself() { Err(TargetError::DotsAlike) } else { Ok(body) }
    }

    /// The same body with light dots on dark faces, or not.
    #[must_use]
    pub fn light_on_dark(self, light_on_dark: bool) -> Self {
        Self { light_on_dark, ..self }
    }

    /// The centres of the dots, ids rising from 0.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// Dot `i`: the frame of its face, X_OF, and its disc in that frame's plane.
    #[must_use]
    pub fn dot(&self, i: usize) -> Option<(Pose, Disc)> {
        let face = self.faces.get(*self.face_of.get(i)?)?;
        let p_F = face.X_OF.inverse() * self.points.get(i)?.p_O;
        Some((face.X_OF, Disc { centre_m: p_F.coords.xy(), radius_m: self.radius_m }))
    }

    /// The direction into the body behind dot `i`, in O.
    #[must_use]
    pub fn inward(&self, i: usize) -> Vector3<f64> {
        let face = self.face_of.get(i).and_then(|face| self.faces.get(*face));
        face.map_or_else(Vector3::z, |face| face.X_OF.rotation * Vector3::z())
    }

    /// Whether dot `i` is turned towards a camera that has the target at `X_CO`.
    #[must_use]
    pub fn is_turned_to_camera(&self, i: usize, X_CO: &Pose) -> bool {
        let Some(point) = self.points.get(i) else { return false };
        (X_CO.rotation * self.inward(i)).dot(&(X_CO * point.p_O).coords) > 0.0
    }

    /// Its faces.
    pub(super) fn sheets(&self) -> Vec<Sheet> {
        let mark =
            |centre_m: &Vector2<f64>| Mark::Disc(Disc { centre_m: *centre_m, radius_m: self.radius_m });
        let sheet = |face: &DotFace| {
            let half = 0.5 * Vector2::from(face.size_m);
            let plate = Plate { low_m: -half, high_m: half, light: !self.light_on_dark };
            Sheet { X_OS: face.X_OF, plate, marks: face.centres_m.iter().map(mark).collect(), is_face: true }
        };
        self.faces.iter().map(sheet).collect()
    }

    /// The free distance about dot `i`, to the next dot's rim on its face or the face's edge, m.
    pub(crate) fn free_m(&self, i: usize) -> f64 {
        let (Some(face), Some((_, disc))) =
            (self.face_of.get(i).and_then(|face| self.faces.get(*face)), self.dot(i))
        else {
            return 0.0;
        };
        let edges = [0, 1].map(|k| 0.5 * face.size_m[k] - disc.centre_m[k].abs() - self.radius_m);
        let others = face.centres_m.iter().map(|other| (other - disc.centre_m).norm());
        // chosen: no two dots lie so near, but for a dot and itself
        let next = others.filter(|m| *m > 1e-9).fold(f64::INFINITY, f64::min) - 2.0 * self.radius_m;
        edges[0].min(edges[1]).min(next)
    }

    /// What it covers along x_o and y_o.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let (mut low_m, mut high_m) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for face in &self.faces {
            for (x, y) in [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)] {
                let p = face.X_OF * Point3::new(x * face.size_m[0], y * face.size_m[1], 0.0);
                (low_m, high_m) = (low_m.inf(&p.coords.xy()), high_m.sup(&p.coords.xy()));
            }
        }
        Plate { low_m, high_m, light: !self.light_on_dark }
    }

    /// No turn puts its dots on one another; a mirror image is another body.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        Symmetry { turns: 1, mirrored: false }
    }

    /// Whether a turn other than none puts all dots on dots of the same direction.
    fn has_a_turn_onto_itself(&self) -> bool {
        let p = |i: usize| self.points.get(i).map_or_else(Vector3::zeros, |point| point.p_O.coords);
        let count = self.points.len();
        let pairs = || (0..count).flat_map(|i| (0..i).map(move |j| (i, j)));
        let least = pairs().map(|(i, j)| (p(i) - p(j)).norm()).fold(f64::INFINITY, f64::min);
        let near = ALIKE * least;
        // Two dots with the direction of the first one's face fix a turn; those that lie along that direction fix none.
        let frame = |i: usize, j: usize| {
            let (z, along) = (self.inward(i), p(j) - p(i));
            let x = along - z * z.dot(&along);
            let x = x.try_normalize(near)?;
            Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
        };
        let ordered = || (0..count).flat_map(|i| (0..count).map(move |j| (i, j)));
        let Some((a, b, own)) = ordered().find_map(|(i, j)| Some((i, j, frame(i, j)?))) else { return true };
        let length = (p(b) - p(a)).norm();
        let same = |i: usize, j: usize| {
            if (i, j) == (a, b) || ((p(j) - p(i)).norm() - length).abs() > near {
                return false;
            }
            let Some(other) = frame(i, j) else { return false };
            let R = other * own.transpose();
            (0..count).all(|k| {
                let (place, inward) = (R * (p(k) - p(a)) + p(i), R * self.inward(k));
                // chosen by hand: within 26 degrees, as no two faces of a body are
                (0..count).any(|m| (place - p(m)).norm() < near && inward.dot(&self.inward(m)) > 0.9)
            })
        };
        ordered().any(|(i, j)| same(i, j))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn face(x: f64, pitch: f64, dots: &[[f64; 2]]) -> DotFace {
        DotFace {
            X_OF: Pose::new([x, 0.0, if x == 0.0 { -0.03 } else { 0.0 }].into(), [0.0, pitch, 0.0].into()),
            size_m: [0.06, 0.06],
            centres_m: dots.iter().map(|dot| Vector2::from(*dot)).collect(),
        }
    }

    #[test]
    fn dots_lie_on_their_faces_and_turn_away_with_them() {
        let top = face(0.0, 0.0, &[[0.0, 0.0], [0.015, 0.0], [0.0, 0.02]]);
        let side = face(0.03, -FRAC_PI_2, &[[0.01, 0.01], [-0.015, -0.01]]);
        let body = DotBody::new(0.004, &[top, side]).unwrap();
        assert!(body.points().iter().zip(0..).all(|(point, id)| point.id == id));
        assert!(body.points()[..3].iter().all(|p| (p.p_O.z + 0.03).abs() < 1e-12));
        assert!(body.points()[3..].iter().all(|p| (p.p_O.x - 0.03).abs() < 1e-12));
        for i in 0..5 {
            let (X_OF, disc) = body.dot(i).unwrap();
            let p = X_OF * Point3::new(disc.centre_m.x, disc.centre_m.y, 0.0);
            assert!((p - body.points()[i].p_O).norm() < 1e-12);
        }
        let above = Pose::translation(0.0, 0.0, 0.4);
        assert_eq!([0, 3].map(|i| body.is_turned_to_camera(i, &above)), [true, false]);
        let aside = Pose::new([0.0, 0.0, 0.4].into(), [0.0, 0.8, 0.0].into());
        assert_eq!([0, 3].map(|i| body.is_turned_to_camera(i, &aside)), [true, true]);
        assert!((body.free_m(0) - 0.007).abs() < 1e-12 && (body.free_m(2) - 0.006).abs() < 1e-12);
        assert_eq!(body.sheets().len(), 2);
    }

    #[test]
    fn bodies_that_cannot_be_identified_are_refused() {
        let of = |faces: &[DotFace]| DotBody::new(0.004, faces).map(|_| ());
        let square = [[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]];
        let odd = [[0.0, 0.0], [0.015, 0.0], [0.0, 0.02], [-0.02, 0.01]];
        let count = |dots: &[[f64; 2]]| of(&[face(0.0, 0.0, dots)]);
        assert!(matches!(count(&odd), Err(TargetError::DotCount { count: 4 })));
        // A square with its middle turns onto itself; on two opposite sides the body does, too.
        let with_middle = [square.as_slice(), &[[0.0, 0.0]]].concat();
        assert!(matches!(count(&with_middle), Err(TargetError::DotsAlike)));
        let pair = |second: &[[f64; 2]]| of(&[face(0.03, -FRAC_PI_2, &odd), face(-0.03, FRAC_PI_2, second)]);
        let [turned, mirrored] = [-1.0, 1.0].map(|sign| odd.map(|[x, y]| [sign * x, -y]));
        assert!(pair(&odd).is_err() && pair(&turned).is_err(), "half a turn about y, and about z");
        assert!(pair(&mirrored).is_ok() && pair(&square).is_ok());
        assert!(matches!(count(&[[0.0, 0.0], [0.005, 0.0]]), Err(TargetError::DotsTouch { dot: 1, .. })));
        assert!(matches!(count(&[[0.027, 0.0]]), Err(TargetError::DotBeyondFace { dot: 0, .. })));
        assert!(DotBody::new(0.0, &[face(0.0, 0.0, &odd)]).is_err());
    }
}
