//! Calibration files of others in XML: OpenCV's `FileStorage`, and ViSP's `vpXmlParserCamera`.
//!
//! | file | lens |
//! |---|---|
//! | OpenCV | by the number of its coefficients, as in OpenCV's YAML |
//! | ViSP, `perspectiveProjWithDistortion` | `plumb_bob` with `k1 = kud`: both give `u = u0 + px x (1 + kud (x^2 + y^2))` of the undistorted x, y |
//! | ViSP, `perspectiveProjWithoutDistortion` | none |

use super::{CameraInfo, CameraInfoError};
use crate::camera_model::{Distortion, Intrinsics};
use roxmltree::{Document, Node};
use std::fmt::Write;

/// Whether a text is XML at all.
pub(super) fn is_xml(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
}

/// Reads either.
pub(super) fn read(text: &str) -> Result<CameraInfo, CameraInfoError> {
    let document = Document::parse(text).map_err(|error| CameraInfoError {
        line: error.pos().row as usize,
        message: format!("not valid XML: {error}"),
    })?;
    let root = document.root_element();
    match root.tag_name().name() {
        "opencv_storage" => of_opencv(&root),
        "root" => of_visp(&root),
        other => Err(wrong(
            &root,
            format!("begins with <{other}>: <opencv_storage> of OpenCV or <root> of ViSP is expected"),
        )),
    }
}

fn wrong(node: &Node<'_, '_>, message: impl Into<String>) -> CameraInfoError {
    let line = node.document().text_pos_at(node.range().start).row as usize;
    CameraInfoError { line, message: message.into() }
}

fn elements<'a, 'b>(node: &Node<'a, 'b>) -> impl Iterator<Item = Node<'a, 'b>> + use<'a, 'b> {
    node.children().filter(Node::is_element)
}

/// The same file as OpenCV writes it in YAML, read as that.
fn of_opencv(root: &Node<'_, '_>) -> Result<CameraInfo, CameraInfoError> {
    let mut yaml = String::new();
    for node in elements(root) {
        let name = node.tag_name().name();
        let text = |node: &Node<'_, '_>| {
            node.text().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(", ")
        };
        // a String takes everything
        if elements(&node).next().is_none() {
            let _ = writeln!(yaml, "{name}: '{}'", text(&node).replace('\'', ""));
            continue;
        }
        let _ = writeln!(yaml, "{name}:");
        for part in elements(&node) {
            let (key, value) = (part.tag_name().name(), text(&part));
            let _ = if key == "data" {
                writeln!(yaml, "  data: [{value}]")
            } else {
                writeln!(yaml, "  {key}: '{value}'")
            };
        }
    }
    // Lines of the text between are nobody's.
    CameraInfo::read(&yaml).map_err(|error| wrong(root, error.message))
}

fn named<'a, 'b>(node: &Node<'a, 'b>, name: &str) -> Option<Node<'a, 'b>> {
    elements(node).find(|child| child.tag_name().name() == name)
}

fn of_visp(root: &Node<'_, '_>) -> Result<CameraInfo, CameraInfoError> {
    let mut cameras = elements(root).filter(|node| node.tag_name().name() == "camera");
    let camera = cameras.next().ok_or_else(|| wrong(root, "has no <camera>"))?;
    if let Some(second) = cameras.next() {
        return Err(wrong(&second, "is a second <camera>: leave the one that is meant"));
    }
    let number = |node: &Node<'_, '_>, name: &str| {
        let found = named(node, name).ok_or_else(|| wrong(node, format!("<{name}> is missing")))?;
        let text = found.text().unwrap_or_default().trim();
        text.parse::<f64>().map_err(|_| wrong(&found, format!("<{name}> is `{text}`, no number")))
    };
    let side = |name: &str| {
        let value = number(&camera, name)?;
        if value.fract() == 0.0 && (1.0..=65536.0).contains(&value) {
            return Ok(value as u32);
        }
        Err(wrong(&camera, format!("<{name}> is {value}, allowed is 1 to 65536")))
    };
    let (width_px, height_px) = (side("image_width")?, side("image_height")?);
    let kind = |model: &Node<'_, '_>| {
        named(model, "type").and_then(|node| node.text()).unwrap_or_default().trim().to_owned()
    };
    let models: Vec<_> = elements(&camera).filter(|node| node.tag_name().name() == "model").collect();
    // The calibration writes both; the one with distortion is the better one.
    let with = models.iter().find(|model| kind(model) == "perspectiveProjWithDistortion");
    let without = || models.iter().find(|model| kind(model) == "perspectiveProjWithoutDistortion");
    let model = with.or_else(without).ok_or_else(|| {
        wrong(
            &camera,
            "has no <model> of type perspectiveProjWithDistortion or perspectiveProjWithoutDistortion",
        )
    })?;
    let k1 = if with.is_some() { number(model, "kud")? } else { 0.0 };
    let intrinsics = Intrinsics {
        fx_px: number(model, "px")?,
        fy_px: number(model, "py")?,
        cx_px: number(model, "u0")?,
        cy_px: number(model, "v0")?,
        width_px,
        height_px,
    };
    let name = named(&camera, "name").and_then(|node| node.text().map(str::to_owned));
    let alone = CameraInfo::of(
        name.as_deref().unwrap_or("camera").trim(),
        intrinsics,
        Distortion { k1, ..Distortion::default() },
    );
    Ok(alone)
}
