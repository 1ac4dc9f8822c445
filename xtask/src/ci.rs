//! The one list of checks, cheapest first. It stops at the first that fails and
//! says how to repeat it.

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};

use crate::{arrows, program::cargo};

/// One call of cargo.
struct Step {
    name: &'static str,
    arguments: &'static str,
    /// Flags for rustdoc.
    rustdoc: &'static str,
}

/// All in one profile and with the same features (`cli` is drape-import), so
/// that they share what they build. Tests run the programs.
const STEPS: [Step; 6] = [
    step("format", "fmt --all --check"),
    step(
        "lints",
        "clippy --release --workspace --all-targets --features drape-dataset/cli --locked -- -D warnings",
    ),
    Step {
        rustdoc: "-D warnings",
        ..step(
            "documentation",
            "doc --release --workspace --no-deps --features drape-dataset/cli",
        )
    },
    step(
        "programs",
        "build --release --workspace --bins --features drape-dataset/cli",
    ),
    step(
        "tests",
        "test --release --workspace --lib --bins --tests --features drape-dataset/cli",
    ),
    step(
        "documentation tests",
        "test --release --workspace --doc --features drape-dataset/cli",
    ),
];

const fn step(name: &'static str, arguments: &'static str) -> Step {
    Step {
        name,
        arguments,
        rustdoc: "",
    }
}

/// Runs all checks.
pub fn run() -> Result<ExitCode> {
    let clock = Instant::now();
    let mut times = Vec::new();
    for step in STEPS {
        if !timed(&mut times, step.name, || cargo_step(&step))? {
            return Ok(ExitCode::FAILURE);
        }
        if step.name == "format" && !timed(&mut times, "arrows between crates", arrows_step)? {
            return Ok(ExitCode::FAILURE);
        }
    }
    println!(
        "\nall checks passed in {:.0} s:",
        clock.elapsed().as_secs_f64()
    );
    for (name, time) in times {
        println!("  {:>6.1} s  {name}", time.as_secs_f64());
    }
    Ok(ExitCode::SUCCESS)
}

fn timed(
    times: &mut Vec<(&'static str, Duration)>,
    name: &'static str,
    step: impl FnOnce() -> Result<bool>,
) -> Result<bool> {
    println!("\n== {name}");
    let clock = Instant::now();
    let passed = step()?;
    println!(
        "== {name}: {} after {:.1} s",
        if passed { "ok" } else { "FAILED" },
        clock.elapsed().as_secs_f64()
    );
    times.push((name, clock.elapsed()));
    Ok(passed)
}

fn cargo_step(step: &Step) -> Result<bool> {
    let mut command = cargo();
    command.args(step.arguments.split(' '));
    if !step.rustdoc.is_empty() {
        command.env("RUSTDOCFLAGS", step.rustdoc);
    }
    let status = command
        .status()
        .with_context(|| format!("cannot run cargo for the step `{}`", step.name))?;
    if !status.success() {
        let variable = if step.rustdoc.is_empty() {
            String::new()
        } else {
            format!("RUSTDOCFLAGS=\"{}\" ", step.rustdoc)
        };
        println!("\nrepeat with: {variable}cargo {}", step.arguments);
    }
    Ok(status.success())
}

fn arrows_step() -> Result<bool> {
    let result = arrows::check();
    if let Err(problems) = &result {
        println!("{problems:#}");
    }
    Ok(result.is_ok())
}
