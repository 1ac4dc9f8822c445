//! What a training run guarantees: resuming and the number of threads change no
//! bit, and a number that is not finite stops it with names, keeping the last
//! good checkpoint.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use drape_dataset::splits::Split;
use drape_model::Parameters;
use drape_tests::example::write_dataset;
use drape_tests::scene::PATCH_SIZE_M;
use drape_train::TrainError;
use drape_train::adam::Adam;
use drape_train::config::TrainConfig;
use drape_train::data::TrainingSet;
use drape_train::losses::LossValues;
use drape_train::run::{Position, RunFolder, RunRecord};
use drape_train::trainer::{Outcome, Progress, Trainer};

/// Stops after some updates.
struct StopAfter<'a> {
    updates: u64,
    stop: &'a AtomicBool,
}

impl Progress for StopAfter<'_> {
    fn update(&mut self, _: &TrainConfig, position: Position, _: &LossValues, _: f64) {
        if position.updates >= self.updates {
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

fn config(data: &Path) -> TrainConfig {
    let mut config = TrainConfig {
        data: data.into(),
        patch_size_m: PATCH_SIZE_M,
        ..TrainConfig::default()
    };
    config.schedule.epochs = 3;
    config.schedule.samples_per_epoch = 8;
    config.schedule.max_steps_without_gradient = 2;
    config.model.blocks = 2;
    config
}

fn record() -> RunRecord {
    RunRecord {
        program: "test".into(),
        commit: "unknown".into(),
        seed: 1,
        data_hash: String::new(),
        sequences: 2,
        parameters: 0,
        updates: 6,
        threads: 1,
        seconds: 0.0,
        finished: false,
    }
}

/// Runs until the schedule ends or `updates` are done; continues what is in the folder.
fn train(config: &TrainConfig, run: &Path, updates: u64) -> Result<Outcome, TrainError> {
    let set = TrainingSet::open(config)?;
    let (folder, (parameters, adam, position)) = if run.join("run.json").exists() {
        let folder = RunFolder::open(run)?;
        let loaded = folder.load(config)?;
        (folder, loaded)
    } else {
        let folder = RunFolder::create(run)?;
        folder.write_start(config, &set.statistics)?;
        folder.write_record(&record())?;
        let parameters = Parameters::new(&config.model, config.seed)?;
        (folder, (parameters, Adam::default(), Position::default()))
    };
    let stop = AtomicBool::new(false);
    let mut progress = StopAfter {
        updates,
        stop: &stop,
    };
    let mut trainer = Trainer {
        config,
        set: &set,
        folder: &folder,
        parameters,
        adam,
        position,
    };
    trainer.run(&mut record(), &stop, &mut progress)
}

fn bytes(run: &Path, name: &str) -> Vec<u8> {
    std::fs::read(run.join("checkpoint").join(name)).expect("a run that ended has a checkpoint")
}

fn dataset() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_dataset(folder.path(), &[Split::Train, Split::Train]).expect("an example data set");
    folder
}

#[test]
fn a_resumed_run_has_the_same_bits_as_one_that_never_stopped() {
    let data = dataset();
    let runs = tempfile::tempdir().expect("a temporary folder");
    let config = config(data.path());
    let (whole, parts) = (runs.path().join("whole"), runs.path().join("parts"));
    assert_eq!(train(&config, &whole, u64::MAX).unwrap(), Outcome::Finished);
    // Once in the middle of an epoch, once at its end.
    assert_eq!(train(&config, &parts, 3).unwrap(), Outcome::Interrupted);
    assert_eq!(train(&config, &parts, 4).unwrap(), Outcome::Interrupted);
    assert_eq!(train(&config, &parts, u64::MAX).unwrap(), Outcome::Finished);
    for name in ["weights.safetensors", "adam.safetensors", "position.json"] {
        assert!(bytes(&whole, name) == bytes(&parts, name), "{name} differs");
    }
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    let data = dataset();
    let runs = tempfile::tempdir().expect("a temporary folder");
    let config = config(data.path());
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let run = runs.path().join(threads.to_string());
        assert_eq!(
            pool.install(|| train(&config, &run, 3)).unwrap(),
            Outcome::Interrupted
        );
    }
    let (one, two) = (runs.path().join("1"), runs.path().join("2"));
    assert!(bytes(&one, "weights.safetensors") == bytes(&two, "weights.safetensors"));
}

#[test]
fn an_overflow_stops_with_tensor_and_sequence_and_keeps_the_checkpoint() {
    let data = dataset();
    let runs = tempfile::tempdir().expect("a temporary folder");
    let mut config = config(data.path());
    let run = runs.path().join("run");
    assert_eq!(train(&config, &run, 2).unwrap(), Outcome::Interrupted);
    let before = bytes(&run, "weights.safetensors");
    // The first update after this one throws the weights out of range.
    config.schedule.learning_rate = 1e30;
    let error = train(&config, &run, u64::MAX).unwrap_err();
    let TrainError::NotFinite {
        sequence, tensor, ..
    } = &error
    else {
        panic!("{error}")
    };
    assert!(sequence.starts_with("sequence_"), "{error}");
    assert!(!tensor.is_empty(), "{error}");
    assert!(
        bytes(&run, "weights.safetensors") == before,
        "the last good checkpoint is kept"
    );
}
