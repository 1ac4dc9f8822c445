//! `drape-generate`: makes a data set of simulated sequences.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::{Parser, ValueEnum};
use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};
use drape_dataset::splits::{DatasetIndex, INDEX_FILE, Split};
use drape_dataset::{SequenceReader, SequenceWriter};
use drape_sim::SimError;
use drape_sim::blender::{Blender, BlenderSettings};
use drape_sim::engine::EngineSettings;
use drape_sim::engine::profile::{self, Profile};
use drape_sim::scene::{Progress, Quality, Recipe, SceneRanges, simulate, simulate_in_blender};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use serde::Deserialize;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Make a data set: bodies in motion, dressed in layers, simulated by the engine.
///
/// Each sequence is drawn from the configuration's ranges with its own body
/// shape, outfit, materials, motion and wind, simulated, and written as one
/// MCAP file; dataset.json lists the files with their splits. The same seed
/// makes the same bytes, whatever the number of threads.
///
/// Interrupted? Run the same command again: sequences that are finished are
/// kept, the others are made.
#[derive(Parser)]
#[command(name = "drape-generate", version)]
struct Arguments {
    /// Configuration (TOML); configs/generate.toml lists the defaults
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder of the data set
    #[arg(long, value_name = "DIR", default_value = "data/default")]
    out: PathBuf,
    /// Number of sequences, train and test in the configuration's proportion
    #[arg(long, value_name = "N")]
    sequences: Option<usize>,
    /// Frames of each sequence
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Seed of everything random
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// What simulates: this program's engine, or Blender, which takes much longer and needs
    /// `cargo xtask setup blender` once
    #[arg(long, value_name = "NAME", value_enum, default_value_t = Simulator::Drape)]
    engine: Simulator,
    /// Force an effect off in all sequences, besides those of the configuration's `engine.without`;
    /// may be given several times; not with Blender
    #[arg(long, value_name = "EFFECT")]
    without: Vec<Effect>,
    /// Sequences simulated at the same time; 0 takes all processor cores
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print where the engine's time went, effect by effect; not with Blender
    #[arg(long)]
    profile: bool,
    /// Print the configuration that would be used, and stop
    #[arg(long)]
    print_config: bool,
}

/// What moves the garments.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Simulator {
    Drape,
    Blender,
}

/// Configuration of a data set.
#[derive(Clone, Debug, PartialEq, Deserialize, serde::Serialize)]
#[serde(default, deny_unknown_fields)]
struct Config {
    /// Of everything random.
    seed: u64,
    train_sequences: usize,
    /// Held out, drawn with streams of their own.
    test_sequences: usize,
    /// Recorded frames of a sequence.
    frames: usize,
    /// Draws of a sequence whose garments do not fit, that blows up or is not clean.
    attempts: usize,
    /// Share of the frames that must be free of intersections from the first
    /// on. What follows the first intersection is cut off; a sequence with less
    /// is drawn again.
    keep_share: f64,
    scene: SceneRanges,
    engine: EngineSettings,
    /// For `--engine blender`.
    blender: BlenderSettings,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            train_sequences: 72,
            test_sequences: 32,
            frames: 48,
            attempts: 4,
            keep_share: 0.9,
            scene: SceneRanges::default(),
            engine: EngineSettings::default(),
            blender: BlenderSettings::default(),
        }
    }
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<ExitCode> {
    ensure!(
        !arguments.profile || arguments.engine == Simulator::Drape,
        "--profile: expected --engine drape, whose effects are timed, found --engine blender; \
         leave one of the two out"
    );
    let config = resolve(arguments)?;
    ensure!(
        config.engine.without.is_empty() || arguments.engine == Simulator::Drape,
        "--without, engine.without: expected --engine drape, whose effects can be forced off one by \
         one, found --engine blender; leave one of the two out"
    );
    if arguments.print_config {
        print!("{}", toml::to_string(&config)?);
        return Ok(ExitCode::SUCCESS);
    }
    let blender = match arguments.engine {
        Simulator::Drape => None,
        Simulator::Blender => Some(Blender::find()?),
    };
    let blender = blender.as_ref();
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot make folder {}", arguments.out.display()))?;
    static STOP: AtomicBool = AtomicBool::new(false);
    ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")?;

    let jobs = jobs(&config);
    let lead = config.scene.lead_in.still + config.scene.lead_in.ease;
    let bar = ProgressBar::new((jobs.len() * (lead + config.frames)) as u64);
    bar.set_style(
        ProgressStyle::with_template("{bar:30} {percent}%  {msg}  {elapsed} gone, {eta} to go")?
            .progress_chars("━━╌"),
    );
    bar.enable_steady_tick(Duration::from_millis(500));
    bar.set_message("simulating");
    let times = arguments.profile.then(|| Mutex::new(Profile::default()));
    let started = Instant::now();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(arguments.threads)
        .build()?;
    let outcomes: Vec<Outcome> = pool.install(|| {
        jobs.par_iter()
            .map(|job| {
                let outcome = make(
                    job,
                    &config,
                    blender,
                    &arguments.out,
                    &bar,
                    &STOP,
                    times.as_ref(),
                );
                if let Outcome::Failed(reason) = &outcome {
                    bar.suspend(|| eprintln!("{}: {reason}", job.name));
                }
                outcome
            })
            .collect()
    });
    bar.finish_and_clear();
    report(&outcomes, &config, started.elapsed());
    if let Some(times) = times {
        print_profile(&times.into_inner().unwrap_or_else(PoisonError::into_inner));
    }
    if STOP.load(Ordering::Relaxed) {
        eprintln!(
            "interrupted; finished sequences are in {}: run the same command again to go on",
            arguments.out.display()
        );
        return Ok(ExitCode::from(130));
    }
    write_index(&arguments.out, &jobs, &outcomes)?;
    let failed = outcomes
        .iter()
        .any(|outcome| matches!(outcome, Outcome::Failed(_)));
    Ok(if failed {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

fn resolve(arguments: &Arguments) -> Result<Config> {
    let mut config = match &arguments.config {
        None => Config::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            toml::from_str(&text)
                .with_context(|| format!("{} is not a configuration", path.display()))?
        }
    };
    if let Some(sequences) = arguments.sequences {
        ensure!(
            sequences >= 2,
            "--sequences: expected at least 2 (one to train, one to test), found {sequences}"
        );
        let all = (config.train_sequences + config.test_sequences).max(1);
        let test = (sequences * config.test_sequences).div_ceil(all);
        config.test_sequences = test.clamp(1, sequences - 1);
        config.train_sequences = sequences - config.test_sequences;
    }
    config.frames = arguments.frames.unwrap_or(config.frames);
    config.seed = arguments.seed.unwrap_or(config.seed);
    config.engine.without.extend(&arguments.without);
    ensure!(config.frames >= 1, "frames: expected at least 1, found 0");
    ensure!(
        config.attempts >= 1,
        "attempts: expected at least 1, found 0"
    );
    ensure!(
        (0.0..=1.0).contains(&config.keep_share),
        "keep_share: expected 0 to 1, found {}",
        config.keep_share
    );
    config.scene.validate()?;
    config.engine.validate()?;
    config.blender.validate()?;
    Ok(config)
}

impl Config {
    /// Clean frames that a sequence needs.
    fn needed(&self) -> usize {
        ((self.keep_share * self.frames as f64).ceil() as usize).max(1)
    }
}

/// One sequence to make.
struct Job {
    name: String,
    split: Split,
    /// Number within the split.
    number: usize,
}

fn jobs(config: &Config) -> Vec<Job> {
    let of = |split: Split, count: usize| {
        (0..count).map(move |number| Job {
            name: format!("{}_{number:04}", split.name()),
            split,
            number,
        })
    };
    of(Split::Train, config.train_sequences)
        .chain(of(Split::Test, config.test_sequences))
        .collect()
}

enum Outcome {
    /// Made now or found finished.
    Done {
        made_in: Option<Duration>,
        frames: usize,
        attempts: usize,
        quality: Quality,
    },
    Failed(String),
    Stopped,
}

fn make(
    job: &Job,
    config: &Config,
    blender: Option<&Blender>,
    folder: &Path,
    bar: &ProgressBar,
    stop: &AtomicBool,
    times: Option<&Mutex<Profile>>,
) -> Outcome {
    let path = folder.join(format!("{}.mcap", job.name));
    let lead = config.scene.lead_in.still + config.scene.lead_in.ease;
    let all = (lead + config.frames) as u64;
    let needed = config.needed();
    let recipe = |attempt: usize| -> Recipe {
        // Attempts after the first draw from streams of their own.
        let name = match attempt {
            0 => job.name.clone(),
            again => format!("{}#{again}", job.name),
        };
        let mut recipe = config.scene.sample(
            &name,
            job.number,
            config.seed,
            config.frames,
            &config.engine,
        );
        recipe.name.clone_from(&job.name);
        match blender {
            None => recipe,
            Some(_) => recipe.for_blender(&config.blender),
        }
    };
    let version = blender.map_or(env!("CARGO_PKG_VERSION"), Blender::version);
    for attempt in 0..config.attempts {
        let recipe = recipe(attempt);
        if let Some(outcome) = finished(&path, &recipe, version, needed, attempt + 1) {
            bar.inc(all);
            return outcome;
        }
    }
    let mut reasons = Vec::new();
    for attempt in 0..config.attempts {
        let started = Instant::now();
        let mut counted = 0;
        let mut refused = None;
        let mut run = || {
            let each = |progress| {
                counted += 1;
                bar.inc(1);
                refused = why_not(progress, lead, needed);
                if refused.is_some() || stop.load(Ordering::Relaxed) {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            };
            let recipe = recipe(attempt);
            match blender {
                None => simulate(&recipe, None, each),
                Some(blender) => simulate_in_blender(&recipe, blender, each),
            }
        };
        let result = match times {
            None => run(),
            Some(times) => {
                let (result, profile) = profile::recorded(run);
                let mut times = times.lock().unwrap_or_else(PoisonError::into_inner);
                times.add(&profile);
                result
            }
        };
        let reason = match (result, refused) {
            (Ok((mut header, mut frames)), _) => {
                cut_dirty(&mut header, &mut frames, config.frames);
                if let Err(error) = write(&path, &header, &frames) {
                    return Outcome::Failed(format!("{error:#}"));
                }
                bar.inc(all - counted);
                return done(&header, &frames, Some(started.elapsed()), attempt + 1);
            }
            (Err(_), Some(reason)) => reason,
            (Err(SimError::Stopped { .. }), None) => return Outcome::Stopped,
            (Err(error), None) => error.to_string(),
        };
        bar.set_position(bar.position() - counted);
        bar.suspend(|| eprintln!("{}: attempt {}: {reason}", job.name, attempt + 1));
        reasons.push(format!("attempt {}: {reason}", attempt + 1));
    }
    bar.inc(all);
    Outcome::Failed(reasons.join("; "))
}

/// Why a sequence cannot have `needed` clean frames any more, after `lead` frames
/// of lead-in and what was simulated so far.
fn why_not(progress: Progress, lead: usize, needed: usize) -> Option<String> {
    if progress.of < lead + needed {
        return Some(format!(
            "only {} of the {needed} frames needed have the body clear of itself",
            progress.of.saturating_sub(lead)
        ));
    }
    let recorded = progress.done.saturating_sub(lead);
    let hits = progress.intersections.unwrap_or_default();
    (0 < recorded && recorded <= needed && hits != Intersections::default()).then(|| {
        format!(
            "intersections in frame {}: {} between garments, {} within garments, {} with the body",
            recorded - 1,
            hits.between_garments,
            hits.within_garments,
            hits.with_body
        )
    })
}

/// Cuts off what follows the first intersection, and says in the header when frames are missing.
fn cut_dirty(header: &mut SequenceHeader, frames: &mut Vec<Frame>, asked: usize) {
    let dirty = |frame: &Frame| frame.intersections.unwrap_or_default() != Intersections::default();
    if let Some(first) = frames.iter().position(dirty) {
        frames.truncate(first);
        header.scene.warnings.push(format!(
            "cut before the first intersection: {first} of {asked} frames are kept"
        ));
    }
}

/// A whole file with this recipe, if there is one.
fn finished(
    path: &Path,
    recipe: &Recipe,
    version: &str,
    needed: usize,
    attempts: usize,
) -> Option<Outcome> {
    if !path.is_file() {
        return None;
    }
    // A damaged or different file is made anew.
    let reader = SequenceReader::open(path).ok()?;
    let same = reader.header().scene.recipe == recipe.to_json()
        && reader.header().scene.engine_version == version
        && (needed..=recipe.frames).contains(&reader.frame_count());
    if !same {
        return None;
    }
    let frames = (0..reader.frame_count())
        .map(|frame| reader.frame(frame))
        .collect::<Result<Vec<_>, _>>()
        .ok()?;
    Some(done(reader.header(), &frames, None, attempts))
}

fn done(
    header: &SequenceHeader,
    frames: &[Frame],
    made_in: Option<Duration>,
    attempts: usize,
) -> Outcome {
    Outcome::Done {
        made_in,
        frames: frames.len(),
        attempts,
        quality: Quality::of(header, frames),
    }
}

fn write(path: &Path, header: &SequenceHeader, frames: &[Frame]) -> Result<()> {
    let mut writer = SequenceWriter::create(path, header)?;
    for frame in frames {
        writer.push(frame)?;
    }
    writer.finish()?;
    Ok(())
}

fn report(outcomes: &[Outcome], config: &Config, elapsed: Duration) {
    let lead = config.scene.lead_in.still + config.scene.lead_in.ease;
    let (mut accepted, mut kept, mut failed, mut first) = (0, 0, 0, 0);
    let (mut recorded, mut simulated) = (0, 0);
    let mut spent = Duration::ZERO;
    let mut quality = Quality::default();
    for outcome in outcomes {
        match outcome {
            Outcome::Done {
                made_in,
                frames,
                attempts,
                quality: of_sequence,
            } => {
                accepted += 1;
                first += usize::from(*attempts == 1);
                recorded += frames;
                quality.merge(of_sequence);
                match made_in {
                    Some(time) => {
                        spent += *time;
                        simulated += frames + lead;
                    }
                    None => kept += 1,
                }
            }
            Outcome::Failed(_) => failed += 1,
            Outcome::Stopped => {}
        }
    }
    let asked = outcomes.len();
    println!("sequences      {accepted} of {asked} ({kept} were there already, {failed} failed)");
    println!(
        "accepted       {first} of {asked} at the first draw, {:.1} %",
        100.0 * first as f64 / asked as f64
    );
    println!(
        "frames         {recorded} of {}, none with an intersection",
        asked * config.frames
    );
    println!("cloth          {quality}");
    if simulated > 0 {
        println!(
            "time           {:.0} s in all; {:.3} s per simulated frame and thread; \
             {:.0} frames per hour",
            elapsed.as_secs_f64(),
            spent.as_secs_f64() / simulated as f64,
            simulated as f64 / elapsed.as_secs_f64() * 3600.0
        );
    }
}

/// The engine's times; bodies, garments, counting and files are not in them.
fn print_profile(profile: &Profile) {
    if profile.frames == 0 {
        println!("profile        no frame was simulated: every sequence was there already");
    } else {
        println!(
            "\nThe engine's time by effect (frames that led in are counted, time of all threads \
             together):\n\n{profile}"
        );
    }
}

fn write_index(folder: &Path, jobs: &[Job], outcomes: &[Outcome]) -> Result<()> {
    let name = folder
        .file_name()
        .map_or_else(|| "data".into(), |name| name.to_string_lossy().into_owned());
    let mut index = DatasetIndex::new(folder, name);
    for (job, outcome) in jobs.iter().zip(outcomes) {
        if matches!(outcome, Outcome::Done { .. }) {
            index.add(format!("{}.mcap", job.name), job.split)?;
        }
    }
    ensure!(
        !index.sequences().is_empty(),
        "no sequence could be made: no {INDEX_FILE} was written"
    );
    index.save()?;
    println!("index          {}", folder.join(INDEX_FILE).display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_configuration_says_the_defaults() {
        let text = include_str!("../../../../configs/generate.toml");
        assert_eq!(toml::from_str::<Config>(text).unwrap(), Config::default());
    }

    #[test]
    fn the_wardrobe_is_a_configuration() {
        let text = include_str!("../../../../configs/wardrobe.toml");
        let config: Config = toml::from_str(text).unwrap();
        assert_eq!((config.frames, config.needed()), (90, 81));
    }

    #[test]
    fn a_hit_refuses_a_sequence_up_to_the_last_frame_that_is_needed_and_not_after() {
        let at = |done, hits| Progress {
            done,
            of: 48 + 90,
            intersections: Some(Intersections {
                with_body: hits,
                ..Intersections::default()
            }),
        };
        let (lead, needed) = (48, 81);
        for done in [49, 48 + 80, 48 + 81] {
            assert_eq!(why_not(at(done, 0), lead, needed), None);
            let reason = why_not(at(done, 3), lead, needed).unwrap();
            assert!(reason.contains("3 with the body"), "{reason}");
            assert!(
                reason.contains(&format!("frame {}:", done - 49)),
                "{reason}"
            );
        }
        assert_eq!(
            why_not(at(48 + 82, 3), lead, needed),
            None,
            "cut, not refused"
        );
        let lead_in = Progress {
            done: 10,
            of: 48 + 81,
            intersections: None,
        };
        assert_eq!(why_not(lead_in, lead, needed), None);
        let short = Progress {
            of: 48 + 80,
            ..lead_in
        };
        assert!(
            why_not(short, lead, needed)
                .unwrap()
                .contains("only 80 of the 81")
        );
    }

    #[test]
    fn every_garment_kind_occurs_at_least_twice_among_the_held_out_sequences() {
        use drape_dataset::registry::GarmentKind::{Dress, Jacket, Pants, Skirt, TShirt};
        let config = Config::default();
        let outfits = &config.scene.outfits;
        for kind in [TShirt, Pants, Skirt, Dress, Jacket] {
            let worn = (0..config.test_sequences)
                .filter(|number| outfits[number % outfits.len()].contains(&kind))
                .count();
            assert!(worn >= 2, "{kind}: {worn}");
        }
    }
}
