//! Finding a Python that has Blender in it.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::{Result, SimError};

/// Names a Python with `bpy`.
const VARIABLE: &str = "DRAPE_BLENDER_PYTHON";
/// Virtual environment that `cargo xtask setup blender` makes in the workspace.
const FOLDER: &str = ".blender";

/// A Python with `bpy`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blender {
    pub(super) python: PathBuf,
    version: String,
}

impl Blender {
    /// Looks for one and asks for its version: the Python that the environment variable
    /// `DRAPE_BLENDER_PYTHON` names, else `.blender` in the current folder or one above it.
    ///
    /// # Errors
    /// [`SimError::NoBlender`] tells where it was looked for and how to get one.
    pub fn find() -> Result<Self> {
        let here = std::env::current_dir().unwrap_or_default();
        let python = look(std::env::var_os(VARIABLE).map(PathBuf::from), &here)?;
        Self::with_python(python)
    }

    /// Blender's version.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Takes this Python, and asks for the version.
    ///
    /// # Errors
    /// [`SimError::NoBlender`]: it does not run, or has no `bpy`.
    pub fn with_python(python: PathBuf) -> Result<Self> {
        let absent = |found: &dyn std::fmt::Display| SimError::NoBlender {
            reason: format!("{} has no usable bpy: {found}", python.display()),
        };
        let output = Command::new(&python)
            .args(["-c", "import bpy; print('bpy', bpy.app.version_string)"])
            .output()
            .map_err(|error| absent(&error))?;
        let printed = String::from_utf8_lossy(&output.stdout);
        let version = printed.lines().find_map(|line| line.strip_prefix("bpy "));
        match version {
            Some(version) if output.status.success() => Ok(Self {
                version: version.trim().to_owned(),
                python,
            }),
            _ => {
                let said = String::from_utf8_lossy(&output.stderr);
                Err(absent(&said.lines().last().unwrap_or("it said nothing")))
            }
        }
    }
}

/// The Python that is `named`, else that of the nearest environment at or above a folder.
fn look(named: Option<PathBuf>, from: &Path) -> Result<PathBuf> {
    if let Some(python) = named {
        return Ok(python);
    }
    let inside = if cfg!(windows) {
        "Scripts/python.exe"
    } else {
        "bin/python"
    };
    from.ancestors()
        .map(|folder| folder.join(FOLDER).join(inside))
        .find(|python| python.exists())
        .ok_or_else(|| SimError::NoBlender {
            reason: format!(
                "{VARIABLE} is not set, and neither {} nor a folder above it has {FOLDER}/{inside}",
                from.display()
            ),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(result: Result<impl std::fmt::Debug>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn without_blender_the_message_names_places_command_and_variable() {
        let empty = tempfile::tempdir().unwrap();
        let message = refusal(look(None, empty.path()));
        for part in [
            empty.path().to_str().unwrap(),
            ".blender",
            "cargo xtask setup blender",
            "DRAPE_BLENDER_PYTHON",
        ] {
            assert!(message.contains(part), "no {part:?} in: {message}");
        }
    }

    #[test]
    fn a_python_that_is_not_there_or_has_no_bpy_is_named() {
        let gone = PathBuf::from("/nowhere/python");
        let message = refusal(Blender::with_python(
            look(Some(gone), Path::new("/")).unwrap(),
        ));
        assert!(message.contains("/nowhere/python"), "{message}");
        assert!(message.contains("cargo xtask setup blender"), "{message}");
        // A program that runs but does not print a version.
        if cfg!(unix) {
            let message = refusal(Blender::with_python("/bin/false".into()));
            assert!(
                message.contains("/bin/false has no usable bpy"),
                "{message}"
            );
        }
    }

    #[test]
    fn the_nearest_environment_at_or_above_the_folder_is_taken() {
        let root = tempfile::tempdir().unwrap();
        let inner = root.path().join("a/b");
        std::fs::create_dir_all(&inner).unwrap();
        let inside = if cfg!(windows) {
            ".blender/Scripts/python.exe"
        } else {
            ".blender/bin/python"
        };
        let put = |folder: &Path| {
            let python = folder.join(inside);
            std::fs::create_dir_all(python.parent().unwrap()).unwrap();
            std::fs::write(&python, "").unwrap();
            python
        };
        let far = put(root.path());
        assert_eq!(look(None, &inner).unwrap(), far);
        let near = put(&root.path().join("a"));
        assert_eq!(look(None, &inner).unwrap(), near);
        assert_eq!(look(Some("x".into()), &inner).unwrap(), Path::new("x"));
    }
}
