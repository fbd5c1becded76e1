//! The first frame, the last one, and those in which the target was lost, with what was found in them.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use super::record::{ImageData, RunRecord};
use crate::report::numbers::{counted, significant};
use crate::report::page::{escaped, heading};
use std::fmt::Write;

/// Half the length of a mark, as a share of the image's width.
const MARK: f64 = 0.012;

/// The same in the small frames of the strip.
const STRIP_MARK: f64 = 0.03;

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
    let mut html = filmstrip(r) + &heading(TITLE, &format!("{says}."));
    html += "<div class=\"images\">\n";
    for image in r.images.iter().filter(|image| !is_of_strip(image)) {
        let rows: Vec<usize> =
            (0..r.frames.rows()).filter(|row| r.frames.word("file", *row) == image.file).collect();
        let Some(first) = rows.first() else { continue };
        let id = r.frames.number("frame_id", *first);
        let row = r.measurements.numbers("frame_id").iter().position(|f| *f == id);
        let time = row.map(|row| r.measurements.number("exposure_s", row)).filter(|t| t.is_finite());
        let found = rows.iter().filter(|row| r.frames.number("u_px", **row).is_finite()).count();
        let of = match row.filter(|_| r.targets_looked_for().len() > 1) {
            Some(row) => format!(" of {}", r.target_name(r.target_at(row))),
            None => String::new(),
        };
        let caption = format!(
            "{} frame, number {id}{}: {}; {}{of}",
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
            marks(r, (&rows, row), MARK)
        );
    }
    html + "</div><p class=\"note\">Green crosses: points that were found; dashed circles: where they are to be. The files beside this page are the \
            images as vision had them, without marks.</p>\n"
}

fn is_of_strip(image: &ImageData) -> bool {
    image.file.starts_with("frame-strip-")
}

/// Small frames from all of the run.
fn filmstrip(r: &RunRecord) -> String {
    let mut frames = String::new();
    let (mut count, mut ends) = (0_u64, (f64::NAN, f64::NAN));
    for image in r.images.iter().filter(|image| is_of_strip(image)) {
        let rows: Vec<usize> =
            (0..r.frames.rows()).filter(|row| r.frames.word("file", *row) == image.file).collect();
        let Some(first) = rows.first() else { continue };
        let id = r.frames.number("frame_id", *first);
        let row = r.measurements.numbers("frame_id").iter().position(|f| *f == id);
        let of = |name: &str| row.map_or(f64::NAN, |row| r.measurements.number(name, row));
        let (time_s, error_px) = (of("exposure_s"), of("error_px"));
        let when = if time_s.is_finite() { format!("{time_s:.2} s") } else { format!("number {id}") };
        let what = if error_px.is_finite() {
            format!("{} px", significant(error_px, 2))
        } else {
            r.frames.word("status", *first).to_owned()
        };
        let caption = escaped(&format!("{when}: {what}"));
        ends = (ends.0.min(time_s), ends.1.max(time_s));
        count += 1;
        // a String takes everything
        let _ = writeln!(
            frames,
            "<figure><div class=\"image\"><img src=\"{}\" alt=\"{caption}\">{}</div><figcaption>{caption}</figcaption></figure>",
            image.data,
            marks(r, (&rows, row), STRIP_MARK)
        );
    }
    // The first and the last frame stand below.
    if count < 3 {
        return String::new();
    }
    let mut says = counted(count, "frame");
    if ends.0.is_finite() {
        says += &format!(" from {:.2} to {:.2} s", ends.0, ends.1);
    }
    let says = format!("{says}, evenly spread, each with its time and its feature error.");
    heading("Filmstrip", &says) + "<div class=\"images strip\">\n" + &frames + "</div>\n"
}

/// What was found in a frame, by its `rows`, and the goal of the target that was looked for in it, by the row of its measurement.
fn marks(r: &RunRecord, (rows, measurement): (&[usize], Option<usize>), mark: f64) -> String {
    let [width, height] = r.image_px;
    let mark = mark * width;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {height}\" aria-hidden=\"true\">"
    );
    let target = measurement.map_or(0, |row| r.target_at(row));
    for row in (0..r.goal.rows()).filter(|row| r.goal_target_at(*row) == target) {
        let (u, v) = (r.goal.number("u_px", row), r.goal.number("v_px", row));
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
        assert!(!html.contains("Filmstrip"), "two frames are no strip");
    }

    #[test]
    fn a_filmstrip_has_times_and_errors() {
        let mut text =
            String::from("file,why,frame_id,status,point,u_px,v_px,frames,frames_without_target,losses\n");
        for id in [0, 4, 8] {
            let _ = writeln!(text, "frame-strip-{id:06}.png,strip,{id},\"found\",1,10,20,9,0,0");
        }
        let image = |id: u32| ImageData { file: format!("frame-strip-{id:06}.png"), data: "data:x".into() };
        let r = RunRecord {
            image_px: [100.0, 50.0],
            frames: CsvTable::parse(&text),
            images: [0, 4, 8].map(image).into(),
            measurements: CsvTable::parse("frame_id,exposure_s,error_px\n0,0.25,12.34\n4,0.5,1\n8,1.25,\n"),
            ..RunRecord::default()
        };
        let html = photographs(&r);
        for part in ["3 frames from 0.25 to 1.25 s", ">0.25 s: 12 px<", ">1.25 s: found<", "M7.0 20.0H13.0"] {
            assert!(html.contains(part), "{part}: {html}");
        }
        assert_eq!(html.matches("<figure>").count(), 3, "they stand in the strip alone");
    }
}
