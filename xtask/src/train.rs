//! The whole job: data, training, table.

use std::{ffi::OsString, fs, path::Path, process::ExitCode};

use anyhow::Result;

use crate::program::{Program, build, exit_code, start, wants_help};

/// Data set that is made when no other is named.
const DEFAULT_DATA: &str = "data/default";
/// File that makes a folder a data set; written when all its sequences are.
const INDEX: &str = "dataset.json";

/// Makes the default data if needed, trains, prints the table of the run.
pub fn run(args: &[OsString]) -> Result<ExitCode> {
    if wants_help(args) {
        build(&[Program::Train])?;
        return start(Program::Train, args).map(exit_code);
    }
    build(&[Program::Generate, Program::Train, Program::Eval])?;
    let made = || Path::new(DEFAULT_DATA).join(INDEX).is_file();
    if uses_default_data(args) && !made() {
        println!("{DEFAULT_DATA} is not there: making it (once; later trainings use it again)");
        let status = start(Program::Generate, &["--out".into(), DEFAULT_DATA.into()])?;
        // Some sequences may have failed (their reasons are printed); the index says that the others are whole.
        if !made() {
            return Ok(exit_code(status));
        }
    }
    let status = start(Program::Train, args)?;
    if !status.success() {
        return Ok(exit_code(status));
    }
    start(Program::Eval, &[]).map(exit_code)
}

/// Whether nothing in the arguments points to another data set: neither `--data`,
/// nor a configuration with a `data` key, nor a run to resume.
fn uses_default_data(args: &[OsString]) -> bool {
    let given = |name: &str| {
        args.iter().enumerate().find_map(|(index, arg)| {
            let rest = arg.to_str()?.strip_prefix(name)?;
            match rest.strip_prefix('=') {
                Some(value) => Some(value.to_owned()),
                None if rest.is_empty() => {
                    Some(args.get(index + 1)?.to_string_lossy().into_owned())
                }
                None => None,
            }
        })
    };
    let in_config = |path: String| {
        fs::read_to_string(path).is_ok_and(|text| {
            text.lines()
                .any(|line| line.starts_with("data ") || line.starts_with("data="))
        })
    };
    !args.iter().any(|arg| arg == "--resume")
        && given("--data").is_none()
        && !given("--config").is_some_and(in_config)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(list: &[&str]) -> Vec<OsString> {
        list.iter().map(OsString::from).collect()
    }

    #[test]
    fn the_default_data_is_made_only_when_nothing_else_is_named() {
        assert!(uses_default_data(&args(&[])));
        assert!(uses_default_data(&args(&[
            "--epochs",
            "2",
            "--database",
            "x"
        ])));
        assert!(!uses_default_data(&args(&["--epochs", "2", "--data", "x"])));
        assert!(!uses_default_data(&args(&["--data=x"])));
        assert!(!uses_default_data(&args(&["--resume"])));
    }
}
