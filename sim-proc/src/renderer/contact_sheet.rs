//! The contact sheet: the whole catalogue in one image, as the agent's camera sees each type from 1, 2.5 and 4 metres,
//! pixel for pixel.

use anyhow::Result;
use png_file::RgbaImage;
use raster::PreparedView;
use warehouse::Warehouse;

use super::camera::Camera;
use super::scene::{ItemStand, catalogue_scene};
use super::text::{PanelText, coverage};
use super::visibility::{Triangles, VisibleSet, draw_list};
use super::{RenderSettings, Renderer};

/// Distances between camera and item, in metres. The first image is shown large, the others beside it.
const DISTANCES_M: [f32; 3] = [1.0, 2.5, 4.0];

const LARGE_PX: u32 = 256;
const SMALL_PX: u32 = 128;
const GAP_PX: u32 = 8;
const CAPTION_PX: u32 = 30;
const COLUMNS: u32 = 6;

const PAPER: [u8; 4] = [246, 246, 244, 255];
const INK: [u8; 3] = [30, 34, 40];

/// Draws the sheet.
///
/// # Errors
/// As [`Renderer::new`] and [`Renderer::render`].
pub fn contact_sheet(warehouse: &Warehouse, settings: RenderSettings) -> Result<RgbaImage> {
    let types = &warehouse.catalogue.types;
    let (scene, stands) = catalogue_scene(&warehouse.catalogue, settings.appearance);
    let mut renderer = Renderer::of_scene(scene, warehouse.layout.clone(), settings)?;
    let tile = [LARGE_PX + SMALL_PX + GAP_PX, LARGE_PX + CAPTION_PX + GAP_PX];
    let rows = (types.len() as u32).div_ceil(COLUMNS);
    let mut sheet = RgbaImage::filled(COLUMNS * tile[0] + GAP_PX, rows * tile[1] + GAP_PX, PAPER);
    for (index, (kind, stand)) in (0..).zip(types.iter().zip(stands)) {
        let left = GAP_PX + index % COLUMNS * tile[0];
        let top = GAP_PX + index / COLUMNS * tile[1];
        let caption =
            PanelText { text: kind.name.clone(), size: [LARGE_PX + SMALL_PX, CAPTION_PX] };
        write_text(&mut sheet, [left, top], &caption);
        let top = top + CAPTION_PX;
        let places = [
            (left, top, LARGE_PX),
            (left + LARGE_PX, top, SMALL_PX),
            (left + LARGE_PX, top + SMALL_PX, SMALL_PX),
        ];
        for (distance_m, (x, y, side)) in DISTANCES_M.into_iter().zip(places) {
            sheet.paste(&centre(&item_image(&mut renderer, stand, distance_m)?, side), x, y);
        }
    }
    Ok(sheet)
}

/// Renders the item at `stand` from `distance_m` metres in front of its face.
fn item_image(renderer: &mut Renderer, stand: ItemStand, distance_m: f32) -> Result<RgbaImage> {
    let (back_x, back_y) = stand.viewer.opposite().vector();
    let at = [
        stand.at[0] + distance_m * f32::from(back_x),
        stand.at[1] + distance_m * f32::from(back_y),
    ];
    let RenderSettings { width_px, height_px, .. } = renderer.settings;
    let camera = Camera::at(at, stand.viewer, width_px, height_px);
    let scene = renderer.visibility.scene();
    let visible = VisibleSet::new(scene, &scene.stocks[0], &camera).objects;
    let list = draw_list(scene, &camera, &visible, Triangles::Facing);
    let clip_from_world = camera.clip_from_world().into();
    renderer.draw_image(PreparedView { clip_from_world, list, barricades: Vec::new() })
}

/// The square of this side in the middle of `image`, or as much of it as there is.
fn centre(image: &RgbaImage, side: u32) -> RgbaImage {
    let [width, height] = [image.width(), image.height()];
    let [x, y] = [width.saturating_sub(side) / 2, height.saturating_sub(side) / 2];
    image.crop(x, y, side.min(width), side.min(height))
}

/// Writes `text` with its top left corner at (`x`, `y`).
fn write_text(image: &mut RgbaImage, [x, y]: [u32; 2], text: &PanelText) {
    for (i, share) in (0..).zip(coverage(text)) {
        let pixel = image.pixel_mut(x + i % text.size[0], y + i / text.size[0]);
        for (channel, ink) in pixel.iter_mut().zip(INK) {
            let (from, to, share) = (f32::from(*channel), f32::from(ink), f32::from(share) / 255.0);
            *channel = (from + (to - from) * share).round() as u8;
        }
    }
}
