//! A drawing of shapes, which is rendered as SVG or pixels.

use crate::picture::{Rgb, Type};

/// Shapes on a white page, in drawing order.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) shapes: Vec<Shape>,
}

/// A shape; coordinates are in pixels from the upper left corner, x first.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// A filled rectangle on whole pixels, so that there is no seam between neighbors.
    Rect { corner: [usize; 2], size: [usize; 2], fill: Rgb },
    /// A line through points with round ends.
    Line { points: Vec<[f64; 2]>, width: f64, color: Rgb },
    /// A filled polygon; opacity 0 to 255.
    Polygon { points: Vec<[f64; 2]>, fill: Rgb, opacity: u8 },
    /// A line of text.
    Text { text: String, at: [f64; 2], anchor: Anchor, kind: Type, color: Rgb },
}

/// The point of a text that its position refers to; all are vertically centered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    /// The beginning.
    Start,
    /// The middle.
    Middle,
    /// The end.
    End,
    /// The middle of a text that runs upward.
    Turned,
}

impl Drawing {
    /// Creates an empty page.
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    pub(super) fn rect(&mut self, corner: [usize; 2], size: [usize; 2], fill: Rgb) {
        if size[0] > 0 && size[1] > 0 {
            self.shapes.push(Shape::Rect { corner, size, fill });
        }
    }

    pub(super) fn line(&mut self, points: Vec<[f64; 2]>, width: f64, color: Rgb) {
        self.shapes.push(Shape::Line { points, width, color });
    }

    pub(super) fn polygon(&mut self, points: Vec<[f64; 2]>, fill: Rgb, opacity: u8) {
        self.shapes.push(Shape::Polygon { points, fill, opacity });
    }

    pub(super) fn text(&mut self, text: impl Into<String>, at: [f64; 2], anchor: Anchor, kind: Type, color: Rgb) {
        self.shapes.push(Shape::Text { text: text.into(), at, anchor, kind, color });
    }
}
