//! The programs behind the commands: which package and binary, and what a
//! newcomer should know before reading their options.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, ExitCode, ExitStatus},
};

use anyhow::{Context, Result, bail};

/// A program of the workspace.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// Trains a model.
    Train,
    /// Measures runs.
    Eval,
    /// Makes sequences.
    Generate,
    /// Predicts a sequence.
    Rollout,
    /// Shows a sequence.
    Inspect,
    /// Converts files of other programs.
    Import,
    /// Measures speed.
    Bench,
}

impl Program {
    /// Package and binary.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Program::Train => ("drape-train", "drape-train"),
            Program::Eval => ("drape-eval", "drape-eval"),
            Program::Generate => ("drape-sim", "drape-generate"),
            Program::Rollout => ("drape-eval", "drape-rollout"),
            Program::Inspect => ("drape-view", "drape-inspect"),
            Program::Import => ("drape-dataset", "drape-import"),
            Program::Bench => ("drape-train", "drape-bench"),
        }
    }

    /// The feature that the binary asks for, as cargo's command line wants it.
    fn feature(self) -> Option<&'static str> {
        match self {
            Program::Import => Some("drape-dataset/cli"),
            _ => None,
        }
    }

    /// What the command is for, printed above the program's own help.
    fn explanation(self) -> &'static str {
        match self {
            Program::Train => {
                "cargo xtask train: learn how garments move.\n\n\
                 Without options it makes data/default (bodies in motion, dressed in two layers, simulated by\n\
                 the engine) unless it is there, trains LayersNet on it, and prints how well the model predicts\n\
                 sequences it has never seen. Everything a run makes is in one folder, runs/NAME. Ctrl-C stops\n\
                 it with the last checkpoint kept; --resume goes on from there.\n\n\
                 All options go to drape-train:\n"
            }
            Program::Eval => {
                "cargo xtask eval: how good is a model, and what does it cost?\n\n\
                 Lets every method predict held-out sequences, each from its own predictions, and compares with\n\
                 the simulated reference: error in millimetres, share of vertices inside the body and inside\n\
                 inner garments, milliseconds per frame. Floors (methods that learn nothing) are in the same\n\
                 table: a model that does not beat them is broken.\n\n\
                 All options go to drape-eval:\n"
            }
            Program::Generate => {
                "cargo xtask generate: make a data set.\n\n\
                 Samples bodies, motions, outfits, materials and wind, simulates each sequence with the cloth\n\
                 engine, and writes one file per sequence. The same seed makes the same bytes. With --engine\n\
                 blender the same scenes are simulated by Blender's cloth (cargo xtask setup blender, once).\n\n\
                 All options go to drape-generate:\n"
            }
            Program::Rollout => {
                "cargo xtask rollout: let a trained model animate the garments of a sequence.\n\n\
                 Reads a sequence, keeps its body motion and wind, predicts its garments from the first frames\n\
                 on, and writes the prediction as a sequence file that inspect can draw.\n\n\
                 All options go to drape-rollout:\n"
            }
            Program::Inspect => {
                "cargo xtask inspect FILE: what is in a sequence file?\n\n\
                 Prints its contents and checks them; draws frames and patches as PNG pictures.\n\n\
                 All options go to drape-inspect:\n"
            }
            Program::Import => {
                "cargo xtask import FORMAT …: use sequences that another program simulated.\n\n\
                 Reads their files, checks them and writes sequence files for train, eval and rollout.\n\n\
                 All options go to drape-import:\n"
            }
            Program::Bench => {
                "cargo xtask bench: how fast is LayersNet on this machine?\n\n\
                 Times one frame of inference and one training step on outfits of known sizes, beside the\n\
                 published program's times, and how time grows with the outfit. Leave the machine alone\n\
                 meanwhile; a product much above the printed reference means that it was not.\n\n\
                 All options go to drape-bench:\n"
            }
        }
    }
}

/// Builds a program, runs it and passes its exit code on.
pub fn run(program: Program, args: &[OsString]) -> Result<ExitCode> {
    build(&[program])?;
    start(program, args).map(exit_code)
}

/// Settings of the programs' libraries, unless the user has his own: the
/// allocator keeps freed pages (giving them back costs a tenth of training in
/// page faults), and candle's own pool, whose threads wait by spinning beside
/// ours, stays off.
const ENVIRONMENT: [(&str, &str); 2] =
    [("MIMALLOC_PURGE_DELAY", "-1"), ("CANDLE_NUM_THREADS", "1")];

/// Runs a program that is built already.
pub fn start(program: Program, args: &[OsString]) -> Result<ExitStatus> {
    if wants_help(args) {
        println!("{}", program.explanation());
    }
    let path = binary(program);
    let mut command = Command::new(&path);
    command.args(args);
    for (name, value) in ENVIRONMENT {
        if env::var_os(name).is_none() {
            command.env(name, value);
        }
    }
    command
        .status()
        .with_context(|| format!("cannot run {}", path.display()))
}

/// Builds programs; cargo shows its progress.
pub fn build(programs: &[Program]) -> Result<()> {
    let mut command = cargo();
    command.args(["build", "--release"]);
    for program in programs {
        let (package, binary) = program.names();
        command.args(["--package", package, "--bin", binary]);
        if let Some(feature) = program.feature() {
            command.args(["--features", feature]);
        }
    }
    let status = command.status().context("cannot run cargo")?;
    if !status.success() {
        bail!("the build failed; its messages are above");
    }
    Ok(())
}

/// Whether the arguments ask for help.
pub fn wants_help(args: &[OsString]) -> bool {
    args.iter()
        .take_while(|arg| *arg != "--")
        .any(|arg| arg == "--help" || arg == "-h")
}

/// The cargo that runs this, in the workspace's folder.
pub fn cargo() -> Command {
    let mut command = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(workspace());
    command
}

/// The workspace's folder.
pub fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap_or(Path::new("."))
}

/// A finished program's exit code; 128 + signal when a signal ended it, as shells do.
pub fn exit_code(status: ExitStatus) -> ExitCode {
    #[cfg(unix)]
    let signal = std::os::unix::process::ExitStatusExt::signal(&status);
    #[cfg(not(unix))]
    let signal = None;
    let code = status
        .code()
        .or(signal.map(|signal| 128 + signal))
        .unwrap_or(1);
    ExitCode::from(u8::try_from(code).unwrap_or(1))
}

fn binary(program: Program) -> PathBuf {
    let target =
        env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace().join("target"), PathBuf::from);
    let name = format!("{}{}", program.names().1, env::consts::EXE_SUFFIX);
    target.join("release").join(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn every_program_is_built_with_the_features_that_its_package_asks_for() {
        let mut metadata = cargo();
        metadata.args([
            "metadata",
            "--no-deps",
            "--offline",
            "--format-version",
            "1",
        ]);
        let metadata = metadata.output().unwrap();
        let metadata: Value = serde_json::from_slice(&metadata.stdout).unwrap();
        let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
        let programs = [
            Program::Train,
            Program::Eval,
            Program::Generate,
            Program::Rollout,
            Program::Inspect,
            Program::Import,
            Program::Bench,
        ];
        for program in programs {
            let (package, binary) = program.names();
            let packages = list(&metadata["packages"]);
            let found = packages.iter().find(|p| p["name"] == package).unwrap();
            let targets = list(&found["targets"]);
            let is_binary = |t: &&Value| t["name"] == binary && t["kind"][0] == "bin";
            let target = targets.iter().find(is_binary).expect(binary);
            let asked: Vec<String> = list(&target["required-features"])
                .iter()
                .filter_map(|feature| Some(format!("{package}/{}", feature.as_str()?)))
                .collect();
            let given: Vec<String> = program.feature().map(String::from).into_iter().collect();
            assert_eq!(asked, given, "{binary}");
        }
    }
}
