//! Puts optional programs of others where ours look for them.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use anyhow::{Context, Result, bail};

use crate::program::workspace;

/// The version that was measured, and the only Python it has wheels for.
const BPY: &str = "bpy==5.0.1";
const PYTHON: &str = "3.11";
/// Where drape-generate looks.
const FOLDER: &str = ".blender";

/// Installs Blender as a Python package into an environment of its own in the
/// workspace. What is there already is kept.
pub fn blender() -> Result<ExitCode> {
    let folder = workspace().join(FOLDER);
    let python = inside(&folder);
    if !python.exists() {
        let base = base_python()?;
        println!("making {}", folder.display());
        call(Command::new(base).args(["-m", "venv"]).arg(&folder))?;
    }
    println!("installing {BPY} (about 1 GB)");
    call(Command::new(&python).args(["-m", "pip", "install", BPY]))?;
    call(
        Command::new(&python).args(["-c", "import bpy; print('Blender', bpy.app.version_string)"]),
    )
    .context("bpy is installed but does not start")?;
    println!("ready: cargo xtask generate --engine blender");
    Ok(ExitCode::SUCCESS)
}

/// The environment's Python.
fn inside(folder: &Path) -> PathBuf {
    folder.join(if cfg!(windows) {
        "Scripts/python.exe"
    } else {
        "bin/python"
    })
}

/// A Python of the right version: `PYTHON` in the environment, else one on the path.
fn base_python() -> Result<OsString> {
    let named = env::var_os("PYTHON");
    let candidates = match &named {
        Some(python) => vec![python.clone()],
        None => ["python3.11", "python3", "python"]
            .map(OsString::from)
            .into(),
    };
    let script = "import sys; print('%d.%d' % sys.version_info[:2])";
    for python in &candidates {
        let output = Command::new(python).args(["-c", script]).output();
        let version =
            output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
        if version.is_ok_and(|version| version == PYTHON) {
            return Ok(python.clone());
        }
    }
    bail!(
        "{BPY} needs Python {PYTHON}, and none of {candidates:?} is one; install it, or let the variable PYTHON name it"
    )
}

fn call(command: &mut Command) -> Result<()> {
    let status = command
        .status()
        .with_context(|| format!("cannot run {:?}", command.get_program()))?;
    if !status.success() {
        bail!("{command:?} failed ({status}); its messages are above");
    }
    Ok(())
}
