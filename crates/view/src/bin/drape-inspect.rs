//! `drape-inspect FILE`: contents, checks and pictures of a sequence file, or of a
//! garment in an OBJ file.
//! Exits with 1 when a check failed, with 2 when the command line is wrong.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use drape_dataset::SequenceReader;
use drape_dataset::file::recover;
use drape_dataset::obj::GarmentMesh;
use drape_dataset::patches::patch_of_face;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{Frame, Material};
use drape_view::inspection::Inspection;
use drape_view::patches::patch_sheet;
use drape_view::sheet::{Clip, SheetOptions, contact_sheet, spread};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Show what a sequence file holds: contents, checks, a contact sheet of
/// shaded frames, and the patches that the model would see. Of a garment in an
/// OBJ file: size, checks, and its panels in colour.
#[derive(Parser)]
#[command(name = "drape-inspect", version)]
struct Arguments {
    /// Sequence file (.mcap), or garment (.obj).
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
    /// Write the whole frames of a cut or damaged sequence file to a sound one, and
    /// do nothing else; frames behind a lost one go to OUT's name with `.from_N`.
    #[arg(long, value_name = "OUT", conflicts_with_all = ["out", "sheet", "patches", "no_pictures"])]
    recover: Option<PathBuf>,
}

fn main() -> ExitCode {
    // `drape-inspect FILE | head` ends quietly.
    sigpipe::reset();
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
    if let Some(out) = &arguments.recover {
        return recover_frames(&arguments.file, out);
    }
    let ending = arguments.file.extension().unwrap_or_default();
    if ending.eq_ignore_ascii_case("obj") {
        return inspect_garment(arguments);
    }
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

/// Saves what is whole of a damaged file, and tells what that is.
fn recover_frames(damaged: &Path, out: &Path) -> Result<bool> {
    for saved in recover(damaged, out)? {
        let (first, last) = (saved.frames.start, saved.frames.end - 1);
        println!("frames {first} to {last}  {}", saved.path.display());
    }
    Ok(true)
}

/// Contents, checks and panels of a garment; whether all checks passed.
fn inspect_garment(arguments: &Arguments) -> Result<bool> {
    let mesh = GarmentMesh::read(&arguments.file)?;
    let mut extent = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
    for (position, axis) in mesh.rest.iter().flat_map(|x| x.iter().zip(0..3)) {
        let [low, high] = &mut extent[axis];
        (*low, *high) = (low.min(*position), high.max(*position));
    }
    let [x, y, z] = extent.map(|[low, high]| high - low);
    println!("garment   {}", arguments.file.display());
    println!(
        "mesh      {} vertices, {} faces, {} UV coordinates, {} panels",
        mesh.rest.len(),
        mesh.faces.len(),
        mesh.uv.len(),
        mesh.panel_count
    );
    println!("extent    {x} × {y} × {z} units");
    println!("\nchecks");
    println!("  ok     numbers, triangles, UVs and areas of every line");
    for note in &mesh.notes {
        println!("  note   {note}");
    }
    if mesh.notes.is_empty() {
        println!("  ok     triangles only, edges, welding, pieces, size, up axis");
    }
    if !arguments.no_pictures {
        // The picture needs a garment; neither kind nor material is drawn.
        let material = Material {
            mass: 0.0,
            tension: 0.0,
            compression: 0.0,
            shear: 0.0,
            bending: 0.0,
            friction: 0.0,
        };
        let garment = mesh.into_garment("garment", GarmentKind::TShirt, 0, material);
        let path = picture_path(arguments, &arguments.patches, "panels")?;
        patch_sheet(
            std::slice::from_ref(&garment),
            std::slice::from_ref(&garment.panel_of_face),
        )?
        .write_png(&path)?;
        println!("\npictures\n  panels  {}", path.display());
    }
    Ok(true)
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
