use super::*;
use crate::detect::tags::pattern::MAX_CELLS;

const CELLS: usize = 6;
const INK_LEVEL: f64 = 40.0;
const STEP_LEVELS: f64 = 160.0;

fn pattern() -> CellPattern {
    let mut white = [[0.0; MAX_CELLS]; MAX_CELLS];
    for (i, j) in [(1, 1), (2, 1), (4, 1), (1, 3), (3, 2), (3, 3), (4, 4), (2, 4)] {
        white[j][i] = 1.0;
    }
    CellPattern::new(&white, CELLS)
}

/// A tilted tag with cells of about 3 px.
fn corners() -> [Vector2<f64>; 4] {
    let v = Vector2::new;
    [v(101.3, 82.1), v(117.9, 86.4), v(119.2, 104.7), v(99.0, 97.6)]
}

fn tag_image(corners: &[Vector2<f64>; 4]) -> TagImage {
    TagImage {
        back: PlaneMap::of_square(corners, CELLS as f64).unwrap().inverse().unwrap(),
        origin: Vector2::new(109.0, 93.0),
        radius: 14.0,
        blur: [1.5, 0.3, 1.1],
        ink: INK_LEVEL,
        contrast: STEP_LEVELS,
        light: [0.04, -0.03],
        ground: [-60.0, 20.0, -90.0, 10.0],
        clipped_noise: None,
        log_gamma: Some(0.6),
        log_ratio: None,
    }
}

/// Eight pixels of level 0, those of them that lie on the tag or near it.
fn pixels(row: i32) -> TagPixels {
    let mut pixels = TagPixels::NONE;
    let tag_image = tag_image(&corners());
    for i in 0..8 {
        pixels.x.0[i] = i as f32 * 3.1 - 11.0;
        pixels.y.0[i] = row as f32 + 0.4 * i as f32;
        let p = Vector2::new(f64::from(pixels.x.0[i]), f64::from(pixels.y.0[i]));
        let at = tag_image.back.at(tag_image.origin + p);
        let near = at.iter().all(|v| *v > -0.6 && *v < CELLS as f64 + 0.6);
        pixels.weight.0[i] = f32::from(u8::from(near));
    }
    pixels
}

fn rows(tag_image: &TagImage, corners: &[Vector2<f64>; 4], pixels: &TagPixels) -> TagJacobian {
    let pattern = pattern();
    TagModel::new(tag_image, &pattern, corners, 1e9).unwrap().at(pixels)
}

/// The model's own sum, counted out: cells, paper and grounds under a fine grid of the blur.
fn counted(tag_image: &TagImage, corners: &[Vector2<f64>; 4], p: Vector2<f64>) -> f64 {
    let back = PlaneMap::of_square(corners, CELLS as f64).unwrap().inverse().unwrap();
    let (pattern, n) = (pattern(), CELLS as f64);
    let [xx, xy, yy] = tag_image.blur;
    let (a, b) = (xx.sqrt(), xy / xx.sqrt());
    let c = (yy - b * b).sqrt();
    let (mut grounds, mut whites, mut weights, fine) = (0.0, 0.0, 0.0, 160);
    let z = |i: i32| (f64::from(i) + 0.5) / f64::from(fine) * 9.0 - 4.5;
    for i in 0..fine {
        for j in 0..fine {
            let (u, v) = (z(i), z(j));
            let weight = (-0.5 * (u * u + v * v)).exp();
            let q = back.at(p + Vector2::new(a * u, b * u + c * v));
            let [left, right, above, below] = tag_image.ground;
            let ground = if q.x < -1.0 {
                left
            } else if q.x > n + 1.0 {
                right
            } else if q.y < -1.0 {
                above
            } else if q.y > n + 1.0 {
                below
            } else {
                0.0
            };
            let white = pattern.bits_at(q.x.floor() as i32, q.y.floor() as i32) & 1;
            whites += weight * f64::from(white);
            grounds += weight * ground;
            weights += weight;
        }
    }
    let q = (p - tag_image.origin) / tag_image.radius;
    let white = whites / weights;
    let gamma = tag_image.log_gamma.unwrap_or(0.0).exp();
    let (ink, paper) = (tag_image.ink.powf(gamma), (tag_image.ink + tag_image.contrast).powf(gamma));
    let level = (ink + white * (paper - ink)).powf(1.0 / gamma) + grounds / weights;
    level * (1.0 + tag_image.light[0] * q.x + tag_image.light[1] * q.y)
}

#[test]
fn levels_are_those_of_blurred_cells() {
    let (corners, mut worst) = (corners(), 0.0f64);
    let tag_image = tag_image(&corners);
    for y in -12..12 {
        let pixels = pixels(y);
        let row = rows(&tag_image, &corners, &pixels);
        for i in 0..8 {
            let p = tag_image.origin + Vector2::new(f64::from(pixels.x.0[i]), f64::from(pixels.y.0[i]));
            if pixels.weight.0[i] > 0.0 {
                // the level that is left over from 0
                worst = worst.max((-f64::from(row[COUNT].0[i]) - counted(&tag_image, &corners, p)).abs());
            }
        }
    }
    // perspective within the blur, and the rest of Mehler's series
    assert!(worst < 0.015 * STEP_LEVELS, "{worst}");
}

#[test]
fn derivatives_are_those_of_levels() {
    let base_corners = corners();
    let told = tag_image(&base_corners);
    // the ratio of light as the levels tell it, and as a parameter of its own
    for (log_ratio, last) in [(None, GAMMA), (Some(2.9), RATIO)] {
        derivatives_of(TagImage { log_ratio, ..told }, last);
    }
}

/// Those of one image against differences of its levels, by all parameters to the column `last`.
fn derivatives_of(base: TagImage, last: usize) {
    let base_corners = corners();
    let shifted = |index: usize, by: f64| {
        let (mut tag_image, mut corners) = (base, base_corners);
        match index {
            0..BLUR => {
                for p in &mut corners {
                    *p += field((*p - base.origin) / base.radius)[index] * by;
                }
                tag_image.back = PlaneMap::of_square(&corners, CELLS as f64).unwrap().inverse().unwrap();
                // derivatives are those of an image that moves, and its blur with it
                let at = |x: f64, y: f64| field(Vector2::new(x, y))[index];
                let stretch =
                    Matrix2::from_columns(&[at(1.0, 0.0) - at(0.0, 0.0), at(0.0, 1.0) - at(0.0, 0.0)])
                        * (by / base.radius);
                let [xx, xy, yy] = base.blur;
                let blur = Matrix2::new(xx, xy, xy, yy);
                let blur = blur + stretch * blur + blur * stretch.transpose();
                // of the two that bend only the middle keeps its blur
                if index < 6 {
                    tag_image.blur = [blur.m11, blur.m12, blur.m22];
                }
            }
            BLUR..INK => tag_image.blur[index - BLUR] += by,
            INK => tag_image.ink += by,
            CONTRAST => tag_image.contrast += by,
            LIGHT..GROUND => tag_image.light[index - LIGHT] += by,
            GAMMA => tag_image.log_gamma = tag_image.log_gamma.map(|log| log + by),
            RATIO => tag_image.log_ratio = tag_image.log_ratio.map(|log| log + by),
            _ => tag_image.ground[index - GROUND] += by,
        }
        (tag_image, corners)
    };
    for index in (0..COUNT).chain(GAMMA..=last) {
        let h = [0.03, 0.02, 0.5, 0.5, 0.01, 0.5, 0.01][match index {
            0..BLUR => 0,
            BLUR..INK => 1,
            INK => 2,
            CONTRAST => 3,
            LIGHT..GROUND => 4,
            GAMMA | RATIO => 6,
            _ => 5,
        }];
        let (mut off, mut size) = (0.0, 0.0);
        for y in -12..12 {
            let pixels = pixels(y);
            let derivative = rows(&base, &base_corners, &pixels)[index];
            let [low, high] = [-h, h].map(|by| {
                let (tag_image, corners) = shifted(index, by);
                rows(&tag_image, &corners, &pixels)[COUNT]
            });
            for i in 0..8 {
                // what is left over falls where levels rise
                let wanted = f64::from(low.0[i] - high.0[i]) / (2.0 * h);
                off += (f64::from(derivative.0[i]) - wanted).powi(2);
                size += wanted.powi(2);
            }
        }
        let most: f64 = if (6..BLUR).contains(&index) { 0.3 } else { 0.05 };
        assert!(off < most * most * size, "{index}: {} of {}", off.sqrt(), size.sqrt());
    }
}

#[test]
fn products_are_sums_over_pixels_that_count() {
    let corners = corners();
    let (tag_image, pattern) = (TagImage { log_ratio: Some(2.9), ..tag_image(&corners) }, pattern());
    let model = TagModel::new(&tag_image, &pattern, &corners, 120.0f64.powi(2)).unwrap();
    let mut blocks: Vec<TagPixels> = (-20..20).map(|y| pixels(y % 12)).collect();
    blocks[3].weight = Eight::ZERO;
    let mut room = [[Eight::ZERO; COLUMNS]; 40];
    let mut sums = RowProducts { products: [[0.0; COLUMNS]; COLUMNS], count: 0.0 };
    accumulate(&model, &blocks, &mut room, &mut sums);
    let rows: Vec<TagJacobian> = blocks.iter().map(|pixels| model.at(pixels)).collect();
    let left_over = |row: &TagJacobian| row[COUNT].0.iter().filter(|r| **r != 0.0).count();
    let count: usize = rows.iter().map(left_over).sum();
    assert!(count > 40 && count < 300 && sums.count == count as f64, "{count} {}", sums.count);
    for i in 0..=RATIO {
        for k in 0..=i {
            let each = |row: &TagJacobian| {
                (0..8).map(|l| f64::from(row[i].0[l]) * f64::from(row[k].0[l])).sum::<f64>()
            };
            let wanted: f64 = rows.iter().map(each).sum();
            let size: f64 =
                rows.iter().map(|r| (r[i] * r[i]).sum() + (r[k] * r[k]).sum()).map(f64::from).sum();
            assert!((sums.products[i][k] - wanted).abs() < 1e-5 * size, "{i} {k}");
        }
    }
}

#[test]
fn blur_across_too_many_cells_is_refused() {
    let corners = corners();
    let pattern = pattern();
    for blur in [[60.0, 0.0, 60.0], [f64::NAN, 0.0, 1.0], [1.0, 0.0, f64::INFINITY], [-1.0, 0.0, -1.0]] {
        let tag_image = TagImage { blur, ..tag_image(&corners) };
        assert!(TagModel::new(&tag_image, &pattern, &corners, 1e9).is_none(), "{blur:?}");
    }
}
