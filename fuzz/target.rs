//! One program for each target of `tests/it/fuzz/targets.rs`, under libFuzzer: the program's name is the target's.

#![no_main]

#[path = "../tests/it/fuzz/memory.rs"]
mod memory;
#[path = "../tests/it/fuzz/targets.rs"]
mod targets;

use libfuzzer_sys::fuzz_target;
use targets::Target;

thread_local! {
    static TARGET: Target = Target::new(env!("CARGO_BIN_NAME"), concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
}

fuzz_target!(|input: &[u8]| {
    TARGET.with(|target| target.check(input).unwrap_or_else(|why| panic!("{why}")));
});
