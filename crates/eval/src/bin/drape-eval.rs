//! `drape-eval`: rolls out every method on held-out sequences, prints the table
//! and writes it with its pictures.

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result};
use clap::Parser;
use drape_dataset::{
    registry::GarmentKind,
    splits::{DatasetIndex, Split},
};
use drape_eval::{
    EvalError,
    contest::{Entry, add_frames, add_note},
    engine::EngineSeries,
    floors::{Frozen, Hold, Skinned},
    layersnet::LayersNetMethod,
    pictures::{Strip, sheet},
    plot::error_against_time,
    table::{Conditions, Row, Table, console, csv, json, markdown},
    tally::Tally,
    task::Clip,
};
use drape_train::run::{RunFolder, write_atomic};
use indicatif::{ProgressBar, ProgressStyle};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Folder that holds runs.
const RUNS: &str = "runs";
/// The engine repeats so many sequences (four times each).
const ENGINE_SEQUENCES: usize = 2;
/// Contact sheets are drawn for so many different outfits.
const SHEETS: usize = 4;

/// Roll out trained models and floors on held-out sequences; print and write the table.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Run folders; several give one row each [default: the newest finished run in runs/]
    #[arg(long, num_args = 1.., value_name = "DIR")]
    run: Vec<PathBuf>,
    /// Data set [default: the one that the first run was trained on]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Which sequences: train, val or test
    #[arg(long, default_value_t = Split::Test, value_name = "SPLIT")]
    split: Split,
    /// Frames to predict in each sequence
    #[arg(long, default_value_t = 35, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    steps: u16,
    /// Last frame whose garments are given; at least 2
    #[arg(long, default_value_t = 2, value_name = "FRAME")]
    start: usize,
    /// Folder for the table and the pictures [default: eval/ in the first run's folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the engine at several substep counts (it takes longest)
    #[arg(long)]
    no_engine: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if matches!(error.downcast_ref(), Some(EvalError::Stopped)) => {
            eprintln!("stopped; nothing was written");
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let stop = stop_on_ctrl_c()?;
    let runs = match arguments.run.as_slice() {
        [] => vec![RunFolder::latest(Path::new(RUNS), Some(true))?],
        paths => paths
            .iter()
            .map(|path| RunFolder::open(path))
            .collect::<Result<_, _>>()?,
    };
    let data = match &arguments.data {
        Some(data) => data.clone(),
        None => runs[0].config()?.data,
    };
    let index = DatasetIndex::load(&data)?;
    let sequences = index.split(arguments.split)?;
    let steps = usize::from(arguments.steps);

    let mut entries = vec![
        Entry::new(Box::new(Hold::default())),
        Entry::new(Box::new(Frozen::default())),
        Entry::new(Box::new(Skinned::default())),
    ];
    // What the (first) network starts from: the rest is what it learnt.
    if let Some(trend) = LayersNetMethod::trend_of_run(&runs[0])? {
        entries.push(Entry::new(Box::new(trend)));
    }
    let floors = entries.len();
    for run in &runs {
        entries.push(Entry::new(Box::new(LayersNetMethod::from_run(run)?)));
    }
    let mut reference_tally = Tally::default();
    let mut engine = EngineSeries::default();
    let mut engine_left = if arguments.no_engine {
        0
    } else {
        ENGINE_SEQUENCES
    };
    let mut sheets = Vec::new();
    let mut outfits: Vec<&[GarmentKind]> = Vec::new();

    eprintln!(
        "{} sequences of {}, {} methods, {steps} frames each{}",
        sequences.len(),
        data.display(),
        entries.len(),
        if arguments.no_engine {
            ""
        } else {
            ", then the engine"
        }
    );
    let bar = progress_bar((sequences.len() * entries.len() * steps) as u64);
    let running = || {
        if stop.load(Ordering::Relaxed) {
            Err(EvalError::Stopped)
        } else {
            Ok(())
        }
    };
    for entry in &sequences {
        let (task, reference) = Clip::read(&index.open(entry)?, arguments.start, steps)?
            .split(arguments.start, steps)?;
        add_frames(&mut reference_tally, &task, &reference.frames, &reference);
        let mut predictions = Vec::new();
        for (number, method) in entries.iter_mut().enumerate() {
            bar.set_message(format!("{}, {}", task.header.name, method.name()));
            let after = bar.position() + steps as u64;
            let rollout = method.run(&task, &reference, &mut || {
                bar.inc(1);
                running()
            })?;
            bar.set_position(after);
            if number >= floors {
                predictions
                    .extend(rollout.map(|rollout| (method.name().to_owned(), rollout.frames)));
            }
        }
        if engine_left > 0 && EngineSeries::can_repeat(&task) {
            bar.set_message(format!(
                "{}, engine at four substep counts",
                task.header.name
            ));
            engine_left -= 1;
            engine.add(&task, &mut || {
                bar.tick();
                running()
            })?;
        }
        if sheets.len() < SHEETS && !outfits.contains(&entry.garments.as_slice()) {
            outfits.push(&entry.garments);
            let strips: Vec<Strip> = std::iter::once(Strip {
                label: "reference",
                frames: &reference.frames,
            })
            .chain(
                predictions
                    .iter()
                    .map(|(label, frames)| Strip { label, frames }),
            )
            .collect();
            sheets.push((task.header.name.clone(), sheet(&task, &strips)?));
        }
    }
    bar.finish_and_clear();

    let mut notes = Vec::new();
    let mut rows = vec![reference_row(&reference_tally, &engine, &mut notes)];
    rows.extend(entries.iter().map(|entry| entry.row(&mut notes)));
    let methods = rows.len();
    rows.extend(engine.rows(&mut notes));
    let table = Table {
        conditions: Conditions {
            data: data.display().to_string(),
            data_hash: index.data_hash(),
            split: arguments.split.name().to_owned(),
            sequences: sequences.len(),
            start: arguments.start,
            steps,
            notes,
        },
        rows,
    };
    println!("{}", console(&table));

    let out = arguments
        .out
        .clone()
        .unwrap_or_else(|| runs[0].path().join("eval"));
    write(&out, &table)?;
    // The reference is what errors are measured against, not a point among them.
    error_against_time(&table.rows[1..methods], &table.rows[methods..])?
        .write_png(&out.join("plot.png"))?;
    for (name, picture) in &sheets {
        picture.write_png(&out.join(format!("sheet_{name}.png")))?;
    }
    println!(
        "\nwritten to {}: table.md, table.csv, table.json, plot.png, {} contact sheet(s)",
        out.display(),
        sheets.len()
    );
    Ok(())
}

/// The recording itself: its collision rates, and what the engine takes for it.
fn reference_row(tally: &Tally, engine: &EngineSeries, notes: &mut Vec<String>) -> Row {
    let ms_per_frame = engine.recipe_ms();
    let note = match ms_per_frame {
        Some(_) => "time of the engine with the recording's own settings".to_owned(),
        None => "not timed: no engine here repeats these recordings, or --no-engine".to_owned(),
    };
    Row {
        method: "reference".to_owned(),
        threads: ms_per_frame.map(|_| 1),
        ms_per_frame,
        summary: Some(tally.summary()),
        note: Some(add_note(notes, note)),
    }
}

fn write(folder: &Path, table: &Table) -> Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let json = format!("{:#}\n", json(table));
    for (name, text) in [
        ("table.md", markdown(table)),
        ("table.csv", csv(table)),
        ("table.json", json),
    ] {
        let path = folder.join(name);
        write_atomic(&path, text.as_bytes())?;
    }
    Ok(())
}

fn stop_on_ctrl_c() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .context("cannot handle Ctrl-C")?;
    Ok(stop)
}

fn progress_bar(length: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {eta} left, {wide_msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style)
}
