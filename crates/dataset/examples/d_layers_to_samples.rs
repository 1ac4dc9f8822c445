//! `d_layers_to_samples ROOT OUT`: the published D-LAYERS folder as a data set, and
//! patched samples of it.

use std::{env, error::Error, fs, path::PathBuf};

use drape_dataset::SequenceWriter;
use drape_dataset::import::DLayers;
use drape_dataset::samples::{SampleOptions, Samples};
use drape_dataset::splits::{DatasetIndex, Split};

fn main() -> Result<(), Box<dyn Error>> {
    let mut folders = env::args().skip(1).map(PathBuf::from);
    let folders = folders.next().zip(folders.next());
    let (root, out) = folders.ok_or("usage: ROOT OUT")?;
    fs::create_dir_all(&out)?;
    let mut source = DLayers::open(&root, None)?;
    let mut index = DatasetIndex::new(&out, "d-layers");
    let there = source.sequences().filter(|(name, _)| source.has(name));
    let there: Vec<_> = there
        .map(|(name, split)| (name.to_owned(), split))
        .collect();
    for (name, split) in there {
        let recording = source.open_sequence(&name)?;
        let file = format!("{name}.mcap");
        let mut writer = SequenceWriter::create(out.join(&file), recording.header())?;
        for frame in recording {
            writer.push(&frame?)?;
        }
        writer.finish()?;
        index.add(file, split)?;
    }
    index.save()?;
    let samples = Samples::open(&index, Split::Train, SampleOptions::default())?;
    for sample in samples.take(3) {
        let sample = sample?;
        let patches = sample.outfit.patches.count();
        println!("{} vertices, {patches} patches", sample.state.len());
    }
    Ok(())
}
