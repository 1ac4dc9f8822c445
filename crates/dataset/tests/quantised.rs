//! Quantised files: no vertex farther off than promised, everything else exact, in any
//! order, through damage; and never mistaken for exact ones.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
#[allow(dead_code)]
mod json;

use std::fs;
use std::path::PathBuf;

use drape_dataset::file::{Storage, recover};
use drape_dataset::sequence::{Frame, SequenceHeader};
use drape_dataset::splits::{DatasetIndex, Split};
use drape_dataset::{DatasetError, SequenceReader, SequenceWriter};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

const FRAMES: usize = 40;

/// A sheet of n × n vertices, 1 m wide, that waves, jumps once, and walks away.
fn sheet(n: u32) -> (SequenceHeader, Vec<Frame>) {
    let mut header = cases::two_layers();
    header.garments.truncate(1);
    let garment = &mut header.garments[0];
    let at = |i: u32, j: u32| i * n + j;
    let grid = || (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let side = (n - 1) as f32;
    garment.rest = grid()
        .map(|(i, j)| [i as f32, j as f32, 0.0].map(|x| x * 10.0 / side))
        .collect();
    garment.faces = grid()
        .filter(|&(i, j)| i + 1 < n && j + 1 < n)
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
            [[a, b, c], [c, b, d]]
        })
        .collect();
    garment.uv = garment
        .rest
        .iter()
        .map(|x| [x[0] / 10.0, x[1] / 10.0])
        .collect();
    garment.uv_faces = garment.faces.clone();
    garment.panel_of_face = vec![0; garment.faces.len()];
    let rest = garment.rest.clone();
    let frame = |f: usize| {
        let mut frame = cases::two_layers_frames().remove(f % 3);
        let t = f as f32 / 30.0;
        let jump = if f >= 23 { 4000.0 } else { 0.0 };
        let wave = |x: &[f32; 3]| {
            let z = (1.3 * x[0] + 5.0 * t).sin() * (0.7 * x[1] + t).cos();
            [x[0] + 12.0 * t + jump, x[1] + 0.1 * z, 12.0 + z]
        };
        frame.garments = vec![rest.iter().map(wave).collect()];
        frame
    };
    (header, (0..FRAMES).map(frame).collect())
}

fn write(folder: &TempDir, name: &str, storage: Storage) -> (PathBuf, SequenceHeader, Vec<Frame>) {
    let (header, frames) = sheet(20);
    let path = folder.path().join(name);
    fs::write(&path, cases::written_as(storage, &header, &frames)).unwrap();
    (path, header, frames)
}

#[test]
fn no_vertex_is_farther_off_than_the_file_says_and_all_else_is_exact() {
    let folder = TempDir::new().unwrap();
    for max_error_m in [1e-2, 5e-5, 2e-5] {
        let storage = Storage::Quantised { max_error_m };
        let (path, header, frames) = write(&folder, "s.mcap", storage);
        let reader = SequenceReader::open(path).unwrap();
        assert_eq!((reader.header(), reader.storage()), (&header, storage));
        let mut farthest = 0f64;
        for (found, exact) in reader.read_all().unwrap().iter().zip(&frames) {
            let scene = |frame: &Frame| (frame.root, frame.wind, frame.intersections);
            assert_eq!(scene(found), scene(exact));
            let pairs = found.body.iter().zip(&exact.body);
            for (a, b) in pairs.chain(found.garments[0].iter().zip(&exact.garments[0])) {
                let square: f64 = (0..3)
                    .map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2))
                    .sum();
                farthest = farthest.max(square.sqrt());
            }
        }
        let bound = f64::from(max_error_m) * 10.0;
        assert!(farthest <= bound, "{farthest} units, stated {bound}");
        assert!(
            farthest > 0.8 * bound,
            "a bound that nothing comes near is no use"
        );
    }
}

#[test]
fn it_is_at_least_three_and_a_half_times_smaller_than_exact() {
    let (header, frames) = sheet(64);
    let size = |storage| cases::written_as(storage, &header, &frames).len() as f64;
    let ratio = size(Storage::Exact) / size(Storage::VIEWING);
    assert!(ratio >= 3.5, "{ratio}");
}

#[test]
fn frames_are_the_same_in_any_order_and_in_any_window() {
    let folder = TempDir::new().unwrap();
    let (path, ..) = write(&folder, "s.mcap", Storage::VIEWING);
    let reader = SequenceReader::open(path).unwrap();
    let all = reader.read_all().unwrap();
    for i in (0..FRAMES).rev().chain([15, 16, 17, 31, 32, 33]) {
        assert_eq!(reader.frame(i).unwrap(), all[i], "frame {i}");
    }
    for start in 0..FRAMES {
        let end = (start + 20).min(FRAMES);
        let window: Vec<_> = reader.frames(start..end).map(Result::unwrap).collect();
        assert_eq!(window, all[start..end], "from {start}");
    }
}

#[test]
fn writing_quantised_frames_again_changes_nothing() {
    let folder = TempDir::new().unwrap();
    let (path, header, _) = write(&folder, "s.mcap", Storage::VIEWING);
    let reader = SequenceReader::open(path).unwrap();
    let once = reader.read_all().unwrap();
    let again = folder.path().join("again.mcap");
    fs::write(&again, cases::written_as(reader.storage(), &header, &once)).unwrap();
    assert_eq!(
        SequenceReader::open(again).unwrap().read_all().unwrap(),
        once
    );
}

#[test]
fn each_flipped_bit_is_found_and_a_cut_or_damaged_file_gives_its_whole_frames() {
    let folder = TempDir::new().unwrap();
    let (path, ..) = write(&folder, "s.mcap", Storage::VIEWING);
    let whole = SequenceReader::open(&path).unwrap().read_all().unwrap();
    let sound = fs::read(&path).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..1000 {
        let mut bytes = sound.clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= 1 << rng.random_range(0..8);
        fs::write(&path, &bytes).unwrap();
        let found = SequenceReader::open(&path).and_then(|r| r.check_bytes().map(|()| r));
        assert!(found.is_err(), "byte {at}");
    }
    let chunks = mcap::Summary::read(&sound).unwrap().unwrap().chunk_indexes;
    let starts = |frame: usize| chunks[frame + 1].chunk_start_offset as usize;

    fs::write(&path, &sound[..starts(21)]).unwrap();
    let message = SequenceReader::open(&path).unwrap_err().to_string();
    assert!(message.contains("frames 0 to 20 are whole"), "{message}");

    // Frame 5 is broken: what follows needs it, up to the next key frame.
    let mut bytes = sound.clone();
    bytes[starts(5) + 60] ^= 1;
    fs::write(&path, &bytes).unwrap();
    let saved = recover(&path, folder.path().join("out.mcap")).unwrap();
    let ranges: Vec<_> = saved.iter().map(|saved| saved.frames.clone()).collect();
    assert_eq!(ranges, [0..5, 16..FRAMES]);
    for saved in saved {
        let reader = SequenceReader::open(saved.path).unwrap();
        assert_eq!(reader.storage(), Storage::VIEWING);
        assert_eq!(reader.read_all().unwrap(), whole[saved.frames]);
    }
}

#[test]
fn what_the_grid_cannot_hold_is_refused_and_the_writer_goes_on() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    let (header, frames) = sheet(4);
    for max_error_m in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let storage = Storage::Quantised { max_error_m };
        let error = SequenceWriter::create_with(&path, &header, storage)
            .err()
            .unwrap();
        assert!(error.to_string().contains("max_error_m"), "{error}");
    }
    let mut writer = SequenceWriter::create_with(&path, &header, Storage::VIEWING).unwrap();
    writer.push(&frames[0]).unwrap();
    for far in [2e6, 1e30] {
        let mut frame = frames[1].clone();
        frame.garments[0][3][1] = far;
        let message = writer.push(&frame).unwrap_err().to_string();
        assert!(
            message.contains("frame 1, garment 0, vertex 3"),
            "{message}"
        );
    }
    writer.push(&frames[1]).unwrap();
    writer.finish().unwrap();
    assert_eq!(SequenceReader::open(&path).unwrap().frame_count(), 2);
}

#[test]
fn a_data_set_takes_no_quantised_sequence() {
    let folder = TempDir::new().unwrap();
    write(&folder, "exact.mcap", Storage::Exact);
    write(&folder, "s.mcap", Storage::VIEWING);
    let mut index = DatasetIndex::new(folder.path(), "mixed");
    index.add("exact.mcap", Split::Train).unwrap();
    let error = index.add("s.mcap", Split::Train).unwrap_err();
    assert!(matches!(error, DatasetError::InFile { .. }), "{error}");
    let message = error.to_string();
    assert!(
        message.contains("0.00005 m") && message.contains("exact"),
        "{message}"
    );
    // Nor does it open one that took another's place.
    fs::copy(
        folder.path().join("s.mcap"),
        folder.path().join("exact.mcap"),
    )
    .unwrap();
    assert!(index.open(&index.sequences()[0]).is_err());
}
