//! The contact sheet: the whole catalogue on one picture, as the agent's camera has it from 1, 2.5 and
//! 4 metres, pixel for pixel.

use anyhow::Result;
use image::{Rgba, RgbaImage, imageops};
use warehouse::Warehouse;

use crate::renderer::{Exhibit, RenderSettings, exhibits, write};

/// From how far the pictures are taken, in metres: the first is shown large, the others beside it.
const DISTANCES_M: [f32; 3] = [1.0, 2.5, 4.0];

const LARGE_PX: u32 = 256;
const SMALL_PX: u32 = 128;
const GAP_PX: u32 = 8;
const CAPTION_PX: u32 = 30;
const COLUMNS: u32 = 6;

/// Draws the sheet.
///
/// # Errors
/// No Vulkan driver, or a device that failed.
pub fn contact_sheet(warehouse: &Warehouse, settings: RenderSettings) -> Result<RgbaImage> {
    let exhibits = exhibits(warehouse, settings, &DISTANCES_M)?;
    let tile = [LARGE_PX + SMALL_PX + GAP_PX, LARGE_PX + CAPTION_PX + GAP_PX];
    let rows = (exhibits.len() as u32).div_ceil(COLUMNS);
    let mut sheet = RgbaImage::from_pixel(
        COLUMNS * tile[0] + GAP_PX,
        rows * tile[1] + GAP_PX,
        Rgba([246, 246, 244, 255]),
    );
    for (index, exhibit) in (0..).zip(&exhibits) {
        let left = GAP_PX + index % COLUMNS * tile[0];
        let top = GAP_PX + index / COLUMNS * tile[1];
        place(&mut sheet, [left, top], exhibit);
    }
    Ok(sheet)
}

fn place(sheet: &mut RgbaImage, [left, top]: [u32; 2], exhibit: &Exhibit) {
    let caption = [LARGE_PX + SMALL_PX, CAPTION_PX];
    write(sheet, [left, top], caption, &exhibit.name, [30, 34, 40]);
    let top = top + CAPTION_PX;
    let places = [
        (left, top, LARGE_PX),
        (left + LARGE_PX, top, SMALL_PX),
        (left + LARGE_PX, top + SMALL_PX, SMALL_PX),
    ];
    for (picture, (x, y, side)) in exhibit.pictures.iter().zip(places) {
        let (width, height) = picture.dimensions();
        let (cut_x, cut_y) = (width.saturating_sub(side) / 2, height.saturating_sub(side) / 2);
        let cut = imageops::crop_imm(picture, cut_x, cut_y, side, side).to_image();
        imageops::replace(sheet, &cut, i64::from(x), i64::from(y));
    }
}
