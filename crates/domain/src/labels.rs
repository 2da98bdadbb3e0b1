//! Where an episode starts, and in which variant of the world it takes place.

use crate::names::named;

named! {
    /// Where the episode starts.
    Start, "start" {
        /// Where the case's original demonstration starts.
        Original = "original",
        /// The case's test pose, which no demonstration starts from.
        New = "new",
    }

    /// Whether the warehouse is the one that was demonstrated.
    Route, "route" {
        /// As demonstrated.
        Unchanged = "unchanged",
        /// A passage that a demonstration used is closed by a barricade.
        Blocked = "blocked",
    }
}
