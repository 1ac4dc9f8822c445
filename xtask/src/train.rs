//! The whole job: data, training, table.

use std::{
    ffi::{OsStr, OsString},
    path::Path,
    process::ExitCode,
};

use anyhow::Result;

use crate::program::{Program, build, exit_code, start, wants_help};

/// Data set that is made when no other is named.
const DEFAULT_DATA: &str = "data/default";

/// Makes the default data if needed, trains, prints the table of the run.
pub fn run(args: &[OsString]) -> Result<ExitCode> {
    if wants_help(args) {
        build(&[Program::Train])?;
        return start(Program::Train, args).map(exit_code);
    }
    build(&[Program::Generate, Program::Train, Program::Eval])?;
    if !names_data(args) && !Path::new(DEFAULT_DATA).is_dir() {
        println!("{DEFAULT_DATA} is not there: making it (once; later trainings use it again)");
        let status = start(Program::Generate, &["--out".into(), DEFAULT_DATA.into()])?;
        if !status.success() {
            return Ok(exit_code(status));
        }
    }
    let status = start(Program::Train, args)?;
    if !status.success() {
        return Ok(exit_code(status));
    }
    start(Program::Eval, &[]).map(exit_code)
}

/// Whether the arguments name a data set themselves.
fn names_data(args: &[OsString]) -> bool {
    args.iter()
        .any(|arg| arg == OsStr::new("--data") || arg.to_string_lossy().starts_with("--data="))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_spellings_of_the_data_option_are_seen() {
        let args = |list: &[&str]| list.iter().map(OsString::from).collect::<Vec<_>>();
        assert!(names_data(&args(&["--epochs", "2", "--data", "x"])));
        assert!(names_data(&args(&["--data=x"])));
        assert!(!names_data(&args(&["--database", "x"])));
    }
}
