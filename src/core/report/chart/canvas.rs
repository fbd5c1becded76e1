//! SVG text: shapes by class, colours by the style sheet, so that light and dark are one drawing.
//!
//! The numbers here are a layout's, chosen by eye so that pages read well; `tests/processes/report.rs` looks whether
//! a letter is small, cut off or under another.

use super::style::CHART_STYLE;
use std::fmt::Write;

/// How wide a figure is shown; each is drawn for all three, so that its letters stay readable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// A telephone.
    Narrow,
    /// A tablet, and paper.
    Medium,
    /// A screen.
    Wide,
}

impl Width {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Narrow, Self::Medium, Self::Wide];

    /// In units of the drawing, which are about a pixel.
    #[must_use]
    pub fn units(self) -> f64 {
        match self {
            Self::Narrow => 360.0,
            Self::Medium => 720.0,
            Self::Wide => 1100.0,
        }
    }

    /// Height of letters; none is shown below 11 px, whatever the window between two widths.
    #[must_use]
    pub fn letters(self) -> f64 {
        match self {
            Self::Narrow => 13.5,
            Self::Medium => 14.5,
            Self::Wide => 13.0,
        }
    }

    /// Its class in a page.
    #[must_use]
    pub fn class(self) -> &'static str {
        match self {
            Self::Narrow => "narrow",
            Self::Medium => "medium",
            Self::Wide => "wide",
        }
    }
}

/// Where a text is anchored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// At its left end.
    Start,
    /// In its middle.
    Middle,
    /// At its right end.
    End,
}

/// A rectangle: least x and y, greatest x and y.
pub type Area = [f64; 4];

/// A drawing under way.
#[derive(Debug, Clone)]
pub struct Canvas {
    body: String,
    width: f64,
    height: f64,
    letters: f64,
    /// Where letters stand.
    texts: Vec<Area>,
}

impl Canvas {
    /// An empty drawing.
    #[must_use]
    pub fn new(width: Width, height: f64) -> Self {
        Self {
            body: String::new(),
            width: width.units(),
            height,
            letters: width.letters(),
            texts: Vec::new(),
        }
    }

    /// Height of its letters.
    #[must_use]
    pub fn letters(&self) -> f64 {
        self.letters
    }

    /// Makes it this high.
    pub fn set_height(&mut self, height: f64) {
        self.height = height;
    }

    /// Begins a group with these attributes, which [`Self::close`] ends.
    pub fn open(&mut self, attributes: &str) {
        let _ = write!(self.body, "<g {attributes}>"); // a String takes everything
    }

    /// Ends the group that was begun last.
    pub fn close(&mut self) {
        self.body.push_str("</g>");
    }

    /// A line through points, in the classes `class`; one of a single point is a dot.
    pub fn path(&mut self, class: &str, points: impl IntoIterator<Item = [f64; 2]>) {
        let mut d = String::new();
        let mut count = 0;
        for [x, y] in points {
            let word = if count == 0 { 'M' } else { 'L' };
            let _ = write!(d, "{word}{} {}", number(x), number(y)); // a String takes everything
            count += 1;
        }
        if count == 1 {
            d.push_str("h0");
        }
        if count > 0 {
            let _ = write!(self.body, "<path class=\"{class}\" d=\"{d}\"/>");
        }
    }

    /// A rectangle.
    pub fn rectangle(&mut self, class: &str, [x0, y0, x1, y1]: Area) {
        let _ = write!(
            self.body,
            "<rect class=\"{class}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
            number(x0),
            number(y0),
            number((x1 - x0).max(0.0)),
            number((y1 - y0).max(0.0))
        );
    }

    /// A circle.
    pub fn circle(&mut self, class: &str, [x, y]: [f64; 2], radius: f64) {
        let (x, y, r) = (number(x), number(y), number(radius));
        let _ = write!(self.body, "<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"{r}\"/>");
    }

    /// A text whose letters stand on `at`.
    pub fn text(&mut self, class: &str, at: [f64; 2], anchor: Anchor, text: &str) {
        if text.is_empty() {
            return;
        }
        self.texts.push(self.area_of(at, anchor, text));
        let (x, y) = (number(at[0]), number(at[1]));
        let word = match anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let size = number(self.letters);
        let _ = write!(
            self.body,
            "<text class=\"{class}\" x=\"{x}\" y=\"{y}\" font-size=\"{size}\"{word}>{}</text>",
            escaped(text)
        );
    }

    /// Where a text would stand.
    #[must_use]
    pub fn area_of(&self, [x, y]: [f64; 2], anchor: Anchor, text: &str) -> Area {
        let width = text_width(text, self.letters);
        let left = match anchor {
            Anchor::Start => x,
            Anchor::Middle => x - 0.5 * width,
            Anchor::End => x - width,
        };
        [left, y - 0.95 * self.letters, left + width, y + 0.3 * self.letters]
    }

    /// Writes a text beside a point, where no other text stands and nothing is cut off; `false` where there is no such place.
    pub fn label(&mut self, class: &str, [x, y]: [f64; 2], text: &str) -> bool {
        let h = self.letters;
        for far in [0.55, 1.3, 2.1, 3.0] {
            for (dx, dy, anchor) in [
                (1.0, -0.55, Anchor::Start),
                (-1.0, -0.55, Anchor::End),
                (1.0, 1.0, Anchor::Start),
                (-1.0, 1.0, Anchor::End),
                (0.0, -1.0, Anchor::Middle),
                (0.0, 1.6, Anchor::Middle),
            ] {
                let at = [x + dx * far * h, y + dy * far * h + 0.2 * h];
                let area = self.area_of(at, anchor, text);
                let inside = area[0] >= 1.0
                    && area[1] >= 1.0
                    && area[2] <= self.width - 1.0
                    && area[3] <= self.height - 1.0;
                if inside && !self.texts.iter().any(|other| overlap(other, &area)) {
                    if far > 1.0 {
                        let to = [0.5 * (area[0] + area[2]), 0.5 * (area[1] + area[3])];
                        let share = 0.45;
                        self.path("leader", [[x, y], [x + share * (to[0] - x), y + share * (to[1] - y)]]);
                    }
                    self.text(class, at, anchor, text);
                    return true;
                }
            }
        }
        false
    }

    /// The drawing as a file of its own, with the style of all charts in it.
    #[must_use]
    pub fn finish_alone(self, title: &str) -> String {
        let (width, height) = (number(self.width), number(self.height));
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"chart\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\
             <title>{}</title><style>{CHART_STYLE}</style><rect width=\"{width}\" height=\"{height}\" style=\"fill:var(--paper)\"/>{}</svg>\n",
            escaped(title),
            self.body
        )
    }

    /// Where its texts stand.
    #[must_use]
    pub fn texts(&self) -> &[Area] {
        &self.texts
    }

    /// The drawing, with the classes `class`; `title` is what is read aloud.
    #[must_use]
    pub fn finish(self, class: &str, title: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"{class}\" viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">{}</svg>",
            number(self.width),
            number(self.height),
            escaped(title),
            self.body
        )
    }
}

/// Whether two rectangles have room in common.
#[must_use]
pub fn overlap(a: &Area, b: &Area) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// About how wide a text is, rather too wide, whatever font there is.
#[must_use]
pub fn text_width(text: &str, letters: f64) -> f64 {
    let wide = |c: char| match c {
        'i' | 'j' | 'l' | 't' | 'f' | 'r' | 'I' | ' ' | '.' | ',' | ':' | ';' | '\'' | '(' | ')' | '['
        | ']' | '|' | '!' => 0.42,
        'm' | 'w' | 'M' | 'W' | '%' | '@' => 1.0,
        c if c.is_uppercase() => 0.74,
        c if c.is_ascii() => 0.645,
        _ => 0.9,
    };
    letters * text.chars().map(wide).sum::<f64>()
}

/// Lines of words that are no wider than `width`; a longer word has a line of its own.
#[must_use]
pub fn wrapped(text: &str, letters: f64, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(line, letters) + text_width(word, letters) + 0.42 * letters <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    lines
}

/// Text that is no markup.
#[must_use]
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c if c.is_control() || ('\u{fffe}'..='\u{ffff}').contains(&c) => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// To a tenth of a unit; what is no number lies far outside.
pub(super) fn number(value: f64) -> String {
    let value = if value.is_finite() { value.clamp(-1e5, 1e5) } else { -1e5 };
    let text = format!("{value:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".into() } else { text.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_keep_clear_of_each_other() {
        let mut canvas = Canvas::new(Width::Narrow, 300.0);
        let placed =
            (0..20).filter(|i| canvas.label("t", [180.0 + f64::from(*i), 150.0], "C at the start")).count();
        assert!(placed >= 6, "{placed}");
        let texts = canvas.texts();
        for (i, a) in texts.iter().enumerate() {
            assert!(texts[i + 1..].iter().all(|b| !overlap(a, b)));
        }
    }

    #[test]
    fn what_is_no_number_does_not_spoil_the_drawing() {
        let mut canvas = Canvas::new(Width::Wide, 10.0);
        canvas.path("c0", [[f64::NAN, f64::INFINITY], [1.04, 1e300]]);
        canvas.text("t", [0.0, 0.0], Anchor::End, "a<b>\u{1}");
        let svg = canvas.finish("x", "\"q\"");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(svg.contains("M-100000 -100000L1 100000") && svg.contains("a&lt;b&gt;\u{fffd}"), "{svg}");
    }

    #[test]
    fn lines_are_broken_at_words() {
        assert_eq!(wrapped("one two  three", 10.0, 60.0), ["one two", "three"]);
        assert_eq!(wrapped("", 10.0, 60.0), Vec::<String>::new());
    }
}
