//! What the cloth of finished sequence files is like, file by file and in all.
//!
//! ```text
//! cargo run --release -p drape-sim --example quality -- data/wardrobe/*.mcap
//! ```

use anyhow::{Context, Result};
use drape_dataset::SequenceReader;
use drape_sim::scene::Quality;

fn main() -> Result<()> {
    let mut all = Quality::default();
    for path in std::env::args().skip(1) {
        let reader = SequenceReader::open(std::path::Path::new(&path))
            .with_context(|| format!("cannot open {path}"))?;
        let frames = (0..reader.frame_count())
            .map(|frame| reader.frame(frame))
            .collect::<Result<Vec<_>, _>>()?;
        let header = reader.header();
        let quality = Quality::of(header, &frames);
        let names: Vec<&str> = header.garments.iter().map(|g| g.name.as_str()).collect();
        println!(
            "{path}: {}; {} frames: {quality}",
            names.join(", "),
            frames.len()
        );
        all.merge(&quality);
    }
    println!("all: {all}");
    Ok(())
}
