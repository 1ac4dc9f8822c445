//! Compiles `data-spec/drape.proto`, the format's single schema, without a
//! system `protoc`: Rust types for the crate, and the descriptor set that every
//! file carries in its MCAP schema records so that other tools can read it.

use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

use protox::prost::Message;

/// Where the schema lives, seen from this crate.
const SPEC: &str = "../../data-spec";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={SPEC}/drape.proto");
    let spec = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join(SPEC);
    let descriptors = protox::Compiler::new([&spec])?
        .include_imports(true)
        .open_file("drape.proto")?
        .file_descriptor_set();
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("drape.binpb"), descriptors.encode_to_vec())?;
    // `Bytes` fields borrow the chunk they are decoded from: positions are copied once.
    prost_build::Config::new()
        .bytes(["."])
        .compile_fds(descriptors)?;
    Ok(())
}
