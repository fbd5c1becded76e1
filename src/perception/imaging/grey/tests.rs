use super::*;
use proptest::prelude::*;

/// Level of pixel `x` in a line of bytes, by the definition of each format.
fn level(format: PixelFormat, line: &[u8], x: usize) -> u8 {
    let wide = |bits: u32| (u32::from(line[2 * x]) + 256 * u32::from(line[2 * x + 1])).min((1 << bits) - 1);
    match format {
        PixelFormat::Grey | PixelFormat::Nv12 => line[x],
        PixelFormat::Y10 => (wide(10) / 4) as u8,
        PixelFormat::Y12 => (wide(12) / 16) as u8,
        PixelFormat::Y16 => (wide(16) / 256) as u8,
        PixelFormat::Yuyv => line[2 * x],
        PixelFormat::Uyvy => line[2 * x + 1],
        PixelFormat::Bgr3 => of_colours(line[3 * x + 2], line[3 * x + 1], line[3 * x]),
        PixelFormat::Rgb3 => of_colours(line[3 * x], line[3 * x + 1], line[3 * x + 2]),
        PixelFormat::Mjpg => unreachable!("has no lines"),
    }
}

/// The weights of BT.601 in 256ths, rounded like any fraction.
fn of_colours(red: u8, green: u8, blue: u8) -> u8 {
    let weights = [0.299, 0.587, 0.114].map(|w: f64| (w * 256.0).round());
    let sum = weights[0] * f64::from(red) + weights[1] * f64::from(green) + weights[2] * f64::from(blue);
    (sum / 256.0 + 0.5).floor().min(255.0) as u8
}

fn format() -> impl Strategy<Value = PixelFormat> {
    prop::sample::select(PixelFormat::ALL.into_iter().filter(|f| *f != PixelFormat::Mjpg).collect::<Vec<_>>())
}

#[test]
fn four_letters_and_back() {
    for format in PixelFormat::ALL {
        assert_eq!(PixelFormat::from_fourcc(format.fourcc()), Some(format));
    }
    assert_eq!(PixelFormat::from_fourcc(*b"JPEG"), Some(PixelFormat::Mjpg));
    assert_eq!(PixelFormat::from_fourcc(*b"H264"), None);
}

#[test]
fn sizes_of_a_frame() {
    assert_eq!(PixelFormat::Yuyv.min_stride_bytes(641), 1284);
    assert_eq!(PixelFormat::Yuyv.min_payload_bytes(640, 480, 1280), 614_400);
    assert_eq!(PixelFormat::Grey.min_payload_bytes(640, 480, 700), 479 * 700 + 640);
    assert_eq!(PixelFormat::Nv12.min_payload_bytes(640, 480, 640), 460_800);
    assert_eq!(PixelFormat::Nv12.min_payload_bytes(3, 3, 4), 4 * 4 + 3);
    assert_eq!(PixelFormat::Y16.min_payload_bytes(u32::MAX, u32::MAX, usize::MAX), usize::MAX);
    assert_eq!(PixelFormat::Grey.min_payload_bytes(640, 0, 640), 0);
}

#[test]
fn what_does_not_fit_is_an_error() {
    let mut out = [0; 8];
    let mut grey = ToGrey::new(PixelFormat::Yuyv, 4, 2);
    assert_eq!(grey.convert(&[1; 16], 8, &mut out), Ok(()));
    assert_eq!(grey.convert(&[1; 18], 10, &mut out), Ok(()), "the last line without padding");
    assert_eq!(grey.convert(&[1; 17], 10, &mut out), Err(NotGrey::Short { len: 17, needed: 18 }));
    assert_eq!(grey.convert(&[1; 16], 7, &mut out), Err(NotGrey::Stride { stride_bytes: 7, needed: 8 }));
    assert!(matches!(grey.convert(&[1; 16], 8, &mut out[..7]), Err(NotGrey::OutLength { len: 7, .. })));
    assert!(matches!(grey.convert(&[1; 16], usize::MAX, &mut out), Err(NotGrey::Short { .. })));
    // A part of a wider frame, up to its last column: the partner of the last pixel lies outside.
    for format in [PixelFormat::Yuyv, PixelFormat::Uyvy] {
        let mut odd = ToGrey::new(format, 3, 2);
        assert_eq!(odd.convert(&[1; 14], 8, &mut out[..6]), Ok(()));
        assert_eq!(odd.convert(&[1; 13], 8, &mut out[..6]), Err(NotGrey::Short { len: 13, needed: 14 }));
    }
    let mut jpeg = ToGrey::new(PixelFormat::Mjpg, 4, 2);
    assert_eq!(jpeg.convert(&[1; 16], 0, &mut out), Err(NotGrey::Jpeg(JpegError::NotJpeg)));
    assert_eq!(ToGrey::new(PixelFormat::Grey, 0, 0).convert(&[], 0, &mut []), Ok(()));
}

/// Numbers that 10 bits cannot hold are white, and do not begin again at black.
#[test]
fn too_bright_is_white() {
    let raw = [0x00, 0x04, 0xFF, 0xFF, 0xFF, 0x03, 0x00, 0x80];
    let mut out = [0; 4];
    ToGrey::new(PixelFormat::Y10, 4, 1).convert(&raw, 8, &mut out).unwrap();
    assert_eq!(out, [255, 255, 255, 255]);
}

proptest! {
    #[test]
    fn every_pixel_by_the_definition(
        format in format(),
        width in 1u32..150,
        height in 1u32..6,
        padding in 0usize..40,
        cut in any::<bool>(),
        seed in any::<u64>(),
    ) {
        let stride = format.min_stride_bytes(width) + padding;
        let lines = format.lines(width, height as usize, stride);
        let length = if cut { lines } else { stride * height as usize };
        let mut random = seed | 1;
        let raw: Vec<u8> = (0..length).map(|_| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (random >> 56) as u8
        }).collect();
        let mut out = vec![7; (width * height) as usize];
        let mut grey = ToGrey::new(format, width, height);
        grey.convert(&raw, stride, &mut out).unwrap();
        for (y, row) in out.chunks(width as usize).enumerate() {
            for (x, &found) in row.iter().enumerate() {
                prop_assert_eq!(found, level(format, &raw[y * stride..], x), "{:?} {} {}", format, x, y);
            }
        }
        if let GreyDecoder::Lines(kernel) = grey.way {
            let mut narrow = vec![9; out.len()];
            kernel.narrow().convert(&raw, stride, width as usize, &mut narrow);
            prop_assert_eq!(narrow, out);
        }
    }

    /// Anything may be said of anything: an error, and no panic.
    #[test]
    fn hostile_frames(
        which in 0usize..8,
        width in 0u32..40,
        height in 0u32..40,
        raw in prop::collection::vec(any::<u8>(), 0..2000),
        stride in prop_oneof![0usize..100, any::<usize>()],
        length in 0usize..2000,
    ) {
        let mut out = vec![0; length];
        let _ = ToGrey::new(PixelFormat::ALL[which], width, height).convert(&raw, stride, &mut out);
    }
}
