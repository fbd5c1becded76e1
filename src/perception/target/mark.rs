//! What is drawn of a target: shapes on its plate.
//!
//! A mark is as dark as the plate is light, and the other way round: [`Plate::light`].

use nalgebra::Vector2;

/// Corners of a closed outline, m: the last one is joined to the first. The inside of an outer outline, followed in its order of
/// corners, lies on the side towards which x turns into y; that of a hole on the other side.
pub type ClosedOutline = Box<[Vector2<f64>]>;

/// A round dot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    /// Centre in the object's plane, m.
    pub centre_m: Vector2<f64>,
    /// Radius, m.
    pub radius_m: f64,
}

/// A shape on the plate, in the object's plane.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A round dot.
    Disc(Disc),
    /// An ellipse.
    Ellipse {
        /// Centre, m.
        centre_m: Vector2<f64>,
        /// Half its axes, m.
        semi_axes_m: [f64; 2],
        /// From x_o towards y_o to the first axis, rad.
        turn_rad: f64,
    },
    /// What lies within outlines and outside of their holes.
    Polygon(Box<[ClosedOutline]>),
}

impl Mark {
    /// The outlines of the mark, a curved one as a polygon whose corners lie on it and whose sides leave it by less than
    /// `sag_m`.
    pub fn loops(&self, sag_m: f64) -> Box<[ClosedOutline]> {
        match self {
            Self::Disc(disc) => [round(&disc.centre_m, [disc.radius_m; 2], 0.0, sag_m)].into(),
            Self::Ellipse { centre_m, semi_axes_m, turn_rad } => {
                [round(centre_m, *semi_axes_m, *turn_rad, sag_m)].into()
            }
            Self::Polygon(loops) => loops.clone(),
        }
    }
}

fn round(centre_m: &Vector2<f64>, [a, b]: [f64; 2], turn_rad: f64, sag_m: f64) -> ClosedOutline {
    // a chord over the angle 2 t leaves a circle of radius r by r t^2 / 2; an ellipse is one that is squeezed
    // not 0, else there would be no end of corners; 4096 are the most anyway
    let half = (2.0 * sag_m / a.max(b)).sqrt().max(1e-3);
    let count = ((std::f64::consts::PI / half).ceil() as u32).clamp(8, 4096);
    let (sin, cos) = turn_rad.sin_cos();
    let corner = |i: u32| {
        let (v, u) = (2.0 * std::f64::consts::PI * f64::from(i) / f64::from(count)).sin_cos();
        let (x, y) = (a * u, b * v);
        centre_m + Vector2::new(cos * x - sin * y, sin * x + cos * y)
    };
    (0..count).map(corner).collect()
}

/// The plate: a rectangle along x_o and y_o.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plate {
    /// Least x_o and y_o, m.
    pub low_m: Vector2<f64>,
    /// Greatest x_o and y_o, m.
    pub high_m: Vector2<f64>,
    /// Light, with dark marks; else dark, with light marks.
    pub light: bool,
}

/// Twice the area within a closed outline, m^2: positive where its inside lies towards y from x.
pub(crate) fn double_area(outline: &[Vector2<f64>]) -> f64 {
    let next = outline.iter().cycle().skip(1);
    outline.iter().zip(next).map(|(a, b)| a.perp(b)).sum()
}

/// Outlines of the set cells of a pattern of `columns` cells a row, each of side `side_m`, the first one's corner at `low_m`.
pub(super) fn outlines(
    cells: &[bool],
    columns: usize,
    side_m: f64,
    low_m: &Vector2<f64>,
) -> Box<[ClosedOutline]> {
    let rows = cells.len() / columns.max(1);
    let set = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < columns as i64 && y < rows as i64;
        inside && cells.get(y as usize * columns + x as usize).copied().unwrap_or(false)
    };
    // sides of cells between set and not set, as start and direction, with the set cell towards y from x
    let mut sides = std::collections::BTreeSet::new();
    for y in 0..=rows as i64 {
        for x in 0..=columns as i64 {
            match (set(x, y - 1), set(x, y)) {
                (false, true) => drop(sides.insert((x, y, 1, 0))),
                (true, false) => drop(sides.insert((x + 1, y, -1, 0))),
                _ => {}
            }
            match (set(x - 1, y), set(x, y)) {
                (false, true) => drop(sides.insert((x, y + 1, 0, -1))),
                (true, false) => drop(sides.insert((x, y, 0, 1))),
                _ => {}
            }
        }
    }
    let mut loops = Vec::new();
    while let Some(first) = sides.pop_first() {
        let mut corners = vec![first];
        let mut side = first;
        loop {
            let (x, y, dx, dy) = side;
            let end = (x + dx, y + dy);
            // cells that touch by a corner are two: the sharper turn about the set cell first
            let next = [(-dy, dx), (dx, dy), (dy, -dx)]
                .map(|(dx, dy)| (end.0, end.1, dx, dy))
                .into_iter()
                .find(|next| sides.remove(next));
            let Some(next) = next else { break };
            if (next.2, next.3) != (dx, dy) {
                corners.push(next);
            }
            side = next;
        }
        // the first one may go on straight from the last
        if corners.len() > 4 && (side.2, side.3) == (first.2, first.3) {
            corners.remove(0);
        }
        let corner =
            |(x, y, _, _): &(i64, i64, i64, i64)| low_m + Vector2::new(*x as f64, *y as f64) * side_m;
        loops.push(corners.iter().map(corner).collect());
    }
    loops.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn curves_become_polygons_as_close_as_asked() {
        let disc = Mark::Disc(Disc { centre_m: Vector2::new(1.0, 2.0), radius_m: 0.1 });
        let ellipse = Mark::Ellipse { centre_m: Vector2::zeros(), semi_axes_m: [0.2, 0.05], turn_rad: 0.7 };
        for (mark, area) in [(disc, 0.01), (ellipse, 0.01)] {
            let loops = mark.loops(1e-5);
            let found = 0.5 * double_area(&loops[0]) / std::f64::consts::PI;
            assert!((found - area).abs() < 1e-5 && found < area, "{found}");
        }
    }

    proptest! {
        /// The signed sum of what lies to one side of all outlines is the pattern: winding numbers at cells' middles.
        #[test]
        fn outlines_enclose_the_set_cells(cells in prop::collection::vec(any::<bool>(), 30), columns in 1..7usize) {
            let rows = cells.len() / columns;
            let cells = &cells[..rows * columns];
            let low = Vector2::new(-1.0, 3.0);
            let loops = outlines(cells, columns, 0.5, &low);
            for (i, set) in cells.iter().enumerate() {
                let p = low + Vector2::new((i % columns) as f64 + 0.5, (i / columns) as f64 + 0.5) * 0.5;
                let mut winding = 0;
                for outline in &loops {
                    for (a, b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
                        prop_assert!(a != b);
                        // to the left of p
                        if a.x < p.x && b.x < p.x && (a.y < p.y) != (b.y < p.y) {
                            winding += if a.y < b.y { -1 } else { 1 };
                        }
                    }
                }
                prop_assert_eq!(winding, i32::from(*set));
            }
            let area: f64 = loops.iter().map(|l| 0.5 * double_area(l)).sum();
            prop_assert!((area - 0.25 * cells.iter().filter(|c| **c).count() as f64).abs() < 1e-9);
            // corners turn: no corner lies on a straight side
            for outline in &loops {
                let n = outline.len();
                for i in 0..n {
                    let (a, b, c) = (outline[i], outline[(i + 1) % n], outline[(i + 2) % n]);
                    prop_assert!((b - a).perp(&(c - b)).abs() > 1e-9, "{outline:?}");
                }
            }
        }
    }
}
