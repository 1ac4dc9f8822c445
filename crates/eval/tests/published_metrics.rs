//! The metrics against numbers of the published LayersNet program: two random
//! garments around a random body, error and collision rates.

use drape_dataset::{
    registry::GarmentKind,
    sequence::{BodyTopology, Garment, Material, SceneMeta, SequenceHeader},
};
use drape_eval::metrics::score_frame;
use safetensors::{SafeTensors, tensor::TensorView};

const FILE: &[u8] = include_bytes!("../../../tests/oracle/unit_losses_f32.safetensors");

#[test]
fn errors_and_collision_rates_equal_the_published_programs() {
    let file = SafeTensors::deserialize(FILE).unwrap();
    let points = |name: &str| triples(&floats(&file.tensor(name).unwrap()));
    let integers = |name: &str| -> Vec<u32> {
        let tensor = file.tensor(name).unwrap();
        tensor
            .data()
            .chunks_exact(8)
            .map(|bytes| i64::from_le_bytes(bytes.try_into().unwrap()) as u32)
            .collect()
    };
    let number = |name: &str| f64::from(floats(&file.tensor(name).unwrap())[0]);

    let offsets = integers("offsets");
    let (inner, outer) = (offsets[1] as usize, offsets[2] as usize);
    let faces = triples(&integers("faces"));
    let garment = |kind, layer, from: usize, to: usize| {
        let own = faces
            .iter()
            .filter(|face| (from..to).contains(&(face[0] as usize)));
        garment(
            kind,
            layer,
            to - from,
            own.map(|face| face.map(|vertex| vertex - from as u32))
                .collect(),
        )
    };
    let body = points("body_v");
    let header = header(
        BodyTopology {
            rest: Vec::new(),
            faces: triples(&integers("body_f")),
            vertex_count: body.len(),
        },
        vec![
            garment(GarmentKind::Jumpsuit, 0, 0, inner),
            garment(GarmentKind::Jacket, 1, inner, outer),
        ],
    );
    let split = |points: Vec<[f32; 3]>| vec![points[..inner].to_vec(), points[inner..].to_vec()];
    let score = score_frame(&header, &split(points("pred")), &split(points("gt")), &body);

    let [jumpsuit, jacket] = score.garments.as_slice() else {
        panic!("two garments")
    };
    let all = (jumpsuit.vertices + jacket.vertices) as f64;
    // The published unit is a scene unit; ours a metre, a tenth of it.
    close(
        jumpsuit.error_m * 10.0,
        number("acc.accuracy_l2.jumpsuit_sleeveless"),
    );
    close(jacket.error_m * 10.0, number("acc.accuracy_l2.jacket"));
    close(
        (jumpsuit.inside_body + jacket.inside_body) as f64 / all,
        number("acc.accuracy_collision.garment2human"),
    );
    close(
        jacket.inside_inner.unwrap() as f64 / jacket.vertices as f64,
        number("acc.accuracy_collision.jacket"),
    );
}

fn close(ours: f64, published: f64) {
    assert!(
        (ours - published).abs() <= 1e-5 * published.abs(),
        "ours {ours}, published {published}"
    );
}

fn floats(tensor: &TensorView<'_>) -> Vec<f32> {
    tensor
        .data()
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
        .collect()
}

fn triples<T: Copy>(flat: &[T]) -> Vec<[T; 3]> {
    flat.chunks_exact(3)
        .map(|three| [three[0], three[1], three[2]])
        .collect()
}

fn garment(kind: GarmentKind, layer: u32, vertices: usize, faces: Vec<[u32; 3]>) -> Garment {
    Garment {
        name: format!("layer{layer}"),
        kind,
        layer,
        rest: vec![[0.0; 3]; vertices],
        faces,
        uv: Vec::new(),
        uv_faces: Vec::new(),
        panel_of_face: Vec::new(),
        panels: Vec::new(),
        material: Material {
            mass: 0.5,
            tension: 50.0,
            compression: 50.0,
            shear: 50.0,
            bending: 50.0,
            friction: 60.0,
        },
    }
}

fn header(body: BodyTopology, garments: Vec<Garment>) -> SequenceHeader {
    SequenceHeader {
        name: "published".to_owned(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "published".to_owned(),
            engine_version: String::new(),
            effects: Vec::new(),
            gravity: [0.0; 3],
            body_friction: 60.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body,
        garments,
    }
}
