//! `memtransfer._native`: what the Python package needs of the Rust crates.
//!
//! The package itself is in `memtransfer/`: plain data classes, the policy interface and the data frames. This
//! crate serves a Python policy or memory (`serve`), gives numpy the frames in shared memory (`frame`), renders prompts
//! and reads answers (`prompt`), reads a run's folder (`results`) and its trajectories (`recorded_run`), steps the Gymnasium
//! environment (`lanes`), and serves a world of one's own (`world`).

mod classes;
mod declaration;
mod exchange;
mod frame;
mod lanes;
mod logging;
mod memory;
mod policy;
mod prompt;
mod query;
mod raised;
mod recorded_run;
mod results;
mod serve;
mod step;
mod world;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::declaration::warehouse_declaration;
    #[pymodule_export]
    use crate::frame::{Frame, SharedPixels};
    #[pymodule_export]
    use crate::lanes::Lanes;
    #[pymodule_export]
    use crate::prompt::{image_name, png, read_answer, render, settings, template, version};
    #[pymodule_export]
    use crate::query::{MemoryStep, Numbers};
    #[pymodule_export]
    use crate::recorded_run::RecordedRun;
    #[pymodule_export]
    use crate::results::read_run;
    #[pymodule_export]
    use crate::serve::{serve, serve_memory};
    #[pymodule_export]
    use crate::step::Step;
    #[pymodule_export]
    use crate::world::{WritablePixels, world_main};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::logging::forward_to_python();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
