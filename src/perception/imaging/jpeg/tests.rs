use super::*;
use jpeg_encoder::{ColorType, Encoder, QuantizationTableType, SamplingFactor};
use proptest::prelude::*;

/// How a test image is encoded.
#[derive(Debug, Clone, Copy)]
struct Encoding {
    quality: u8,
    /// None: an image without chroma.
    sampling: Option<SamplingFactor>,
    restart_every: u16,
    own_codes: bool,
    progressive: bool,
}

const PLAIN: Encoding = Encoding {
    quality: 85,
    sampling: Some(SamplingFactor::R_4_2_2),
    restart_every: 0,
    own_codes: false,
    progressive: false,
};

/// A scene with edges, slopes and noise, in colours.
fn scene(width: usize, height: usize, seed: u64) -> Vec<u8> {
    let mut random = seed | 1;
    let mut rgb = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let noise = (random >> 60) as usize;
            let disc = (x % 41).abs_diff(20).pow(2) + (y % 37).abs_diff(18).pow(2) < 150;
            let ground = if disc { 40 } else { 120 + (x + 2 * y) % 97 };
            rgb.extend(
                [ground + noise, (ground + 2 * noise + x % 7).min(255), (y + noise) % 256].map(|c| c as u8),
            );
        }
    }
    rgb
}

fn encode(way: Encoding, rgb: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, way.quality);
    encoder.set_quantization_tables(QuantizationTableType::Default, QuantizationTableType::Default);
    if let Some(sampling) = way.sampling {
        encoder.set_sampling_factor(sampling);
    }
    if way.restart_every > 0 {
        encoder.set_restart_interval(way.restart_every);
    }
    encoder.set_optimized_huffman_tables(way.own_codes);
    encoder.set_progressive(way.progressive);
    let (w, h) = (width as u16, height as u16);
    match way.sampling {
        Some(_) => encoder.encode(rgb, w, h, ColorType::Rgb).unwrap(),
        None => {
            let grey: Vec<u8> = rgb.chunks(3).map(|c| c[1]).collect();
            encoder.encode(&grey, w, h, ColorType::Luma).unwrap();
        }
    }
    jpeg
}

fn decode(jpeg: &[u8], width: usize, height: usize) -> Result<Vec<u8>, JpegError> {
    let mut out = vec![0; width * height];
    LumaDecoder::new(width as u32, height as u32).decode(jpeg, &mut out).map(|()| out)
}

/// By another decoder: the first of its three components.
fn reference(jpeg: &[u8], width: usize, height: usize) -> Vec<u8> {
    use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
    let mut decoder = zune_jpeg::JpegDecoder::new(ZCursor::new(jpeg));
    decoder.decode_headers().unwrap();
    let space = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => ColorSpace::Luma,
        _ => ColorSpace::YCbCr,
    };
    decoder.set_options(DecoderOptions::default().jpeg_set_out_colorspace(space));
    let pixels = decoder.decode().unwrap();
    assert_eq!(pixels.len(), width * height * space.num_components());
    pixels.chunks(space.num_components()).map(|c| c[0]).collect()
}

/// Segments with this marker taken out.
fn without(jpeg: &[u8], marker: u8) -> Vec<u8> {
    let mut out = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xDA {
        let next = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != marker {
            out.extend_from_slice(&jpeg[at..next]);
        }
        at = next;
    }
    out.extend_from_slice(&jpeg[at..]);
    out
}

/// Where the coded data of the first scan begins.
fn data_of(jpeg: &[u8]) -> usize {
    let at = jpeg.windows(2).position(|w| w == [0xFF, 0xDA]).unwrap();
    at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]))
}

fn largest_difference(a: &[u8], b: &[u8]) -> u8 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

fn way() -> impl Strategy<Value = Encoding> {
    let sampling = prop::option::weighted(
        0.9,
        prop::sample::select(vec![
            SamplingFactor::R_4_4_4,
            SamplingFactor::R_4_2_2,
            SamplingFactor::R_4_2_0,
            SamplingFactor::R_4_4_0,
            SamplingFactor::R_4_1_1,
        ]),
    );
    (1u8..=100, sampling, prop_oneof![Just(0u16), 1u16..40], any::<bool>()).prop_map(
        |(quality, sampling, restart_every, own_codes)| Encoding {
            quality,
            sampling,
            restart_every,
            // the encoder counts its symbols without regard to restarts
            own_codes: own_codes && restart_every == 0,
            progressive: false,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn agrees_with_another_decoder(way in way(), width in 17usize..150, height in 17usize..90, seed in any::<u64>()) {
        let scene = scene(width, height, seed);
        let same = |jpeg: Encoding| decode(&encode(jpeg, &scene, width, height), width, height);
        // The other decoder makes mistakes with restarts, rare samplings and scans of their own: it is asked about plain
        // images. Luma does not depend on those.
        let sampling = way.sampling.map(|_| SamplingFactor::R_4_4_4);
        let plain = Encoding { sampling, restart_every: 0, own_codes: false, ..way };
        let luma = same(plain);
        prop_assert!(luma.is_ok(), "{:?}", luma);
        prop_assert_eq!(&same(way), &luma);
        let jpeg = encode(plain, &scene, width, height);
        prop_assert!(largest_difference(&luma.unwrap(), &reference(&jpeg, width, height)) <= 1);
    }

    /// The other decoder leaves pixels of tiny images out; here they are what the same pixels of a larger image are.
    #[test]
    fn tiny_images(way in way(), width in 1usize..17, height in 1usize..17, seed in any::<u64>()) {
        let rgb = scene(width, height, seed);
        // the encoder repeats the last column and row
        let at = |x: usize, y: usize| &rgb[3 * (y.min(height - 1) * width + x.min(width - 1))..][..3];
        let larger: Vec<u8> = (0..64 * 64).flat_map(|i| at(i % 64, i / 64).to_vec()).collect();
        let tiny = decode(&encode(way, &rgb, width, height), width, height).unwrap();
        let larger = decode(&encode(way, &larger, 64, 64), 64, 64).unwrap();
        for (y, row) in tiny.chunks(width).enumerate() {
            prop_assert_eq!(row, &larger[64 * y..64 * y + width]);
        }
    }

    /// Every piece from the start is an error, unless nothing of the coded data is missing.
    #[test]
    fn a_piece_is_an_error(way in way(), part in 0.0..1.0f64, seed in any::<u64>()) {
        let jpeg = encode(way, &scene(67, 45, seed), 67, 45);
        let length = (part * (jpeg.len() - 2) as f64) as usize;
        let piece = decode(&jpeg[..length], 67, 45);
        prop_assert!(piece.is_err(), "{length} of {} bytes", jpeg.len());
        let scans = jpeg.windows(2).filter(|w| *w == [0xFF, 0xDA]).count();
        prop_assert_eq!(decode(&jpeg[..jpeg.len() - 2], 67, 45).is_ok(), scans == 1, "all but the end marker");
    }

    #[test]
    fn damaged_bytes_do_not_panic(
        way in way(),
        progressive in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        seed in any::<u64>(),
    ) {
        let way = Encoding { progressive, ..way };
        let mut jpeg = encode(way, &scene(67, 45, seed), 67, 45);
        for (at, byte) in changes {
            let at = at.index(jpeg.len());
            jpeg[at] = byte;
        }
        let _ = decode(&jpeg, 67, 45);
    }

    #[test]
    fn random_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..600), header in any::<bool>()) {
        let whole = encode(PLAIN, &scene(67, 45, 1), 67, 45);
        let mut jpeg = if header { whole[..data_of(&whole)].to_vec() } else { vec![0xFF, 0xD8, 0xFF] };
        jpeg.extend(bytes);
        prop_assert!(decode(&jpeg, 67, 45).is_err());
    }
}

#[test]
fn huffman_tables_may_be_missing() {
    for sampling in [None, PLAIN.sampling] {
        let jpeg = encode(Encoding { sampling, ..PLAIN }, &scene(160, 120, 3), 160, 120);
        let bare = without(&jpeg, 0xC4);
        assert!(bare.len() + 200 < jpeg.len());
        assert_eq!(decode(&bare, 160, 120), decode(&jpeg, 160, 120));
    }
}

/// Tables of one image are not those of the next.
#[test]
fn an_image_leaves_nothing_behind() {
    let scene = scene(160, 120, 3);
    let own = encode(Encoding { own_codes: true, quality: 40, ..PLAIN }, &scene, 160, 120);
    let bare = without(&encode(PLAIN, &scene, 160, 120), 0xC4);
    let wanted = decode(&bare, 160, 120).unwrap();
    let mut decoder = LumaDecoder::new(160, 120);
    let mut out = vec![0; 160 * 120];
    for _ in 0..3 {
        decoder.decode(&own, &mut out).unwrap();
        assert_ne!(out, wanted);
        decoder.decode(&bare, &mut out).unwrap();
        assert_eq!(out, wanted);
        decoder.decode(&own[..own.len() / 2], &mut out).unwrap_err();
    }
    assert!(matches!(
        decoder.decode(&without(&own, 0xDB), &mut out),
        Err(JpegError::Damaged("the luma's quantization table is missing"))
    ));
}

#[test]
fn other_kinds_are_refused() {
    let jpeg = encode(Encoding { progressive: true, ..PLAIN }, &scene(160, 120, 3), 160, 120);
    let refused = decode(&jpeg, 160, 120).unwrap_err();
    assert!(matches!(refused, JpegError::Unsupported(_)), "{refused}");
}

/// Every component in a scan of its own, luma in the middle.
#[test]
fn luma_may_have_its_own_scan() {
    let (width, height) = (67, 45);
    let rgb = scene(width, height, 5);
    let grey = encode(Encoding { sampling: None, ..PLAIN }, &rgb, width, height);
    let data = data_of(&grey);
    let coded = &grey[data..grey.len() - 2];
    let frame = grey.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    let scan = data - 10;
    let mut jpeg = grey[..frame].to_vec();
    jpeg.extend([0xFF, 0xC0, 0, 17, 8, 0, height as u8, 0, width as u8, 3]);
    let id = grey[frame + 10];
    // twice the resolution of chroma: blocks of luma alone come without regard to that
    for (id, sampling) in [(id, 0x22), (77, 0x11), (78, 0x11)] {
        jpeg.extend([id, sampling, 0]);
    }
    jpeg.extend(&grey[frame + 13..scan]);
    for id in [77, id, 78] {
        jpeg.extend([0xFF, 0xDA, 0, 8, 1, id, 0, 0, 63, 0]);
        jpeg.extend(coded);
    }
    jpeg.extend([0xFF, 0xD9]);
    assert_eq!(decode(&jpeg, width, height), decode(&grey, width, height));
    decode(&jpeg[..jpeg.len() - 2], width, height).unwrap_err();
}

#[test]
fn sizes_are_compared() {
    let jpeg = encode(PLAIN, &scene(160, 120, 3), 160, 120);
    for (width, height) in [(160, 112), (152, 120), (320, 240)] {
        assert_eq!(
            decode(&jpeg, width, height),
            Err(JpegError::Size {
                found_width_px: 160,
                found_height_px: 120,
                width_px: width as u32,
                height_px: height as u32
            })
        );
    }
}

#[test]
fn bytes_behind_the_image_are_left_alone() {
    let jpeg = encode(PLAIN, &scene(160, 120, 3), 160, 120);
    let wanted = decode(&jpeg, 160, 120);
    let mut longer = jpeg.clone();
    longer.extend([0x5A; 300]);
    assert_eq!(decode(&longer, 160, 120), wanted);
    // filled up with zeros before the end marker, or instead of it
    let mut filled = jpeg[..jpeg.len() - 2].to_vec();
    filled.extend([0; 300]);
    assert_eq!(decode(&filled, 160, 120), wanted);
    filled.extend([0xFF, 0xFF, 0xD9]);
    assert_eq!(decode(&filled, 160, 120), wanted);
}

/// A piece lost in the middle, as USB loses them: the data ends too early, or does not fit.
#[test]
fn a_lost_piece_is_found() {
    for restart_every in [0, 10] {
        let jpeg = encode(Encoding { restart_every, ..PLAIN }, &scene(160, 120, 3), 160, 120);
        let data = data_of(&jpeg);
        let mut missed = 0;
        for at in (data..jpeg.len() - 520).step_by(37) {
            let mut lossy = jpeg[..at].to_vec();
            lossy.extend(&jpeg[at + 512..]);
            missed += usize::from(decode(&lossy, 160, 120).is_ok());
        }
        assert_eq!(missed, 0);
    }
}

#[test]
fn restart_markers_are_counted() {
    let jpeg = encode(Encoding { restart_every: 10, ..PLAIN }, &scene(160, 120, 3), 160, 120);
    let mut markers: Vec<usize> = (data_of(&jpeg)..jpeg.len())
        .filter(|&i| jpeg[i] == 0xFF && (0xD0..0xD8).contains(&jpeg[i + 1]))
        .collect();
    assert_eq!(markers.len(), 14, "150 units of 16 x 8 px");
    let mut swapped = jpeg.clone();
    swapped[markers[3] + 1] = 0xD4;
    decode(&swapped, 160, 120).unwrap_err();
    // a whole interval is missing
    let (from, to) = (markers.remove(3), markers.remove(3));
    let mut short = jpeg[..from].to_vec();
    short.extend(&jpeg[to..]);
    decode(&short, 160, 120).unwrap_err();
}
