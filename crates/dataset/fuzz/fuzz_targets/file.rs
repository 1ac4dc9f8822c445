//! Any bytes: an error or a sound sequence, never a panic, never much memory.
//!
//! ```sh
//! cd crates/dataset && cargo +nightly fuzz run file -- -max_total_time=600 -malloc_limit_mb=512
//! ```
//!
//! An input that broke something goes to `corpus/file` when it is mended; the test
//! `fuzz_corpus` replays that folder on the stable compiler.

#![no_main]

#[path = "../harness.rs"]
mod harness;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    harness::run(input);
});
