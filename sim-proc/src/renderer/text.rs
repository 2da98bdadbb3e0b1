//! Lettering: every text of the scene drawn once into an atlas of coverage values.
//!
//! The font is Ubuntu Light out of `epaint_default_fonts`; a stroke of its weight vanishes at a few
//! metres, so letters are thickened after they are drawn.

use std::collections::BTreeMap;

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};

/// Width of the atlas in texels; it grows in height.
const ATLAS_WIDTH: u32 = 2048;

/// Levels of detail, the full picture included.
pub(super) const MIP_LEVELS: u32 = 6;

/// Empty texels around every text, so that coarse levels of detail do not mix neighbours.
const MARGIN: u32 = 8;

/// A text's rectangle in the atlas, as shares of the atlas: left, top, right, bottom.
pub(super) type AtlasRect = [f32; 4];

/// A text with the panel it is meant for.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Lettering {
    /// What is written, on one line.
    pub(super) text: String,
    /// Size of the panel's picture in texels; the text is fitted into it.
    pub(super) size: [u32; 2],
}

/// The texts asked for so far and their places.
#[derive(Default)]
pub(super) struct AtlasPlan {
    places: BTreeMap<Lettering, [u32; 2]>,
    cursor: [u32; 2],
    row_height: u32,
}

/// Finished coverage values, one byte a texel, for every level of detail.
pub(super) struct Atlas {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) levels: Vec<Vec<u8>>,
}

impl AtlasPlan {
    /// The place, in texels, of `lettering`'s top left corner.
    fn place(&mut self, lettering: Lettering) -> [u32; 2] {
        if let Some(&place) = self.places.get(&lettering) {
            return place;
        }
        let [width, height] = lettering.size.map(|side| side + 2 * MARGIN);
        if self.cursor[0] + width > ATLAS_WIDTH {
            self.cursor = [0, self.cursor[1] + self.row_height];
            self.row_height = 0;
        }
        let place = self.cursor.map(|c| c + MARGIN);
        self.cursor[0] += width;
        self.row_height = self.row_height.max(height);
        self.places.insert(lettering, place);
        place
    }

    /// The rectangle, in texels, that shows `lettering`: left, top, right, bottom.
    pub(super) fn rect(&mut self, lettering: Lettering) -> [u32; 4] {
        let [width, height] = lettering.size;
        let [left, top] = self.place(lettering);
        [left, top, left + width, top + height]
    }

    /// Draws everything that was asked for.
    pub(super) fn draw(&self) -> Atlas {
        let height = (self.cursor[1] + self.row_height).next_power_of_two().max(64);
        let mut base = vec![0; (ATLAS_WIDTH * height) as usize];
        for (lettering, &[left, top]) in &self.places {
            let width = lettering.size[0] as usize;
            for (y, row) in coverage(lettering).chunks_exact(width).enumerate() {
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

impl Atlas {
    /// A rectangle of texels as shares of the atlas.
    pub(super) fn share(&self, [left, top, right, bottom]: [u32; 4]) -> AtlasRect {
        let (w, h) = (self.width as f32, self.height as f32);
        [left as f32 / w, top as f32 / h, right as f32 / w, bottom as f32 / h]
    }
}

/// One text as coverage values, row by row: as large as its panel allows, centred, with thickened
/// strokes.
pub(super) fn coverage(lettering: &Lettering) -> Vec<u8> {
    let Ok(font) = FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT) else {
        unreachable!("the font that is compiled in can be read");
    };
    let [width, height] = lettering.size.map(|side| side as f32);
    // Upper-case letters take about 0.69 of the scale; descenders need some of what is below.
    let scale_y = height * 0.94;
    let natural = text_width(&font, &lettering.text, PxScale { x: scale_y, y: scale_y });
    let stroke = (scale_y * 0.028).max(0.8);
    let scale_x = scale_y * ((width * 0.94 - 2.0 * stroke) / natural).min(1.06);
    let scale = PxScale { x: scale_x, y: scale_y };
    let baseline = height * 0.755;
    let start = (width - text_width(&font, &lettering.text, scale)) / 2.0;

    let (w, h) = (lettering.size[0] as usize, lettering.size[1] as usize);
    let mut picture = vec![0.0_f32; w * h];
    let scaled = font.as_scaled(scale);
    let mut x = start;
    for character in lettering.text.chars() {
        let glyph = font.glyph_id(character).with_scale_and_position(scale, point(x, baseline));
        x += scaled.h_advance(glyph.id);
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let bounds = outline.px_bounds();
        outline.draw(|px, py, coverage| {
            let (px, py) =
                (bounds.min.x as i64 + i64::from(px), bounds.min.y as i64 + i64::from(py));
            if (0..w as i64).contains(&px) && (0..h as i64).contains(&py) {
                let texel = &mut picture[py as usize * w + px as usize];
                *texel = texel.max(coverage);
            }
        });
    }
    let thick = thickened(&picture, w, stroke);
    thick.into_iter().map(|value| (value.min(1.0) * 255.0).round() as u8).collect()
}

fn text_width(font: &FontRef<'_>, text: &str, scale: PxScale) -> f32 {
    let scaled = font.as_scaled(scale);
    text.chars().map(|character| scaled.h_advance(font.glyph_id(character))).sum()
}

/// Every texel takes the strongest coverage within `radius`, weaker towards the rim.
fn thickened(picture: &[f32], width: usize, radius: f32) -> Vec<f32> {
    let height = picture.len() / width;
    let reach = radius.ceil() as i64;
    let mut out = vec![0.0_f32; picture.len()];
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let weight = (radius + 0.5 - (dx as f32).hypot(dy as f32)).clamp(0.0, 1.0);
            if weight == 0.0 {
                continue;
            }
            for y in dy.max(0)..(height as i64 + dy).min(height as i64) {
                for x in dx.max(0)..(width as i64 + dx).min(width as i64) {
                    let from = (y - dy) as usize * width + (x - dx) as usize;
                    let to = y as usize * width + x as usize;
                    out[to] = out[to].max(picture[from] * weight);
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
        for (a, b) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
            let sum: u32 = a.iter().chain(b).map(|&v| u32::from(v)).sum();
            out.push(((sum + 2) / 4) as u8);
        }
    }
    out
}
