//! Pictures of the whole catalogue: every type from near to far, as the agent's camera has it.

use image::RgbaImage;
use warehouse::Warehouse;

use super::camera::Camera;
use super::scene::showcase;
use super::text::{Lettering, coverage};
use super::visibility::{DrawList, Sight, Triangles};
use super::{Picture, RenderError, RenderSettings, Renderer};

/// Writes `text` on one line into the rectangle of `size` pixels whose top left corner is at `place`, as
/// large as fits, in the renderer's own lettering.
pub fn write(image: &mut RgbaImage, place: [u32; 2], size: [u32; 2], text: &str, ink: [u8; 3]) {
    let coverage = coverage(&Lettering { text: text.to_owned(), size });
    for (i, share) in (0..).zip(coverage) {
        let pixel = image.get_pixel_mut(place[0] + i % size[0], place[1] + i / size[0]);
        for (channel, ink) in pixel.0.iter_mut().zip(ink) {
            let (from, to, share) = (f32::from(*channel), f32::from(ink), f32::from(share) / 255.0);
            *channel = (from + (to - from) * share).round() as u8;
        }
    }
}

/// A type of the catalogue in pictures.
pub struct Exhibit {
    /// The type's name.
    pub name: String,
    /// One picture for each distance asked for.
    pub pictures: Vec<RgbaImage>,
}

/// Pictures of every type of the catalogue, looked at from `distances_m` metres in front of its face.
///
/// # Errors
/// As [`Renderer::new`] and [`Renderer::render`].
pub fn exhibits(
    warehouse: &Warehouse,
    settings: RenderSettings,
    distances_m: &[f32],
) -> Result<Vec<Exhibit>, RenderError> {
    let (scene, stands) = showcase(&warehouse.catalogue);
    let (width_px, height_px) = (settings.width_px, settings.height_px);
    let mut renderer = Renderer::of_scene(scene, warehouse.layout.clone(), settings)?;
    let mut exhibits = Vec::new();
    for (kind, stand) in warehouse.catalogue.types.iter().zip(stands) {
        let mut pictures = Vec::new();
        for distance in distances_m {
            let (back_x, back_y) = stand.viewer.opposite().vector();
            let at = [
                stand.at[0] + distance * f32::from(back_x),
                stand.at[1] + distance * f32::from(back_y),
            ];
            let camera = Camera::at(at, stand.viewer, width_px, height_px);
            let scene = renderer.lookout.scene();
            let visible = Sight::new(scene, &camera).objects;
            let list = DrawList::new(scene, &camera, &visible, Triangles::Facing);
            let picture = Picture { camera, list, barricades: Vec::new() };
            pictures.push(renderer.draw_image(picture)?);
        }
        exhibits.push(Exhibit { name: kind.name.clone(), pictures });
    }
    Ok(exhibits)
}
