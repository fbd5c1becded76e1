//! Whether a board is a part of a floor, of which things that lie there hide the rest: corners elsewhere in the image continue its pattern.
//!
//! ```text
//!   corners of the board ── thing that hides some ── corners of a floor: on the board's lattice, edges along its lines, colours in turn
//! ```
//! The homography of a part says well where the next squares are, and less well where those at the far end of the floor are, since lenses bend rows. There
//! neighbours still lie one square from each other.

use super::Board;
use crate::imaging::corners::RingCorner;
use nalgebra::{Matrix3, Vector2, Vector3};

/// How far off its place a corner of the lattice may lie at the rim, squares. Chosen by hand: at half of it a thing of four squares hides all that is there, at the double the place of the
/// next square is as near.
const ON: f64 = 0.15;
/// How much more for each square beyond the rim. Chosen by hand: a lens of k1 = -0.15 and a homography of seven corners leave 0.26 at eight squares.
const ON_BENT: f64 = 0.02;
/// Up to how many squares beyond the rim places are believed. Chosen by hand: there the tolerance has come to 0.31, a third of a square.
const FAR: f64 = 8.0;
/// The same of the distance between neighbours, in squares: their size is told by the homography to a fifth at the far end of an image. Chosen by hand: half
/// loses what lies there, the double takes corners half a square off.
const APART: f64 = 0.25;
/// Sine between the edges of such a corner and the lattice's lines there: 17 degrees. Chosen by hand, as that of links (`lattice::ASIDE`).
const ASIDE: f64 = 0.3;
/// Least contrast of such corners in that of the board's. Chosen by hand: light may fall to half over a floor, and blur takes a part of the contrast of small
/// squares; half of it takes woven cloth for a pattern of squares (`photographs_with_a_quarter_covered`), the double loses floors in the shade.
const ALIKE: f64 = 0.4;
/// So many corners on the lattice are not by accident: of those next to the rim, and everywhere. Chosen by hand: what is no floor lies within a tenth of the places, with
/// both edges in one of ten directions and the colours in one of two: one in two hundred agrees. Floors of which parts were boards had 2 to 49. Half lets one thing
/// refuse a board; the double keeps floors of which hardly any is seen.
const MIN_NEXT: usize = 2;
const MIN_ON: usize = 4;
/// One in so many of the corners that are seen about the board must be on the lattice, where not next to the rim: as of those behind a thing
/// (`ends::SHARE_BEHIND`).
const SHARE: usize = 4;
/// So many neighbours of each other anywhere else are a pattern of squares like the board's. Chosen by hand, the corners of one square and its neighbours: half
/// is what two crossing stripes have, the double keeps floors of which hardly any is seen.
const MIN_PAIRS: usize = 4;

/// A corner of the image as the lattice has it.
struct LatticeCorner {
    px: Vector2<f64>,
    /// Columns and rows.
    at: Vector2<f64>,
    /// Squares beyond the last corners; less than 0 within.
    beyond: f64,
    /// Displacement to the next column and row, px.
    axes: [Vector2<f64>; 2],
    /// Whether its rising edge runs along the columns' direction; `None` where its edges are not along the lattice.
    rises: Option<bool>,
}

impl Board {
    /// Whether corners of the image continue the board's pattern beyond its rim. `corners` of a level, a pixel of which is `scale` pixels of the image.
    /// Where all corners and all four ends of a board are seen it need not be asked. Of a board of which a part is seen also a like pattern elsewhere is enough: nothing tells that it is not the rest.
    pub(in crate::detect::chessboard) fn is_part_of_floor(&self, corners: &[RingCorner], scale: f64) -> bool {
        let Some(whole) = self.homography() else { return false };
        let Some(back) = whole.try_inverse() else { return false };
        let (sum, fitted) =
            self.fitted().fold((0.0, 0.0), |(sum, n), (_, fit)| (sum + fit.half_contrast.abs(), n + 1.0));
        let min_contrast = (ALIKE * 2.0 * sum / fitted) as f32;
        let like = corners.iter().filter(move |corner| corner.contrast >= min_contrast);
        let seen = || like.clone().filter_map(|corner| self.on_lattice(corner, scale, &whole, &back));
        let (mut about, mut on, mut next) = (0, 0, 0);
        // half a square beyond the last corner the place of the next one begins
        for corner in seen().filter(|c| c.beyond > 0.5 && c.beyond < FAR) {
            about += 1;
            let near = corner.at.map(f64::round);
            let light = ((near.x + near.y).rem_euclid(2.0) == 0.0) == self.even_light;
            if corner.rises == Some(light) && (corner.at - near).amax() < ON + ON_BENT * corner.beyond {
                on += 1;
                // half a square behind the next one its neighbour's place begins; follows from the lattice
                next += usize::from(corner.beyond < 1.5);
            }
        }
        if next >= MIN_NEXT || (on >= MIN_ON && SHARE * on >= about) {
            return true;
        }
        let count = self.columns * self.rows;
        let outside = || seen().filter(|c| c.beyond > 0.5 && c.rises.is_some());
        let has_neighbour = |a: &LatticeCorner| {
            outside().any(|b| {
                let off = |axis: &Vector2<f64>, sign: f64| (b.px - a.px - axis * sign).norm() / axis.norm();
                let one = |axis| off(axis, 1.0) < APART || off(axis, -1.0) < APART;
                a.rises != b.rises && a.axes.iter().any(one)
            })
        };
        self.fitted().count() < count && outside().filter(has_neighbour).take(MIN_PAIRS).count() == MIN_PAIRS
    }

    /// A corner on the board's lattice; `None` where that is at infinity or behind the camera.
    fn on_lattice(
        &self,
        corner: &RingCorner,
        scale: f64,
        whole: &Matrix3<f64>,
        back: &Matrix3<f64>,
    ) -> Option<LatticeCorner> {
        let px = Vector2::new(corner.x, corner.y).map(|p| (f64::from(p) + 0.5) * scale - 0.5);
        let v = back * Vector3::new(px.x, px.y, 1.0);
        let at = Vector2::new(v.x, v.y) / v.z;
        let v = whole * Vector3::new(at.x, at.y, 1.0);
        // z is 1 in the board's middle; chosen by hand: a thousandth of it lies a thousand times as far away, where squares cannot be seen
        if !(v.z > 1e-3) {
            return None;
        }
        let axes = [0, 1].map(|axis| {
            let d = whole.column(axis);
            (Vector2::new(d[0], d[1]) - px * d[2]) / v.z
        });
        let along = |axis: Vector2<f64>, angle: f32| {
            let (sin, cos) = f64::from(angle).sin_cos();
            (axis.x * sin - axis.y * cos).abs() < ASIDE * axis.norm()
        };
        let [x, y] = axes;
        let rises = match (along(x, corner.rising), along(y, corner.falling)) {
            (true, true) => Some(true),
            _ if along(y, corner.rising) && along(x, corner.falling) => Some(false),
            _ => None,
        };
        let last = Vector2::new(self.columns as f64 - 1.0, self.rows as f64 - 1.0);
        let beyond = (-at).sup(&(at - last)).max();
        Some(LatticeCorner { px, at, beyond, axes, rises })
    }
}
