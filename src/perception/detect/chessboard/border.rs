//! Whether a board ends beyond a side of a lattice.
//!
//! A missing next corner is no evidence: something may occlude the board. The end is visible where the outer dark squares all stop
//! at one line along the side, and the light squares between them continue past that line into the light margin; on a board that
//! continues, dark squares would follow there.
//!
//! ```text
//!   corner ──── outer dark square ──┤ light margin          0 ... t ... t + step:   dark, dark | light
//!   corner ──── outer light square ─┤ light margin          0 ... t ... t + step:   light, light, light
//! ```

use super::strongest::follows;
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// How far outwards is looked, in squares. Derived: to the end of [`CUTS`] and well past it, where the light squares must still be light.
const REACH: f64 = 1.5;
/// Between samples, in squares. Chosen by hand: between two of them the level is linear, on squares of 20 px they are the pixels; on a
/// larger step an edge could begin and end, a smaller one only costs time.
const STEP: f64 = 0.05;
/// Where dark outer squares may end, in squares: some boards cut them short. Chosen by hand: what ends before 0.35 cannot be distinguished
/// from blur at 0.25, where the square's own level is read.
const CUTS: std::ops::RangeInclusive<f64> = 0.35..=1.15;
/// Where whole ones end. Chosen by hand: the outer square is foretold from the two behind it, and the third difference that perspective and lens
/// leave is some hundredths. Halved, strongly tilted boards have no end; doubled, a square that is cut by a quarter passes for whole.
const WHOLE: std::ops::RangeInclusive<f64> = 0.88..=1.12;
/// A step that differs by more from the last one, in itself, foretells nothing. Chosen by hand: boards across half a fisheye's image change by a
/// quarter from square to square; with more one corner is wrong.
const MAX_CHANGE: f64 = 0.3;
/// How far the ends of the dark squares may lie from their line: in squares, and in pixels. Chosen by hand: the ends of one side differ by
/// what perspective and the reading of levels leave, some tenths of a pixel; twice of it lets the rim of a thing that lies there be a line.
const LINE: f64 = 0.03;
const LINE_PX: f64 = 0.4;
/// How far past the line the light squares must go on: in squares, and in pixels. Chosen by hand: twice and three times the line's own
/// tolerance, so that an edge at the same place, as the paper's end would be, is not past it.
const PAST: f64 = 0.065;
const PAST_PX: f64 = 1.2;
/// How far the ends of the light squares may lie from each other where squares are cut short, in squares. Chosen by hand: paper is cut less
/// straight than squares are printed; twice of it takes a round thing's rim for paper.
const EVEN: f64 = 0.1;
/// Least number of dark and of light squares that must agree.
const MIN_DARK: usize = 2;
const MIN_LIGHT: usize = 1;
/// Least number of places without a corner that show that squares stop.
const MIN_STOPS: i32 = 2;
/// Share of the squares that must agree; of the light ones less where paper must end evenly. Chosen by hand: more than half, so that what lies on
/// the border does not decide, and two of three dark squares are not enough; with 0.85 one thing on the border hides the end.
const SHARE: f64 = 0.7;
const SHARE_PAPER: f64 = 0.6;
/// Most squares along a side that are examined. Derived: a board has at most 60 corners along a side, so that all of them fit in.
const MOST: usize = 64;

/// One outer square: between two neighbours on the lattice's rim, and the next two inwards.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outer {
    /// Corners on the rim.
    pub(super) rim: [Vector2<f64>; 2],
    /// Corners one step inwards of them.
    pub(super) inner: [Vector2<f64>; 2],
    /// Corners two steps inwards, where they are known.
    pub(super) third: Option<[Vector2<f64>; 2]>,
    /// Whether the outer square is light.
    pub(super) light: bool,
}

impl Outer {
    /// Where the board's next corner would be behind one of the rim's: as far as that is from the one before it, and once more what this step differs
    /// by from its own predecessor, since perspective and fisheyes make each square shorter, or longer, than the last.
    fn next(&self, i: usize) -> Vector2<f64> {
        let step = self.rim[i] - self.inner[i];
        let change = self.third.map(|third| step - (self.inner[i] - third[i]));
        let change = change.filter(|change| change.norm() < MAX_CHANGE * step.norm());
        self.rim[i] + step + change.unwrap_or_default()
    }

    /// Outwards across the square, px.
    fn outwards(&self) -> Vector2<f64> {
        0.5 * (self.next(0) - self.rim[0] + self.next(1) - self.rim[1])
    }
}

/// Measurement of one outer square.
#[derive(Debug, Clone, Copy, Default)]
struct OuterSquare {
    /// Levels outwards, from 0 to [`REACH`].
    middle: f64,
    end: f64,
    /// For light squares: the distance up to which they stay light.
    light: bool,
}

/// Evidence of the board's end at one side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BoardEnd {
    /// None.
    Unseen,
    /// One dark square and its neighbours indicate it: sufficient only where the opposite side does too, and the size between them fits.
    Likely,
    /// The end is visible.
    Seen,
}

/// The evidence of the board's end in the outer squares of one side.
pub(super) fn end(image: &ImageView<'_>, squares: impl Iterator<Item = Outer>) -> BoardEnd {
    let mut seen = [OuterSquare::default(); MOST];
    let mut count = 0;
    let mut min_px = f64::INFINITY;
    for (square, slot) in squares.zip(&mut seen) {
        let Some(s) = look(image, &square) else { continue };
        min_px = min_px.min(square.outwards().norm());
        *slot = s;
        count += 1;
    }
    let mut kept = [OuterSquare::default(); MOST];
    let mut n = 0;
    for (slot, s) in kept.iter_mut().zip(seen.iter().filter(|s| s.middle > 0.0)) {
        *slot = *s;
        n += 1;
    }
    let Some(seen) = kept.get(..n.min(count)) else { return BoardEnd::Unseen };
    let dark = || seen.iter().filter(|s| !s.light);
    let all = dark().count();
    // the line that most dark squares end at
    let near = |a: &OuterSquare, b: &OuterSquare| (a.end - b.end).abs() < LINE + LINE_PX / min_px;
    let mut best: (usize, Option<&OuterSquare>) = (0, None);
    for a in dark().filter(|a| CUTS.contains(&a.end)) {
        let agree = dark().filter(|b| near(a, b)).count();
        if agree > best.0 {
            best = (agree, Some(a));
        }
    }
    let (agree, Some(line)) = best else { return BoardEnd::Unseen };
    if (agree as f64) < SHARE * all as f64 {
        return BoardEnd::Unseen;
    }
    let line = dark().filter(|b| near(line, b)).map(|b| b.end).sum::<f64>() / agree as f64;
    let past = PAST.max(PAST_PX / min_px);
    let light = || seen.iter().filter(|s| s.light);
    let far = light().count();
    let go_on = light().filter(|s| s.end > line + past).count();
    if go_on < MIN_LIGHT || (go_on as f64) < SHARE * far as f64 {
        return BoardEnd::Unseen;
    }
    // where squares are cut short, a light thing that lies on the board would look the same: but paper ends
    let even = |a: &OuterSquare| light().filter(|s| (s.end - a.end).abs() < EVEN && s.end < REACH).count();
    let paper = light().map(even).max().unwrap_or(0) as f64 >= SHARE_PAPER * far as f64;
    match (agree >= MIN_DARK, WHOLE.contains(&line), paper) {
        (true, true, _) | (true, _, true) => BoardEnd::Seen,
        (false, true, _) | (false, _, true) => BoardEnd::Likely,
        _ => BoardEnd::Unseen,
    }
}

/// Whether the squares of one side end there, whatever lies behind them: the outer squares are complete, and no corner follows where two of
/// them meet. An occluder cuts squares anywhere, and hardly along a line of corners.
pub(super) fn stops(image: &ImageView<'_>, squares: impl Iterator<Item = Outer>) -> bool {
    let (mut stop, mut go_on) = (0, 0);
    let mut vote = |square: &Outer, i: usize| match follows(image, square.rim[i], square.next(i)) {
        Some(true) => go_on += 1,
        Some(false) => stop += 1,
        None => {}
    };
    // the outer corner of the squares so far, where all that were seen beside it are whole
    let mut open: Option<Outer> = None;
    let mut cut: Option<Vector2<f64>> = None;
    for square in squares {
        let whole = look(image, &square).is_some_and(|s| s.end >= *WHOLE.start());
        let before = open.take();
        if whole && cut != Some(square.rim[0]) {
            vote(&square, 0);
        }
        match before {
            // a gap ends a run of squares
            Some(b) if b.rim[1] != square.rim[0] => vote(&b, 1),
            _ => {}
        }
        if whole {
            open = Some(square);
        } else {
            cut = Some(square.rim[1]);
        }
    }
    if let Some(last) = open {
        vote(&last, 1);
    }
    stop >= MIN_STOPS && f64::from(stop) >= SHARE * f64::from(stop + go_on)
}

/// Profile of one square outwards: where the dark square becomes light, or the light one dark. `None` outside of the image and without contrast.
fn look(image: &ImageView<'_>, square: &Outer) -> Option<OuterSquare> {
    let [a, b] = square.rim;
    let outwards = square.outwards();
    let side = b - a;
    let at = |t: f64| {
        // three lines through the square
        let mut sum = 0.0;
        for part in [0.35, 0.5, 0.65] {
            sum += level(image, a + side * part + outwards * t)?;
        }
        Some(sum / 3.0)
    };
    let (own, other) = (at(0.25)?, at(-0.5)?);
    let middle = 0.5 * (own + other);
    // chosen by hand: less than the twelve levels from which corners are found, more than what shade makes within a square
    if (own > other) != square.light || (own - other).abs() < 8.0 {
        return None;
    }
    let mut before = own;
    let mut t = 0.25;
    while t < REACH {
        t += STEP;
        let now = at(t)?;
        if (now > middle) != square.light {
            let part = ((before - middle) / (before - now)).clamp(0.0, 1.0);
            let end = t - STEP * (1.0 - part);
            // above 0, since that is what an unused slot has
            return Some(OuterSquare { middle: middle.max(1e-3), end, light: square.light });
        }
        before = now;
    }
    // above 0, since that is what an unused slot has
    Some(OuterSquare { middle: middle.max(1e-3), end: REACH, light: square.light })
}

/// Bilinearly interpolated level; `None` outside of the image.
fn level(image: &ImageView<'_>, at: Vector2<f64>) -> Option<f64> {
    if !(at.x >= 0.0 && at.y >= 0.0) {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = (at.x - x as f64, at.y - y as f64);
    let pair = |row: &[u8]| Some([f64::from(*row.get(x)?), f64::from(*row.get(x + 1)?)]);
    let ([a, b], [c, d]) = (pair(image.row(y))?, pair(image.row(y + 1))?);
    Some((a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy)
}
