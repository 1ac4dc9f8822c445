//! Small headers and meshes that tests of this crate share.

use drape_dataset::{
    registry::GarmentKind,
    sequence::{BodyTopology, Garment, Material, SceneMeta, SequenceHeader},
};

use crate::task::Positions;

/// A header with empty meshes at scale 10; garments are `(kind, layer)`.
pub fn header(garments: &[(GarmentKind, u32)]) -> SequenceHeader {
    let material = Material {
        mass: 0.5,
        tension: 50.0,
        compression: 50.0,
        shear: 50.0,
        bending: 50.0,
        friction: 60.0,
    };
    let garment = |(number, (kind, layer)): (usize, &(GarmentKind, u32))| Garment {
        name: format!("garment{number}"),
        kind: *kind,
        layer: *layer,
        rest: Vec::new(),
        faces: Vec::new(),
        uv: Vec::new(),
        uv_faces: Vec::new(),
        panel_of_face: Vec::new(),
        panels: Vec::new(),
        material,
    };
    SequenceHeader {
        name: "example".to_owned(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "test".to_owned(),
            engine_version: "0".to_owned(),
            effects: Vec::new(),
            gravity: [0.0, 0.0, -98.1],
            body_friction: 60.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: Vec::new(),
            faces: Vec::new(),
            vertex_count: 0,
        },
        garments: garments.iter().enumerate().map(garment).collect(),
    }
}

/// An open tube around Z with outward normals: `around` columns, `rings` rings one unit apart.
pub fn tube(radius: f32, around: u32, rings: u32) -> (Positions, Vec<[u32; 3]>) {
    let points = (0..rings)
        .flat_map(|ring| {
            (0..around).map(move |column| {
                let angle = std::f32::consts::TAU * column as f32 / around as f32;
                [radius * angle.cos(), radius * angle.sin(), ring as f32]
            })
        })
        .collect();
    let faces = (0..rings - 1)
        .flat_map(|ring| {
            (0..around).flat_map(move |column| {
                let [a, b] = [column, (column + 1) % around].map(|column| ring * around + column);
                [[a, b, b + around], [a, b + around, a + around]]
            })
        })
        .collect();
    (points, faces)
}
