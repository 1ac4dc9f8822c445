//! Outfits at rest, turned round: one frame every 30 degrees, as a sequence
//! file that `drape-inspect` draws.
//!
//! ```text
//! cargo run --release -p drape-sim --example turntable -- OUT.mcap SEED EDGE_MM t-shirt jacket-hood
//! ```
//! Kinds are named inner garment first; cuts and body are drawn with the seed.

use anyhow::{Context, Result, bail};
use drape_dataset::SequenceWriter;
use drape_dataset::random::stream;
use drape_dataset::sequence::{BodyTopology, Frame, Material, SceneMeta, SequenceHeader};
use drape_geometry::mesh::edges;
use drape_sim::body::{Body, ShapeRanges};
use drape_sim::garment::{METRES_PER_UV, Outfit, OutfitRequest};
use drape_sim::scene::CutRange;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, seed, edge_mm, kinds @ ..] = arguments.as_slice() else {
        bail!("expected OUT.mcap SEED EDGE_MM KIND...");
    };
    let seed: u64 = seed.parse().context("SEED: expected a number")?;
    let edge_m = edge_mm
        .parse::<f64>()
        .context("EDGE_MM: expected a number")?
        / 1000.0;
    let material = Material {
        mass: 0.5,
        tension: 50.0,
        compression: 50.0,
        shear: 50.0,
        bending: 50.0,
        friction: 60.0,
    };
    let mut rng = stream(seed, "turntable");
    let shape = ShapeRanges::default().sample(&mut rng);
    let mut garments = Vec::new();
    for kind in kinds {
        let cut = CutRange::All.sample(kind.parse()?, kinds.len() > 1, &mut rng);
        println!("{cut:?}");
        garments.push((cut, material));
    }
    let body = Body::load()?;
    let request = OutfitRequest {
        garments: &garments,
        edge_m,
        trimmed_layers: true,
    };
    let outfit = Outfit::fit(&body, &body.shaped(&shape), &request)?;
    for garment in &outfit.garments {
        let mut lengths: Vec<f32> = edges(&garment.faces)
            .iter()
            .map(|e| {
                let [a, b] = e.map(|v| glam::Vec3::from_array(garment.rest[v as usize]));
                100.0 * a.distance(b)
            })
            .collect();
        lengths.sort_by(f32::total_cmp);
        let at = |share: f64| lengths[(share * (lengths.len() - 1) as f64) as usize];
        println!(
            "{}: {} vertices, panels {:?}, edges in mm: {:.1} shortest, {:.1} 5 %, {:.1} median, {:.1} 95 %, {:.1} longest",
            garment.name,
            garment.rest.len(),
            garment.panels,
            at(0.0),
            at(0.05),
            at(0.5),
            at(0.95),
            at(1.0)
        );
    }
    let header = SequenceHeader {
        name: "turntable".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed,
            engine: "turntable".into(),
            engine_version: env!("CARGO_PKG_VERSION").into(),
            effects: Vec::new(),
            gravity: [0.0; 3],
            body_friction: 0.0,
            metres_per_uv: METRES_PER_UV as f32,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: outfit.body.clone(),
            faces: body.faces().to_vec(),
            vertex_count: body.vertex_count(),
        },
        garments: outfit.garments.clone(),
    };
    let mut writer = SequenceWriter::create(std::path::Path::new(out), &header)?;
    for step in 0..6 {
        let turn = |positions: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let (sin, cos) = (step as f32 * 30.0).to_radians().sin_cos();
            positions
                .iter()
                .map(|&[x, y, z]| [cos * x - sin * y, sin * x + cos * y, z])
                .collect()
        };
        writer.push(&Frame {
            body: turn(&outfit.body),
            garments: outfit.garments.iter().map(|g| turn(&g.rest)).collect(),
            ..Frame::default()
        })?;
    }
    writer.finish()?;
    Ok(())
}
