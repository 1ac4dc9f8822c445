//! `drape-rollout`: a trained model animates the garments of a sequence; the
//! prediction is written as a sequence file.

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, bail};
use clap::Parser;
use drape_dataset::{
    SequenceReader, SequenceWriter,
    intersections::count_intersections,
    sequence::{Frame, Intersections, SequenceHeader},
};
use drape_eval::{
    EvalError,
    layersnet::LayersNetMethod,
    method::{Rollout, roll_out},
    task::{Clip, Task},
};
use drape_train::run::RunFolder;
use indicatif::{ProgressBar, ProgressStyle};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Folder that holds runs.
const RUNS: &str = "runs";

/// Let a trained model animate the garments of a sequence, given its body motion and wind.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Sequence file (.mcap)
    sequence: PathBuf,
    /// Run folder with the trained model [default: the newest finished run in runs/]
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Last frame whose garments are given; at least 2
    #[arg(long, default_value_t = 2, value_name = "FRAME")]
    start: usize,
    /// Frames to predict [default: to the end of the sequence]
    #[arg(long, value_name = "N")]
    steps: Option<usize>,
    /// File to write [default: rollouts/NAME.mcap in the run folder]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
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
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .context("cannot handle Ctrl-C")?;

    let reader = SequenceReader::open(&arguments.sequence)?;
    let steps = arguments
        .steps
        .unwrap_or_else(|| reader.frame_count().saturating_sub(arguments.start + 1));
    if steps == 0 {
        bail!(
            "no frame to predict: {} has {} frames and --start is {}",
            arguments.sequence.display(),
            reader.frame_count(),
            arguments.start
        );
    }
    let folder = match &arguments.run {
        Some(path) => RunFolder::open(path)?,
        None => RunFolder::latest(Path::new(RUNS), Some(true))?,
    };
    let mut method = LayersNetMethod::from_run(&folder)?;

    let clip = Clip::read(&reader, arguments.start, steps)?;
    let given: Vec<Frame> = clip.frames[..=arguments.start].to_vec();
    let (task, _) = clip.split(arguments.start, steps)?;
    eprintln!(
        "predicting {steps} frames of {} with {}",
        task.header.name,
        folder.path().display()
    );
    let bar = ProgressBar::new(steps as u64).with_style(
        ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {eta} left")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let rollout = roll_out(&mut method, &task, &mut || {
        bar.inc(1);
        if stop.load(Ordering::Relaxed) {
            Err(EvalError::Stopped)
        } else {
            Ok(())
        }
    })?;
    bar.finish_and_clear();

    let out = arguments.out.clone().unwrap_or_else(|| {
        folder
            .path()
            .join("rollouts")
            .join(format!("{}.mcap", task.header.name))
    });
    if let Some(parent) = out.parent() {
        fs::create_dir_all(parent)
            .with_context(|| format!("cannot make the folder {}", parent.display()))?;
    }
    let dirty = write(
        &out,
        &predicted_header(&task, folder.path()),
        given,
        &task,
        &rollout,
    )?;
    println!(
        "{}: {steps} frames predicted, {:.1} ms per frame, {dirty} of them with intersections",
        out.display(),
        rollout.ms_per_frame()
    );
    println!("look at it: cargo xtask inspect {}", out.display());
    Ok(())
}

/// The sequence's header with the prediction's origin.
fn predicted_header(task: &Task, run: &Path) -> SequenceHeader {
    let mut header = task.header.clone();
    header.scene.warnings.push(format!(
        "predicted by the run {} from frame {} on; earlier frames are {} {}'s",
        run.file_name().unwrap_or(run.as_os_str()).display(),
        task.start + 1,
        header.scene.engine,
        header.scene.engine_version
    ));
    header.scene.engine = "layersnet".to_owned();
    header.scene.engine_version = env!("CARGO_PKG_VERSION").to_owned();
    // A prediction cannot be repeated from the recipe of what it predicts.
    header.scene.recipe = String::new();
    header
}

/// Writes given and predicted frames; returns how many predicted ones have intersections.
fn write(
    path: &Path,
    header: &SequenceHeader,
    given: Vec<Frame>,
    task: &Task,
    rollout: &Rollout,
) -> Result<usize> {
    let mut writer = SequenceWriter::create(path, header)?;
    for frame in &given {
        writer.push(frame)?;
    }
    let mut dirty = 0;
    for (step, garments) in rollout.frames.iter().enumerate() {
        let mut frame = task.frame_with(step, garments.clone());
        let found = count_intersections(header, &frame);
        dirty += usize::from(found != Intersections::default());
        frame.intersections = Some(found);
        writer.push(&frame)?;
    }
    writer.finish()?;
    Ok(dirty)
}
