//! Which drawn outfits do not fit, and how even the meshes of the others are.
//!
//! ```text
//! cargo run --release -p drape-sim --example outfits -- configs/wardrobe.toml SEED DRAWS [EDGE_MM]
//! ```
//! Without EDGE_MM the edge length is the one that the configuration asks for.

use anyhow::{Context, Result, bail};
use drape_geometry::mesh::edges;
use drape_sim::body::Body;
use drape_sim::engine::EngineSettings;
use drape_sim::garment::Outfit;
use drape_sim::scene::SceneRanges;
use glam::Vec3;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (config, seed, draws, edge_mm) = match arguments.as_slice() {
        [config, seed, draws] => (config, seed, draws, None),
        [config, seed, draws, edge_mm] => (config, seed, draws, Some(edge_mm)),
        _ => bail!("expected CONFIG.toml SEED DRAWS [EDGE_MM]"),
    };
    let seed: u64 = seed.parse().context("SEED: expected a number")?;
    let draws: usize = draws.parse().context("DRAWS: expected a number")?;
    let edge_m: Option<f64> = edge_mm
        .map(|text| text.parse::<f64>().context("EDGE_MM: expected a number"))
        .transpose()?
        .map(|edge_mm| edge_mm / 1000.0);
    let ranges = scene_of(config)?;
    let body = Body::load()?;
    let (mut refused, mut even) = (0, Evenness::default());
    for number in 0..draws {
        let name = format!("draw_{number:04}");
        let mut recipe = ranges.sample(&name, number, seed, 1, &EngineSettings::default());
        recipe.edge_m = edge_m.unwrap_or(recipe.edge_m);
        match recipe.outfit(&body, &body.shaped(&recipe.shape)) {
            Ok(outfit) => even.add(&outfit, 10.0 * recipe.edge_m as f32),
            Err(error) => {
                refused += 1;
                let garments = recipe.garments.iter();
                let kinds: Vec<&str> = garments.map(|g| g.parameters.kind.name()).collect();
                println!("{name} {}: {error}", kinds.join(", "));
            }
        }
    }
    println!("{refused} of {draws} draws refused");
    even.print();
    Ok(())
}

/// The table `scene` of a configuration file.
fn scene_of(config: &str) -> Result<SceneRanges> {
    let text = std::fs::read_to_string(config).with_context(|| format!("cannot read {config}"))?;
    let mut table: toml::Table = toml::from_str(&text).with_context(|| config.to_string())?;
    let scene = table.remove("scene").unwrap_or(toml::Table::new().into());
    scene.try_into().with_context(|| config.to_string())
}

/// Edges as multiples of the length asked for, and angles of triangles in degrees.
#[derive(Default)]
struct Evenness {
    lengths: Vec<f32>,
    angles: Vec<f32>,
}

impl Evenness {
    fn add(&mut self, outfit: &Outfit, edge: f32) {
        for garment in &outfit.garments {
            let at = |v: u32| Vec3::from_array(garment.rest[v as usize]);
            let lengths = edges(&garment.faces)
                .into_iter()
                .map(|[a, b]| at(a).distance(at(b)) / edge);
            self.lengths.extend(lengths);
            let smallest = |face: &[u32; 3]| {
                let angle = |k: usize| {
                    let [a, b, c] = [0, 1, 2].map(|j| at(face[(k + j) % 3]));
                    (b - a).angle_between(c - a).to_degrees()
                };
                (0..3).map(angle).fold(180.0, f32::min)
            };
            self.angles.extend(garment.faces.iter().map(smallest));
        }
    }

    fn print(&mut self) {
        let mean = self.lengths.iter().sum::<f32>() / self.lengths.len() as f32;
        let at = |values: &mut Vec<f32>, share: f64| {
            values.sort_by(f32::total_cmp);
            let last = values.len().saturating_sub(1);
            values.get((share * last as f64) as usize).copied()
        };
        let shares = [0.0, 0.001, 0.05, 0.5, 0.95, 1.0];
        println!("edges, as multiples of the length asked for: mean {mean:.3}");
        for share in shares {
            let length = at(&mut self.lengths, share).unwrap_or(f32::NAN);
            println!("  {:>5.1} % below {length:.3}", 100.0 * share);
        }
        println!("smallest angle of a triangle, degrees:");
        for share in &shares[..4] {
            let angle = at(&mut self.angles, *share).unwrap_or(f32::NAN);
            println!("  {:>5.1} % below {angle:.1}", 100.0 * share);
        }
    }
}
