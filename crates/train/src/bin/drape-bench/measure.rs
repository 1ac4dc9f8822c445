//! Timing of one case.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use candle_core::{Device, Tensor};
use drape_dataset::sample::{FrameStates, Step, gravity_per_frame};
use drape_model::{ForwardSeconds, FrameGraph, LayersNet, ModelConfig, Parameters};
use drape_train::adam::Adam;
use drape_train::losses::LossConfig;
use drape_train::losses::orthogonality::orthogonality;
use drape_train::step::{advance_pairs, sample_gradient};
use serde::{Deserialize, Serialize};

use crate::case::{Shape, make};

/// Runs before those that count.
const WARM_UP: usize = 3;

/// Sizes and times of a case; milliseconds are medians.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CaseResult {
    /// One frame.
    pub inference_ms: f64,
    /// One sample: forward, losses, backward, Adam.
    pub train_step_ms: f64,
    /// Peak of resident memory of a process that ran inference alone, before any training.
    pub inference_peak_mib: f64,
    /// Peak of resident memory of the whole case.
    pub peak_mib: f64,
    /// Garment vertices.
    pub vertices: usize,
    /// Body vertices.
    pub body_vertices: usize,
    /// Patches.
    pub patches: usize,
    /// Mesh entries per patch, attributes included.
    pub mesh_entries: f64,
    /// World entries per patch.
    pub world_entries: f64,
    /// Body entries per patch, repeats counted.
    pub body_entries: f64,
    /// Body entries per patch, repeats not counted.
    pub distinct_body_entries: f64,
    /// Body vertices that some patch sees.
    pub distinct_body_vertices: usize,
    /// Medians of parts, in ms.
    pub stages: BTreeMap<String, f64>,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 {
        values[middle]
    } else {
        (values[middle - 1] + values[middle]) / 2.0
    }
}

/// Times of parts, in seconds, run by run.
#[derive(Default)]
struct Stages(BTreeMap<String, Vec<f64>>);

impl Stages {
    fn add(&mut self, name: &str, seconds: f64) {
        self.0.entry(name.into()).or_default().push(seconds);
    }

    fn forward(&mut self, of: &str, seconds: &ForwardSeconds) {
        let ForwardSeconds {
            graph,
            encoders,
            blocks,
            decoder,
        } = *seconds;
        self.add(&format!("{of}: neighbours, normals, frames"), graph);
        self.add(&format!("{of}: encoders"), encoders);
        self.add(&format!("{of}: blocks"), blocks);
        self.add(&format!("{of}: decoder"), decoder);
    }

    /// Milliseconds; the first runs warm up.
    fn medians(self) -> BTreeMap<String, f64> {
        let medians = self.0.into_iter();
        medians
            .map(|(name, seconds)| (name, 1e3 * median(seconds[WARM_UP..].to_vec())))
            .collect()
    }
}

/// Median milliseconds of warm runs.
fn time(runs: usize, mut work: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut times = Vec::new();
    for run in 0..WARM_UP + runs {
        let start = Instant::now();
        work()?;
        if run >= WARM_UP {
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    Ok(median(times))
}

/// Best of nine of candle's 2048³ f32 product: puts machines on one scale.
pub fn matmul_2048_ms() -> Result<f64> {
    let a = Tensor::rand(-1f32, 1f32, (2048, 2048), &Device::Cpu)?;
    let b = Tensor::rand(-1f32, 1f32, (2048, 2048), &Device::Cpu)?;
    let mut best = f64::INFINITY;
    for _ in 0..10 {
        let start = Instant::now();
        black_box(a.matmul(&b)?);
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(best)
}

fn peak_mib() -> Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status")
        .context("cannot read /proc/self/status: peak memory is measured on Linux only")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib: f64 = line
        .and_then(|rest| rest.split_whitespace().next())
        .and_then(|number| number.parse().ok())
        .context("/proc/self/status has no VmHWM")?;
    Ok(kib / 1024.0)
}

/// Measures a shape in this process.
pub fn measure(shape: &Shape, runs: usize) -> Result<CaseResult> {
    let case = make(shape)?;
    let config = ModelConfig::released();
    let parameters = Parameters::new(&config, 1)?;
    let (sample, statistics) = (&case.sample, &case.statistics);
    let outfit = &sample.outfit;
    let columns = &statistics.vertices;

    let gravity = gravity_per_frame(&case.header);
    let [older, now, next] = &case.frames;
    let net = LayersNet::frozen(&config, &parameters)?;
    // The body's next positions are new in each frame; its states of this frame are known.
    let now_states = FrameStates::new(now, Some(older), None);
    let drive = || {
        let next = FrameStates::new(next, Some(now), Some(older));
        Step::new(&next, &now_states, statistics, gravity)
    };
    let mut stages = Stages::default();
    let (mut state, mut accelerations) = (Vec::new(), Vec::new());
    let inference_ms = time(runs, || {
        let start = Instant::now();
        let step = drive();
        stages.add(
            "inference: body states, forces",
            start.elapsed().as_secs_f64(),
        );
        let evaluation = net.evaluate(outfit, columns, &sample.state, &step)?;
        stages.forward("inference", &evaluation.seconds);
        evaluation.accelerations(&mut accelerations);
        state.clone_from(&sample.state);
        advance_pairs(&mut state, &accelerations);
        black_box(&state);
        Ok(())
    })?;
    let graph = FrameGraph::new(&config, outfit, &sample.state, &sample.steps[0])?;
    let inference_peak_mib = peak_mib()?;

    let losses = LossConfig::released();
    let mut adam = Adam::default();
    let train_step_ms = time(runs, || {
        let net = LayersNet::trainable(&config, &parameters)?;
        let mut result = sample_gradient(
            &net,
            &parameters,
            columns,
            &losses,
            sample,
            &sample.state,
            true,
        )?;
        stages.forward("training", &result.evaluation.seconds);
        stages.add("training: losses", result.seconds[0]);
        stages.add("training: backward", result.seconds[1]);
        let start = Instant::now();
        for (name, gradient) in orthogonality(&config, &parameters)?.gradients {
            if let Some(sum) = result.gradients.get_mut(&name) {
                sum.iter_mut()
                    .zip(&gradient)
                    .for_each(|(sum, value)| *sum += *value as f32);
            }
        }
        // A rate at which the weights stay what they are.
        adam.update(&parameters, &result.gradients, 1e-12)?;
        stages.add("training: regulariser, Adam", start.elapsed().as_secs_f64());
        Ok(())
    })?;

    let patches = outfit.patches.count();
    let per_patch = |count: usize| count as f64 / patches as f64;
    let repeats: f64 = graph
        .edges
        .body_log_count
        .iter()
        .map(|log| f64::from(log.exp()))
        .sum();
    Ok(CaseResult {
        inference_ms,
        train_step_ms,
        inference_peak_mib,
        peak_mib: peak_mib()?,
        vertices: outfit.vertices(),
        body_vertices: outfit.body_vertices,
        patches,
        mesh_entries: per_patch(graph.edges.mesh.items.len()),
        world_entries: per_patch(graph.edges.world.items.len()),
        // Wind and gravity, two entries of every patch, are not body vertices.
        body_entries: repeats / patches as f64 - 2.0,
        distinct_body_entries: per_patch(graph.edges.body.items.len()) - 2.0,
        distinct_body_vertices: graph.body_tokens,
        stages: stages.medians(),
    })
}
