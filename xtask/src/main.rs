//! Commands of the workspace: `cargo xtask COMMAND`.
//!
//! Each command builds the program that does the work (release profile), runs
//! it with the arguments given and ends with its exit code. Nothing here
//! computes: no tensors, no meshes, few dependencies.

mod arrows;
mod ci;
mod program;
mod setup;
mod train;

use std::{ffi::OsString, process::ExitCode};

use clap::{Parser, Subcommand};

use crate::program::Program;

/// Makes layered garment sequences, learns them and measures honestly.
///
/// Start with `cargo xtask train`: it makes the data, trains a model and prints
/// its table. `cargo xtask COMMAND --help` explains one command.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", verbatim_doc_comment)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
#[command(disable_help_subcommand = true)]
enum Command {
    /// Make the default data if it is not there, train, print the held-out table
    #[command(disable_help_flag = true)]
    Train(Passed),
    /// Print the table of the latest run, or of the runs and data given
    #[command(disable_help_flag = true)]
    Eval(Passed),
    /// Make a data set of layered garment sequences
    #[command(disable_help_flag = true)]
    Generate(Passed),
    /// Predict a sequence with a trained model and write it as a sequence file
    #[command(disable_help_flag = true)]
    Rollout(Passed),
    /// Show what a sequence file holds, check it, draw pictures of it
    #[command(disable_help_flag = true)]
    Inspect(Passed),
    /// Turn files of other programs into sequence files
    #[command(disable_help_flag = true)]
    Import(Passed),
    /// Measure how fast LayersNet predicts and trains on this machine
    #[command(disable_help_flag = true)]
    Bench(Passed),
    /// Install what is optional: Blender, for `generate --engine blender`
    Setup {
        /// What to install
        what: Optional,
    },
    /// Run all checks, cheapest first; stops at the first that fails
    Ci,
}

/// Programs of others that ours can use.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Optional {
    /// Blender as a Python package, in `.blender` (about 1 GB; needs Python 3.11)
    Blender,
}

/// Arguments for the program that does the work.
#[derive(clap::Args)]
struct Passed {
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "ARGUMENTS"
    )]
    args: Vec<OsString>,
}

fn main() -> ExitCode {
    // The terminal sends Ctrl-C to the whole process group. The running program
    // ends in its own time (and keeps its files whole); xtask waits for it.
    if let Err(error) = ctrlc::set_handler(|| {}) {
        eprintln!("error: cannot handle Ctrl-C: {error}");
        return ExitCode::FAILURE;
    }
    let result = match Cli::parse().command {
        Command::Train(passed) => train::run(&passed.args),
        Command::Eval(passed) => program::run(Program::Eval, &passed.args),
        Command::Generate(passed) => program::run(Program::Generate, &passed.args),
        Command::Rollout(passed) => program::run(Program::Rollout, &passed.args),
        Command::Inspect(passed) => program::run(Program::Inspect, &passed.args),
        Command::Import(passed) => program::run(Program::Import, &passed.args),
        Command::Bench(passed) => program::run(Program::Bench, &passed.args),
        Command::Setup {
            what: Optional::Blender,
        } => setup::blender(),
        Command::Ci => ci::run(),
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}
