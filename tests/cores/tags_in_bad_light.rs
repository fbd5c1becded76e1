//! Single tags on which something lies: a soft shadow across a corner or along a side, a highlight, a spot, a cover. What is told of them contains
//! the error; what is told of tags on which nothing lies is as exact as before. `VSERVO_CAMPAIGN=n` looks at `n` times as many
//! images, `VSERVO_SEED=n` at others.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests; numbers for people

use crate::dots_truth::campaign;
use crate::tag_scene::{Canvas, Dice, Look, Map};
use vservo::detect::tags::TagFinder;
use vservo::imaging::ImageView;
use vservo::target::TagFamily;

const SIZE: (usize, usize) = (360, 340);
/// Deviations of a corner from which on what is told is untrue.
const UNTRUE_SDS: f64 = 5.0;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Harm {
    None,
    /// Light that grows or falls evenly across the image.
    Gradient,
    Shadow,
    /// A shadow whose edge runs along a side.
    Along,
    Highlight,
    Spot,
    Cover,
}

/// What was told of images of one kind.
#[derive(Debug, Default)]
struct Told {
    found: usize,
    untrue: usize,
    normalized: f64,
    worst_sds: f64,
}

fn seed(usual: u64) -> u64 {
    std::env::var("VSERVO_SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}

fn any_look(harm: Harm, dice: &mut Dice) -> Look {
    let uneven = harm == Harm::Gradient;
    Look {
        dark: dice.within(15.0, 50.0),
        // no light of any gradient reaches the last level
        light: dice.within(150.0, if uneven { 180.0 } else { 230.0 }),
        ground: dice.within(40.0, if uneven { 180.0 } else { 200.0 }),
        blur_px: dice.within(0.5, 2.0),
        noise: dice.within(0.5, 4.0),
        gradient: if uneven { dice.within(0.5, 2.0) } else { 1.0 },
        ..Look::default()
    }
}

/// Puts the harm on the light, beside one of the corners.
fn harmed(canvas: &mut Canvas, harm: Harm, truth: &[(f64, f64); 4], look: &Look, dice: &mut Dice) {
    let which = dice.below(4) as usize;
    let (corner, next) = (truth[which], truth[(which + 1) % 4]);
    let along = (next.1 - corner.1).atan2(next.0 - corner.0);
    let across = along + std::f64::consts::FRAC_PI_2 * if dice.unit() < 0.5 { 1.0 } else { -1.0 };
    let turned = if harm == Harm::Along { across + dice.within(-0.1, 0.1) } else { dice.within(-3.2, 3.2) };
    let (sin, cos) = turned.sin_cos();
    let (gain, soft, size) = (dice.within(0.4, 0.85), dice.within(1.5, 30.0), dice.within(3.0, 15.0));
    let reach = if matches!(harm, Harm::Shadow | Harm::Along) { soft } else { size };
    let at = (corner.0 + dice.within(-1.0, 1.0) * reach, corner.1 + dice.within(-1.0, 1.0) * reach);
    let spot = dice.within(0.0, 255.0);
    // a step that is blurred as the tag is
    let step = |depth: f64| 1.0 / (1.0 + (-1.7 * depth / look.blur_px).exp());
    for (i, level) in canvas.levels.iter_mut().enumerate() {
        let d = ((i % SIZE.0) as f64 - at.0, (i / SIZE.0) as f64 - at.1);
        let (away, depth) = (d.0.hypot(d.1), d.0 * cos + d.1 * sin);
        match harm {
            Harm::None | Harm::Gradient => {}
            Harm::Shadow | Harm::Along => *level *= gain + (1.0 - gain) / (1.0 + (-2.0 * depth / soft).exp()),
            Harm::Highlight => *level += 255.0 * (-0.5 * (away / size).powi(4)).exp(),
            Harm::Spot => *level += (spot - *level) * step(size - away),
            Harm::Cover if away < 2.0 * size => *level += (look.light - *level) * step(-depth),
            Harm::Cover => {}
        }
    }
}

fn look_at(harm: Harm, count: usize, dice: &mut Dice) -> Told {
    let mut told = Told::default();
    for k in 0..count {
        let family = TagFamily::ALL[k % 3];
        let side_px = dice.within(30f64.ln(), 210f64.ln()).exp();
        let middle = (SIZE.0 as f64 / 2.0, SIZE.1 as f64 / 2.0);
        let (u, v) = (middle.0 + dice.within(-8.0, 8.0), middle.1 + dice.within(-8.0, 8.0));
        let (roll, tilt, about) = (dice.within(0.0, 6.3), dice.within(0.0, 1.05), dice.within(0.0, 6.3));
        let cells = f64::from(family.cells_per_side());
        let map = Map::view(cells, u, v, side_px, roll, tilt, about, 800.0, middle);
        let (look, id) = (any_look(harm, dice), dice.below(family.count()));
        let mut canvas = Canvas::new(SIZE.0, SIZE.1, look.ground);
        let truth = canvas.draw_exact(family, id, &map, &look);
        harmed(&mut canvas, harm, &truth, &look, dice);
        let pixels = canvas.expose(&look, dice);
        let (mut finder, mut found) = (TagFinder::new(family, SIZE.0, SIZE.1), Vec::new());
        let _ = finder.search(&ImageView::new(&pixels, SIZE.0, SIZE.1).unwrap(), &mut found);
        let [tag] = &found[..] else { continue };
        assert_eq!(tag.id, id, "{harm:?} {k}");
        told.found += 1;
        let mut sds = 0.0f64;
        for (i, ((p, t), &[xx, xy, yy])) in
            tag.corners_px.iter().zip(&truth).zip(&tag.covariance_px2).enumerate()
        {
            let (x, y) = (p.x - t.0, p.y - t.1);
            sds = sds.max(x.hypot(y) / tag.sd_px(i));
            told.normalized += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy) / 8.0;
        }
        told.untrue += usize::from(sds > UNTRUE_SDS);
        told.worst_sds = told.worst_sds.max(sds);
    }
    told.normalized /= told.found as f64;
    println!(
        "{harm:?}: {} of {count} found, {} untrue, {:.1} sd at most, normalized {:.2}",
        told.found, told.untrue, told.worst_sds, told.normalized
    );
    told
}

/// Half of the shadowed tags were untrue when rows along a side counted as independent. The share of covers is hardly below that of before, 18 % of 132: what they hide of a side shows little.
#[test]
fn a_harmed_tag_is_told_as_uncertain() {
    let mut dice = Dice(seed(401));
    for (harm, share) in [
        (Harm::Shadow, 0.125),
        (Harm::Along, 0.125),
        (Harm::Highlight, 0.08),
        (Harm::Spot, 0.08),
        (Harm::Cover, 0.18),
    ] {
        let told = look_at(harm, 60 * campaign(), &mut dice);
        assert!(told.untrue as f64 <= share * told.found as f64, "{harm:?}: {told:?}");
    }
}

#[test]
fn tags_without_harm_are_as_exact_as_they_are_told() {
    let mut dice = Dice(seed(402));
    for harm in [Harm::None, Harm::Gradient] {
        let count = 120 * campaign();
        let told = look_at(harm, count, &mut dice);
        // four deviations of a mean of squares, of eight coordinates a tag of which those of the four corners hang together
        let chance = 4.0 * (2.0 / (4.0 * count as f64)).sqrt();
        assert!(told.found * 50 >= count * 49 && told.untrue == 0, "{told:?}");
        let honest = 0.8 * (1.0 - chance)..1.25 * (1.0 + chance);
        assert!(honest.contains(&told.normalized), "{told:?}");
    }
}
