//! Outfits of a known size: two tubes of cloth over a tube of a body.
//!
//! The tubes flare towards the hem, as a skirt does, so that the share of patches
//! beyond the body's reach is that of real outfits. Sizes are those at which the
//! published program was timed.

use std::f64::consts::TAU;
use std::sync::Arc;

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sample::{FrameStates, Outfit, Sample, gravity_per_frame};
use drape_dataset::sequence::{
    BodyTopology, Frame, Garment, Material, Root, SceneMeta, SequenceHeader, Wind,
};
use drape_dataset::statistics::{Statistics, StatisticsBuilder};

/// Shape of a case; lengths in units (0.1 m).
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Vertices around and rings of each garment.
    pub garment: (usize, usize),
    /// Vertices around and rings of the body.
    pub body: (usize, usize),
    /// Height of garments and body.
    pub height: (f64, f64),
    /// Radius of the body.
    pub radius: f64,
    /// Distance of the inner garment from the body, and of the outer from the inner.
    pub gaps: (f64, f64),
    /// How much wider the garments are at the hem than at the top.
    pub flare: f64,
    /// Patches around and along each garment.
    pub cells: (usize, usize),
}

/// 600 vertices, 200 patches and 200 body vertices.
pub const SMALL: Shape = Shape {
    garment: (34, 9),
    body: (20, 10),
    height: (3.316, 5.511),
    radius: 0.557,
    gaps: (0.051, 0.041),
    flare: 0.272,
    cells: (17, 6),
};

/// 3,000 vertices, 1,200 patches and 1,514 body vertices.
pub const MEDIUM: Shape = Shape {
    garment: (62, 24),
    body: (65, 23),
    height: (8.852, 21.949),
    radius: 1.383,
    gaps: (0.151, 0.141),
    flare: 0.317,
    cells: (26, 23),
};

/// 8,000 vertices, 1,200 patches and 6,890 body vertices.
pub const LARGE: Shape = Shape {
    garment: (51, 78),
    body: (97, 71),
    height: (9.069, 26.965),
    radius: 1.265,
    gaps: (0.29, 0.185),
    flare: 0.005,
    cells: (24, 25),
};

impl Shape {
    /// An outfit of about `vertices` at the same density: garments and body grow
    /// along their axis, and patches with them.
    pub fn grown(self, vertices: usize) -> Self {
        let rings = (vertices as f64 / (2 * self.garment.0) as f64).round() as usize;
        let factor = (rings - 1) as f64 / (self.garment.1 - 1) as f64;
        let scaled = |count: usize| ((count as f64 * factor).round() as usize).max(1);
        Self {
            garment: (self.garment.0, rings),
            body: (self.body.0, scaled(self.body.1)),
            height: (self.height.0 * factor, self.height.1 * factor),
            cells: (self.cells.0, scaled(self.cells.1)),
            ..self
        }
    }
}

/// A case ready to run.
pub struct Case {
    /// The sample: state, one step, its reference.
    pub sample: Sample,
    /// Statistics of its frames.
    pub statistics: Statistics,
    /// What was made.
    pub header: SequenceHeader,
    /// The body at the frame before the sample's, at it, and after it; no garments.
    pub frames: [Frame; 3],
}

fn tube_faces(around: usize, rings: usize, seam: bool) -> Vec<[u32; 3]> {
    let columns = if seam { around + 1 } else { around };
    let at = |ring: usize, side: usize| (ring * columns + side % columns) as u32;
    (0..rings - 1)
        .flat_map(|ring| (0..around).map(move |side| (ring, side)))
        .flat_map(|(ring, side)| {
            let (a, b) = (at(ring, side), at(ring, side + 1));
            let (c, d) = (at(ring + 1, side + 1), at(ring + 1, side));
            // Diagonals alternate, as in a remeshed garment no direction is special.
            if (ring + side) % 2 == 0 {
                [[a, b, c], [a, c, d]]
            } else {
                [[a, b, d], [b, c, d]]
            }
        })
        .collect()
}

/// Points of a tube; `radius` by height from 0 to 1.
fn tube(
    (around, rings): (usize, usize),
    height: f64,
    radius: impl Fn(f64) -> f64,
    sway: f64,
) -> Vec<[f32; 3]> {
    let mut points = Vec::with_capacity(around * rings);
    for ring in 0..rings {
        let up = ring as f64 / (rings - 1) as f64;
        for side in 0..around {
            let angle = TAU * side as f64 / around as f64;
            let r = radius(up) * (1.0 + 0.01 * (3.0 * angle + 5.0 * up).sin());
            let swing = sway * (2.0 * angle + 4.0 * up).sin();
            points.push([
                (r * angle.cos() + swing) as f32,
                (r * angle.sin()) as f32,
                ((up - 0.5) * height + 0.3 * swing) as f32,
            ]);
        }
    }
    points
}

/// Makes the case of a shape.
pub fn make(shape: &Shape) -> anyhow::Result<Case> {
    // One UV unit across both axes: cells are squares in UV, as high and wide as they come.
    let (across, along) = (shape.cells.0 as f32, shape.cells.1 as f32);
    let patch_size = 1.0 / across.max(along);
    let (around, rings) = shape.garment;
    let garment = |name: &str, kind, layer| Garment {
        name: name.into(),
        kind,
        layer,
        rest: vec![[0.0; 3]; around * rings],
        faces: tube_faces(around, rings, false),
        uv: (0..rings)
            .flat_map(|ring| {
                (0..=around).map(move |side| {
                    [
                        patch_size * across * side as f32 / around as f32,
                        patch_size * along * ring as f32 / (rings - 1) as f32,
                    ]
                })
            })
            .collect(),
        uv_faces: tube_faces(around, rings, true),
        panel_of_face: vec![0; 2 * around * (rings - 1)],
        panels: vec!["tube".into()],
        material: Material {
            mass: 0.3 + 0.1 * layer as f32,
            tension: 20.0,
            compression: 20.0,
            shear: 20.0,
            bending: 30.0,
            friction: 50.0,
        },
    };
    let garments = vec![
        garment("inner", GarmentKind::Skirt, 0),
        garment("outer", GarmentKind::Dress, 1),
    ];
    let header = SequenceHeader {
        name: "bench".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "bench".into(),
            engine_version: String::new(),
            effects: vec![Effect::Gravity, Effect::Wind],
            gravity: [0.0, 0.0, -98.1],
            body_friction: 50.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: Vec::new(),
            faces: tube_faces(shape.body.0, shape.body.1, false),
            vertex_count: shape.body.0 * shape.body.1,
        },
        garments,
    };
    let frame = |f: usize| {
        let phase = 0.2 * f as f64;
        let layer = |gap: f64| {
            let radius = move |up: f64| shape.radius + gap + shape.flare * (1.0 - up).powi(2);
            tube(shape.garment, shape.height.0, radius, 0.05 * phase.sin())
        };
        Frame {
            body: tube(
                shape.body,
                shape.height.1,
                |_| shape.radius,
                0.04 * phase.sin(),
            ),
            root: Root {
                translation: [0.1 * f as f32, 0.02 * (f as f32).powi(2), 0.0],
                ..Root::default()
            },
            garments: vec![layer(shape.gaps.0), layer(shape.gaps.0 + shape.gaps.1)],
            wind: Wind {
                rotation: [0.8, 0.6, 0.0, 0.0],
                strength: 120.0,
            },
            intersections: None,
        }
    };
    let frames: Vec<Frame> = (0..5).map(frame).collect();
    let states: Vec<FrameStates> = (2..5)
        .map(|f| FrameStates::new(&frames[f], Some(&frames[f - 1]), Some(&frames[f - 2])))
        .collect();
    let mut builder = StatisticsBuilder::default();
    for two in states.windows(2) {
        two[1].collect(&two[0], &mut builder);
    }
    let statistics = builder.finish();
    let outfit = Arc::new(Outfit::new(&header, patch_size)?);
    let sample = Sample::new(outfit, &states, &statistics, gravity_per_frame(&header));
    let frames = [1, 2, 3].map(|f: usize| Frame {
        garments: Vec::new(),
        ..frames[f + 1].clone()
    });
    Ok(Case {
        sample,
        statistics,
        header,
        frames,
    })
}

#[cfg(test)]
mod tests {
    use drape_model::{FrameGraph, ModelConfig};

    use super::*;

    /// Vertices, body vertices, patches; mesh, world and body entries per patch (repeats counted), of
    /// them distinct; body vertices in use.
    fn sizes(shape: &Shape) -> [f64; 8] {
        let case = make(shape).unwrap();
        let (outfit, sample) = (&case.sample.outfit, &case.sample);
        let config = ModelConfig::released();
        let graph = FrameGraph::new(&config, outfit, &sample.state, &sample.steps[0]).unwrap();
        let patches = outfit.patches.count() as f64;
        let logs = graph.edges.body_log_count.iter();
        let repeats: f64 = logs.map(|log| f64::from(log.exp())).sum();
        [
            outfit.vertices() as f64,
            outfit.body_vertices as f64,
            patches,
            graph.edges.mesh.items.len() as f64 / patches,
            graph.edges.world.items.len() as f64 / patches,
            repeats / patches - 2.0,
            graph.edges.body.items.len() as f64 / patches - 2.0,
            graph.body_tokens as f64,
        ]
    }

    #[test]
    fn sizes_are_the_published_ones_within_five_percent() {
        for (name, shape, published) in [
            (
                "small",
                SMALL,
                [600.0, 200.0, 200.0, 12.6, 3.0, 16.0, 8.1, 117.0],
            ),
            (
                "medium",
                MEDIUM,
                [3000.0, 1514.0, 1200.0, 15.3, 1.8, 13.4, 5.2, 571.0],
            ),
            (
                "large",
                LARGE,
                [8000.0, 6890.0, 1200.0, 10.9, 1.8, 13.6, 13.0, 2414.0],
            ),
        ] {
            for (index, (found, expected)) in sizes(&shape).into_iter().zip(published).enumerate() {
                let off = (found / expected - 1.0).abs();
                assert!(
                    off <= 0.05,
                    "{name}, size {index}: {found}, published {expected}"
                );
            }
        }
    }

    #[test]
    fn grown_outfits_have_the_density_of_the_first() {
        let [first, grown] = [1000, 8000].map(|vertices| sizes(&MEDIUM.grown(vertices)));
        assert!((grown[0] / 8000.0 - 1.0).abs() < 0.02);
        // Patches and body grow alike, neighbours stay as many; ends count less on a longer tube.
        for index in [1, 2, 7] {
            let growth = grown[index] / first[index];
            assert!(
                (growth / 8.0 - 1.0).abs() < 0.2,
                "size {index} grew {growth} times"
            );
        }
        for index in 3..7 {
            let off = (grown[index] / first[index] - 1.0).abs();
            assert!(
                off < 0.2,
                "size {index}: {} and {}",
                first[index],
                grown[index]
            );
        }
    }
}
