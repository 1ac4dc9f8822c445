//! LayersNet, and the trend it starts from alone, as a [`Method`]: what it needs per sequence is prepared once
//! (patches, attributes, the first state); a step is one forward pass from the
//! model's own prediction, with the body, wind and gravity of the next frame.
//!
//! States are relative to the root's translation (`drape_dataset::sample`), so
//! a prediction becomes absolute by adding the root of the predicted frame.

use drape_dataset::{
    sample::{FrameStates, Outfit, StatePair, Step, gravity_per_frame, pair},
    statistics::{ColumnStatistics, Statistics, Trend},
};
use drape_model::{FrameGraph, LayersNet, ModelConfig};
use drape_train::{TrainError, run::RunFolder, step::advance_pairs};

use crate::{
    EvalError,
    method::Method,
    task::{Positions, Task},
};

/// What tells accelerations.
enum Predictor {
    Network(Box<LayersNet>),
    /// [`drape_dataset::statistics::Trend`] with the reach of these choices.
    Trend(ModelConfig),
}

impl Predictor {
    /// Accelerations of all vertices of the rollout under way, `[3 N]` in units/frame².
    fn accelerations(
        &self,
        statistics: &ColumnStatistics,
        rolling: &mut Rolling,
    ) -> drape_model::Result<()> {
        let Rolling {
            outfit,
            state,
            step,
            accelerations: to,
            graph,
            trend,
            ..
        } = rolling;
        let config = match self {
            Self::Network(net) => {
                net.evaluate(outfit, statistics, state, step)?
                    .accelerations(to);
                return Ok(());
            }
            Self::Trend(config) => config,
        };
        graph.derive(config, outfit, state, step)?;
        graph.trend_again(&statistics.trend, outfit, state, step, trend);
        let (vertices, patches) = trend.split_at(state.len());
        let whole = vertices.iter().zip(&graph.own_patch).map(|(own, &patch)| {
            let patch = patches[patch as usize];
            [0, 1, 2].map(|axis| own[axis] + patch[axis])
        });
        to.clear();
        to.extend(whole.flatten());
        Ok(())
    }
}

/// A trained LayersNet, or its trend alone.
pub struct LayersNetMethod {
    name: String,
    predictor: Predictor,
    statistics: Statistics,
    patch_size_m: f32,
    rolling: Option<Rolling>,
}

/// The rollout under way.
struct Rolling {
    outfit: Outfit,
    state: Vec<StatePair>,
    /// Body, root and wind of the newest frame, and room for the next one's.
    now: FrameStates,
    next: FrameStates,
    gravity: [f32; 3],
    step: Step,
    /// Of the newest step.
    accelerations: Vec<f32>,
    /// Where a trend's accelerations are found.
    graph: FrameGraph,
    trend: Vec<[f32; 3]>,
}

impl LayersNetMethod {
    /// A network with the statistics and the patch size (real metres) it was trained with.
    pub fn new(
        name: impl Into<String>,
        net: LayersNet,
        statistics: Statistics,
        patch_size_m: f32,
    ) -> Self {
        Self {
            name: name.into(),
            predictor: Predictor::Network(Box::new(net)),
            statistics,
            patch_size_m,
            rolling: None,
        }
    }

    /// The model of a run folder, under the folder's name.
    ///
    /// # Errors
    /// When the folder holds no whole checkpoint.
    pub fn from_run(folder: &RunFolder) -> Result<Self, TrainError> {
        let model = folder.trained()?;
        let net = LayersNet::frozen(&model.config.model, &model.parameters)?;
        Ok(Self::new(
            format!("LayersNet {}", model.name),
            net,
            model.statistics,
            model.config.patch_size_m,
        ))
    }

    /// What the run's network starts from, without the network; `None` if it has no trend.
    ///
    /// # Errors
    /// When the folder holds no whole checkpoint.
    pub fn trend_of_run(folder: &RunFolder) -> Result<Option<Self>, TrainError> {
        let model = folder.trained()?;
        let found = model.statistics.vertices.trend != Trend::default();
        Ok(found.then(|| Self {
            name: format!("trend {}", model.name),
            predictor: Predictor::Trend(model.config.model),
            statistics: model.statistics,
            patch_size_m: model.config.patch_size_m,
            rolling: None,
        }))
    }

    fn failed(&self, task: &Task, frame: usize, reason: impl ToString) -> EvalError {
        EvalError::Method {
            method: self.name.clone(),
            sequence: task.header.name.clone(),
            frame,
            reason: reason.to_string(),
        }
    }
}

impl Method for LayersNetMethod {
    fn name(&self) -> &str {
        &self.name
    }

    fn threads(&self) -> usize {
        rayon::current_num_threads()
    }

    fn begin(&mut self, task: &Task) -> Result<(), EvalError> {
        let outfit = Outfit::new(&task.header, self.patch_size_m)?;
        let older = states(task, task.start - 1);
        let now = states(task, task.start);
        let state = now
            .garments
            .iter()
            .zip(&older.garments)
            .map(|(now, older)| pair(now, older))
            .collect();
        self.rolling = Some(Rolling {
            outfit,
            state,
            now,
            next: FrameStates::default(),
            gravity: gravity_per_frame(&task.header),
            step: Step::default(),
            accelerations: Vec::new(),
            graph: FrameGraph::default(),
            trend: Vec::new(),
        });
        Ok(())
    }

    fn step(&mut self, task: &Task, frame: usize) -> Result<Vec<Positions>, EvalError> {
        let Some(mut rolling) = self.rolling.take() else {
            return Err(self.failed(task, frame, "a step before the beginning of a rollout"));
        };
        let Rolling {
            now,
            next,
            step,
            gravity,
            ..
        } = &mut rolling;
        become_states(next, task, frame);
        step.lead(next, now, &self.statistics, *gravity);
        self.predictor
            .accelerations(&self.statistics.vertices, &mut rolling)
            .map_err(|error| self.failed(task, frame, error))?;
        advance_pairs(&mut rolling.state, &rolling.accelerations);
        std::mem::swap(&mut rolling.now, &mut rolling.next);
        let garments = absolute(&rolling.state, &rolling.outfit, &rolling.now);
        self.rolling = Some(rolling);
        Ok(garments)
    }
}

fn states(task: &Task, frame: usize) -> FrameStates {
    let mut states = FrameStates::default();
    become_states(&mut states, task, frame);
    states
}

fn become_states(states: &mut FrameStates, task: &Task, frame: usize) {
    let older = |by: usize| frame.checked_sub(by).map(|older| &task.frames[older]);
    states.become_those_of(&task.frames[frame], older(1), older(2));
}

/// `[garment][vertex, 3]` in the world.
fn absolute(states: &[StatePair], outfit: &Outfit, frame: &FrameStates) -> Vec<Positions> {
    let root = frame.root;
    outfit
        .garment_offsets
        .windows(2)
        .map(|range| {
            states[range[0]..range[1]]
                .iter()
                .map(|s| [0, 1, 2].map(|k| s[k] + root[k]))
                .collect()
        })
        .collect()
}
