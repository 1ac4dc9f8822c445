//! The trend of accelerations: what it adds to a prediction, and that its fit is the best one.

use drape_dataset::sample::{StatePair, Step};
use drape_dataset::splits::Split;
use drape_dataset::statistics::Trend;
use drape_model::{FrameGraph, LayersNet, ModelConfig, Parameters};
use drape_tests::example::write_dataset;
use drape_tests::scene::{PATCH_SIZE_M, Scene, SceneConfig};
use drape_train::config::TrainConfig;
use drape_train::data::TrainingSet;

const TREND: Trend = Trend {
    persistence: [0.3, 0.5, 0.7],
    damping: [0.01, 0.03, 0.06],
    follow: [0.25, 0.1, 0.02],
    carry: [0.5, 0.3, 0.04],
    air: 0.03,
    gust: 0.05,
    hang: 0.002,
};

/// The number at a distance: linear between those that are given, constant beyond.
fn at(distance: f32, numbers: [f32; 3]) -> f32 {
    let [near, middle, far] = Trend::BANDS;
    let line = |low: f32, high: f32, from: f32, to: f32| {
        from + (to - from) * (distance - low) / (high - low)
    };
    match distance {
        d if d <= near => numbers[0],
        d if d <= middle => line(near, middle, numbers[0], numbers[1]),
        d if d <= far => line(middle, far, numbers[1], numbers[2]),
        _ => numbers[2],
    }
}

/// The formula, written out for one vertex.
fn by_hand(
    trend: &Trend,
    mass: f32,
    sight: f32,
    [rigid, hanging]: [[f32; 3]; 2],
    row: &StatePair,
    step: &Step,
) -> [f32; 3] {
    let distance = |body: &StatePair| -> f32 {
        let squared: f32 = (0..3).map(|axis| (body[axis] - row[axis]).powi(2)).sum();
        squared.sqrt()
    };
    let nearest = step
        .body
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .filter(|body| distance(body) < sight);
    let d = nearest.map_or(f32::INFINITY, distance);
    [0, 1, 2].map(|axis| {
        let (v, older) = (row[3 + axis], row[9 + axis]);
        let skin = nearest.map_or(0.0, |body| {
            let (skin, earlier) = (body[3 + axis], body[9 + axis]);
            at(d, trend.carry) * (skin - earlier) - at(d, trend.follow) * (v - skin)
        });
        let still =
            at(d, trend.persistence) * (v - older) - at(d, trend.damping) * (v - rigid[axis]);
        let air = trend.air * step.wind[10] / mass;
        let hang = trend.hang * (hanging[axis] - row[axis]);
        still + skin - air * v + trend.gust * step.gust()[axis] + hang
    })
}

#[test]
fn it_adds_the_formula_to_each_vertex() {
    for (body, wind) in [(true, true), (true, false), (false, true)] {
        let scene = Scene::new(SceneConfig {
            body,
            ..SceneConfig::default()
        });
        let (mut sample, statistics) = scene.sample(1);
        let config = ModelConfig::default();
        let step = &mut sample.steps[0];
        // A gust of 200 along +x from still air.
        step.wind[10] = if wind { 0.5 } else { 0.0 };
        step.wind[21] = 0.0;
        step.wind_rotations[0] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]];
        let gust = if wind { [0.5, 0.0, 0.0] } else { [0.0; 3] };
        assert_eq!(step.gust(), gust);
        let parameters = Parameters::new(&config, 1).unwrap();
        let net = LayersNet::frozen(&config, &parameters).unwrap();
        let [without, with] = [Trend::default(), TREND].map(|trend| {
            let mut columns = statistics.vertices;
            columns.trend = trend;
            let prediction = net.forward(&sample.outfit, &columns, &sample.state, &sample.steps[0]);
            let acceleration = prediction.unwrap().acceleration;
            acceleration.to_vec2::<f32>().unwrap()
        });
        let (mut largest, step) = (0f32, &sample.steps[0]);
        for (vertex, (with, without)) in with.iter().zip(&without).enumerate() {
            let layer = (vertex >= sample.outfit.garment_offsets[1]) as u8;
            // As the scene's materials have it.
            let mass = 0.3 + 0.1 * f32::from(layer);
            let row = &sample.state[vertex];
            let rest = sample.outfit.rest[vertex];
            let support = &sample.outfit.supports[usize::from(layer)];
            assert_eq!(support.is_some(), body);
            let support = support.as_ref().map(|support| {
                let pose = support.pose(&step.body, &mut Vec::new()).unwrap();
                [pose.velocity(rest), pose.hanging(rest)]
            });
            // Without a body: damped relative to the root, and nothing to hang from.
            let support = support.unwrap_or([[0.0; 3], [row[0], row[1], row[2]]]);
            let expected = by_hand(&TREND, mass, config.patch_sight, support, row, step);
            for axis in 0..3 {
                let found = with[axis] - without[axis];
                assert!((found - expected[axis]).abs() < 1e-5, "vertex {vertex}");
                largest = largest.max(expected[axis].abs());
            }
        }
        assert!(largest > 1e-3, "there is something to see");
    }
}

/// Squared distance of the trend from the recorded accelerations, over the first epoch's draws.
fn misfit(set: &TrainingSet, config: &TrainConfig, trend: &Trend) -> f64 {
    let mut sum = 0.0;
    for draw in set.draws(config, 0) {
        let sample = set.sample(&draw, config.model.gravity).unwrap();
        let (state, step) = (&sample.state, &sample.steps[0]);
        let graph = FrameGraph::new(&config.model, &sample.outfit, state, step).unwrap();
        let patches = state.len();
        let added = graph.trend(trend, &sample.outfit, state, step);
        for (vertex, reference) in sample.reference[0].iter().enumerate() {
            let own = added[patches + graph.own_patch[vertex] as usize];
            for axis in 0..3 {
                let recorded = reference[3 + axis] - state[vertex][3 + axis];
                sum += f64::from(recorded - added[vertex][axis] - own[axis]).powi(2);
            }
        }
    }
    sum
}

#[test]
fn the_fit_is_the_least_squares() {
    let folder = tempfile::tempdir().unwrap();
    write_dataset(folder.path(), &[Split::Train, Split::Train]).unwrap();
    let mut config = TrainConfig {
        data: folder.path().into(),
        patch_size_m: PATCH_SIZE_M,
        ..TrainConfig::default()
    };
    // As recorded: no sway to come back from, and all garments alike.
    config.schedule.samples_per_epoch = 8;
    config.schedule.sway = 0.0;
    config.losses.stray_discount = 0.0;
    let set = TrainingSet::open(&config).unwrap();
    let best = set.statistics.vertices.trend;
    assert_ne!(best, Trend::default());
    let least = misfit(&set, &config, &best);
    assert!(least < misfit(&set, &config, &Trend::default()));
    for change in [-0.02, 0.02] {
        let weights = best.weights();
        let changed = (0..Trend::TERMS).map(|term| {
            let mut weights = weights;
            weights[term] += change;
            Trend::of_weights(weights)
        });
        for other in changed {
            let misfit = misfit(&set, &config, &other);
            assert!(
                misfit >= least * (1.0 - 1e-6),
                "{other:?} fits better than {best:?}"
            );
        }
    }
    config.model.trend = false;
    let none = TrainingSet::open(&config)
        .unwrap()
        .statistics
        .vertices
        .trend;
    assert_eq!(none, Trend::default());
}
