//! Pictures in memory: 8-bit sRGB pixels, text, PNG.
//!
//! Text is drawn with an embedded subset of DejaVu Sans (ASCII and a few
//! symbols), so that pictures look the same on machines without fonts. Its
//! licence lies beside it in `assets/`.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::OnceLock;

use plotters::backend::BitMapBackend;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::prelude::{RGBColor, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, IntoFont, TextStyle, register_font};

use crate::error::ViewError;

static FONT: &[u8] = include_bytes!("../assets/DejaVuSans-subset.ttf");

/// Colour, 8-bit sRGB.
pub type Rgb = [u8; 3];

/// Pixels, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// Which end of a text stands at the given place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The text begins there.
    Left,
    /// The text is centred there.
    Centre,
    /// The text ends there.
    Right,
}

impl Picture {
    /// A picture of one colour.
    pub fn new(width: usize, height: usize, background: Rgb) -> Self {
        Self {
            width,
            height,
            pixels: background.repeat(width * height),
        }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Colour of a pixel.
    ///
    /// # Panics
    /// If the pixel lies outside.
    pub fn pixel(&self, x: usize, y: usize) -> Rgb {
        assert!(
            x < self.width && y < self.height,
            "pixel ({x}, {y}) lies outside"
        );
        self.pixels.as_chunks::<3>().0[y * self.width + x]
    }

    /// Sets a pixel; pixels outside are left out.
    pub fn set_pixel(&mut self, x: usize, y: usize, colour: Rgb) {
        if x < self.width && y < self.height {
            self.pixels.as_chunks_mut::<3>().0[y * self.width + x] = colour;
        }
    }

    /// Copies `other` with its upper left corner at (x, y), cutting what lies outside.
    pub fn paste(&mut self, other: &Self, x: usize, y: usize) {
        let columns = other.width.min(self.width.saturating_sub(x)) * 3;
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let from = row * other.width * 3;
            let to = ((y + row) * self.width + x) * 3;
            self.pixels[to..to + columns].copy_from_slice(&other.pixels[from..from + columns]);
        }
    }

    /// Draws one line of text, `size` pixels high, its middle at height `y`.
    ///
    /// # Errors
    /// If the plotting library fails.
    pub fn text(
        &mut self,
        (x, y): (usize, usize),
        text: &str,
        size: f64,
        anchor: Anchor,
        colour: Rgb,
    ) -> Result<(), ViewError> {
        let horizontal = match anchor {
            Anchor::Left => HPos::Left,
            Anchor::Centre => HPos::Center,
            Anchor::Right => HPos::Right,
        };
        let style = text_style(size, colour).pos(Pos::new(horizontal, VPos::Center));
        let place = (x as i32, y as i32);
        self.drawing_area()
            .draw(&Text::new(text, place, style))
            .map_err(|error| ViewError::drawing("text", error))
    }

    /// Writes a PNG file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), ViewError> {
        let encode = || -> Result<(), png::EncodingError> {
            let file = BufWriter::new(File::create(path)?);
            let mut encoder = png::Encoder::new(file, self.width as u32, self.height as u32);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.pixels)?;
            writer.finish()
        };
        encode().map_err(|reason| ViewError::Write {
            path: path.to_path_buf(),
            reason,
        })
    }

    /// The pixels as the plotting library sees them.
    pub(crate) fn drawing_area(
        &mut self,
    ) -> DrawingArea<BitMapBackend<'_>, plotters::coord::Shift> {
        let size = (self.width as u32, self.height as u32);
        BitMapBackend::with_buffer(&mut self.pixels, size).into_drawing_area()
    }
}

/// Text style in the embedded font.
pub(crate) fn text_style(size: f64, colour: Rgb) -> TextStyle<'static> {
    static REGISTERED: OnceLock<()> = OnceLock::new();
    REGISTERED.get_or_init(|| {
        let registered = register_font("sans-serif", FontStyle::Normal, FONT);
        assert!(registered.is_ok(), "the embedded font is damaged");
    });
    let [r, g, b] = colour;
    ("sans-serif", size).into_font().color(&RGBColor(r, g, b))
}

/// Width of a line of text in pixels.
pub(crate) fn text_width(text: &str, size: f64) -> Result<usize, ViewError> {
    let boxed = text_style(size, [0; 3]).font.layout_box(text);
    let ((left, _), (right, _)) = boxed.map_err(|error| ViewError::drawing("text", error))?;
    Ok((right - left).max(0) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_leaves_ink_where_it_is_anchored() {
        let ink = |anchor: Anchor| {
            let mut picture = Picture::new(120, 20, [255; 3]);
            picture
                .text((60, 10), "frame 12", 14.0, anchor, [0; 3])
                .unwrap();
            let dark: Vec<usize> = (0..120)
                .filter(|&x| (0..20).any(|y| picture.pixel(x, y)[0] < 128))
                .collect();
            (dark[0], dark[dark.len() - 1])
        };
        let (left, centre, right) = (ink(Anchor::Left), ink(Anchor::Centre), ink(Anchor::Right));
        assert!(left.0 >= 60 && left.1 > 90, "{left:?}");
        assert!(centre.0 < 50 && centre.1 > 70, "{centre:?}");
        assert!(right.1 <= 60 && right.0 < 30, "{right:?}");
    }

    #[test]
    fn pasting_cuts_at_the_border() {
        let mut picture = Picture::new(4, 3, [0; 3]);
        picture.paste(&Picture::new(3, 3, [9; 3]), 2, 1);
        picture.paste(&Picture::new(3, 3, [7; 3]), 9, 9);
        let filled = (0..12)
            .filter(|i| picture.pixel(i % 4, i / 4) == [9; 3])
            .count();
        assert_eq!(filled, 4);
    }

    #[test]
    fn writing_into_a_missing_folder_names_the_file() {
        let error = Picture::new(1, 1, [0; 3]).write_png(Path::new("no-such-folder/a.png"));
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("no-such-folder/a.png")
        );
    }
}
