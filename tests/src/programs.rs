//! Runs the workspace's programs as a person would, from tests.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// A program of the workspace, in `folder`.
///
/// # Panics
/// When the program is not built: `cargo xtask ci` builds all of them before the tests.
pub fn program(name: &str, folder: &Path) -> Command {
    let path = release_folder().join(format!("{name}{}", env::consts::EXE_SUFFIX));
    assert!(
        path.is_file(),
        "{} is not built: run `cargo build --release --workspace --bins` first",
        path.display()
    );
    let mut command = Command::new(path);
    command.current_dir(folder);
    command
}

/// Runs a program to its end.
///
/// # Panics
/// When the program cannot be started.
pub fn run<S: AsRef<OsStr>>(name: &str, folder: &Path, arguments: &[S]) -> Output {
    program(name, folder)
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// What a program printed.
pub fn printed(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// The folder with the programs that tests belong to: tests run from `TARGET/PROFILE/deps`.
///
/// # Panics
/// When the running test is not in such a folder.
pub fn release_folder() -> PathBuf {
    let test = env::current_exe().expect("a test has a path");
    test.ancestors()
        .nth(2)
        .expect("tests run from TARGET/PROFILE/deps")
        .to_path_buf()
}
