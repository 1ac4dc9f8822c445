//! Data sets in D-LAYERS' layout, written by Python.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

/// A data set that `make.py` wrote.
pub struct Made {
    _folder: TempDir,
    pub root: PathBuf,
    /// What should be read, by sequence.
    pub expected: Value,
}

/// Whether there is a Python that can write data sets; says so if not.
pub fn python_is_there() -> bool {
    python_has("numpy")
}

/// Whether Python has a module; says what is skipped without it.
pub fn python_has(module: &str) -> bool {
    let there = Command::new("python3")
        .args(["-c", &format!("import {module}")])
        .output()
        .is_ok_and(|output| output.status.success());
    if !there {
        eprintln!("skipped: no python3 with {module} on this machine to write the files");
    }
    there
}

/// Writes a data set with the options that differ from `make.py`'s.
pub fn make(options: Value) -> Made {
    let folder = TempDir::new().unwrap();
    let root = folder.path().join("published");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/d_layers/make.py");
    let output = Command::new("python3")
        .arg(script)
        .arg(&root)
        .arg(options.to_string())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "make.py {options}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let expected = std::fs::read(root.join("expected.json")).unwrap();
    Made {
        _folder: folder,
        root,
        expected: serde_json::from_slice(&expected).unwrap(),
    }
}
