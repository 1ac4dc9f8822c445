//! Our engine beside Blender: simulates the scenes of Blender's sequences
//! again and compares what the cloth does, frame by frame.
//!
//!     cargo run --release -p drape-sim --example beside_blender -- --out DIR FILE.mcap …
//!
//! A sequence of `generate --engine blender` is made again from its recipe. Of
//! an imported one, body, garments, materials, wind and gravity are taken as
//! they are; its garments must start at rest, and where it lists waist bands,
//! vertices near the garments' upper ends follow the body. DIR gets our
//! sequence beside each, and a picture of the curves; the table has means over
//! frames 10 to the last.

mod measures;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use drape_dataset::intersections::count_intersections;
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{Frame, Garment, SequenceHeader};
use drape_dataset::{SequenceReader, SequenceWriter};
use drape_sim::engine::{Engine, EngineSettings, ScenePhysics};
use drape_sim::scene::{Recipe, Units, simulate};
use drape_view::Picture;
use drape_view::plot::{LinePlot, Series, line_plot};
use measures::{Gauge, NAMES, Numbers, Skin, mean};

/// Compared frames: garments have left their rest positions.
const FROM: usize = 10;

/// Compare our engine with Blender on the scenes of its sequences.
#[derive(Parser)]
struct Arguments {
    /// Sequences that Blender made
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Folder for our sequences and the pictures
    #[arg(long)]
    out: PathBuf,
    /// Steps a frame
    #[arg(long)]
    substeps: Option<u32>,
    /// Distance that our cloth keeps from the body, mm real
    #[arg(long, default_value_t = 4.0)]
    body_mm: f64,
    /// Height of an imported garment's waist band, mm real
    #[arg(long, default_value_t = 16.0)]
    band_mm: f32,
    /// Density of the air for our engine, kg/m³; without it that of units "d-layers"
    #[arg(long)]
    air: Option<f64>,
}

impl Arguments {
    fn air(&self) -> f64 {
        self.air.unwrap_or(Units::DLayers.air_density())
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.out)?;
    println!(
        "| sequence | garment | engine | {} |\n|{}",
        NAMES.join(" | "),
        "---|".repeat(NAMES.len() + 3)
    );
    for file in &arguments.files {
        compare(file, &arguments).with_context(|| format!("in {}", file.display()))?;
    }
    Ok(())
}

fn compare(file: &Path, arguments: &Arguments) -> Result<()> {
    let reader = SequenceReader::open(file)?;
    let header = reader.header().clone();
    let theirs = reader.read_all()?;
    let settings = EngineSettings {
        substeps: arguments
            .substeps
            .unwrap_or(EngineSettings::default().substeps),
        body_thickness_m: arguments.body_mm / 1e3,
        ..EngineSettings::default()
    };
    let clock = std::time::Instant::now();
    let (our_header, ours) = match Recipe::from_json(&header.scene.recipe) {
        Ok(mut recipe) => {
            recipe.engine = settings;
            recipe.air_density = arguments.air();
            simulate(&recipe, None, |_| ControlFlow::Continue(()))?
        }
        Err(_) => again(&header, &theirs, &settings, arguments)?,
    };
    let seconds = clock.elapsed().as_secs_f64() / ours.len() as f64;
    let name = &header.name;
    write(
        &arguments.out.join(format!("{name}_ours.mcap")),
        &our_header,
        &ours,
    )?;
    let mut curves = vec![Vec::new(); NAMES.len()];
    for number in 0..header.garments.len() {
        for (engine, frames) in [("Blender", &theirs), ("ours", &ours)] {
            let gauge = Gauge::new(&header, number);
            let numbers = measured(&gauge, &header, frames);
            let means: Vec<String> = (0..NAMES.len())
                .map(|k| format!("{:.3}", mean(numbers.iter().skip(FROM).map(|n| n[k]))))
                .collect();
            println!(
                "| {name} | {} | {engine} | {} |",
                gauge.name(),
                means.join(" | ")
            );
            for (k, lines) in curves.iter_mut().enumerate() {
                let from = usize::from(NAMES[k].starts_with("speed"));
                let points = numbers.iter().enumerate().skip(from);
                lines.push(Series {
                    name: format!("{}, {engine}", gauge.name()),
                    points: points.map(|(frame, n)| (frame as f64, n[k])).collect(),
                });
            }
        }
    }
    for (engine, frames) in [("Blender", &theirs), ("ours", &ours)] {
        println!("{name}, {engine}: {}", hits(&header, frames));
    }
    println!("{name}: {seconds:.3} s per frame for ours, alone or not");
    draw(
        name,
        &curves,
        &arguments.out.join(format!("{name}_beside.png")),
    )
}

/// Our engine on a body that goes the same way, from the garments' rest.
fn again(
    header: &SequenceHeader,
    frames: &[Frame],
    settings: &EngineSettings,
    arguments: &Arguments,
) -> Result<(SequenceHeader, Vec<Frame>)> {
    let first = frames.first().context("no frames")?;
    let at_rest = first
        .garments
        .iter()
        .zip(&header.garments)
        .all(|(positions, garment)| *positions == garment.rest);
    ensure!(
        at_rest,
        "garments of frame 0: expected at rest, found elsewhere"
    );
    let physics = ScenePhysics {
        scale: header.scene.scale,
        gravity: header.scene.gravity,
        air_density: arguments.air(),
        body_friction: header.scene.body_friction,
        effects: header.scene.effects.iter().copied().collect(),
    };
    let banded = physics.calls_for(Effect::Waistband);
    let height = arguments.band_mm / 1e3 * header.scene.scale;
    let bands: Vec<Vec<u32>> = header
        .garments
        .iter()
        .map(|garment| {
            if banded {
                band(garment, height)
            } else {
                Vec::new()
            }
        })
        .collect();
    let faces = &header.body.faces;
    let mut engine = Engine::new(
        &header.garments,
        &bands,
        faces,
        &first.body,
        &physics,
        settings,
    )?;
    let dt_s = 1.0 / f64::from(header.scene.fps);
    let mut made = vec![first.clone()];
    for frame in &frames[1..] {
        let mut frame = frame.clone();
        engine.advance(&frame.body, frame.wind, dt_s)?;
        frame.garments = engine.garments();
        frame.intersections = Some(count_intersections(header, &frame));
        made.push(frame);
    }
    let mut header = header.clone();
    header.scene.engine = "drape-sim".into();
    header.scene.engine_version = env!("CARGO_PKG_VERSION").into();
    Ok((header, made))
}

/// Vertices of a skirt or pants within a height of the upper end.
fn band(garment: &Garment, height: f32) -> Vec<u32> {
    if !matches!(garment.kind, GarmentKind::Skirt | GarmentKind::Pants) {
        return Vec::new();
    }
    let top = garment.rest.iter().map(|p| p[2]).fold(f32::MIN, f32::max);
    (0..garment.rest.len() as u32)
        .filter(|&v| garment.rest[v as usize][2] > top - height)
        .collect()
}

fn measured(gauge: &Gauge, header: &SequenceHeader, frames: &[Frame]) -> Vec<Numbers> {
    let mut skin = Skin::new(header);
    let mut before = None;
    frames
        .iter()
        .map(|frame| {
            skin.pose(frame);
            gauge.measure(frame, before.replace(frame), &skin)
        })
        .collect()
}

/// Intersections of all frames.
fn hits(header: &SequenceHeader, frames: &[Frame]) -> String {
    let mut sums = [0; 3];
    let mut dirty = 0;
    for frame in frames {
        let counts = count_intersections(header, frame);
        let counts = [
            counts.between_garments,
            counts.within_garments,
            counts.with_body,
        ];
        dirty += usize::from(counts != [0; 3]);
        for (sum, count) in sums.iter_mut().zip(counts) {
            *sum += count;
        }
    }
    let [between, within, body] = sums;
    format!(
        "{between} hits between garments, {within} within, {body} with the body; {dirty} of {} \
         frames not clean",
        frames.len()
    )
}

fn write(path: &Path, header: &SequenceHeader, frames: &[Frame]) -> Result<()> {
    let mut writer = SequenceWriter::create(path, header)?;
    for frame in frames {
        writer.push(frame)?;
    }
    Ok(writer.finish()?)
}

/// One plot below the other.
fn draw(name: &str, curves: &[Vec<Series>], path: &Path) -> Result<()> {
    const WIDTH: usize = 1000;
    const HEIGHT: usize = 380;
    let rows = curves.len().div_ceil(2);
    let mut picture = Picture::new(2 * WIDTH, rows * HEIGHT, [255; 3]);
    for (k, series) in curves.iter().enumerate() {
        let plot = LinePlot {
            title: &format!("{name}: {}", NAMES[k]),
            x_label: "frame",
            y_label: "",
            log_y: false,
            series,
            marks: &[],
        };
        let drawn = line_plot(&plot, WIDTH, HEIGHT)?;
        picture.paste(&drawn, k % 2 * WIDTH, k / 2 * HEIGHT);
    }
    Ok(picture.write_png(path)?)
}
