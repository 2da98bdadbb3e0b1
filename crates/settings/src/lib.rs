//! What a run is asked to do: sources of settings, resolved once into a `RunSettings`.
//!
//! Every entry of the table of settings ([`KEYS`]) is a flag of `memtransfer run`, a `MEMTRANSFER_*` variable and a key of a
//! suite file. A [`Layer`] holds what one source says, its values
//! checked against the table, so a message can name the source. [`resolve`] merges the layers (defaults <
//! suite < environment < command line) and checks what concerns several settings.

mod cases;
mod layer;
mod resolve;
mod suite;

pub use cases::{cases_of_run, select_cases};
pub use conditions::settings::{KEYS, Key, MAX_IMAGES};
pub use layer::{Layer, Origin, variable};
pub use resolve::{Resolved, check, check_values, commands, on_this_machine, resolve};
pub use suite::{SHIPPED_SUITES, load_suite};
