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
        let svg = String::from_utf8(print(&target, Format::Svg, None).unwrap()).unwrap();
        assert!(svg.contains(&format!("width=\"{}mm\"", sheet.size_mm.x.round())), "{svg}");
        assert!(svg.contains(&describe(&target)) && svg.ends_with("</svg>\n"));
        let pdf = print(&target, Format::Pdf, None).unwrap();
        let text = String::from_utf8_lossy(&pdf);
        assert!(text.starts_with("%PDF") && text.contains("Helvetica"));
        let points = sheet.size_mm.x / 25.4 * 72.0;
        let media = text.split("/MediaBox [0 0 ").nth(1).unwrap().split(' ').next().unwrap();
        assert!((media.parse::<f64>().unwrap() - points).abs() < 0.01, "{points} {text}");
        // pixels: as many as its resolution says
        let png = image::load_from_memory(&print(&target, Format::Png, None).unwrap()).unwrap().into_luma8();
        assert!((f64::from(png.width()) - sheet.size_mm.x * 300.0 / 25.4).abs() <= 0.5);
        let mm = sheet.size_mm.x - (plate.high_m.x - plate.low_m.x) * 1e3;
        assert!(mm >= 2.0 * EDGE_MM - 1e-9);
    }
}

#[test]
fn the_image_of_a_board_has_squares_of_the_right_size() {
    let target = Chessboard::with_squares(9, 6, 0.0254).unwrap();
    let png =
        image::load_from_memory(&print(&target.into(), Format::Png, None).unwrap()).unwrap().into_luma8();
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
    assert!(matches!(print(&large, Format::Png, None), Err(PrintError::TooLarge { .. })));
    assert!(matches!(print(&large, Format::Pdf, None), Err(PrintError::TooLarge { .. })));
    assert!(print(&large, Format::Svg, None).is_ok());
    let small = Target::from(Tags::one(TagFamily::Tag16h5, 0.001, 1).unwrap());
    let sheet = PrintSheet::of(&small);
    let width = sheet.text.chars().count() as f64 * sheet.text_height_mm * 6.0 / 7.0;
    assert!(width <= sheet.size_mm.x - 2.0 * EDGE_MM + 1e-9, "{width}");
    assert!(sheet.bar_length_mm <= sheet.size_mm.x - 2.0 * EDGE_MM);
}

#[test]
fn a_target_lies_in_the_middle_of_its_paper_or_is_refused() {
    let board = |square_m| Target::from(Chessboard::with_squares(9, 6, square_m).unwrap());
    let (target, alone) = (board(0.023), PrintSheet::of(&board(0.023)));
    for (paper, size_mm) in
        [(Paper::A4, [297.0, 210.0]), (Paper::Letter, [279.4, 215.9]), (Paper::A3, [297.0, 420.0])]
    {
        let sheet = PrintSheet::of(&target).on(paper).unwrap();
        assert_eq!(<[f64; 2]>::from(sheet.size_mm), size_mm);
        let (PrintShape::Outlines(here), PrintShape::Outlines(there)) = (&sheet.shapes[0], &alone.shapes[0])
        else {
            panic!("a board has outlines")
        };
        let by = here[0][0] - there[0][0];
        assert!((by - 0.5 * (sheet.size_mm - alone.size_mm)).norm() < 1e-9);
        assert!(
            (sheet.bar_mm - alone.bar_mm - by).norm() < 1e-9
                && (sheet.text_mm - alone.text_mm - by).norm() < 1e-9
        );
        let pdf = print(&target, Format::Pdf, Some(paper)).unwrap();
        assert!(String::from_utf8_lossy(&pdf).contains("%PDF"));
    }
    // What is told to fit does, and a little more does not.
    let told = PrintSheet::of(&board(0.025)).on(Paper::A4).unwrap_err();
    assert_eq!(
        told.to_string(),
        "285 x 224 mm with its margin and the bar do not fit on A4: make the target 93 % of its size, or take a larger paper"
    );
    assert!(PrintSheet::of(&board(0.93 * 0.025)).on(Paper::A4).is_ok());
    assert!(PrintSheet::of(&board(0.94 * 0.025)).on(Paper::A4).is_err());
    assert_eq!(paper_in_words(&board(0.023)), "fits on A4");
    assert_eq!(paper_in_words(&board(0.025)), "fits on A3");
    assert!(paper_in_words(&board(0.05)).contains("larger than A3"));
}
