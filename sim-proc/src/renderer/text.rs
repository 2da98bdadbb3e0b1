//! Draws every text of the scene once, into an atlas of coverage values.
//!
//! The font is Ubuntu Light from `epaint_default_fonts`. Strokes of its weight vanish at a few metres, so letters are
//! thickened after they are drawn.

use std::collections::BTreeMap;

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use raster::Atlas;

/// Width of the atlas in texels. Its height grows with the texts.
const ATLAS_WIDTH: u32 = 2048;

/// Levels of detail, the finest included.
pub(super) const MIP_LEVELS: u32 = 6;

/// Empty texels around every text, so that coarse levels do not mix neighbours.
const MARGIN: u32 = 8;

/// A text and the panel it is fitted into.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct PanelText {
    /// One line of text.
    pub(super) text: String,
    /// Width and height of the panel, in texels.
    pub(super) size: [u32; 2],
}

/// The texts requested so far and their positions in the atlas.
#[derive(Default)]
pub(super) struct AtlasBuilder {
    places: BTreeMap<PanelText, [u32; 2]>,
    cursor: [u32; 2],
    row_height: u32,
}

impl AtlasBuilder {
    /// The position, in texels, of the text's top left corner.
    fn place(&mut self, text: PanelText) -> [u32; 2] {
        if let Some(&place) = self.places.get(&text) {
            return place;
        }
        let [width, height] = text.size.map(|side| side + 2 * MARGIN);
        if self.cursor[0] + width > ATLAS_WIDTH {
            self.cursor = [0, self.cursor[1] + self.row_height];
            self.row_height = 0;
        }
        let place = self.cursor.map(|c| c + MARGIN);
        self.cursor[0] += width;
        self.row_height = self.row_height.max(height);
        self.places.insert(text, place);
        place
    }

    /// Leaves so much room below the texts so far that those to come are mixed with them at no level of detail.
    pub(super) fn leave_gap(&mut self) {
        let coarsest = 1 << (MIP_LEVELS - 1);
        self.cursor =
            [0, (self.cursor[1] + self.row_height).next_multiple_of(coarsest) + 4 * coarsest];
        self.row_height = 0;
    }

    /// The rectangle, in texels, that shows the text: left, top, right, bottom.
    pub(super) fn rect(&mut self, text: PanelText) -> [u32; 4] {
        let [width, height] = text.size;
        let [left, top] = self.place(text);
        [left, top, left + width, top + height]
    }

    /// Draws all requested texts.
    pub(super) fn draw(&self) -> Atlas {
        let height = (self.cursor[1] + self.row_height).next_power_of_two().max(64);
        let mut base = vec![0; (ATLAS_WIDTH * height) as usize];
        for (text, &[left, top]) in &self.places {
            let width = text.size[0] as usize;
            for (y, row) in coverage(text).chunks_exact(width).enumerate() {
                let at = (top as usize + y) * ATLAS_WIDTH as usize + left as usize;
                base[at..at + width].copy_from_slice(row);
            }
        }
        let mut levels = vec![base];
        for level in 1..MIP_LEVELS {
            let finer = &levels[level as usize - 1];
            levels.push(halved(finer, ATLAS_WIDTH >> (level - 1)));
        }
        Atlas { width: ATLAS_WIDTH, height, levels }
    }
}

/// The coverage values of a text, row by row: as large as its panel allows, centred, with thickened strokes.
fn coverage(text: &PanelText) -> Vec<u8> {
    let Ok(font) = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT) else {
        unreachable!("the font is compiled in and valid");
    };
    let [width, height] = text.size.map(|side| side as f32);
    // Upper-case letters take about 0.69 of the scale; descenders need some of what is below.
    let scale_y = height * 0.94;
    let natural = text_width(&font, &text.text, PxScale { x: scale_y, y: scale_y });
    let stroke = (scale_y * 0.028).max(0.8);
    let scale_x = scale_y * ((width * 0.94 - 2.0 * stroke) / natural).min(1.06);
    let scale = PxScale { x: scale_x, y: scale_y };
    let baseline = height * 0.755;
    let start = (width - text_width(&font, &text.text, scale)) / 2.0;

    let (w, h) = (text.size[0] as usize, text.size[1] as usize);
    let mut image = vec![0.0_f32; w * h];
    let scaled = font.as_scaled(scale);
    let mut x = start;
    for character in text.text.chars() {
        let glyph = font.glyph_id(character).with_scale_and_position(scale, point(x, baseline));
        x += scaled.h_advance(glyph.id);
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let bounds = outline.px_bounds();
        outline.draw(|px, py, coverage| {
            let (px, py) =
                (bounds.min.x as i64 + i64::from(px), bounds.min.y as i64 + i64::from(py));
            if (0..w as i64).contains(&px) && (0..h as i64).contains(&py) {
                let texel = &mut image[py as usize * w + px as usize];
                *texel = texel.max(coverage);
            }
        });
    }
    let thick = thickened(&image, w, stroke);
    thick.into_iter().map(|value| (value.min(1.0) * 255.0).round() as u8).collect()
}

fn text_width(font: &FontRef<'_>, text: &str, scale: PxScale) -> f32 {
    let scaled = font.as_scaled(scale);
    text.chars().map(|character| scaled.h_advance(font.glyph_id(character))).sum()
}

/// Gives every texel the strongest coverage within `radius`, weighted less towards the rim.
fn thickened(image: &[f32], width: usize, radius: f32) -> Vec<f32> {
    let height = image.len() / width;
    let reach = radius.ceil() as i64;
    let mut out = vec![0.0_f32; image.len()];
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let weight = (radius + 0.5 - (dx as f32).hypot(dy as f32)).clamp(0.0, 1.0);
            if weight == 0.0 {
                continue;
            }
            // In a row of each image, where the columns that correspond begin.
            let [from, to] = [-dx, dx].map(|columns| (columns.max(0) as usize).min(width));
            for y in dy.max(0)..(height as i64 + dy).min(height as i64) {
                let row = |y: i64| y as usize * width..(y as usize + 1) * width;
                let (source, target) = (&image[row(y - dy)][from..], &mut out[row(y)][to..]);
                for (target, source) in target.iter_mut().zip(source) {
                    *target = target.max(source * weight);
                }
            }
        }
    }
    out
}

/// The next coarser level of detail: the mean of four texels.
fn halved(finer: &[u8], width: u32) -> Vec<u8> {
    let width = width as usize;
    let mut out = Vec::with_capacity(finer.len() / 4);
    for rows in finer.chunks_exact(2 * width) {
        let (upper, lower) = rows.split_at(width);
        let (upper, lower) = (upper.as_chunks().0, lower.as_chunks().0);
        out.extend(upper.iter().zip(lower).map(|(&[a, b], &[c, d])| {
            let sum = u16::from(a) + u16::from(b) + u16::from(c) + u16::from(d);
            ((sum + 2) / 4) as u8
        }));
    }
    out
}
