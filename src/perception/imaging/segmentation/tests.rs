use super::*;
use proptest::prelude::*;

/// The definition: a list of pairs sorted by difference, labels that are overwritten.
fn slow(pixels: &[u8], width: usize, uniformity: Uniformity, least: usize) -> Vec<usize> {
    let mut pairs = Vec::new();
    for at in 0..pixels.len() {
        if (at + 1) % width != 0 {
            pairs.push((pixels[at].abs_diff(pixels[at + 1]), at, at + 1));
        }
        if at + width < pixels.len() {
            pairs.push((pixels[at].abs_diff(pixels[at + width]), at, at + width));
        }
    }
    pairs.sort_by_key(|p| p.0);
    let mut labels: Vec<usize> = (0..pixels.len()).collect();
    let levels = |labels: &[usize], label: usize| -> Vec<f64> {
        (0..pixels.len()).filter(|&i| labels[i] == label).map(|i| f64::from(pixels[i])).collect()
    };
    for small in [false, true] {
        for &(_, i, j) in &pairs {
            let (a, b) = (labels[i], labels[j]);
            if a == b {
                continue;
            }
            let (va, vb) = (levels(&labels, a), levels(&labels, b));
            let both = [va.clone(), vb.clone()].concat();
            let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            let may = match uniformity {
                _ if small => va.len().min(vb.len()) < least,
                Uniformity::Range(most) => {
                    both.iter().fold(0.0f64, |m, &v| m.max(v)) - both.iter().fold(255.0f64, |m, &v| m.min(v))
                        <= f64::from(most)
                }
                Uniformity::Means(most) => (mean(&va) - mean(&vb)).abs() <= most,
            };
            if may {
                labels.iter_mut().filter(|l| **l == b).for_each(|l| *l = a);
            }
        }
    }
    // numbers in reading order
    let mut order = Vec::new();
    labels
        .iter()
        .map(|l| {
            order.iter().position(|o| o == l).unwrap_or_else(|| {
                order.push(*l);
                order.len() - 1
            })
        })
        .collect()
}

proptest! {
    #[test]
    fn regions_are_those_of_the_definition(
        width in 1usize..14, height in 1usize..12, seed in any::<u64>(), coarse in 0u32..8, range in any::<u8>(),
        means in 0.0..100.0, least in 0u32..9,
    ) {
        let mut state = seed;
        let pixels: Vec<u8> = (0..width * height).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8 >> coarse << coarse
        }).collect();
        let image = ImageView::new(&pixels, width, height).unwrap();
        let mut segmentation = Segmentation::with_limit(200);
        for uniformity in [Uniformity::Range(range), Uniformity::Range(range / 8), Uniformity::Means(means)] {
            segmentation.find(&image, uniformity, least).unwrap();
            let wanted = slow(&pixels, width, uniformity, least as usize);
            let got: Vec<usize> = segmentation.labels().as_slice().iter().map(|&l| l as usize).collect();
            prop_assert_eq!(&got, &wanted);
            for (label, region) in segmentation.as_slice().iter().enumerate() {
                let own = || (0..pixels.len()).filter(|&i| wanted[i] == label);
                prop_assert_eq!(region.sums.m00, own().count() as i128);
                prop_assert_eq!(region.sums.m21, own().map(|i| ((i % width).pow(2) * (i / width)) as i128).sum::<i128>());
                prop_assert_eq!(region.level_sum, own().map(|i| u64::from(pixels[i])).sum::<u64>());
                prop_assert_eq!(region.low, own().map(|i| pixels[i]).min().unwrap());
                prop_assert_eq!(region.high, own().map(|i| pixels[i]).max().unwrap());
                prop_assert_eq!(region.x0 as usize, own().map(|i| i % width).min().unwrap());
                prop_assert_eq!(region.x1 as usize, own().map(|i| i % width + 1).max().unwrap());
                prop_assert_eq!(region.y0 as usize, own().map(|i| i / width).min().unwrap());
                prop_assert_eq!(region.y1 as usize, own().map(|i| i / width + 1).max().unwrap());
            }
        }
    }
}

#[test]
fn too_large_is_refused() {
    let mut segmentation = Segmentation::with_limit(8);
    let image = [0; 9];
    let view = ImageView::new(&image, 3, 3).unwrap();
    assert_eq!(segmentation.find(&view, Uniformity::Range(3), 0), Err(TooManyPixels { pixels: 9, limit: 8 }));
    assert!(segmentation.as_slice().is_empty() && segmentation.labels().as_slice().is_empty());
    let view = ImageView::new(&image[..8], 4, 2).unwrap();
    assert_eq!(segmentation.find(&view, Uniformity::Range(0), 0), Ok(()));
    assert_eq!(segmentation.as_slice().len(), 1);
}
