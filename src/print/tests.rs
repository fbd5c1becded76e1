use super::*;
use crate::imaging::ImageView;
use crate::target::{Chessboard, DotGrid, FourDots, TagFamily};

fn targets() -> Vec<Target> {
    vec![
        FourDots::default().into(),
        FourDots::default().light_on_dark(true).into(),
        DotGrid::with_pitch(7, 5, 0.03).unwrap().into(),
        Chessboard::with_squares(9, 6, 0.025).unwrap().into(),
        Tags::one(TagFamily::Tag36h11, 0.05, 7).unwrap().into(),
    ]
}

#[test]
fn sheets_are_as_large_as_they_say() {
    for target in targets() {
        let sheet = PrintSheet::of(&target);
        let plate = target.plate();
        let svg = String::from_utf8(print(&target, Format::Svg).unwrap()).unwrap();
        assert!(svg.contains(&format!("width=\"{}mm\"", sheet.size_mm.x.round())), "{svg}");
        assert!(svg.contains(&describe(&target)) && svg.ends_with("</svg>\n"));
        let pdf = print(&target, Format::Pdf).unwrap();
        let text = String::from_utf8_lossy(&pdf);
        assert!(text.starts_with("%PDF") && text.contains("Helvetica"));
        let points = sheet.size_mm.x / 25.4 * 72.0;
        let media = text.split("/MediaBox [0 0 ").nth(1).unwrap().split(' ').next().unwrap();
        assert!((media.parse::<f64>().unwrap() - points).abs() < 0.01, "{points} {text}");
        // pixels: as many as its resolution says
        let png = image::load_from_memory(&print(&target, Format::Png).unwrap()).unwrap().into_luma8();
        assert!((f64::from(png.width()) - sheet.size_mm.x * 300.0 / 25.4).abs() <= 0.5);
        let mm = sheet.size_mm.x - (plate.high_m.x - plate.low_m.x) * 1e3;
        assert!(mm >= 2.0 * EDGE_MM - 1e-9);
    }
}

#[test]
fn the_image_of_a_board_has_squares_of_the_right_size() {
    let target = Chessboard::with_squares(9, 6, 0.0254).unwrap();
    let png = image::load_from_memory(&print(&target.into(), Format::Png).unwrap()).unwrap().into_luma8();
    let (width, height) = (png.width() as usize, png.height() as usize);
    let image = ImageView::new(png.as_raw(), width, height).unwrap();
    // through the middle of the first row of squares: the plate's margin, then 300 px each
    let row = image.row(((5.0 + 12.7 + 12.7) * 300.0 / 25.4) as usize);
    let changes: Vec<_> = (1..width).filter(|x| (row[*x] < 128) != (row[x - 1] < 128)).collect();
    assert_eq!(changes.len(), 10, "{changes:?}");
    for pair in changes.windows(2) {
        assert!(pair[1].abs_diff(pair[0] + 300) <= 1, "{changes:?}");
    }
}

#[test]
fn large_targets_are_refused_and_small_ones_keep_their_text() {
    let large = Target::from(Chessboard::with_squares(9, 6, 1.0).unwrap());
    assert!(matches!(print(&large, Format::Png), Err(PrintError::TooLarge { .. })));
    assert!(matches!(print(&large, Format::Pdf), Err(PrintError::TooLarge { .. })));
    assert!(print(&large, Format::Svg).is_ok());
    let small = Target::from(Tags::one(TagFamily::Tag16h5, 0.001, 1).unwrap());
    let sheet = PrintSheet::of(&small);
    let width = sheet.text.chars().count() as f64 * sheet.text_height_mm * 6.0 / 7.0;
    assert!(width <= sheet.size_mm.x - 2.0 * EDGE_MM + 1e-9, "{width}");
    assert!(sheet.bar_length_mm <= sheet.size_mm.x - 2.0 * EDGE_MM);
}
