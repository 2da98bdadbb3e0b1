//! How the world looks in frames: `--plates` and `--labels`.

use crate::names::named;

named! {
    /// Whether something that a person might not find in a warehouse is drawn.
    Drawn, "value" {
        /// Drawn.
        On = "on",
        /// Not drawn.
        Off = "off",
    }
}

#[expect(
    clippy::derivable_impls,
    reason = "the macro that declares it marks no member as the default"
)]
impl Default for Drawn {
    fn default() -> Self {
        Self::On
    }
}
