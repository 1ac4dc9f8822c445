//! `drape-inspect FILE`: contents, checks and pictures of a sequence file.
//! Exits with 1 when a check failed, with 2 when the command line is wrong.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use drape_dataset::SequenceReader;
use drape_dataset::patches::patch_of_face;
use drape_dataset::sequence::Frame;
use drape_view::inspection::Inspection;
use drape_view::patches::patch_sheet;
use drape_view::sheet::{Clip, SheetOptions, contact_sheet, spread};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Show what a sequence file holds: contents, checks, a contact sheet of
/// shaded frames, and the patches that the model would see.
#[derive(Parser)]
#[command(name = "drape-inspect", version)]
struct Arguments {
    /// Sequence file (.mcap).
    file: PathBuf,
    /// Folder for pictures without a path of their own [default: the file's folder].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Where to write the contact sheet [default: NAME.sheet.png].
    #[arg(long, value_name = "PNG")]
    sheet: Option<PathBuf>,
    /// Where to write the patches in colour [default: NAME.patches.png].
    #[arg(long, value_name = "PNG")]
    patches: Option<PathBuf>,
    /// Frames on the contact sheet, spread evenly; their intersections are recounted.
    #[arg(long, default_value_t = 6, value_name = "N")]
    frames: usize,
    /// Side of a patch in metres of real cloth.
    #[arg(long, default_value_t = 0.05, value_name = "M")]
    patch_size: f32,
    /// Print only; write no pictures.
    #[arg(long, conflicts_with_all = ["out", "sheet", "patches"])]
    no_pictures: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Whether all checks passed.
fn run(arguments: &Arguments) -> Result<bool> {
    ensure!(arguments.frames > 0, "--frames 0: expected at least 1");
    let patch_size = arguments.patch_size;
    ensure!(
        patch_size.is_finite() && patch_size > 0.0,
        "--patch-size {patch_size}: expected a positive length in metres, such as 0.05"
    );
    let reader = SequenceReader::open(&arguments.file)?;
    let chosen = spread(reader.frame_count(), arguments.frames);
    let inspection = Inspection::of(&reader, &chosen);
    print!("{inspection}");
    if !arguments.no_pictures {
        println!("\npictures");
        draw_sheet(
            &reader,
            &chosen,
            &picture_path(arguments, &arguments.sheet, "sheet")?,
        )?;
        let path = picture_path(arguments, &arguments.patches, "patches")?;
        draw_patches(&reader, patch_size, &path)?;
    }
    Ok(inspection.passed())
}

fn draw_sheet(reader: &SequenceReader, chosen: &[usize], path: &Path) -> Result<()> {
    // A frame that cannot be read is already a failed check: draw the others.
    let frames: Vec<(usize, Frame)> = chosen
        .iter()
        .filter_map(|&index| Some((index, reader.frame(index).ok()?)))
        .collect();
    let header = reader.header();
    let frames = frames
        .iter()
        .map(|(number, frame)| (*number, frame))
        .collect();
    let clip = Clip {
        label: &header.scene.engine,
        header,
        frames,
    };
    contact_sheet(&[clip], &SheetOptions::default())?.write_png(path)?;
    println!("  contact sheet  {}", path.display());
    Ok(())
}

fn draw_patches(reader: &SequenceReader, patch_size_m: f32, path: &Path) -> Result<()> {
    let header = reader.header();
    let size_uv = patch_size_m / header.scene.metres_per_uv;
    let mut patches = Vec::new();
    let mut count = 0;
    for garment in &header.garments {
        let (of_face, garment_count) = patch_of_face(garment, size_uv)?;
        patches.push(of_face);
        count += garment_count;
    }
    patch_sheet(&header.garments, &patches)?.write_png(path)?;
    let millimetres = patch_size_m * 1000.0;
    println!(
        "  patches        {} ({count} of {millimetres} mm)",
        path.display()
    );
    Ok(())
}

/// The path that was asked for, or `NAME.KIND.png` in the output folder.
fn picture_path(arguments: &Arguments, asked: &Option<PathBuf>, kind: &str) -> Result<PathBuf> {
    if let Some(path) = asked {
        return Ok(path.clone());
    }
    let folder = match &arguments.out {
        Some(folder) => {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot make the folder {}", folder.display()))?;
            folder.clone()
        }
        None => arguments
            .file
            .parent()
            .unwrap_or(Path::new(""))
            .to_path_buf(),
    };
    let name = arguments
        .file
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy();
    Ok(folder.join(format!("{name}.{kind}.png")))
}
