//! The extension module `wad_cosim._native`: environments on threads of their own, and what travels with them.
//!
//! Python's half (`python/wad_cosim`) knows Gymnasium and speaks to users; this half knows the simulator. A
//! thread drives each environment, so that signals are heard during long resets, and many environments run at once;
//! Python's own thread drives the first one's ticks, with Python's lock free meanwhile.

mod collection;
mod curriculum;
mod environments;
mod episode;
mod errors;
mod evaluation;
mod held;
mod info;
mod setup;
mod worker;

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;

/// The module.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    wad_cosim::register_bundled();
    // NumPy's interface is looked up at its first use, where Ctrl-C would be a panic: here, not in a training's save.
    PyArray1::<f32>::zeros(module.py(), 0, false).readonly();
    errors::add(module)?;
    module.add("VERSION", wad_cosim::program::version())?;
    module.add("DEFAULT_DETECTOR", wad_cosim::perception::DEFAULT_DETECTOR)?;
    module.add("NUMBERS", episode::NUMBERS.to_vec())?;
    module.add("WHOLE", episode::WHOLE.map(|index| episode::NUMBERS[index]).to_vec())?;
    module.add("RAW_SIZE", wad_cosim::observation::RAW_SIZE)?;
    module.add("LATENT_SIZE", wad_cosim::observation::LATENT_SIZE)?;
    module.add("VECTOR_SIZE", setup::VECTOR_SIZE)?;
    module.add("TRANSFORMED_SIZE", wad_cosim::perception::TRANSFORMED_SIZE)?;
    module.add_class::<environments::Environments>()?;
    module.add_class::<collection::Collection>()?;
    module.add_class::<collection::Collector>()?;
    module.add_class::<evaluation::LoadedAgent>()?;
    module.add_class::<evaluation::Ledger>()?;
    module.add_class::<evaluation::Worker>()?;
    module.add_function(wrap_pyfunction!(setup::bench, module)?)?;
    module.add_function(wrap_pyfunction!(info::info_of, module)?)?;
    module.add_function(wrap_pyfunction!(setup::names, module)?)?;
    module.add_function(wrap_pyfunction!(setup::suites, module)?)?;
    module.add_function(wrap_pyfunction!(curriculum::check_curriculum, module)?)?;
    module.add_function(wrap_pyfunction!(curriculum::note_episode, module)?)?;
    module.add_function(wrap_pyfunction!(evaluation::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(evaluation::report_of, module)?)?;
    module.add_function(wrap_pyfunction!(evaluation::save_agent, module)?)?;
    module.add_function(wrap_pyfunction!(setup::use_sumo, module)?)?;
    module.add_function(wrap_pyfunction!(setup::use_openvino, module)?)?;
    Ok(())
}
