//! Two small sequences that the published program preprocessed, from
//! `tests/oracle/tiny_preprocess.safetensors`: root-relative positions with the
//! root itself as last row, wind, UV groups, patches and statistics.

use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{
    BodyTopology, Frame, Garment, Material, Root, SceneMeta, SequenceHeader, Wind,
};
use safetensors::{Dtype, SafeTensors};

/// Garment vertices of each of the two garments, and body vertices.
pub const GARMENT: usize = 48;
pub const BODY: usize = 58;
/// Side of a patch in UV units.
pub const PATCH_SIZE: f32 = 0.25;

/// A file's tensors.
pub struct Reference(Vec<u8>);

impl Reference {
    pub fn read(name: &str) -> Self {
        let path = format!(
            "{}/../../tests/oracle/{name}.safetensors",
            env!("CARGO_MANIFEST_DIR")
        );
        Self(std::fs::read(path).unwrap())
    }

    /// A tensor's values, whatever its type.
    pub fn values(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap();
        let data = tensor.data();
        match tensor.dtype() {
            Dtype::F32 => (data.chunks_exact(4))
                .map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())))
                .collect(),
            Dtype::F64 => (data.chunks_exact(8))
                .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
                .collect(),
            Dtype::I64 => (data.chunks_exact(8))
                .map(|b| i64::from_le_bytes(b.try_into().unwrap()) as f64)
                .collect(),
            other => panic!("{name} has type {other:?}"),
        }
    }

    /// Rows of a tensor.
    pub fn rows<const N: usize>(&self, name: &str) -> Vec<[f64; N]> {
        let all = self.values(name);
        all.chunks_exact(N)
            .map(|row| row.try_into().unwrap())
            .collect()
    }

    fn indices<const N: usize>(&self, name: &str) -> Vec<[u32; N]> {
        self.rows::<N>(name)
            .iter()
            .map(|row| row.map(|x| x as u32))
            .collect()
    }

    /// The header of the first sequence; only what patches and samples read is filled.
    pub fn header(&self) -> SequenceHeader {
        // The attribute rows of `tiny_inputs` are these materials', mapped to 0–1.
        let attributes = Reference::read("tiny_inputs").values("attr");
        let raw = |garment: usize, row: usize, low: f64, high: f64| {
            (low + (high - low) * attributes[2 * row + garment]) as f32
        };
        let garments = (0..2).map(|garment| {
            let (mut faces, mut uv, mut uv_faces) = (Vec::new(), Vec::new(), Vec::new());
            let mut panel_of_face = Vec::new();
            for panel in 0..2u32 {
                let name = |part: &str| format!("raw.garment{garment}.uvgroup{panel}.{part}");
                let ids = self.indices::<1>(&name("vertex_ids"));
                let first = uv.len() as u32;
                uv.extend(
                    self.rows::<2>(&name("uv"))
                        .iter()
                        .map(|c| c.map(|x| x as f32)),
                );
                for face in self.indices::<3>(&name("faces")) {
                    uv_faces.push(face.map(|vertex| {
                        let at = ids.iter().position(|id| id[0] == vertex).unwrap();
                        first + at as u32
                    }));
                    faces.push(face);
                    panel_of_face.push(panel);
                }
            }
            Garment {
                name: format!("garment{garment}"),
                kind: GarmentKind::Jacket,
                layer: garment as u32,
                rest: vec![[0.0; 3]; GARMENT],
                faces,
                uv,
                uv_faces,
                panel_of_face,
                panels: vec!["front".into(), "back".into()],
                material: Material {
                    tension: raw(garment, 0, 15.0, 100.0),
                    bending: raw(garment, 1, 15.0, 200.0),
                    mass: raw(garment, 2, 0.2, 0.8),
                    friction: raw(garment, 3, 40.0, 80.0),
                    compression: 0.0,
                    shear: 0.0,
                },
            }
        });
        SequenceHeader {
            name: "00001".into(),
            scene: SceneMeta {
                scale: 10.0,
                fps: 30.0,
                seed: 0,
                engine: "synthetic".into(),
                engine_version: "1".into(),
                effects: Vec::new(),
                gravity: [0.0, 0.0, -98.1],
                body_friction: raw(0, 4, 40.0, 80.0),
                metres_per_uv: 1.0,
                recipe: String::new(),
                warnings: Vec::new(),
            },
            body: BodyTopology {
                rest: Vec::new(),
                faces: self.indices("raw.human_faces"),
                vertex_count: BODY,
            },
            garments: garments.collect(),
        }
    }

    /// Frames of a sequence (`00001` or `00002`) in absolute positions; wind is the first's.
    pub fn frames(&self, sequence: &str) -> Vec<Frame> {
        let rows = 2 * GARMENT + BODY + 1;
        let positions = self.rows::<3>(&format!("{sequence}.h5.position"));
        let winds = self.rows::<5>("h5.wind");
        (positions.chunks_exact(rows).zip(winds))
            .map(|(rows, wind)| {
                let root = rows[rows.len() - 1];
                let absolute: Vec<[f32; 3]> = (rows.iter())
                    .map(|x| [0, 1, 2].map(|axis| (x[axis] + root[axis]) as f32))
                    .collect();
                Frame {
                    garments: vec![
                        absolute[..GARMENT].to_vec(),
                        absolute[GARMENT..2 * GARMENT].to_vec(),
                    ],
                    body: absolute[2 * GARMENT..2 * GARMENT + BODY].to_vec(),
                    root: Root {
                        translation: root.map(|x| x as f32),
                        ..Root::default()
                    },
                    wind: Wind {
                        rotation: [0, 1, 2, 3].map(|i| wind[i] as f32),
                        strength: wind[4] as f32,
                    },
                    intersections: None,
                }
            })
            .collect()
    }
}
