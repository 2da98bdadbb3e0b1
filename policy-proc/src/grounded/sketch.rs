//! A picture in a few numbers: enough to tell whether two views show the same place.

use crate::FrameView;

/// Fields across and down.
const SIDE: usize = 28;

/// Least spread of brightness, in levels of 255, of a picture that shows anything. A picture without
/// texture looks like every other one, so it is like none.
const LEAST_SPREAD: f32 = 4.0;

/// Largest mean difference of brightness, in levels of 255, of two pictures of the same place. A step
/// along an aisle changes a view about three times as much.
const LARGEST_DIFFERENCE: f32 = 1.75;

/// Mean brightness of a picture in 28 x 28 fields.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sketch {
    fields: Box<[u8; SIDE * SIDE]>,
    has_texture: bool,
}

impl Sketch {
    /// The sketch of `frame`; a frame whose bytes do not make a picture has no texture.
    pub(super) fn of(frame: &FrameView<'_>) -> Self {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let mut fields = Box::new([0; SIDE * SIDE]);
        if width < SIDE || height < SIDE || frame.pixels.len() != 4 * width * height {
            return Self { fields, has_texture: false };
        }
        for (row, fields) in fields.chunks_exact_mut(SIDE).enumerate() {
            let edge = |part: usize, whole: usize| part * whole / SIDE;
            let mut sums = [0_u32; SIDE];
            // Every other row says as much as all of them.
            let rows = (edge(row, height)..edge(row + 1, height)).step_by(2);
            for y in rows.clone() {
                let pixels = &frame.pixels[4 * width * y..][..4 * width];
                for (column, sum) in sums.iter_mut().enumerate() {
                    let field = &pixels[4 * edge(column, width)..4 * edge(column + 1, width)];
                    *sum += field.chunks_exact(4).map(brightness).sum::<u32>();
                }
            }
            for (column, (field, sum)) in fields.iter_mut().zip(sums).enumerate() {
                let across = edge(column + 1, width) - edge(column, width);
                *field = (sum / (8 * (across * rows.len()) as u32)) as u8;
            }
        }
        let count = fields.len() as f32;
        let mean = fields.iter().map(|&field| f32::from(field)).sum::<f32>() / count;
        let square = |&field: &u8| (f32::from(field) - mean).powi(2);
        let spread = (fields.iter().map(square).sum::<f32>() / count).sqrt();
        Self { fields, has_texture: spread >= LEAST_SPREAD }
    }

    /// Whether the picture shows anything.
    pub(super) fn has_texture(&self) -> bool {
        self.has_texture
    }

    /// Whether both show something, and the same.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let difference: u32 = self
            .fields
            .iter()
            .zip(other.fields.iter())
            .map(|(&a, &b)| u32::from(a.abs_diff(b)))
            .sum();
        let mean = difference as f32 / (SIDE * SIDE) as f32;
        self.has_texture && other.has_texture && mean <= LARGEST_DIFFERENCE
    }
}

/// Eight times the brightness of a pixel, roughly as an eye weighs colours.
fn brightness(pixel: &[u8]) -> u32 {
    2 * u32::from(pixel[0]) + 5 * u32::from(pixel[1]) + u32::from(pixel[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grounded::testing::view;
    use plates::painter::Picture;

    fn grey(level: u8) -> Sketch {
        Sketch::of(&FrameView {
            id: 1,
            width: 64,
            height: 64,
            pixels: &[level; 64 * 64 * 4],
            ..FrameView::NONE
        })
    }

    #[test]
    fn a_picture_is_like_itself_and_unlike_others() {
        let sketch = |seed| Sketch::of(&view(&Picture::background(448, seed), 1));
        assert!(sketch(1).is_like(&sketch(1)));
        assert!(!sketch(1).is_like(&sketch(2)));
    }

    #[test]
    fn a_blank_picture_is_like_nothing() {
        assert!(!grey(128).is_like(&grey(128)));
        assert!(!grey(128).is_like(&Sketch::of(&view(&Picture::background(448, 1), 1))));
    }

    #[test]
    fn fields_hold_the_mean_brightness() {
        assert!(grey(200).fields.iter().all(|&field| field == 200));
        let broken = FrameView {
            id: 1,
            width: 64,
            height: 65,
            pixels: &[9; 64 * 64 * 4],
            ..FrameView::NONE
        };
        assert!(!Sketch::of(&broken).has_texture);
    }
}
