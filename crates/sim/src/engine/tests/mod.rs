//! Does the engine obey the laws it claims? Small meshes, closed forms.
//!
//! | file | asks |
//! |---|---|
//! | [`laws`] | fall, elongation, friction angle, terminal speed, momentum, energy |
//! | [`effects`] | what is not called for never runs and changes no bit |
//! | [`contacts`] | layers on a moving body stay apart; what is inside comes out |
//! | [`profiles`] | where time goes: every effect has its row, asking changes nothing |
//! | [`robust`] | extreme and bad input |
//! | [`verification`] | pendulum, catenary, order of convergence, energy, a long gale |

mod contacts;
mod effects;
mod laws;
mod profiles;
mod robust;
mod verification;

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{Garment, Material, Wind};

use super::{AIR_DENSITY, Engine, EngineSettings, ScenePhysics};

const FRAME_S: f64 = 1.0 / 30.0;

const MATERIAL: Material = Material {
    mass: 0.4,
    tension: 40.0,
    compression: 40.0,
    shear: 40.0,
    bending: 40.0,
    friction: 50.0,
};

/// Sheet of nearly equilateral triangles, `columns` × `rows` vertices, first row pinned nowhere;
/// `place` maps (along, across) in units to space.
fn sheet(
    columns: u32,
    rows: u32,
    edge: f32,
    layer: u32,
    place: impl Fn(f32, f32) -> [f32; 3],
) -> Garment {
    let mut rest = Vec::new();
    let mut uv = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let along = edge * (column as f32 + 0.5 * (row % 2) as f32);
            let across = edge * 0.75_f32.sqrt() * row as f32;
            rest.push(place(along, across));
            uv.push([0.1 * along, 0.1 * across]);
        }
    }
    let mut faces = Vec::new();
    for row in 0..rows - 1 {
        for column in 0..columns - 1 {
            let at = |c: u32, r: u32| r * columns + c;
            let [a, b] = [at(column, row), at(column + 1, row)];
            let [c, d] = [at(column, row + 1), at(column + 1, row + 1)];
            if row % 2 == 0 {
                faces.extend([[a, b, c], [b, d, c]]);
            } else {
                faces.extend([[a, d, c], [a, b, d]]);
            }
        }
    }
    Garment {
        name: format!("sheet {layer}"),
        kind: GarmentKind::Skirt,
        layer,
        rest,
        panel_of_face: vec![0; faces.len()],
        uv_faces: faces.clone(),
        faces,
        uv,
        panels: vec!["sheet".into()],
        material: MATERIAL,
    }
}

fn physics(effects: &[Effect]) -> ScenePhysics {
    ScenePhysics {
        scale: 10.0,
        gravity: [0.0, 0.0, -98.1],
        air_density: AIR_DENSITY,
        body_friction: 50.0,
        effects: effects.iter().copied().collect(),
    }
}

/// Everything but wind and waist bands.
const USUAL: [Effect; 9] = [
    Effect::Gravity,
    Effect::AirDrag,
    Effect::Stretch,
    Effect::Shear,
    Effect::Bending,
    Effect::BodyContact,
    Effect::LayerContact,
    Effect::SelfContact,
    Effect::Friction,
];

fn engine(garments: &[Garment], body: &Body, effects: &[Effect]) -> Engine {
    let settings = EngineSettings::default();
    Engine::new(
        garments,
        &[],
        &body.faces,
        &body.positions,
        &physics(effects),
        &settings,
    )
    .unwrap()
}

/// A collider.
#[derive(Clone, Default)]
struct Body {
    positions: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
}

impl Body {
    /// A square in the plane z = 0 turned by `angle` around y, facing upwards.
    fn ramp(angle: f32, half: f32) -> Self {
        let at = |x: f32, y: f32| [x * angle.cos(), y, -x * angle.sin()];
        Self {
            positions: vec![
                at(-half, -half),
                at(half, -half),
                at(half, half),
                at(-half, half),
            ],
            faces: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    /// A ball of rings.
    fn ball(centre: [f32; 3], radius: f32) -> Self {
        let (rings, sides) = (9u32, 16u32);
        let mut positions = Vec::new();
        for ring in 0..=rings {
            let polar = std::f32::consts::PI * ring as f32 / rings as f32;
            let count = if ring == 0 || ring == rings { 1 } else { sides };
            for side in 0..count {
                let turn = std::f32::consts::TAU * side as f32 / sides as f32;
                let direction = [
                    polar.sin() * turn.cos(),
                    polar.sin() * turn.sin(),
                    polar.cos(),
                ];
                positions.push(std::array::from_fn(|k| centre[k] + radius * direction[k]));
            }
        }
        let at = |ring: u32, side: u32| {
            if ring == 0 {
                0
            } else if ring == rings {
                positions.len() as u32 - 1
            } else {
                1 + (ring - 1) * sides + side % sides
            }
        };
        let mut faces = Vec::new();
        for ring in 0..rings {
            for side in 0..sides {
                let (a, b) = (at(ring, side), at(ring, side + 1));
                let (c, d) = (at(ring + 1, side), at(ring + 1, side + 1));
                if ring > 0 {
                    faces.push([a, c, b]);
                }
                if ring + 1 < rings {
                    faces.push([b, c, d]);
                }
            }
        }
        Self { positions, faces }
    }

    fn moved(&self, by: [f32; 3]) -> Vec<[f32; 3]> {
        self.positions
            .iter()
            .map(|p| std::array::from_fn(|k| p[k] + by[k]))
            .collect()
    }
}

/// Wind along +X.
fn wind(strength: f32) -> Wind {
    let half = 0.5_f32.sqrt();
    Wind {
        rotation: [half, 0.0, half, 0.0],
        strength,
    }
}

fn bits(engine: &Engine) -> Vec<u32> {
    engine
        .garments()
        .iter()
        .flatten()
        .flatten()
        .map(|x| x.to_bits())
        .collect()
}
