//! `drape-import d-layers`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, ensure};
use drape_dataset::import::DLayers;
use drape_dataset::import::d_layers::Recording;
use drape_dataset::intersections::count_intersections;
use drape_dataset::sequence::Intersections;
use drape_dataset::splits::{DatasetIndex, Split};
use drape_dataset::{SequenceReader, SequenceWriter};

/// The D-LAYERS data set as published: garments, wind, splits, and the body with SMPL.
///
/// ROOT holds data/train_val_test.json, data/SEQUENCE/ and human/. Sequences
/// keep their names and splits. Intersections of the published frames are
/// counted and stored, for they are not clean: every line tells in how many
/// frames garments cross each other, themselves or the body.
///
/// The body needs SMPL models (model_f.pkl and model_m.pkl, or .npz), which are
/// licensed and come from smpl.is.tue.mpg.de; without them sequences come in
/// without a body, and say so.
///
/// Interrupted? Run the same command again: finished sequences are kept. A
/// sequence that cannot be read is reported and the others go on; the exit code
/// then tells of it.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder of the published data set
    root: PathBuf,
    /// Folder of the drape data set: made if missing; sequences are added to one that is there
    out: PathBuf,
    /// Folder with the SMPL models [default: ROOT/smpl/model, if it is there]
    #[arg(long, value_name = "DIR")]
    smpl: Option<PathBuf>,
    /// Only these sequences, for example 00396
    #[arg(long, num_args = 1.., value_name = "NAME")]
    only: Vec<String>,
    /// Do not count intersections (the slowest part)
    #[arg(long)]
    skip_intersections: bool,
}

/// What became of a sequence.
enum Outcome {
    Kept,
    Written(Counts),
    Interrupted,
}

/// Intersections of a sequence; `None` if nobody counted.
type Counts = Option<Sum>;

#[derive(Default)]
struct Sum {
    frames: usize,
    /// Frames with at least one.
    frames_hit: usize,
    between: u64,
    within: u64,
    body: u64,
}

static STOP: AtomicBool = AtomicBool::new(false);

pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let Arguments {
        root, out, only, ..
    } = arguments;
    let default = root.join("smpl/model");
    let smpl = match &arguments.smpl {
        None if default.is_dir() => Some(&default),
        given => given.as_ref(),
    };
    if let Some(folder) = smpl {
        ensure!(
            folder.is_dir(),
            "--smpl {}: no such folder",
            folder.display()
        );
    }
    let mut source = DLayers::open(root, smpl.map(PathBuf::as_path))?;
    let listed: Vec<(String, Split)> = source
        .sequences()
        .map(|(name, split)| (name.to_owned(), split))
        .collect();
    let names: BTreeSet<_> = listed.iter().map(|(name, _)| name).collect();
    for name in only {
        ensure!(
            names.contains(name),
            "--only {name}: no such sequence among the {} that train_val_test.json lists",
            names.len()
        );
    }
    let (there, missing): (Vec<_>, Vec<_>) = listed
        .into_iter()
        .filter(|(name, _)| only.is_empty() || only.contains(name))
        .partition(|(name, _)| source.has(name));
    ensure!(
        !there.is_empty(),
        "none of the sequences that train_val_test.json lists is in {}",
        root.join("data").display()
    );
    match smpl {
        Some(folder) => println!("bodies: SMPL from {}", folder.display()),
        None => println!("bodies: missing, for there are no SMPL models (--smpl DIR)"),
    }

    ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")?;
    let mut index = crate::open_index(out)?;
    let mut failed = 0;
    let mut total = Sum::default();
    for (i, (name, split)) in there.iter().enumerate() {
        let line = format!("[{}/{}] {name}:", i + 1, there.len());
        if STOP.load(Ordering::Relaxed) {
            return Ok(interrupted(out));
        }
        match import(&mut source, name, *split, arguments, &mut index) {
            Ok((_, Outcome::Interrupted)) => return Ok(interrupted(out)),
            Ok((what, Outcome::Kept)) => println!("{line} {what}, kept"),
            Ok((what, Outcome::Written(counts))) => {
                println!("{line} {what}; {}", describe(&counts));
                if let Some(counts) = counts {
                    total.frames += counts.frames;
                    total.frames_hit += counts.frames_hit;
                }
            }
            Err(error) => {
                failed += 1;
                eprintln!("{line} error: {error:#}");
            }
        }
    }
    if !missing.is_empty() {
        let some: Vec<_> = missing
            .iter()
            .take(5)
            .map(|(name, _)| name.as_str())
            .collect();
        println!(
            "{} listed sequences are not in {}: {}{}",
            missing.len(),
            root.join("data").display(),
            some.join(", "),
            if missing.len() > some.len() {
                " …"
            } else {
                ""
            }
        );
    }
    if total.frames > 0 {
        println!(
            "intersections in {} of {} frames that were counted now",
            total.frames_hit, total.frames
        );
    }
    crate::print_total(out, &index);
    if failed > 0 {
        eprintln!(
            "{failed} of {} sequences could not be imported",
            there.len()
        );
        return Ok(ExitCode::FAILURE);
    }
    Ok(ExitCode::SUCCESS)
}

fn interrupted(out: &Path) -> ExitCode {
    eprintln!(
        "interrupted; finished sequences are in {}: run the same command again to go on",
        out.display()
    );
    ExitCode::from(130)
}

/// Imports one sequence, unless the same one is there already.
fn import(
    source: &mut DLayers,
    name: &str,
    split: Split,
    arguments: &Arguments,
    index: &mut DatasetIndex,
) -> Result<(String, Outcome)> {
    let recording = source.open_sequence(name)?;
    let header = recording.header();
    let kinds: Vec<_> = header.garments.iter().map(|g| g.kind.to_string()).collect();
    let what = format!(
        "{} frames, {}, split {split}",
        recording.frame_count(),
        kinds.join(" + ")
    );
    let file = format!("{name}.mcap");
    let path = arguments.out.join(&file);
    let count = !arguments.skip_intersections;
    let outcome = if is_finished(&path, &recording, count) {
        Outcome::Kept
    } else {
        write(recording, &path, count)?
    };
    let listed =
        |entry: &drape_dataset::splits::SequenceEntry| entry.file == file && entry.split == split;
    match outcome {
        Outcome::Interrupted => {}
        Outcome::Kept if index.sequences().iter().any(listed) => {}
        _ => {
            index.add(&file, split)?;
            // After each sequence: what is done stays done.
            index.save()?;
        }
    }
    Ok((what, outcome))
}

/// Whether the file holds this very sequence (with counts, if those are wanted).
fn is_finished(path: &Path, recording: &Recording, counted: bool) -> bool {
    SequenceReader::open(path).is_ok_and(|file| {
        file.header() == recording.header()
            && file.frame_count() == recording.frame_count()
            && (!counted
                || file
                    .frame(0)
                    .is_ok_and(|frame| frame.intersections.is_some()))
    })
}

fn write(recording: Recording, path: &Path, count: bool) -> Result<Outcome> {
    let header = recording.header().clone();
    let mut writer = SequenceWriter::create(path, &header)?;
    let mut counts = count.then(Sum::default);
    for frame in recording {
        if STOP.load(Ordering::Relaxed) {
            return Ok(Outcome::Interrupted);
        }
        let mut frame = frame?;
        if let Some(counts) = &mut counts {
            let found = count_intersections(&header, &frame);
            counts.add(found);
            frame.intersections = Some(found);
        }
        writer.push(&frame)?;
    }
    writer.finish()?;
    Ok(Outcome::Written(counts))
}

impl Sum {
    fn add(&mut self, found: Intersections) {
        self.frames += 1;
        self.frames_hit += usize::from(found != Intersections::default());
        self.between += u64::from(found.between_garments);
        self.within += u64::from(found.within_garments);
        self.body += u64::from(found.with_body);
    }
}

fn describe(counts: &Counts) -> String {
    match counts {
        None => "intersections not counted".into(),
        Some(Sum {
            frames,
            frames_hit: 0,
            ..
        }) => format!("no intersections in {frames} frames"),
        Some(sum) => format!(
            "intersections in {} of {} frames (between garments {}, within {}, with the body {})",
            sum.frames_hit, sum.frames, sum.between, sum.within, sum.body
        ),
    }
}
