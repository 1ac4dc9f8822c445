//! `drape-import`: turns sequences of other programs into a drape data set.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::{Parser, Subcommand};
use drape_dataset::import::import_npz;
use drape_dataset::splits::{DatasetIndex, INDEX_FILE, Split};

/// Turns garment sequences that another program simulated into a drape data set.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    source: Source,
}

#[derive(Subcommand)]
enum Source {
    /// Blender cloth exports: one .npz file a sequence.
    Npz {
        /// The .npz files; each becomes a sequence of the same name.
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Folder of the data set: made if missing; sequences are added to one that is there.
        #[arg(long)]
        out: PathBuf,
        /// Names of the sequences to hold out for testing; the others are for training.
        #[arg(long, num_args = 1.., value_name = "NAME")]
        test: Vec<String>,
    },
}

fn main() -> Result<()> {
    let Source::Npz { files, out, test } = Arguments::parse().source;
    let mut names = BTreeSet::new();
    for file in &files {
        let name = file
            .file_stem()
            .context("an .npz file has a name")?
            .to_string_lossy();
        ensure!(
            names.insert(name.clone().into_owned()),
            "two files are called {name:?}"
        );
    }
    if let Some(unknown) = test.iter().find(|name| !names.contains(*name)) {
        let known = names.into_iter().collect::<Vec<_>>().join(", ");
        bail!("--test {unknown}: no such sequence; the files given are {known}");
    }
    fs::create_dir_all(&out)
        .with_context(|| format!("cannot make the folder {}", out.display()))?;
    let mut index = if out.join(INDEX_FILE).exists() {
        DatasetIndex::load(&out)?
    } else {
        let name = out
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        DatasetIndex::new(&out, name)
    };
    for file in &files {
        let imported = import_npz(file)?;
        let header = &imported.header;
        let name = format!("{}.mcap", header.name);
        imported.write(out.join(&name))?;
        let split = if test.contains(&header.name) {
            Split::Test
        } else {
            Split::Train
        };
        index.add(&name, split)?;
        // After each file: what is done stays done if a later file fails.
        index.save()?;
        let kinds: Vec<_> = header.garments.iter().map(|g| g.kind.to_string()).collect();
        println!(
            "{name}: {} frames, {}, split {split}",
            imported.frames.len(),
            kinds.join(" + ")
        );
        for warning in &header.scene.warnings {
            println!("  note: {warning}");
        }
    }
    println!(
        "{}: {} sequences, data hash {}",
        out.display(),
        index.sequences().len(),
        &index.data_hash()[..12]
    );
    Ok(())
}
