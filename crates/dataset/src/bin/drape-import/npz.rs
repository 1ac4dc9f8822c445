//! `drape-import npz`.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail, ensure};
use drape_dataset::import::import_npz;
use drape_dataset::splits::Split;

/// Blender cloth exports: one .npz file a sequence.
#[derive(clap::Args)]
pub struct Arguments {
    /// The .npz files; each becomes a sequence of the same name.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Folder of the data set: made if missing; sequences are added to one that is there.
    #[arg(long)]
    out: PathBuf,
    /// Names of the sequences to hold out for testing; the others are for training.
    #[arg(long, num_args = 1.., value_name = "NAME")]
    test: Vec<String>,
}

pub fn run(Arguments { files, out, test }: &Arguments) -> Result<ExitCode> {
    let mut names = BTreeSet::new();
    for file in files {
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
    let mut index = crate::open_index(out)?;
    for file in files {
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
    crate::print_total(out, &index);
    Ok(ExitCode::SUCCESS)
}
