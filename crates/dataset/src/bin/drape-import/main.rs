//! `drape-import`: turns sequences of other programs into a drape data set.

mod d_layers;
mod npz;

use std::fs;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use drape_dataset::splits::{DatasetIndex, INDEX_FILE};

/// Turns garment sequences that another program simulated into a drape data set.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    source: Source,
}

#[derive(Subcommand)]
enum Source {
    Npz(npz::Arguments),
    DLayers(d_layers::Arguments),
}

fn main() -> ExitCode {
    let done = match Arguments::parse().source {
        Source::Npz(arguments) => npz::run(&arguments),
        Source::DLayers(arguments) => d_layers::run(&arguments),
    };
    done.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}

/// The index of the data set in `out`, which is made if missing.
fn open_index(out: &Path) -> Result<DatasetIndex> {
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    if out.join(INDEX_FILE).exists() {
        return Ok(DatasetIndex::load(out)?);
    }
    let name = out.file_name().unwrap_or_default().to_string_lossy();
    Ok(DatasetIndex::new(out, name.into_owned()))
}

/// The last line: what is in the data set.
fn print_total(out: &Path, index: &DatasetIndex) {
    println!(
        "{}: {} sequences, data hash {}",
        out.display(),
        index.sequences().len(),
        &index.data_hash()[..12]
    );
}
