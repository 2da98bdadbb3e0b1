//! What an episode differs in from the demonstrations, beside its start and its route.

use crate::names::named;

named! {
    /// What an episode differs in from the demonstrations, beside its start and its route. Demonstrations are always as they
    /// were recorded. What each means in the warehouse is in the specification, section 6.
    #[derive(Default)]
    Mismatch, "mismatch" {
        /// Nothing.
        #[default]
        None = "none",
        /// The light and the tints.
        Light = "light",
        /// Nothing is written in the world.
        Labels = "labels",
        /// The height of the camera.
        CameraHeight = "camera-height",
        /// The camera's field of view.
        FieldOfView = "field-of-view",
        /// The words of the instruction.
        Wording = "wording",
        /// Where things are that the task is not about.
        Stock = "stock",
    }
}

impl Mismatch {
    /// Whether it changes the world. The words of an instruction do not.
    pub const fn changes_world(self) -> bool {
        match self {
            Self::None | Self::Wording => false,
            Self::Light | Self::Labels | Self::CameraHeight | Self::FieldOfView | Self::Stock => {
                true
            }
        }
    }
}
