//! Views of any world of a run, one at a time.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use anyhow::{Context, Result, ensure};
use domain::{Mismatch, Pose};
use png_file::RgbaImage;
use warehouse::GREY_VARIANT;

use crate::renderer::{RenderSettings, Renderer, ViewSpec};
use crate::worlds::{WorldParts, Worlds};
use peer::world::GREY;

/// The worlds of a run, and their renderers: one for the tested hall, and one for the hall in which tasks are only
/// demonstrated.
pub struct ViewSource {
    worlds: Worlds,
    renderer: Renderer,
    elsewhere: Option<Renderer>,
    settings: RenderSettings,
    /// The renderers of other looks of the tested hall, opened by the first view.
    looks: BTreeMap<Mismatch, Renderer>,
    /// The last image, and what it shows.
    last: Option<(WorldParts, Pose, RgbaImage)>,
    grey: RgbaImage,
}

impl ViewSource {
    /// Opens the renderers.
    ///
    /// # Errors
    /// When there is no such adapter, or frames of this size cannot be rendered.
    pub fn new(worlds: Worlds, settings: RenderSettings) -> Result<Self> {
        let (stocks, other) = worlds.halls();
        let grey = RgbaImage::filled(settings.width_px, settings.height_px, GREY);
        let renderer = Renderer::with_stocks(stocks, settings.clone())?;
        let elsewhere = other.map(|other| Renderer::new(other, settings.clone())).transpose()?;
        let looks = BTreeMap::new();
        Ok(Self { worlds, renderer, elsewhere, settings, looks, last: None, grey })
    }

    /// Renders the view from `pose` in world variant `variant`; uniform grey for [`GREY_VARIANT`]. Variants that look the same from a pose are rendered once
    /// if they come one after another.
    ///
    /// # Errors
    /// When there is no such variant, the pose is not on free floor, or the device failed.
    pub fn render(&mut self, variant: u32, pose: Pose) -> Result<&RgbaImage> {
        let Self { worlds, renderer, elsewhere, settings, looks, last, grey } = self;
        if variant == GREY_VARIANT {
            return Ok(grey);
        }
        let world = worlds.variant(variant);
        let mut world = world.with_context(|| format!("there is no world variant {variant}"))?;
        let is_free = worlds.layout_of(world).is_free(pose.cell);
        ensure!(is_free, "the cell of pose {pose} is not free floor");
        let view = |world, stock| ViewSpec { pose, variant: worlds.closed(world), stock };
        let elsewhere =
            elsewhere.as_mut().filter(|_| world.stock as usize == worlds.halls().0.len());
        let renderer = match looks.entry(world.look) {
            _ if world.look == Mismatch::None => renderer,
            Entry::Occupied(open) => open.into_mut(),
            Entry::Vacant(missing) => {
                let (stocks, settings) = (worlds.halls().0, settings.with_mismatch(world.look));
                missing.insert(Renderer::new(&stocks[0], settings)?)
            }
        };
        if elsewhere.is_none() {
            world = world.as_seen(renderer.changes(view(world, world.stock)));
        }
        let shown = last.take_if(|(of, from, _)| (*of, *from) == (world, pose));
        let shown = match (shown, elsewhere) {
            (Some(shown), _) => shown,
            (None, Some(other)) => (world, pose, other.render_image(view(world, 0))?),
            (None, None) => (world, pose, renderer.render_image(view(world, world.stock))?),
        };
        Ok(&last.insert(shown).2)
    }
}

#[cfg(test)]
mod tests {
    use case_book::CaseVariant;
    use domain::Heading;
    use warehouse::{CaseSet, Warehouse};

    use super::*;
    use crate::renderer::Backend;

    #[test]
    fn every_mismatch_is_visible_and_its_own() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let settings = RenderSettings {
            width_px: 128,
            height_px: 128,
            backend: Some(Backend::Cpu),
            ..RenderSettings::default()
        };
        let seen: Vec<Mismatch> =
            Mismatch::ALL.iter().copied().filter(|mismatch| mismatch.changes_world()).collect();
        let worlds = Worlds::new(&warehouse, &cases, Vec::new(), &seen);
        let mut views = ViewSource::new(worlds, settings).unwrap();
        // Beside a rack with items that no task of the first case is about.
        let of_task = cases.cases[0].task.targets(&warehouse);
        let other = warehouse.items.iter().find(|item| {
            let category = warehouse.category_of(item);
            of_task.iter().all(|target| warehouse.category_of(target) != category)
        });
        let other = other.unwrap();
        let pose = Pose { cell: other.standpoint, heading: other.face.opposite() };
        let of = |mismatch| CaseVariant { case: 0, is_blocked: false, mismatch }.number();
        let mut image = |variant| views.render(variant, pose).unwrap().clone();
        let usual = image(0);
        let mut known = vec![usual.clone()];
        for &mismatch in &seen {
            let found = image(of(mismatch));
            assert!(!known.contains(&found), "{mismatch}");
            assert_eq!(image(0), usual, "after {mismatch}");
            known.push(found);
        }
        assert!(views.render(of(Mismatch::None) + 7000, pose).is_err());
    }

    #[test]
    fn a_view_does_not_depend_on_the_one_before() {
        let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let settings = RenderSettings {
            width_px: 64,
            height_px: 64,
            backend: Some(Backend::Cpu),
            ..RenderSettings::default()
        };
        let worlds = Worlds::new(&warehouse, &cases, Vec::new(), &[]);
        let mut views = ViewSource::new(worlds, settings).unwrap();
        let case = &cases.cases[0];
        let closed = case.barricade[0];
        // A pose that looks at the barricade of the first case, and one that does not.
        let before = Heading::ALL.into_iter().find_map(|heading| {
            let cell = closed.step(heading.opposite())?;
            warehouse.layout.is_free(cell).then(|| Pose::new(cell.x, cell.y, heading))
        });
        let before = before.unwrap();
        let mut image = |variant, pose| views.render(variant, pose).unwrap().clone();
        let away = Pose { heading: before.heading.opposite(), ..before };
        let seen = [(0, before), (1, before), (0, away), (1, away)].map(|(v, p)| image(v, p));
        assert_ne!(seen[0], seen[1]);
        assert_eq!(seen[2], seen[3]);
        assert_ne!(seen[0], seen[2]);
        let again = [(1, away), (0, away), (1, before), (0, before)].map(|(v, p)| image(v, p));
        assert!(again.iter().eq(seen.iter().rev()));
        assert!(image(GREY_VARIANT, before).pixels().all(|pixel| pixel == GREY));
    }
}
