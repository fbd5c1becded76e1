use super::*;
use proptest::prelude::*;

fn slow(image: &ImageView<'_>, w: &Window, dark: impl Fn(usize, usize) -> bool) -> Vec<Run> {
    let mut out = Vec::new();
    for y in w.y0..w.y1 {
        let mut x = w.x0;
        while x < w.x1 {
            let x0 = x;
            while x < w.x1 && dark(x, y) {
                x += 1;
            }
            if x > x0 {
                out.push(Run { y: y as u32, x0: x0 as u32, x1: x as u32 });
            }
            x += usize::from(x == x0);
        }
    }
    assert!(w.x1 <= image.width());
    out
}

proptest! {
    #[test]
    fn runs_are_the_dark_pixels(
        width in 1usize..200, height in 1usize..6, seed in any::<u64>(), threshold in any::<u8>(),
        a in 0usize..200, b in 0usize..200,
    ) {
        let mut state = seed;
        let pixels: Vec<u8> = (0..width * height).map(|_| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 56) as u8 & if state >> 40 & 1 == 1 { 0xff } else { 0xf0 }
        }).collect();
        let image = ImageView::new(&pixels, width, height).unwrap();
        let (x0, x1) = (a.min(b).min(width), a.max(b).min(width));
        for window in [Window::whole(&image), Window { x0, x1, y0: height / 2, y1: height }] {
            let wanted = slow(&image, &window, |x, y| image.row(y)[x] <= threshold);
            let mut runs = Runs::with_limit(4000);
            runs.find(&image, &window, threshold);
            prop_assert_eq!(runs.as_slice(), &wanted[..]);
            runs.wide = false;
            runs.find(&image, &window, threshold);
            prop_assert_eq!(runs.as_slice(), &wanted[..]);
            runs.runs.clear();
            runs.find_with::<false>(&image, &window, |p| dark_mask_portable(p, threshold));
            prop_assert_eq!(runs.as_slice(), &wanted[..]);
            let light = slow(&image, &window, |x, y| image.row(y)[x] > threshold);
            for wide in [runs.wide, Runs::with_limit(0).wide] {
                runs.wide = wide;
                runs.binarize(&image, &window, threshold, Polarity::Light);
                prop_assert_eq!(runs.as_slice(), &light[..]);
            }
        }
        let mut local = LocalThreshold::default();
        local.set(&image, 255, 100);
        let levels: Vec<Vec<u8>> = (0..height).map(|y| local.row(y).to_vec()).collect();
        let whole = Window::whole(&image);
        let wanted = slow(&image, &whole, |x, y| image.row(y)[x] <= levels[y][x]);
        let light = slow(&image, &whole, |x, y| image.row(y)[x] > levels[y][x]);
        let below = slow(&image, &whole, |x, y| image.row(y)[x] < levels[y][x]);
        let mut runs = Runs::with_limit(4000);
        for wide in [runs.wide, false] {
            runs.wide = wide;
            runs.find_local(&image, &mut local);
            prop_assert_eq!(runs.as_slice(), &wanted[..]);
            runs.binarize_local(&image, &mut local, Polarity::Light);
            prop_assert_eq!(runs.as_slice(), &light[..]);
            runs.find_below(&image, &mut local);
            prop_assert_eq!(runs.as_slice(), &below[..]);
        }
        runs.runs.clear();
        runs.find_each_with::<AT_MOST>(&image, &mut local, dark_mask_each_portable);
        prop_assert_eq!(runs.as_slice(), &wanted[..]);
    }
}

#[test]
fn overflow_is_told() {
    let pixels: Vec<u8> = (0..100).map(|i| if i % 2 == 0 { 0 } else { 255 }).collect();
    let image = ImageView::new(&pixels, 100, 1).unwrap();
    let mut runs = Runs::with_limit(10);
    runs.find(&image, &Window::whole(&image), 128);
    assert!(runs.overflowed());
    assert_eq!(runs.as_slice().len(), 10);
    runs.limit_to(3);
    runs.find(&image, &Window::whole(&image), 128);
    assert!(runs.overflowed());
    assert_eq!(runs.as_slice().len(), 3);
    runs.limit_to(usize::MAX);
    runs.find(&image, &Window::whole(&image), 128);
    assert!(runs.overflowed() && runs.as_slice().len() >= 10);
}
