use super::*;
use proptest::prelude::*;

fn run(steps: &str, pixels: &[u8], width: usize) -> Vec<StepOutcome> {
    let view = ImageView::new(pixels, width, pixels.len() / width).unwrap();
    Pipeline::parse(steps).unwrap().run(&view).unwrap()
}

#[test]
fn every_step_is_read_and_done() {
    // parameters for those that need some
    let arguments = [
        ("gaussian", ":1"),
        ("pyramid", ":1"),
        ("threshold", ":100"),
        ("local_mean", ":3"),
        ("local_extremes", ":10"),
        ("merge", ":means:10"),
        ("laplacian_edges", ":4"),
        ("polygons", ":1"),
    ];
    let way = |kind: ValueKind| match kind {
        ValueKind::Image => "",
        ValueKind::Gradient => "sobel | ",
        ValueKind::Field => "laplacian | ",
        ValueKind::Binary => "threshold:100 | ",
        ValueKind::Regions => "threshold:100 | regions | ",
        ValueKind::Contours => "threshold:100 | contours | ",
        ValueKind::Edges => "edges | ",
        ValueKind::Chains => "edges | chains | ",
        ValueKind::Shapes => "corners | ",
    };
    let pixels: Vec<u8> =
        (0..40 * 40).map(|i| if (i % 40 / 12 + i / 40 / 12) % 2 == 0 { 200 } else { 40 }).collect();
    for info in STEPS {
        assert_eq!(info.usage.split([':', '[']).next(), Some(info.name), "{}", info.usage);
        let parameters = arguments.iter().find(|(name, _)| *name == info.name).map_or("", |a| a.1);
        for takes in info.takes {
            let outcomes = run(&format!("{}{}{parameters}", way(*takes), info.name), &pixels, 40);
            let last = outcomes.last().unwrap();
            assert_eq!(last.kind, info.gives.unwrap_or(*takes), "{}", info.name);
            assert!(!last.facts.is_empty(), "{} tells nothing", info.name);
            assert_eq!(last.drawn.rgb.len(), (3 * last.drawn.width * last.drawn.height) as usize);
            for row in last.table.iter().flat_map(|table| &table.rows) {
                assert_eq!(row.len(), last.table.as_ref().unwrap().columns.len(), "{}", info.name);
            }
        }
    }
}

#[test]
fn no_step_takes_what_it_is_not_given() {
    for info in STEPS {
        for before in STEPS.iter().filter(|b| b.gives.is_some_and(|gives| !info.takes.contains(&gives))) {
            let Some(text) = ["", ":1", ":100", ":3", ":means:10"].iter().find_map(|p| {
                let start = match before.takes[0] {
                    ValueKind::Image => String::new(),
                    ValueKind::Gradient => "sobel | ".into(),
                    ValueKind::Binary => "threshold:9 | ".into(),
                    ValueKind::Edges => "edges | ".into(),
                    other => panic!("{other}"),
                };
                let text = format!("{start}{}{p}", before.name);
                Pipeline::parse(&text).is_ok().then_some(text)
            }) else {
                panic!("{} cannot be written", before.name);
            };
            let refused = Pipeline::parse(&format!("{text} | {}", info.name)).unwrap_err();
            assert!(matches!(refused, PipelineError::Mismatch { .. }), "{refused}");
        }
    }
}

/// The chain of the user's first try: magnitudes of two kinds, split where the variance between the two is greatest.
#[test]
fn a_field_is_split_by_otsu_as_an_image_is() {
    let pixels: Vec<u8> = (0..64 * 48)
        .map(|i| if (20..44).contains(&(i % 64)) && (10..38).contains(&(i / 64)) { 180 } else { 60 })
        .collect();
    let outcomes = run("sobel | magnitude | threshold:otsu | regions | moments", &pixels, 64);
    let fact = |step: usize, name: &str| outcomes[step].facts.iter().find(|fact| fact.0 == name).unwrap().1;
    let threshold = fact(2, "threshold");
    assert!(fact(1, "least") < threshold && threshold < fact(1, "greatest"), "{threshold}");
    assert_eq!(fact(3, "regions"), 1.0, "the ring of the edges");
    // A field whose numbers are whole levels 0 to 255 is split where the image of these levels is.
    let steps: Vec<u8> = (0..64 * 48)
        .map(|i| {
            if i % 64 < 30 {
                0
            } else if i % 64 < 32 {
                40
            } else {
                255
            }
        })
        .collect();
    let of_field = run("differences | magnitude | threshold:otsu", &steps, 64);
    assert!(
        of_field[2].facts.iter().any(|(name, value)| *name == "threshold" && (0.0..215.0).contains(value))
    );
    let flat = ImageView::new(&[7; 64], 8, 8).unwrap();
    assert!(Pipeline::parse("sobel | magnitude | threshold:otsu").unwrap().run(&flat).is_err(), "one level");
}

proptest! {
    #[test]
    fn a_binary_image_and_its_regions_have_the_same_pixels(
        pixels in prop::collection::vec(any::<u8>(), 24 * 16), level in 0u8..=255, light in any::<bool>(),
    ) {
        let side = if light { "light" } else { "dark" };
        let outcomes = run(&format!("threshold:{level}:{side} | regions | moments | grey_moments"), &pixels, 24);
        let object = |p: u8| if light { p > level } else { p <= level };
        let objects: Vec<(usize, u8)> = pixels.iter().copied().enumerate().filter(|(_, p)| object(*p)).collect();
        prop_assert_eq!(outcomes[0].facts[0], ("object_pixels", objects.len() as f64));
        let sum = |step: usize, name: &str| outcomes[step].table.as_ref().unwrap().column(name).iter().sum::<f64>();
        prop_assert_eq!(sum(2, "m00"), objects.len() as f64);
        prop_assert_eq!(sum(2, "m10"), objects.iter().map(|(i, _)| (i % 24) as f64).sum::<f64>());
        prop_assert_eq!(sum(2, "m01"), objects.iter().map(|(i, _)| (i / 24) as f64).sum::<f64>());
        prop_assert_eq!(sum(3, "m00"), objects.iter().map(|(_, p)| f64::from(*p)).sum::<f64>());
        // the image of the binary image is white on the objects alone
        for (pixel, rgb) in pixels.iter().zip(outcomes[0].drawn.rgb.chunks(3)) {
            prop_assert_eq!(rgb[0] == 255, object(*pixel));
        }
    }

    #[test]
    fn any_text_is_read_or_refused(text in "[a-z_:|0-9. -]{0,40}") {
        if let Err(e) = Pipeline::parse(&text) {
            prop_assert!(!e.to_string().is_empty());
        }
    }

    #[test]
    fn a_merged_image_is_covered_by_its_regions(pixels in prop::collection::vec(any::<u8>(), 20 * 12), levels in 0u8..255) {
        let outcomes = run(&format!("merge:interval:{levels} | grey_moments"), &pixels, 20);
        let table = |step: usize| outcomes[step].table.as_ref().unwrap();
        prop_assert_eq!(table(0).column("area_px2").iter().sum::<f64>(), 240.0);
        let all: u64 = pixels.iter().map(|p| u64::from(*p)).sum();
        prop_assert_eq!(table(1).column("m00").iter().sum::<f64>(), all as f64);
    }
}
