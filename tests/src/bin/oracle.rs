//! `oracle DIR PREFIX`: compares the port with the published program's numbers
//! and prints one JSON object as the last line of stdout, each value the largest
//! difference over the largest entry of the reference part.

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dir, prefix] = arguments.as_slice() else {
        eprintln!(
            "usage: oracle DIR PREFIX\n\nreads weights, PREFIX_inputs, PREFIX_forward_f32_tiesafe, \
             PREFIX_train_f32_tiesafe,\nPREFIX_rollout_tiesafe and PREFIX_multistep_train (.safetensors) in DIR"
        );
        return ExitCode::from(2);
    };
    match drape_tests::oracle::compare(Path::new(dir), prefix) {
        Ok(report) => {
            println!("{report}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("oracle: {error:#}");
            ExitCode::FAILURE
        }
    }
}
