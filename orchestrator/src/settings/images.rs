//! Whether a request can hold the images that settings ask for (SPEC section 5).

use domain::representation::Trajectories;
use results::conditions::Condition;
use results::settings::RunSettings;

/// Most images of a prompt (paper, Experimental Setup).
pub const MAX_IMAGES: u32 = 50;

/// Settings under which a request could hold more than [`MAX_IMAGES`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "a request under {condition} may need {images} images (the current view, {window} of the window, \
     {remembered} remembered), and a prompt holds at most {MAX_IMAGES}: lower --window or {flag}"
)]
pub struct TooManyImages {
    condition: Condition,
    images: u32,
    window: u32,
    remembered: u32,
    flag: &'static str,
}

/// Whether the requests of every condition fit into a prompt. A policy that has a budget for images leaves
/// out what does not fit, and counts it.
///
/// # Errors
/// For the first condition whose requests might not.
pub(super) fn check_images(settings: &RunSettings) -> Result<(), TooManyImages> {
    let unbounded = if settings.model.is_some() { Vec::new() } else { settings.conditions() };
    for condition in unbounded {
        let (images, window) = (settings.images(&condition), condition.variation.window);
        if images > MAX_IMAGES {
            let flag = match condition.memory.describe().trajectories {
                Trajectories::Segment => "--horizon",
                Trajectories::Whole | Trajectories::Nothing => "--keyframes",
            };
            let remembered = images - 1 - window;
            return Err(TooManyImages { condition, images, window, remembered, flag });
        }
    }
    Ok(())
}
