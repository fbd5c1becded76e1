//! The first frame, the last one, and those in which the target was lost, with what was found in them.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use super::record::RunRecord;
use crate::report::numbers::counted;
use crate::report::page::{escaped, heading};
use std::fmt::Write;

/// Half the length of a mark, as a share of the image's width.
const MARK: f64 = 0.012;

/// The section.
pub(super) fn photographs(r: &RunRecord) -> String {
    const TITLE: &str = "Frames: the first, the last, and where the target was lost";
    let count = |name: &str| r.frames.numbers(name).first().copied().unwrap_or(0.0) as u64;
    let (frames, without, losses) = (count("frames"), count("frames_without_target"), count("losses"));
    if frames == 0 {
        return heading(TITLE, "No frame reached vision.");
    }
    let mut says = match (losses, without) {
        (0, 0) => format!("The target was found in each of {}", counted(frames, "frame")),
        (0, without) => format!(
            "The target was never lost once it was found; {without} of {} show none",
            counted(frames, "frame")
        ),
        (losses, without) => {
            format!("The target was lost {losses} times; {without} of {} show none", counted(frames, "frame"))
        }
    };
    let shown = r.images.iter().filter(|p| p.file.contains("-lost-")).count() as u64;
    if losses > shown {
        says += &format!("; {} of the losses are shown", shown);
    }
    let mut html = heading(TITLE, &format!("{says}."));
    html += "<div class=\"images\">\n";
    for image in &r.images {
        let rows: Vec<usize> =
            (0..r.frames.rows()).filter(|row| r.frames.word("file", *row) == image.file).collect();
        let Some(first) = rows.first() else { continue };
        let id = r.frames.number("frame_id", *first);
        let row = r.measurements.numbers("frame_id").iter().position(|f| *f == id);
        let time = row.map(|row| r.measurements.number("exposure_s", row)).filter(|t| t.is_finite());
        let found = rows.iter().filter(|row| r.frames.number("u_px", **row).is_finite()).count();
        let caption = format!(
            "{} frame, number {id}{}: {}; {}",
            super::joints::capital(r.frames.word("why", *first)),
            time.map_or_else(String::new, |t| format!(", exposed at {t:.3} s")),
            r.frames.word("status", *first),
            counted(found as u64, "point")
        );
        // a String takes everything
        let _ = writeln!(
            html,
            "<figure><div class=\"image\"><img src=\"{}\" alt=\"{1}\">{2}</div><figcaption>{1}</figcaption></figure>",
            image.data,
            escaped(&caption),
            marks(r, &rows)
        );
    }
    html + "</div><p class=\"note\">Green crosses: points that were found; dashed circles: where they are to be. The files beside this page are the \
            images as vision had them, without marks.</p>\n"
}

fn marks(r: &RunRecord, rows: &[usize]) -> String {
    let [width, height] = r.image_px;
    let mark = MARK * width;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {height}\" aria-hidden=\"true\">"
    );
    for (u, v) in r.goal.numbers("u_px").iter().zip(r.goal.numbers("v_px")) {
        if u.is_finite() && v.is_finite() {
            let _ = write!(svg, "<circle class=\"goal\" cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"{mark:.1}\"/>");
        }
    }
    for row in rows {
        let (u, v) = (r.frames.number("u_px", *row), r.frames.number("v_px", *row));
        if u.is_finite() && v.is_finite() {
            let (x0, x1, y0, y1) = (u - mark, u + mark, v - mark, v + mark);
            let _ = write!(svg, "<path d=\"M{x0:.1} {v:.1}H{x1:.1}M{u:.1} {y0:.1}V{y1:.1}\"/>");
        }
    }
    svg + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::super::record::ImageData;
    use super::*;
    use crate::report::csv_table::CsvTable;

    #[test]
    fn images_have_their_points_and_their_words() {
        let text = "file,why,frame_id,status,point,u_px,v_px,frames,frames_without_target,losses\n\
                    frame-first-000000.png,first,0,\"found\",1,10,20,9,3,2\nframe-lost-000005.png,lost,5,\"no contrast in the frame\",,,,9,3,2\n";
        let image = |file: &str| ImageData { file: file.into(), data: "data:x".into() };
        let r = RunRecord {
            image_px: [100.0, 50.0],
            frames: CsvTable::parse(text),
            images: vec![image("frame-first-000000.png"), image("frame-lost-000005.png")],
            measurements: CsvTable::parse("frame_id,exposure_s\n0,0.25\n"),
            ..RunRecord::default()
        };
        let html = photographs(&r);
        assert!(html.contains("lost 2 times; 3 of 9 frames show none; 1 of the losses are shown."), "{html}");
        assert!(html.contains("First frame, number 0, exposed at 0.250 s: found; 1 point<"), "{html}");
        assert!(html.contains("Lost frame, number 5: no contrast in the frame; 0 points<"), "{html}");
        assert!(html.contains("M8.8 20.0H11.2M10.0 18.8V21.2"), "{html}");
    }
}
