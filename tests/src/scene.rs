//! A small synthetic scene in closed form: one or two tubes of cloth around a
//! capsule, swaying, with a moving root, wind and gravity.
//!
//! Scale 10, 30 fps, Z up. The inner tube is 0.15 units outside the body and 0.15
//! inside the outer tube, so every kind of attention edge occurs. Each tube is one
//! panel with a UV seam. Nothing here is simulated: tests need shapes, not physics.

use std::f64::consts::TAU;
use std::sync::Arc;

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sample::{FrameStates, Outfit, Sample, gravity_per_frame};
use drape_dataset::sequence::{
    BodyTopology, Frame, Garment, Material, Root, SceneMeta, SequenceHeader, Wind,
};
use drape_dataset::statistics::{Statistics, StatisticsBuilder};

const AROUND: usize = 12;
const RINGS: usize = 9;
const HEIGHT: f64 = 3.0;
/// Quads between the rings of a tube, and between those of the body's cylinder.
const BODY_QUADS: usize = 6;
/// Side of a patch in metres; one UV unit is one metre.
pub const PATCH_SIZE_M: f32 = 0.08;

/// What the scene contains.
#[derive(Clone, Copy, Debug)]
pub struct SceneConfig {
    /// Tubes, 1 or 2.
    pub garments: usize,
    /// Whether there is a body.
    pub body: bool,
    /// Whether wind blows.
    pub wind: bool,
    /// Factor of all motion; 0: nothing moves.
    pub motion: f64,
    /// How many times as long as usual garments and body are; everything is as dense as usual.
    pub length: usize,
    /// Where the body stands relative to the garments, in units.
    pub body_offset: [f32; 3],
}

impl SceneConfig {
    /// Rings of a tube, and its height.
    fn tube(&self) -> (usize, f64) {
        ((RINGS - 1) * self.length + 1, HEIGHT * self.length as f64)
    }

    /// Rings of the body: three of each half sphere, the others along the cylinder.
    fn body_rings(&self) -> usize {
        6 + BODY_QUADS * self.length + 1
    }
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self {
            garments: 2,
            body: true,
            wind: true,
            motion: 1.0,
            length: 1,
            body_offset: [0.0; 3],
        }
    }
}

/// A scene: header, and any frame of it.
#[derive(Clone, Debug)]
pub struct Scene {
    config: SceneConfig,
    /// Everything fixed.
    pub header: SequenceHeader,
}

/// Triangles of a tube of quads, and of its UV map, whose seam has its own column.
fn tube_faces(rings: usize) -> (Vec<[u32; 3]>, Vec<[u32; 3]>) {
    let (mut faces, mut uv_faces) = (Vec::new(), Vec::new());
    for ring in 0..rings - 1 {
        for side in 0..AROUND {
            let corner = |up: usize, right: usize, columns: usize| {
                ((ring + up) * columns + (side + right) % columns) as u32
            };
            for [a, b, c] in [[(0, 0), (0, 1), (1, 1)], [(0, 0), (1, 1), (1, 0)]] {
                let triangle = |columns| [a, b, c].map(|(up, right)| corner(up, right, columns));
                faces.push(triangle(AROUND));
                uv_faces.push(triangle(AROUND + 1));
            }
        }
    }
    (faces, uv_faces)
}

/// Where a vertex of a straight tube is.
fn tube_point(vertex: usize, radius: f64, (rings, height): (usize, f64)) -> [f64; 3] {
    let (ring, side) = ((vertex / AROUND) as f64, (vertex % AROUND) as f64);
    let angle = TAU * side / AROUND as f64;
    let z = height * ring / (rings - 1) as f64;
    [radius * angle.cos(), radius * angle.sin(), z]
}

fn tube(name: &str, kind: GarmentKind, layer: u32, (rings, height): (usize, f64)) -> Garment {
    let (faces, uv_faces) = tube_faces(rings);
    let uv = (0..rings)
        .flat_map(|ring| {
            (0..=AROUND).map(move |side| {
                [
                    0.63 * side as f32 / AROUND as f32,
                    0.1 * (height as f32) * ring as f32 / (rings - 1) as f32,
                ]
            })
        })
        .collect();
    Garment {
        name: name.into(),
        kind,
        layer,
        rest: (0..AROUND * rings)
            .map(|vertex| {
                let radius = 1.0 + 0.15 * f64::from(layer);
                tube_point(vertex, radius, (rings, height)).map(|x| x as f32)
            })
            .collect(),
        panel_of_face: vec![0; faces.len()],
        faces,
        uv,
        uv_faces,
        panels: vec!["tube".into()],
        material: Material {
            mass: 0.3 + 0.1 * layer as f32,
            tension: 20.0,
            compression: 20.0,
            shear: 20.0,
            bending: 30.0,
            friction: 50.0,
        },
    }
}

/// Triangles of a closed capsule.
fn body_faces(rings: usize) -> Vec<[u32; 3]> {
    let at = |ring: usize, side: usize| (1 + ring * AROUND + side % AROUND) as u32;
    let top = (1 + rings * AROUND) as u32;
    let mut faces = Vec::new();
    for side in 0..AROUND {
        faces.push([0, at(0, side + 1), at(0, side)]);
        faces.push([top, at(rings - 1, side), at(rings - 1, side + 1)]);
        for ring in 0..rings - 1 {
            let (a, b, c, d) = (
                at(ring, side),
                at(ring, side + 1),
                at(ring + 1, side + 1),
                at(ring + 1, side),
            );
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    faces
}

/// Capsule of radius 0.85 around the garments' axis, `[vertex, 3]`.
fn capsule(config: &SceneConfig) -> Vec<[f64; 3]> {
    let (rings, (_, height)) = (config.body_rings(), config.tube());
    let radius = 0.85;
    let (low, high) = (-0.2, height + 0.2);
    let mut points = vec![[0.0, 0.0, low - radius]];
    for ring in 0..rings {
        let (r, z) = match ring {
            0..3 => {
                let angle = TAU / 4.0 * (ring as f64 + 1.0) / 4.0;
                (radius * angle.sin(), low - radius * angle.cos())
            }
            _ if ring + 3 >= rings => {
                let angle = TAU / 4.0 * (rings - ring) as f64 / 4.0;
                (radius * angle.sin(), high + radius * angle.cos())
            }
            _ => (
                radius,
                low + (high - low) * (ring - 3) as f64 / (rings - 7) as f64,
            ),
        };
        points.extend((0..AROUND).map(|side| {
            let angle = TAU * side as f64 / AROUND as f64;
            [r * angle.cos(), r * angle.sin(), z]
        }));
    }
    points.push([0.0, 0.0, high + radius]);
    points
}

impl Scene {
    /// The scene of a configuration.
    pub fn new(config: SceneConfig) -> Self {
        let kinds = [
            ("inner", GarmentKind::Dress),
            ("outer", GarmentKind::Jacket),
        ];
        let garments = kinds[..config.garments].iter().enumerate();
        let body = if config.body {
            capsule(&config)
        } else {
            Vec::new()
        };
        let mut effects = vec![Effect::Gravity];
        effects.extend(config.wind.then_some(Effect::Wind));
        let header = SequenceHeader {
            name: "synthetic".into(),
            scene: SceneMeta {
                scale: 10.0,
                fps: 30.0,
                seed: 0,
                engine: "closed form".into(),
                engine_version: "1".into(),
                effects,
                gravity: [0.0, 0.0, -98.1],
                body_friction: 60.0,
                metres_per_uv: 1.0,
                recipe: String::new(),
                warnings: Vec::new(),
            },
            body: BodyTopology {
                rest: body.iter().map(|x| x.map(|x| x as f32)).collect(),
                faces: if config.body {
                    body_faces(config.body_rings())
                } else {
                    Vec::new()
                },
                vertex_count: body.len(),
            },
            garments: garments
                .map(|(layer, &(name, kind))| tube(name, kind, layer as u32, config.tube()))
                .collect(),
        };
        Self { config, header }
    }

    /// Frame `index`.
    pub fn frame(&self, index: usize) -> Frame {
        let t = 0.2 * index as f64;
        let motion = self.config.motion;
        let root = [
            0.4 * motion * t.sin(),
            0.25 * motion * (0.7 * t).cos(),
            9.0 + 0.1 * motion * (1.3 * t).sin(),
        ];
        let place = |x: [f64; 3], sway: [f64; 3]| {
            [0, 1, 2].map(|axis| (x[axis] + sway[axis] + root[axis]) as f32)
        };
        let body_sway = [
            0.03 * motion * (1.1 * t).sin(),
            0.02 * motion * t.cos(),
            0.0,
        ];
        let points = if self.config.body {
            capsule(&self.config)
        } else {
            Vec::new()
        };
        let offset = self.config.body_offset;
        let body = points
            .into_iter()
            .map(|x| {
                let x = place(x, body_sway);
                [0, 1, 2].map(|axis| x[axis] + offset[axis])
            })
            .collect();
        let (rings, height) = self.config.tube();
        let garments = (0..self.config.garments)
            .map(|layer| {
                let lag = t - 0.5 - 0.3 * layer as f64;
                (0..AROUND * rings)
                    .map(|vertex| {
                        let (ring, side) = ((vertex / AROUND) as f64, (vertex % AROUND) as f64);
                        let angle = TAU * side / AROUND as f64;
                        let ripple = 0.03 * (3.0 * angle + ring + motion * lag).sin();
                        let radius = 1.0 + 0.15 * layer as f64 + ripple;
                        let z = height * ring / (rings - 1) as f64
                            + 0.02 * (2.0 * angle - motion * lag).cos();
                        let sway = [
                            0.03 * motion * (1.1 * lag).sin(),
                            0.02 * motion * lag.cos(),
                            0.0,
                        ];
                        place([radius * angle.cos(), radius * angle.sin(), z], sway)
                    })
                    .collect()
            })
            .collect();
        let wind = if self.config.wind {
            Wind {
                rotation: [0.8, 0.6, 0.0, 0.0],
                strength: 150.0,
            }
        } else {
            Wind::default()
        };
        Frame {
            body,
            root: Root {
                translation: root.map(|x| x as f32),
                rotation: [1.0, 0.0, 0.0, 0.0],
            },
            garments,
            wind,
            intersections: None,
        }
    }

    /// Frames `0..count`.
    pub fn frames(&self, count: usize) -> Vec<Frame> {
        (0..count).map(|index| self.frame(index)).collect()
    }

    /// The outfit.
    pub fn outfit(&self) -> Arc<Outfit> {
        Arc::new(Outfit::new(&self.header, PATCH_SIZE_M).expect("tubes have UV"))
    }

    /// States and statistics of the first `count` frames.
    pub fn states(&self, count: usize) -> (Vec<FrameStates>, Statistics) {
        states_of(&self.frames(count))
    }

    /// A sample that starts at frame 3 and makes `steps` steps, with the scene's statistics.
    pub fn sample(&self, steps: usize) -> (Sample, Statistics) {
        let (states, statistics) = self.states(4 + steps.max(8));
        let sample = Sample::new(
            self.outfit(),
            &states[2..4 + steps],
            &statistics,
            gravity_per_frame(&self.header),
        );
        (sample, statistics)
    }
}

/// States and statistics of frames.
pub fn states_of(frames: &[Frame]) -> (Vec<FrameStates>, Statistics) {
    let states: Vec<FrameStates> = (0..frames.len())
        .map(|f| {
            let older = |back: usize| f.checked_sub(back).map(|index| &frames[index]);
            FrameStates::new(&frames[f], older(1), older(2))
        })
        .collect();
    let mut builder = StatisticsBuilder::default();
    for two in states.windows(2).skip(1) {
        two[1].collect(&two[0], &mut builder);
    }
    (states, builder.finish())
}
