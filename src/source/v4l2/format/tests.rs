//! Choices among made-up offers, and what a device that does not keep to them is told of.

use super::*;

fn offer(fourcc: &[u8; 4], sizes: &[(u32, u32)], rates_hz: &[u32]) -> OfferedFormat {
    let rates = rates_hz.iter().map(|hz| rate(*hz)).collect::<Vec<_>>();
    let sizes = sizes.iter().map(|(width, height)| OfferedSize {
        size: SizeOffer::Discrete { width: *width, height: *height },
        rates: rates.clone(),
    });
    let fourcc = FourCc(*fourcc);
    OfferedFormat {
        format: FormatName { fourcc, description: String::new() },
        usable: known(fourcc).is_some(),
        sizes: sizes.collect(),
    }
}

fn rate(hz: u32) -> RateOffer {
    RateOffer::Discrete(Interval { numerator: 1, denominator: hz })
}

const REQUEST: FormatRequest = FormatRequest { width: 640, height: 480, rate_hz: 30.0, format: None };
const VGA: [(u32, u32); 1] = [(640, 480)];

/// What is asked for, in this order, where the rates are those that the offers say.
fn asked(offers: &[OfferedFormat], request: &FormatRequest) -> Result<Vec<String>, V4l2Error> {
    let rates = |fourcc| {
        let of = offers.iter().find(|o| o.format.fourcc == fourcc).unwrap();
        of.sizes.first().map_or(Vec::new(), |s| s.rates.clone())
    };
    Ok(candidates(offers, request, rates)?.iter().map(|(_, fourcc)| fourcc.to_string()).collect())
}

#[test]
fn the_cheapest_format_comes_first() {
    let all = [b"MJPG", b"Y12 ", b"UYVY", b"YUYV", b"RGB3", b"Y10 ", b"NV12", b"GREY", b"Y16 "];
    let offers = all.map(|fourcc| offer(fourcc, &VGA, &[30]));
    let order = asked(&offers, &REQUEST).unwrap();
    assert_eq!(order, ["GREY", "NV12", "YUYV", "UYVY", "Y16", "Y12", "Y10", "RGB3", "MJPG"]);
    let only = FormatRequest { format: Some(PixelFormat::Mjpg), ..REQUEST };
    assert_eq!(asked(&offers, &only).unwrap(), ["MJPG"]);
}

/// The usual USB camera: uncompressed images are slow, and the rate is what was asked for.
#[test]
fn a_format_with_the_rate_precedes_a_cheaper_one_without() {
    let offers = [offer(b"YUYV", &VGA, &[5]), offer(b"UYVY", &VGA, &[10]), offer(b"MJPG", &VGA, &[30, 15])];
    assert_eq!(asked(&offers, &REQUEST).unwrap(), ["MJPG", "UYVY", "YUYV"]);
    let silent = [offer(b"YUYV", &VGA, &[]), offer(b"MJPG", &VGA, &[30])];
    assert_eq!(asked(&silent, &REQUEST).unwrap(), ["YUYV", "MJPG"], "one that says no rates may have it");
}

#[test]
fn what_is_not_offered_is_told_with_what_is() {
    let offers = [offer(b"YUYV", &[(320, 240), (1280, 720)], &[30, 15]), offer(b"H264", &VGA, &[30])];
    let size = asked(&offers, &REQUEST).unwrap_err().to_string();
    assert!(size.contains("640x480") && size.ends_with("it offers 320x240, 1280x720"), "{size}");
    let request = FormatRequest { format: Some(PixelFormat::Grey), ..REQUEST };
    let format = asked(&offers, &request).unwrap_err().to_string();
    assert!(format.contains("does not offer GREY") && format.ends_with("YUYV, H264"), "{format}");
    let none = asked(&offers[1..], &REQUEST).unwrap_err().to_string();
    assert!(none.contains("any of GREY, NV12") && none.ends_with("it offers H264"), "{none}");
}

#[test]
fn ranges_of_sizes_and_rates_have_their_steps() {
    let range = SizeOffer::Stepwise { smallest: [32, 16], largest: [1920, 1080], step: [16, 2] };
    assert!(range.has(640, 480) && range.has(32, 16) && range.has(1920, 1080));
    assert!(!range.has(641, 480) && !range.has(640, 481) && !range.has(1936, 480) && !range.has(16, 16));
    let any = SizeOffer::Stepwise { smallest: [1, 1], largest: [9, 9], step: [0, 0] };
    assert!(any.has(7, 3), "a step of 0 is one of 1");
    let (shortest, longest) =
        (Interval { numerator: 1, denominator: 120 }, Interval { numerator: 1, denominator: 5 });
    let between = RateOffer::Between { shortest, longest };
    assert!(between.has(30.0) && between.has(120.0) && !between.has(4.0) && !between.has(125.0));
    assert!(rate(30).has(30.0) && !rate(30).has(25.0) && between.to_string() == "5 to 120");
}

#[test]
fn rates_become_the_fractions_that_drivers_know() {
    let of = |hz| {
        let i = Interval::of_rate(hz);
        (i.numerator, i.denominator)
    };
    assert_eq!([of(25.0), of(30.0), of(1000.0)], [(1, 25), (1, 30), (1, 1000)]);
    assert_eq!([of(29.97), of(59.94)], [(1001, 30000), (1001, 60000)]);
    assert_eq!([of(7.5), of(0.1), of(12.5)], [(1000, 7500), (1000, 100), (1000, 12500)]);
    assert_eq!(Interval { numerator: 0, denominator: 5 }.rate_hz(), 0.0);
}

#[test]
fn another_rate_is_told_or_refused() {
    let at = |hz| Some(Interval { numerator: 1, denominator: hz });
    assert_eq!(rate_news(30.0, at(30), &[], true).unwrap(), None);
    let told = rate_news(90.0, at(30), &[rate(30), rate(15)], false).unwrap().unwrap();
    assert!(
        told.contains("asked for 90 Hz") && told.contains("30.000 Hz") && told.contains("30, 15 Hz"),
        "{told}"
    );
    let refused = rate_news(90.0, at(30), &[rate(30)], true).unwrap_err().to_string();
    assert!(refused.contains("strict_rate = false"), "{refused}");
    assert!(rate_news(30.0, None, &[], false).unwrap().unwrap().contains("no rate to set"));
}

#[test]
fn a_layout_that_cannot_be_is_refused() {
    let layout = BufferFormat {
        fourcc: FourCc(*b"YUYV"),
        width: 640,
        height: 480,
        field: 1,
        stride: 1280,
        size: 614_400,
    };
    assert!(check_layout(PixelFormat::Yuyv, &layout).is_ok());
    assert!(check_layout(PixelFormat::Yuyv, &BufferFormat { stride: 640, ..layout }).is_err());
    assert!(check_layout(PixelFormat::Yuyv, &BufferFormat { size: 614_399, ..layout }).is_err());
    assert!(check_layout(PixelFormat::Mjpg, &BufferFormat { stride: 0, size: 100_000, ..layout }).is_ok());
}
