//! `drape-train`: trains LayersNet on a data set and writes a run folder.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use clap::Parser;
use drape_train::adam::Adam;
use drape_train::config::TrainConfig;
use drape_train::curves;
use drape_train::data::TrainingSet;
use drape_train::losses::LossValues;
use drape_train::run::{Position, RunFolder, RunRecord};
use drape_train::trainer::{Outcome, Progress, Trainer};
use indicatif::{ProgressBar, ProgressStyle};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Updates of the paper's schedule: 10 epochs over D-LAYERS' training samples at
/// batch 4 (2,600 motions with 36 samples each).
const PAPER_UPDATES: f64 = 10.0 * 2600.0 * 36.0 / 4.0;

/// Trains LayersNet.
///
/// Runs a warm-up phase without collision losses, then a phase with them. The run
/// folder holds the resolved config, seed, commit, data hash, statistics,
/// checkpoint, log and loss curves. Ctrl-C saves a checkpoint; `--resume`
/// continues with the same bits as if it had never stopped.
#[derive(Parser)]
#[command(name = "drape-train", version)]
struct Cli {
    /// Configuration (TOML); all keys have defaults, see configs/train.toml
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Data set folder; overrides the configuration's `data`
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder to write; default: runs/<time>
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Continue the run given by --run, or the newest unfinished one
    #[arg(long)]
    resume: bool,
    /// Seed; overrides the configuration's
    #[arg(long)]
    seed: Option<u64>,
    /// Epochs; overrides the configuration's
    #[arg(long)]
    epochs: Option<usize>,
    /// Draws per epoch; overrides the configuration's
    #[arg(long, value_name = "N")]
    samples_per_epoch: Option<usize>,
}

struct Bar {
    bar: ProgressBar,
    folder: PathBuf,
}

impl Progress for Bar {
    fn update(
        &mut self,
        config: &TrainConfig,
        position: Position,
        losses: &LossValues,
        samples_per_s: f64,
    ) {
        let phase = if config.schedule.with_collisions(position.epoch) {
            "collisions"
        } else {
            "warm-up"
        };
        self.bar.set_position(position.updates);
        self.bar.set_message(format!(
            "{phase} epoch {}/{}  position {:.2e} ({:.2} of hold) patch {:.2e} normal {:.2e} body {:.1e} layer {:.1e}  {:.1} samples/s",
            position.epoch + 1,
            config.schedule.epochs,
            losses.position,
            losses.position / losses.hold.max(f64::MIN_POSITIVE),
            losses.patch,
            losses.normal,
            losses.body_collision,
            losses.layer_collision,
            samples_per_s,
        ));
    }

    fn epoch(&mut self, _epoch: usize) {
        if let Err(error) = curves::draw(&self.folder) {
            self.bar
                .println(format!("loss curves were not drawn: {error}"));
        }
    }
}

fn commit() -> String {
    let output = std::process::Command::new("git")
        .args(["rev-parse", "HEAD"])
        .output();
    match output {
        Ok(output) if output.status.success() => {
            String::from_utf8_lossy(&output.stdout).trim().into()
        }
        _ => "unknown".into(),
    }
}

fn default_folder() -> PathBuf {
    let seconds = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |since| since.as_secs());
    PathBuf::from("runs").join(format!("{seconds}"))
}

fn configured(cli: &Cli) -> Result<TrainConfig> {
    let mut config = match &cli.config {
        Some(path) => TrainConfig::load(path)?,
        None => TrainConfig::default(),
    };
    if let Some(data) = &cli.data {
        config.data.clone_from(data);
    }
    if let Some(seed) = cli.seed {
        config.seed = seed;
    }
    if let Some(epochs) = cli.epochs {
        config.schedule.epochs = epochs;
    }
    if let Some(samples) = cli.samples_per_epoch {
        config.schedule.samples_per_epoch = samples;
    }
    config.validate()?;
    Ok(config)
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(Outcome::Finished) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(130),
        Err(error) => {
            eprintln!("drape-train: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<Outcome> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("\nstopping after this update (again: at once, keeping the last checkpoint)");
    })
    .context("cannot listen for Ctrl-C")?;

    let (folder, config) = if cli.resume {
        let folder = match &cli.run {
            Some(path) => RunFolder::open(path)?,
            None => RunFolder::latest("runs".as_ref(), Some(false))?,
        };
        if cli.config.is_some() || cli.data.is_some() || cli.seed.is_some() || cli.epochs.is_some()
        {
            anyhow::bail!(
                "--resume continues with the run's own configuration: leave out --config, --data, --seed and --epochs"
            );
        }
        let config = folder.config()?;
        (folder, config)
    } else {
        let config = configured(cli)?;
        (
            RunFolder::create(&cli.run.clone().unwrap_or_else(default_folder))?,
            config,
        )
    };
    println!("run folder: {}", folder.path().display());
    let set = TrainingSet::open(&config)?;
    let (mut record, parameters, adam, position);
    if cli.resume {
        record = folder.record()?;
        if record.data_hash != set.data_hash {
            anyhow::bail!(
                "{} has changed since the run began: hash {}, expected {}",
                config.data.display(),
                set.data_hash,
                record.data_hash
            );
        }
        (parameters, adam, position) = folder.load(&config)?;
    } else {
        parameters = drape_model::Parameters::new(&config.model, config.seed)?;
        (adam, position) = (Adam::default(), Position::default());
        record = RunRecord {
            program: concat!("drape-train ", env!("CARGO_PKG_VERSION")).into(),
            commit: commit(),
            seed: config.seed,
            data_hash: set.data_hash.clone(),
            sequences: set.sequences.len(),
            parameters: parameters.count(),
            updates: config.schedule.epochs * config.schedule.updates_per_epoch(),
            threads: rayon::current_num_threads(),
            seconds: 0.0,
            finished: false,
        };
        folder.write_start(&config, &set.statistics)?;
        folder.write_record(&record)?;
    }
    println!(
        "{} sequences, {} weights, {} gradient updates of {} samples on {} threads",
        set.sequences.len(),
        record.parameters,
        record.updates,
        config.schedule.batch,
        record.threads
    );
    let bar = ProgressBar::new(record.updates as u64).with_position(position.updates);
    bar.set_style(
        ProgressStyle::with_template("{bar:24} {pos}/{len} {elapsed} ETA {eta}  {msg}")
            .expect("the template is valid"),
    );
    let before = (position.updates, record.seconds);
    let mut progress = Bar {
        bar: bar.clone(),
        folder: folder.path().into(),
    };
    let mut trainer = Trainer {
        config: &config,
        set: &set,
        folder: &folder,
        parameters,
        adam,
        position,
    };
    let outcome = trainer.run(&mut record, &stop, &mut progress)?;
    bar.finish();
    let per_update =
        (record.seconds - before.1) / (trainer.position.updates - before.0).max(1) as f64;
    println!(
        "{} updates in {:.0} s; the paper's full schedule ({PAPER_UPDATES:.0} updates) would take {:.1} h at this speed",
        trainer.position.updates - before.0,
        record.seconds - before.1,
        PAPER_UPDATES * per_update / 3600.0
    );
    match outcome {
        Outcome::Finished => println!("finished: {}", folder.path().display()),
        Outcome::Interrupted => {
            println!(
                "stopped at update {}; continue with `--resume --run {}`",
                trainer.position.updates,
                folder.path().display()
            );
        }
    }
    Ok(outcome)
}
