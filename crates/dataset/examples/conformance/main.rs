//! Writes the conformance files of the format: `FILE.mcap` and beside it
//! `FILE.json`, what a reader must find in it.
//!
//! ```sh
//! cargo run --release -p drape-dataset --example conformance -- data-spec/conformance
//! ```
//!
//! The files are part of the format's text: run this only when a case was added or
//! when the version moved, and look at the difference. The test `conformance` makes
//! them again and compares.

mod cases;
mod json;

use std::path::PathBuf;
use std::{env, error::Error, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(env::args().nth(1).ok_or("usage: conformance FOLDER")?);
    for case in cases::all() {
        let path = folder.join(case.name).with_extension("mcap");
        fs::write(&path, &case.bytes)?;
        fs::write(path.with_extension("json"), json::text(&case.expected))?;
        println!("{}: {} bytes", path.display(), case.bytes.len());
    }
    Ok(())
}
