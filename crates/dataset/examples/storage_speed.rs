//! How fast sequence files are read, and how much smaller quantised ones are.
//!
//! ```sh
//! cargo run --release -p drape-dataset --example storage_speed [FILE.mcap]
//! ```
//!
//! With a file: that sequence, exact and quantised. Without: 300 frames of 6,000
//! vertices that wave, without a body. One thread; each line is the best and the median
//! of the repeats, warm (the file has just been written or read).

use std::error::Error;
use std::path::Path;
use std::time::Instant;
use std::{env, fs};

use drape_dataset::file::Storage;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{BodyTopology, Frame, Garment, Material, SceneMeta, SequenceHeader};
use drape_dataset::{SequenceReader, SequenceWriter};

const REPEATS: usize = 9;

fn main() -> Result<(), Box<dyn Error>> {
    let (header, frames) = match env::args().nth(1) {
        Some(path) => {
            let reader = SequenceReader::open(path)?;
            (reader.header().clone(), reader.read_all()?)
        }
        None => waves(60, 100, 300),
    };
    let vertices: usize = header
        .garments
        .iter()
        .map(|garment| garment.rest.len())
        .sum();
    let numbers = 3 * (vertices + header.body.vertex_count) * frames.len();
    println!(
        "{} frames, {vertices} garment and {} body vertices, {:.1} MB of f32",
        frames.len(),
        header.body.vertex_count,
        numbers as f64 * 4e-6
    );
    let folder = tempfile::tempdir()?;
    let mut exact_bytes = 0.0;
    for storage in [Storage::Exact, Storage::VIEWING] {
        let path = folder.path().join("sequence.mcap");
        let clock = Instant::now();
        let mut writer = SequenceWriter::create_with(&path, &header, storage)?;
        for frame in &frames {
            writer.push(frame)?;
        }
        writer.finish()?;
        let written_s = clock.elapsed().as_secs_f64();
        let bytes = fs::metadata(&path)?.len() as f64;
        println!("\n{storage}");
        println!(
            "  file            {:.2} MB, written in {:.0} ms",
            bytes / 1e6,
            written_s * 1e3
        );
        match storage {
            Storage::Exact => exact_bytes = bytes,
            Storage::Quantised { .. } => {
                println!("  smaller         {:.2} times", exact_bytes / bytes)
            }
        }
        measure(&path, bytes)?;
        let found = SequenceReader::open(&path)?;
        let error_mm = farthest(&found, &frames)? / f64::from(header.scene.scale) * 1e3;
        println!("  farthest vertex {error_mm:.4} mm (real size) from where it was");
    }
    Ok(())
}

/// All frames in order, then frames far from each other.
fn measure(path: &Path, bytes: f64) -> Result<(), Box<dyn Error>> {
    let reader = SequenceReader::open(path)?;
    let count = reader.frame_count();
    let mut all = Vec::new();
    let mut random = Vec::new();
    for _ in 0..REPEATS {
        let clock = Instant::now();
        for frame in reader.frames(0..count) {
            frame?;
        }
        all.push(clock.elapsed().as_secs_f64());
        let clock = Instant::now();
        // Steps of 7919, a prime, visit the frames in a scattered order.
        for i in 0..count {
            reader.frame(i * 7919 % count)?;
        }
        random.push(clock.elapsed().as_secs_f64() / count as f64);
    }
    for times in [&mut all, &mut random] {
        times.sort_by(f64::total_cmp);
    }
    let (best, median) = (all[0], all[REPEATS / 2]);
    let rate = |seconds: f64| bytes / seconds * 1e-9;
    println!(
        "  read all        {:.2} GB/s of file (median {:.2})",
        rate(best),
        rate(median)
    );
    let (best, median) = (random[0] * 1e3, random[REPEATS / 2] * 1e3);
    println!("  a random frame  {best:.4} ms (median {median:.4})");
    Ok(())
}

/// Largest distance of a vertex from its exact place, units.
fn farthest(reader: &SequenceReader, exact: &[Frame]) -> Result<f64, Box<dyn Error>> {
    let mut farthest = 0f64;
    for (found, exact) in reader.frames(0..exact.len()).zip(exact) {
        let found = found?;
        let all = |frame: &Frame| -> Vec<[f32; 3]> {
            let garments = frame.garments.iter().flatten();
            frame.body.iter().chain(garments).copied().collect()
        };
        for (a, b) in all(&found).iter().zip(&all(exact)) {
            let square: f64 = (0..3)
                .map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2))
                .sum();
            farthest = farthest.max(square.sqrt());
        }
    }
    Ok(farthest)
}

/// A sheet of m × n vertices, 1 m wide, that waves while it walks.
fn waves(m: u32, n: u32, frames: usize) -> (SequenceHeader, Vec<Frame>) {
    let grid = || (0..m).flat_map(|i| (0..n).map(move |j| (i, j)));
    let rest: Vec<[f32; 3]> = grid()
        .map(|(i, j)| [i as f32 / (m - 1) as f32, j as f32 / (n - 1) as f32, 0.0].map(|x| x * 10.0))
        .collect();
    let inner = grid().filter(|&(i, j)| i + 1 < m && j + 1 < n);
    let faces: Vec<[u32; 3]> = inner
        .flat_map(|(i, j)| {
            let [a, b] = [i * n + j, (i + 1) * n + j];
            [[a, b, a + 1], [a + 1, b, b + 1]]
        })
        .collect();
    let header = SequenceHeader {
        name: "waves".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "storage_speed".into(),
            engine_version: "1".into(),
            effects: Vec::new(),
            gravity: [0.0; 3],
            body_friction: 0.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: Vec::new(),
            faces: Vec::new(),
            vertex_count: 0,
        },
        garments: vec![Garment {
            name: "sheet".into(),
            kind: GarmentKind::Skirt,
            layer: 0,
            uv: rest.iter().map(|x| [x[0] / 10.0, x[1] / 10.0]).collect(),
            uv_faces: faces.clone(),
            panel_of_face: vec![0; faces.len()],
            panels: vec!["all".into()],
            rest: rest.clone(),
            faces,
            material: Material {
                mass: 0.3,
                tension: 20.0,
                compression: 20.0,
                shear: 20.0,
                bending: 20.0,
                friction: 50.0,
            },
        }],
    };
    let frame = |f: usize| {
        let t = f as f32 / 30.0;
        let wave = |x: &[f32; 3]| {
            let z = (1.3 * x[0] + 5.0 * t).sin() * (0.7 * x[1] + t).cos();
            [x[0] + 12.0 * t, x[1] + 0.1 * z, 12.0 + z]
        };
        Frame {
            garments: vec![rest.iter().map(wave).collect()],
            ..Frame::default()
        }
    };
    (header, (0..frames).map(frame).collect())
}
