//! Writes shapes as SVG.

use std::fmt::Write;

use super::drawing::{Anchor, Drawing, Shape};
use crate::picture::{Rgb, Type};

/// Width of a letter in Noto Sans Mono and similar fonts, in em.
const LETTER_EM: f64 = 0.6;

/// Height of the middle of lower case letters with ascenders above the baseline, in em.
const MIDDLE_EM: f64 = 0.34;

impl Drawing {
    /// Returns the text of an SVG file.
    pub fn to_svg(&self) -> String {
        write(self)
    }
}

fn write(drawing: &Drawing) -> String {
    let Drawing { width, height, .. } = drawing;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"'Noto Sans Mono','DejaVu Sans Mono',Menlo,Consolas,monospace\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    for shape in &drawing.shapes {
        push(&mut svg, shape).expect("writing to a string does not fail");
    }
    svg.push_str("</svg>\n");
    svg
}

fn push(svg: &mut String, shape: &Shape) -> std::fmt::Result {
    match shape {
        Shape::Rect { corner: [x, y], size: [width, height], fill } => {
            let fill = hex(*fill);
            writeln!(svg, "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"{fill}\"/>")
        }
        Shape::Line { points, width, color } => {
            let (points, color) = (list(points), hex(*color));
            writeln!(
                svg,
                "<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\" \
                 stroke-linecap=\"round\" stroke-linejoin=\"round\"/>"
            )
        }
        Shape::Polygon { points, fill, opacity } => {
            let (points, fill, opacity) = (list(points), hex(*fill), f64::from(*opacity) / 255.0);
            writeln!(svg, "<polygon points=\"{points}\" fill=\"{fill}\" fill-opacity=\"{opacity:.3}\"/>")
        }
        Shape::Text { text, at: [x, y], anchor, kind, color } => {
            let size = kind.width("x") as f64 / LETTER_EM;
            let below = MIDDLE_EM * size;
            let place = match anchor {
                // Rotated about the middle: an offset below the middle becomes an offset to the right.
                Anchor::Turned => format!("transform=\"translate({:.1} {y:.1}) rotate(-90)\"", x + below),
                _ => format!("x=\"{x:.1}\" y=\"{:.1}\"", y + below),
            };
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle | Anchor::Turned => "middle",
                Anchor::End => "end",
            };
            let weight = match kind {
                Type::Small | Type::Body => "",
                Type::BodyBold | Type::Heading => " font-weight=\"bold\"",
            };
            let (color, text) = (hex(*color), escaped(text));
            writeln!(
                svg,
                "<text {place} font-size=\"{size:.1}\" text-anchor=\"{anchor}\" fill=\"{color}\"{weight}>{text}</text>"
            )
        }
    }
}

/// Formats a color as `#rrggbb`.
pub(super) fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn list(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
