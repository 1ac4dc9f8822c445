//! Units against the published program's: the attention, a whole block, the
//! attention's weights alone, losses, and geometry, each with gradients.
//!
//! The unit cases give every (receiver, slot) its own body token and rotation, and
//! have receivers without world entries (3), body slots (4), both (5), mesh
//! entries (6) and any entry (7). Inputs of f32 cases are the f64 ones rounded.
//! Rotations and body positions are f32 in our types, so f64 results that
//! depend on them agree to 1e-6; all others to 1e-12.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use candle_core::{DType, Tensor, Var};
use drape_dataset::patches::{Csr, Patches};
use drape_dataset::registry::GarmentKind;
use drape_dataset::sample::{Outfit, rotation_matrix};
use drape_geometry::grid::Grid;
use drape_geometry::mesh::on_border;
use drape_geometry::normals::face_normals;
use drape_model::block::{Blocks, Tokens};
use drape_model::frames::{Matrix, frame};
use drape_model::kernels::attention::{Edges, GROUPS, attend};
use drape_model::kernels::linear::product;
use drape_model::kernels::row_map::{RowMap, map_rows};
use drape_model::parameters::group_rotation_name;
use drape_model::{FrameAxis, ModelConfig, Parameters};
use drape_tests::dense_attention::dense_weights;
use drape_tests::oracle::{Tensors, relative};
use drape_train::losses::collision::{CollisionRoom, body_collision, layer_collision};
use drape_train::losses::normal::{MeshNormals, NormalRoom, normal_loss};
use drape_train::losses::{LossConfig, Term, squared_error};

const P: usize = 24;
const T: usize = 26;
const K: usize = 6;
const BLOCK: &str = "backbone.encoder.layers.0.";

fn read(name: &str) -> Tensors {
    Tensors::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("oracle"), name).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor
        .to_dtype(DType::F64)
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap()
}

fn triples<const N: usize>(values: &[f64]) -> Vec<[f32; N]> {
    values
        .chunks_exact(N)
        .map(|row| std::array::from_fn(|i| row[i] as f32))
        .collect()
}

fn close(what: &str, found: &[f64], reference: &[f64], bar: f64) {
    let difference = relative(found, reference);
    assert!(difference <= bar, "{what}: {difference} > {bar}");
}

/// The attention of the first block without residuals and norms, from the fused kernel and candle's
/// own products: Z', `r_proj(r)`, `s_proj(s)`.
fn attention_alone(parameters: &Parameters, tokens: &Tokens, edges: Arc<Edges>) -> Tokens {
    let weight = |name: &str| {
        let name = format!("{BLOCK}self_attn.attn.{name}");
        parameters.get(&name).unwrap().as_tensor().clone()
    };
    let product = |x: &Tensor, w: &Tensor| x.matmul(&w.t().unwrap()).unwrap();
    let map = |x: &Tensor, name: &str| product(x, &weight(&format!("{name}.weight")));
    let affine = |x: &Tensor, name: &str| {
        let bias = weight(&format!("{name}.bias"));
        map(x, name).broadcast_add(&bias).unwrap()
    };
    let patches = tokens.state.narrow(0, 0, P).unwrap();
    let stream = |z: &Tensor, name: &str, memory: &Tensor| {
        let remembered = (map(memory, "memory_weight") + memory).unwrap();
        (map(z, name) + remembered).unwrap()
    };
    let r = stream(&patches, "receiver_weight", &tokens.receiver);
    let s = stream(&tokens.state, "sender_weight", &tokens.sender);
    let q = map(&patches, "q_proj.layers.0");
    let mut groups = Vec::new();
    for group in 0..GROUPS {
        let mlp = format!("rs_mlp.group_layers.{group}.layers.0");
        let rotation = parameters.get(&group_rotation_name(0, group)).unwrap();
        groups.push(rotation.flatten_all().unwrap());
        groups.push(weight(&format!("{mlp}.weight")).flatten_all().unwrap());
        groups.push(weight(&format!("{mlp}.bias")));
    }
    let attended = attend(
        &Tensor::cat(&[&r, &q, &s], 0).unwrap(),
        &Tensor::cat(&groups, 0).unwrap(),
        edges,
        false,
    )
    .unwrap();
    let flat = |name: &str| weight(name).reshape((1, 128)).unwrap();
    let scaled = attended.broadcast_mul(&flat("n_weight")).unwrap();
    let scaled = scaled.broadcast_add(&flat("n_bias")).unwrap();
    let output = affine(&scaled, "proj.layers.0");
    let rows = tokens.state.dim(0).unwrap();
    let others = tokens.state.narrow(0, P, rows - P).unwrap();
    Tokens {
        state: Tensor::cat(&[&output, &others], 0).unwrap(),
        receiver: affine(&r, "r_proj.layers.0"),
        sender: affine(&s, "s_proj.layers.0"),
    }
}

/// A unit case: inputs, weights, cotangents, and what the port makes of them.
struct Unit {
    outputs: BTreeMap<&'static str, Tensor>,
    inputs: BTreeMap<&'static str, Var>,
    gradients: candle_core::backprop::GradStore,
    by_weight: BTreeMap<String, Tensor>,
}

impl Unit {
    /// Runs the first block, or its attention only, on a file's inputs and weights.
    fn run(inputs: &Tensors, dtype: DType, whole_block: bool) -> Self {
        let config = ModelConfig {
            blocks: 1,
            ..ModelConfig::released()
        };
        let fresh = Parameters::new(&config, 0).unwrap();
        let mut tensors: BTreeMap<String, Tensor> = fresh
            .iter()
            .map(|(name, variable)| (name.to_string(), variable.as_tensor().clone()))
            .collect();
        let weights = read("unit_encoder_layer_f32");
        for name in weights.names("w.") {
            let old = tensors.insert(
                format!("{BLOCK}{name}"),
                weights.get(&format!("w.{name}")).unwrap().clone(),
            );
            assert!(old.is_some(), "{name} is no weight of a block");
        }
        let parameters = Parameters::from_tensors(tensors, &config, dtype).unwrap();

        let tensor = |name: &str, rows: usize| {
            // The f64 case's inputs pass through f32 for the f32 case.
            inputs
                .get(name)
                .unwrap()
                .reshape((rows, 128))
                .unwrap()
                .to_dtype(dtype)
                .unwrap()
        };
        let variables: BTreeMap<&'static str, Var> = [
            ("x_state", T),
            ("x_receiver", P),
            ("x_sender", T),
            ("h_state", P * K),
            ("h_sender", P * K),
        ]
        .map(|(name, rows)| {
            (
                name,
                Var::from_tensor(&tensor(&format!("in.{name}"), rows)).unwrap(),
            )
        })
        .into();
        let part = |name: &str| variables[name].as_tensor();
        let tokens = Tokens {
            state: Tensor::cat(&[part("x_state"), part("h_state")], 0).unwrap(),
            receiver: part("x_receiver").clone(),
            sender: Tensor::cat(&[part("x_sender"), part("h_sender")], 0).unwrap(),
        };
        let edges = Arc::new(edges(inputs));
        let blocks = Blocks::trainable(&config, &parameters).unwrap();
        let result = if whole_block {
            blocks.everything(&tokens, &edges).unwrap()
        } else {
            attention_alone(&parameters, &tokens, edges)
        };
        let Tokens {
            state,
            receiver,
            sender,
        } = result;
        let rows = |tensor: &Tensor, start, count| tensor.narrow(0, start, count).unwrap();
        let outputs: BTreeMap<&'static str, Tensor> = [
            ("x", rows(&state, 0, T)),
            ("h_state", rows(&state, T, P * K)),
            ("receiver", receiver),
            ("sender", rows(&sender, 0, T)),
            ("h_sender", rows(&sender, T, P * K)),
        ]
        .into();
        let loss = outputs
            .iter()
            .map(|(name, out)| {
                (out * tensor(&format!("cot.{name}"), out.dim(0).unwrap()))
                    .unwrap()
                    .sum_all()
                    .unwrap()
            })
            .reduce(|a, b| (a + b).unwrap())
            .unwrap();
        let gradients = loss.backward().unwrap();
        let mut by_weight = blocks.gradients(&parameters, &gradients).unwrap();
        for (name, variable) in parameters.iter() {
            if let Some(gradient) = gradients.get(variable) {
                by_weight.insert(name.into(), gradient.clone());
            }
        }
        Self {
            outputs,
            inputs: variables,
            gradients,
            by_weight,
        }
    }

    /// Compares every output and gradient that a file holds; returns how many there were.
    fn compare(&self, reference: &Tensors, weight_prefix: &str, bar: f64) -> usize {
        let mut count = 0;
        let mut check = |name: String, found: &Tensor| {
            close(&name, &flat(found), &reference.values(&name).unwrap(), bar);
            count += 1;
        };
        for name in reference.names("out.") {
            check(format!("out.{name}"), &self.outputs[name]);
        }
        for name in reference.names("grad.") {
            check(
                format!("grad.{name}"),
                self.gradients.get(&self.inputs[name]).unwrap(),
            );
        }
        for name in reference.names("gradw.") {
            let weight = format!("{BLOCK}{weight_prefix}{name}");
            check(format!("gradw.{name}"), &self.by_weight[&weight]);
        }
        count
    }
}

fn edges(inputs: &Tensors) -> Edges {
    let lists = |mask: &[f64], columns: usize, each: fn(usize, usize) -> usize| {
        let entries = mask.iter().enumerate().filter(|(_, value)| **value > 0.0);
        let pairs = entries.map(|(at, _)| {
            let (row, column) = (at / columns, at % columns);
            (row as u32, each(row, column) as u32)
        });
        Csr::from_pairs(P, pairs.collect())
    };
    let mask = inputs.values("in.rs_mask").unwrap();
    let (world, mesh) = mask.split_at(P * T);
    let body = lists(&inputs.values("in.h_rs_mask").unwrap(), K, |row, slot| {
        K * row + slot
    });
    let rotations = triples::<9>(&inputs.values("in.h_rotation").unwrap());
    Edges {
        mesh: lists(mesh, T, |_, column| column),
        world: lists(world, T, |_, column| column),
        body_log_count: vec![0.0; body.items.len()],
        body,
        rotations: rotations
            .iter()
            .map(|r| [0, 1, 2].map(|row| [0, 1, 2].map(|column| r[3 * row + column])))
            .collect(),
        senders: T,
    }
}

#[test]
fn attention_in_f64() {
    let file = read("unit_attention_f64");
    let unit = Unit::run(&file, DType::F64, false);
    assert!(unit.compare(&file, "self_attn.attn.", 1e-6) > 20);
    // What no f32 rotation touches is exact: both memories, and receivers without body slots.
    for name in ["receiver", "sender"] {
        close(
            name,
            &flat(&unit.outputs[name]),
            &file.values(&format!("out.{name}")).unwrap(),
            1e-12,
        );
    }
    let (found, reference) = (flat(&unit.outputs["x"]), file.values("out.x").unwrap());
    for row in [4, 5, 7, 24, 25] {
        let range = row * 128..(row + 1) * 128;
        close(
            &format!("out.x row {row}"),
            &found[range.clone()],
            &reference[range],
            1e-12,
        );
    }
}

#[test]
fn attention_in_f32() {
    let wide = read("unit_attention_f64");
    let unit = Unit::run(&wide, DType::F32, false);
    assert_eq!(
        unit.compare(&read("unit_attention_f32"), "self_attn.attn.", 1e-5),
        5
    );
    unit.compare(&wide, "self_attn.attn.", 1e-5);
}

#[test]
fn whole_block_in_f32() {
    let file = read("unit_encoder_layer_f32");
    let unit = Unit::run(&file, DType::F32, true);
    assert!(unit.compare(&file, "", 1e-5) > 25);
}

#[test]
fn weights_of_the_attention_alone() {
    let wide = read("unit_attn_core_f64");
    for (dtype, file, bar) in [
        (DType::F64, &wide, 1e-12),
        (DType::F32, &read("unit_attn_core_f32"), 1e-5),
    ] {
        let input = |name: &str| {
            let tensor = wide
                .get(name)
                .unwrap()
                .squeeze(0)
                .unwrap()
                .to_dtype(dtype)
                .unwrap();
            Var::from_tensor(&tensor).unwrap()
        };
        let [r, q, s, body] = ["receiver", "query", "sender", "body"].map(input);
        let mask = input("rs_mask");
        let body_mask = input("body_mask");
        let world_body = body.narrow(1, 0, 1).unwrap().squeeze(1).unwrap();
        let bias = body_mask.zeros_like().unwrap();
        let weights = dense_weights([&r, &q, &s], &world_body, &mask, &body_mask, &bias).unwrap();
        close(
            "out_self",
            &flat(&weights.senders),
            &file.values("out_self").unwrap(),
            bar,
        );
        close(
            "out_body",
            &flat(&weights.body),
            &file.values("out_body").unwrap(),
            bar,
        );
        let with = |out: &Tensor, cotangent: &str| {
            let cotangent = input(cotangent).reshape(out.shape()).unwrap();
            (out * cotangent).unwrap().sum_all().unwrap()
        };
        let loss = (with(&weights.senders, "cot_self") + with(&weights.body, "cot_body")).unwrap();
        let gradients = loss.backward().unwrap();
        for (name, variable) in [
            ("receiver", &r),
            ("query", &q),
            ("sender", &s),
            ("body", &body),
        ] {
            if let Ok(reference) = file.values(&format!("grad_{name}")) {
                close(
                    &format!("grad_{name}"),
                    &flat(gradients.get(variable).unwrap()),
                    &reference,
                    bar,
                );
            }
        }
    }
}

#[test]
fn losses_and_their_gradients() {
    for name in ["unit_losses_f32", "unit_losses_f64"] {
        let file = read(name);
        let vectors = |name: &str| -> Vec<[f64; 3]> {
            file.values(name)
                .unwrap()
                .chunks_exact(3)
                .map(|v| [v[0], v[1], v[2]])
                .collect()
        };
        let faces = |name: &str| -> Vec<[u32; 3]> {
            file.indices(name)
                .unwrap()
                .chunks_exact(3)
                .map(|v| [0, 1, 2].map(|i| v[i] as u32))
                .collect()
        };
        let (predicted, truth, garment_faces) = (vectors("pred"), vectors("gt"), faces("faces"));
        let body: Vec<[f32; 12]> = vectors("body_v")
            .iter()
            .map(|x| std::array::from_fn(|i| if i < 3 { x[i] as f32 } else { 0.0 }))
            .collect();
        let outfit = Outfit {
            garment_offsets: file.indices("offsets").unwrap(),
            kinds: vec![GarmentKind::Jumpsuit, GarmentKind::Jacket],
            faces: garment_faces.clone(),
            on_border: on_border(predicted.len(), &garment_faces),
            body_vertices: body.len(),
            body_faces: faces("body_f"),
            body_on_border: on_border(body.len(), &faces("body_f")),
            patches: Patches::default(),
            attributes: Vec::new(),
            patch_attributes: Csr::default(),
            supports: vec![None; 2],
            rest: vec![[0.0; 3]; predicted.len()],
            patch_rest: Vec::new(),
        };
        let (mut room, mut true_room) = (NormalRoom::default(), NormalRoom::default());
        let normals = MeshNormals::new(&predicted, &garment_faces, &mut room);
        let true_normals = MeshNormals::new(&truth, &garment_faces, &mut true_room);
        let mut room = CollisionRoom::default();
        let [mut position, mut normal, mut on_body, mut between] =
            [(); 4].map(|()| Term::default());
        squared_error(&predicted, &truth, &mut position);
        normal_loss(&normals, &true_normals, &mut Term::default(), &mut normal);
        let config = LossConfig::released().collision;
        body_collision(
            &config,
            &predicted,
            &body,
            &outfit.body_faces,
            &outfit.body_on_border,
            &mut room,
            &mut on_body,
        );
        layer_collision(
            &config,
            &outfit,
            &predicted,
            &normals,
            &mut room,
            &mut between,
        );
        close(
            "layer loss",
            &[between.value],
            &file.values("mid.layer_loss").unwrap(),
            1e-5,
        );
        let weighted = |a: f64, b: f64| 1.3 * a + 0.1 * b;
        let total = Term {
            value: weighted(on_body.value, between.value),
            gradient: (on_body.gradient.iter().zip(&between.gradient))
                .map(|(a, b)| [0, 1, 2].map(|axis| weighted(a[axis], b[axis])))
                .collect(),
        };
        for (term, found) in [
            ("l2", position),
            ("normal", normal),
            ("collision_body", on_body),
            ("collision_total_1p3_0p1", total),
        ] {
            let reference = file.values(&format!("loss.{term}")).unwrap();
            close(term, &[found.value], &reference, 1e-5);
            let reference = file.values(&format!("gradpred.{term}")).unwrap();
            close(
                &format!("gradient of {term}"),
                found.gradient.as_flattened(),
                &reference,
                1e-5,
            );
        }
    }
}

#[test]
fn geometry() {
    let file = read("unit_geometry");
    let vectors = |name: &str| triples::<3>(&file.values(name).unwrap());
    let matrices = |name: &str| -> Vec<Matrix> {
        let rows = vectors(name);
        rows.chunks_exact(3).map(|r| [r[0], r[1], r[2]]).collect()
    };
    let wide = |all: &[[f32; 3]]| {
        all.as_flattened()
            .iter()
            .map(|&x| f64::from(x))
            .collect::<Vec<_>>()
    };

    // Frames from unit, degenerate, zero and non-unit vectors, by the fixed axis.
    for (from, to) in [
        ("normals", "rotations_rows_t_b_n"),
        ("nonunit_vectors", "nonunit_rotations"),
    ] {
        let found: Vec<[f32; 3]> = vectors(from)
            .iter()
            .flat_map(|&n| frame(n, FrameAxis::FixedX))
            .collect();
        close(from, &wide(&found), &file.values(to).unwrap(), 1e-6);
    }
    let quaternions = triples::<4>(&file.values("quat_wxyz").unwrap());
    let found: Vec<[f32; 3]> = quaternions
        .iter()
        .flat_map(|&q| rotation_matrix(q))
        .collect();
    close(
        "quaternions",
        &wide(&found),
        &file.values("quat_matrix").unwrap(),
        1e-6,
    );
    let faces: Vec<[u32; 3]> = file
        .indices("mesh_f")
        .unwrap()
        .chunks_exact(3)
        .map(|v| [0, 1, 2].map(|i| v[i] as u32))
        .collect();
    let found = face_normals(&vectors("mesh_v"), &faces);
    close(
        "face normals",
        &wide(&found),
        &file.values("mesh_face_normals").unwrap(),
        1e-6,
    );

    // Neighbours, equal index by index.
    let grid = Grid::build(&vectors("points"), 0.6);
    let (mut nearest, mut four, mut balls) = (Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
    let mut near = Vec::new();
    for centre in vectors("centers") {
        nearest.push(grid.nearest(centre).unwrap().0 as usize);
        grid.k_nearest(centre, 4, 1e3, &mut near);
        four.extend(near.iter().map(|&(index, _)| index as usize));
        for (ball, (radius, slots)) in balls.iter_mut().zip([(0.6, 16), (1.2, 4)]) {
            grid.within(centre, radius, &mut near);
            let first = near.first().map_or(0, |hit| hit.0);
            ball.extend((0..slots).map(|slot| near.get(slot).map_or(first, |hit| hit.0) as usize));
        }
    }
    assert_eq!(nearest, file.indices("knn1").unwrap());
    assert_eq!(four, file.indices("knn4").unwrap());
    assert_eq!(balls[0], file.indices("ball_r0p6_k16").unwrap());
    assert_eq!(balls[1], file.indices("ball_r1p2_k4").unwrap());

    // W R Wᵀ as the model applies it: down to 3, a row map, up to 16; columns of the identity in, columns out.
    let rotations = matrices("rotffn_in");
    let mut found = Vec::new();
    for group in 0..4 {
        let w = file.get(&format!("rotffn_w{group}")).unwrap();
        let down = product(
            &Tensor::eye(16, DType::F32, w.device()).unwrap(),
            &w.t().unwrap(),
        )
        .unwrap();
        for matrix in &rotations {
            let maps = (0..16)
                .map(|index| RowMap {
                    index,
                    matrix: *matrix,
                    offset: [0.0; 3],
                })
                .collect();
            let columns = product(&map_rows(&down, maps).unwrap(), w).unwrap();
            found.extend(flat(&columns.t().unwrap()));
        }
    }
    close(
        "lifted rotations",
        &found,
        &file.values("rotffn_out").unwrap(),
        1e-6,
    );
}
