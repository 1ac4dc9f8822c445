//! Compiles the format's schemas in `data-spec/` without a system `protoc`: Rust
//! types for the crate, and the descriptor sets that files carry in their MCAP
//! schema records so that other tools can read them.

use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

use protox::prost::Message;

/// Where the schemas live, seen from this crate: links to `data-spec/`, so that a
/// package of the crate holds them.
const SPEC: &str = "proto";
/// A descriptor set for each schema, with all that the schema imports.
const SCHEMAS: [&str; 2] = ["drape", "quantised"];

fn main() -> Result<(), Box<dyn Error>> {
    let spec = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join(SPEC);
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let mut all = protox::Compiler::new([&spec])?;
    for schema in SCHEMAS {
        println!("cargo::rerun-if-changed={SPEC}/{schema}.proto");
        let file = format!("{schema}.proto");
        all.include_imports(true).open_file(&file)?;
        let mut one = protox::Compiler::new([&spec])?;
        let descriptors = one.include_imports(true).open_file(&file)?;
        let descriptors = descriptors.file_descriptor_set().encode_to_vec();
        fs::write(out.join(schema).with_extension("binpb"), descriptors)?;
    }
    // `Bytes` fields borrow the chunk they are decoded from: positions are copied once.
    prost_build::Config::new()
        .bytes(["."])
        .compile_fds(all.file_descriptor_set())?;
    Ok(())
}
