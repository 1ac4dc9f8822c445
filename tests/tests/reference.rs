//! LayersNet by candle's own operations (`drape_model::reference`) and by the kernels:
//! the same numbers and the same gradients, in f64 to rounding.

use std::sync::Arc;

use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_dataset::random::stream;
use drape_dataset::sample::Sample;
use drape_dataset::statistics::{ColumnStatistics, Trend};
use drape_model::kernels::attention::{self, Edges, GROUP_PARAMETERS, GROUPS, HEAD, WIDTH};
use drape_model::parameters::is_idle;
use drape_model::reference::{self, Group};
use drape_model::{Evaluation, LayersNet, ModelConfig, Parameters, Prediction};
use drape_tests::oracle::relative;
use drape_tests::scene::{Scene, SceneConfig};
use rand::Rng;

/// Powers of two, for the same reason as the deviations below.
const TREND: Trend = Trend {
    persistence: [0.25, 0.5, 0.5],
    damping: [0.0625, 0.125, 0.125],
    follow: [0.25, 0.125, 0.0625],
    carry: [0.5, 0.25, 0.125],
    air: 0.03125,
    gust: 0.0625,
    hang: 0.015625,
};

struct Case {
    name: &'static str,
    config: ModelConfig,
    sample: Sample,
    statistics: ColumnStatistics,
}

/// Both presets on a scene with everything, without a body, with one garment, with the body
/// out of reach, and with garments crumpled to a point, where vertices find no patch to take
/// a motion from.
fn cases() -> Vec<Case> {
    let everything = SceneConfig::default();
    let scenes = [
        ("everything", everything, false),
        (
            "no body",
            SceneConfig {
                body: false,
                ..everything
            },
            false,
        ),
        (
            "one garment",
            SceneConfig {
                garments: 1,
                ..everything
            },
            false,
        ),
        (
            "body out of reach",
            SceneConfig {
                body_offset: [9.0, 0.0, 0.0],
                ..everything
            },
            false,
        ),
        ("crumpled", everything, true),
    ];
    let presets = [ModelConfig::default(), ModelConfig::released()];
    let mut cases = Vec::new();
    for (name, scene, crumpled) in scenes {
        for config in &presets {
            let (mut sample, statistics) = Scene::new(scene).sample(1);
            let mut statistics = statistics.vertices;
            // LayersNet multiplies the frames back to the world by these in f32: exact if
            // they are powers of two, so that f64 compares the formulas and nothing else.
            statistics.std = statistics.std.map(|std| std.log2().round().exp2());
            if config.trend {
                statistics.trend = TREND;
            }
            if crumpled {
                let point = sample.state[0];
                for row in &mut sample.state {
                    row[..3].copy_from_slice(&point[..3]);
                }
            }
            cases.push(Case {
                name,
                config: config.clone(),
                sample,
                statistics,
            });
        }
    }
    cases
}

impl Case {
    /// Fresh weights; biases and layer norms that start as constants are moved off them.
    fn parameters(&self, dtype: DType, seed: u64) -> Parameters {
        let fresh = Parameters::new(&self.config, seed).unwrap();
        let tensors = fresh.iter().map(|(name, variable)| {
            let offset = (random(name, variable.shape()) * 0.1).unwrap();
            let moved = (variable.to_dtype(DType::F64).unwrap() + offset).unwrap();
            // Both types hold the same values.
            (name.into(), moved.to_dtype(DType::F32).unwrap())
        });
        Parameters::from_tensors(tensors.collect(), &self.config, dtype).unwrap()
    }

    fn by_kernels(&self, net: &LayersNet) -> Prediction {
        let (outfit, state) = (&self.sample.outfit, &self.sample.state);
        net.forward(outfit, &self.statistics, state, &self.sample.steps[0])
            .unwrap()
    }

    fn evaluated(&self, net: &LayersNet) -> Evaluation {
        let (outfit, state) = (&self.sample.outfit, &self.sample.state);
        net.evaluate(outfit, &self.statistics, state, &self.sample.steps[0])
            .unwrap()
    }

    fn by_reference(&self, parameters: &Parameters) -> Prediction {
        reference::forward(
            &self.config,
            parameters,
            &self.sample.outfit,
            &self.statistics,
            &self.sample.state,
            &self.sample.steps[0],
            &Device::Cpu,
        )
        .unwrap()
    }
}

fn random(name: &str, shape: impl Into<candle_core::Shape>) -> Tensor {
    let shape = shape.into();
    let mut rng = stream(7, name);
    let values: Vec<f64> = (0..shape.elem_count())
        .map(|_| rng.random_range(-1.0..1.0))
        .collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    let tensor = tensor.to_dtype(DType::F64).unwrap();
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn rows(tensor: &Tensor) -> Vec<[f64; 3]> {
    flat(tensor).as_chunks::<3>().0.to_vec()
}

fn outputs(prediction: &Prediction) -> Vec<(String, &Tensor)> {
    let named = [
        ("acceleration", &prediction.acceleration),
        ("relative", &prediction.relative),
        ("patch acceleration", &prediction.patch_acceleration),
    ];
    // From the last on: the kernels give no other.
    let blocks = prediction.blocks.iter().rev().enumerate();
    named
        .into_iter()
        .map(|(name, tensor)| (name.to_string(), tensor))
        .chain(blocks.map(|(index, block)| (format!("block {index} from the last"), block)))
        .collect()
}

#[test]
fn predictions_equal_those_of_the_kernels() {
    // Rounding through four blocks; the released gravity frame is no rotation and adds some.
    for (dtype, bar) in [(DType::F32, 1e-5), (DType::F64, 1e-11)] {
        let mut worst = 0f64;
        for case in cases() {
            let parameters = case.parameters(dtype, 1);
            let frozen = LayersNet::frozen(&case.config, &parameters).unwrap();
            let trainable = LayersNet::trainable(&case.config, &parameters).unwrap();
            let kernels = [case.by_kernels(&frozen), case.by_kernels(&trainable)];
            let reference = case.by_reference(&parameters);
            let expected = kernels.each_ref().map(outputs);
            assert_eq!(expected[0].len(), 3 + 1);
            assert_eq!(expected[1].len(), 3 + 1);
            let found = || outputs(&reference).into_iter();
            let pairs = expected
                .into_iter()
                .flat_map(|expected| found().zip(expected));
            for ((name, found), (_, expected)) in pairs {
                assert_eq!(found.dims(), expected.dims(), "{name}");
                assert_eq!(found.dtype(), dtype, "{name}");
                let difference = relative(&flat(found), &flat(expected));
                assert!(
                    difference <= bar,
                    "{}, {dtype:?}, {name}: {difference}",
                    case.name
                );
                worst = worst.max(difference);
            }
        }
        println!("{dtype:?}: predictions differ by {worst:.1e} of the largest entry at most");
    }
}

/// Gradients of a linear form of the accelerations.
fn backward(prediction: &Prediction) -> GradStore {
    let form = |name: &str, x: &Tensor| {
        let coefficients = random(name, x.shape()).to_dtype(x.dtype()).unwrap();
        (x * coefficients).unwrap().sum_all().unwrap()
    };
    let vertices = form("vertices", &prediction.acceleration);
    let patches = form("patches", &prediction.patch_acceleration);
    (vertices + patches).unwrap().backward().unwrap()
}

/// Largest difference over a weight's gradients, and the weight.
fn gradient_difference(case: &Case, dtype: DType, seed: u64) -> (f64, String) {
    let parameters = case.parameters(dtype, seed);
    let net = LayersNet::trainable(&case.config, &parameters).unwrap();
    let mut evaluation = case.evaluated(&net);
    let prediction = evaluation.prediction().unwrap();
    let [by_vertex, by_patch] = [
        ("vertices", &prediction.acceleration),
        ("patches", &prediction.patch_acceleration),
    ]
    .map(|(name, x)| rows(&random(name, x.shape())));
    let kernels = net
        .gradients(&parameters, &mut evaluation, &by_vertex, &by_patch)
        .unwrap();
    let reference = backward(&case.by_reference(&parameters));
    let mut worst = (0.0, String::new());
    for (name, variable) in parameters.iter() {
        if is_idle(name, &case.config) {
            assert!(reference.get(variable).is_none(), "{name} is idle");
            continue;
        }
        let [found, expected] = [reference.get(variable), kernels.get(name)]
            .map(|gradient| flat(gradient.unwrap_or_else(|| panic!("{name} has no gradient"))));
        assert_eq!(kernels[name].shape(), variable.shape(), "{name}");
        assert!(
            expected.iter().any(|value| *value != 0.0),
            "{name}: all zeros"
        );
        let difference = relative(&found, &expected);
        if difference > worst.0 {
            worst = (difference, name.to_string());
        }
    }
    worst
}

#[test]
fn gradients_of_every_weight_equal_those_of_the_kernels() {
    // A preactivation within rounding of 0 may pass a ReLU on one side only, which moves
    // gradients by percents: in f32 about one set of weights in eight has one. A fault
    // shows with every set.
    for (dtype, bar, seeds) in [(DType::F32, 1e-3, 1..=5), (DType::F64, 1e-9, 1..=1)] {
        let mut worst = 0f64;
        for case in cases() {
            let mut tried = Vec::new();
            let fits = seeds.clone().any(|seed| {
                tried.push(gradient_difference(&case, dtype, seed));
                tried
                    .last()
                    .is_some_and(|(difference, _)| *difference <= bar)
            });
            assert!(fits, "{}, {dtype:?}: {tried:?}", case.name);
            if tried.len() > 1 {
                println!("{}, {dtype:?}: {tried:?}", case.name);
            }
            worst = worst.max(tried.last().expect("at least one seed").0);
        }
        println!("{dtype:?}: gradients differ by {worst:.1e} of a weight's largest at most");
    }
}

/// What the comparisons above rest on: each scene has what its name says.
#[test]
fn the_scenes_reach_every_branch() {
    for case in cases() {
        let graph = case.by_reference(&case.parameters(DType::F32, 1)).graph;
        let released = case.config == ModelConfig::released();
        let refused = graph.slot_offsets.windows(2).any(|ends| ends[0] == ends[1]);
        let layers = !graph.edges.world.items.is_empty();
        let repeats = graph.edges.body_log_count.iter().any(|count| *count > 0.0);
        let near = !["no body", "body out of reach"].contains(&case.name);
        // The released program's decoder uses a body that no patch sees.
        let distant = released && case.name == "body out of reach";
        assert_eq!(graph.body_tokens > 0, near, "{}", case.name);
        assert_eq!(
            !graph.body_rows.is_empty(),
            near || distant,
            "{}",
            case.name
        );
        assert_eq!(repeats, released && near, "{}", case.name);
        assert_eq!(layers, case.name != "one garment", "{}", case.name);
        assert_eq!(refused, case.name == "crumpled", "{}", case.name);
    }
}

#[test]
fn bf16_keeps_the_first_two_digits() {
    let case = &cases()[0];
    let [fine, coarse] = [DType::F32, DType::BF16]
        .map(|dtype| flat(&case.by_reference(&case.parameters(dtype, 1)).acceleration));
    let difference = relative(&coarse, &fine);
    println!("bf16: {difference:.1e}");
    assert!(0.0 < difference && difference < 0.1, "{difference}");
}

const RECEIVERS: usize = 6;
const SENDERS: usize = 7;
const BODY: usize = 3;

/// Receiver 1 has no entries at all, 2 none in world heads, 3 none in mesh heads, 4 only
/// world neighbours in world heads, 5 only body tokens there.
fn edges(with_world: bool, with_body: bool) -> Edges {
    let list = |columns: usize, empty: &[usize], present: bool| {
        let pairs = (0..RECEIVERS)
            .filter(|row| present && !empty.contains(row))
            .flat_map(|row| (0..columns).map(move |item| (row as u32, item as u32)))
            .filter(|(row, item)| (row + item) % 3 != 1);
        Csr::from_pairs(RECEIVERS, pairs.collect())
    };
    let body = list(BODY, &[1, 2, 4], with_body);
    let rotations: Vec<f64> = flat(&random("rotations", (BODY, 9)));
    Edges {
        mesh: list(SENDERS, &[1, 3], true),
        world: list(SENDERS, &[1, 2, 5], with_world),
        body_log_count: body
            .items
            .iter()
            .map(|&item| (item as f32).ln_1p())
            .collect(),
        body,
        rotations: rotations
            .chunks_exact(9)
            .map(|m| [0, 1, 2].map(|row| [0, 1, 2].map(|column| m[3 * row + column] as f32)))
            .collect(),
        senders: SENDERS,
    }
}

#[test]
fn attention_equals_the_kernels_where_lists_are_empty_and_tokens_coincide() {
    for (with_world, with_body, coincide) in [
        (true, true, false),
        (true, true, true),
        (false, true, false),
        (true, false, false),
        (false, false, false),
    ] {
        let edges = Arc::new(edges(with_world, with_body));
        let rows = 2 * RECEIVERS + SENDERS + BODY;
        let mut tokens = random("tokens", (rows, WIDTH));
        if coincide {
            // Senders 0 and 3 are where receiver 0 is: |r − s| = 0.
            let row = tokens.narrow(0, 0, 1).unwrap().contiguous().unwrap();
            for sender in [0, 3] {
                let at = 2 * RECEIVERS + sender;
                tokens = tokens.slice_assign(&[at..at + 1, 0..WIDTH], &row).unwrap();
            }
        }
        let tokens = Var::from_tensor(&tokens).unwrap();
        let parameters =
            Var::from_tensor(&random("parameters", GROUPS * GROUP_PARAMETERS)).unwrap();
        let cotangent = random("cotangent", (RECEIVERS, WIDTH));
        for own_slots in [true, false] {
            let kernel = attention::attend(&tokens, &parameters, edges.clone(), own_slots).unwrap();
            let part = |start, rows| tokens.narrow(0, start, rows).unwrap();
            let groups: Vec<Group> = (0..GROUPS)
                .map(|group| {
                    let part = |start, length| {
                        parameters
                            .narrow(0, group * GROUP_PARAMETERS + start, length)
                            .unwrap()
                    };
                    Group {
                        w: part(0, 3 * HEAD).reshape((HEAD, 3)).unwrap(),
                        m: part(3 * HEAD, HEAD * HEAD).reshape((HEAD, HEAD)).unwrap(),
                        c: part(3 * HEAD + HEAD * HEAD, HEAD),
                    }
                })
                .collect();
            let (r, q) = (part(0, RECEIVERS), part(RECEIVERS, RECEIVERS));
            let s = part(2 * RECEIVERS, SENDERS + BODY);
            let found = reference::attend([&r, &q, &s], &groups, &edges, own_slots).unwrap();
            let difference = relative(&flat(&found), &flat(&kernel));
            assert!(difference < 1e-12, "{difference}");

            let out: Vec<Vec<f64>> = found.to_vec2().unwrap();
            assert!(out[1].iter().all(|value| *value == 0.0));
            if own_slots {
                let zero = |row: usize, mesh: usize| {
                    let heads = out[row].chunks_exact(HEAD).skip(mesh).step_by(2);
                    heads.flatten().all(|value| *value == 0.0)
                };
                assert!(zero(2, 0) && !zero(2, 1), "no world entries");
                assert!(zero(3, 1) && zero(3, 0) != (with_world || with_body));
                assert!(zero(4, 0) != with_world && zero(5, 0) != with_body);
            }

            let backward = |out: &Tensor| {
                let form = (out * &cotangent).unwrap().sum_all().unwrap();
                form.backward().unwrap()
            };
            let (by_kernel, by_reference) = (backward(&kernel), backward(&found));
            for variable in [&tokens, &parameters] {
                let [found, expected] = [&by_reference, &by_kernel].map(|store| {
                    // Nobody reads the parameters without body tokens.
                    store
                        .get(variable)
                        .map_or_else(|| vec![0.0; variable.elem_count()], flat)
                });
                let difference = relative(&found, &expected);
                assert!(difference < 1e-11, "{difference}");
            }
        }
    }
}
