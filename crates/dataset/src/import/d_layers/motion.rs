//! The body's motion: an axis-angle vector per joint and a translation, per frame.

use std::collections::BTreeMap;
use std::path::Path;

use crate::error::{DatasetError, Result};
use crate::import::pickle::{Item, Pickle};

/// Poses of a sequence's frames.
pub(super) struct Motion {
    /// `[frame][joint]`
    pub poses: Vec<Vec<[f64; 3]>>,
    /// `[frame]`, in metres.
    pub translations: Vec<[f64; 3]>,
}

/// Reads `count` frames of a motion file from frame `start` on. `poses` and
/// `trans` are arrays (one row a frame) or dicts keyed by frame number. A motion
/// of one pose holds for every frame, as in the published reader.
pub(super) fn read(path: &Path, start: u64, count: usize) -> Result<Motion> {
    let pickle = Pickle::open(path)?;
    let poses = rows(pickle.root(), "poses", path)?;
    let translations = rows(pickle.root(), "trans", path)?;
    let still = poses.len() == 1;
    let row = |name: &str, rows: &BTreeMap<i64, Vec<[f64; 3]>>, frame: usize| {
        let found = match (still, i64::try_from(start + frame as u64)) {
            (true, _) => rows.values().next(),
            (false, Ok(key)) => rows.get(&key),
            (false, Err(_)) => None,
        };
        found.cloned().ok_or_else(|| {
            let place = format!("{name} of frame {frame} (seq_start {start} + {frame})");
            let ends = rows.keys().next().zip(rows.keys().next_back());
            let found = ends.map_or("no frames".into(), |(first, last)| {
                format!("{} frames, {first} to {last}", rows.len())
            });
            DatasetError::invalid(place, format!("frame {}", start + frame as u64), found)
                .in_file(path)
        })
    };
    let mut motion = Motion {
        poses: Vec::with_capacity(count),
        translations: Vec::with_capacity(count),
    };
    for frame in 0..count {
        motion.poses.push(row("poses", &poses, frame)?);
        let translation = row("trans", &translations, frame)?;
        motion.translations.push(translation[0]);
    }
    Ok(motion)
}

/// Rows of 3-vectors by frame number, all of one length.
fn rows(root: Item<'_>, name: &str, path: &Path) -> Result<BTreeMap<i64, Vec<[f64; 3]>>> {
    let item = root.get(name, "motion")?;
    let place = format!("motion, {name}");
    let mut rows = BTreeMap::new();
    let mut insert = |frame: i64, values: &[f64]| {
        let place = format!("{place}, frame {frame}");
        let (vectors, rest) = values.as_chunks::<3>();
        let expected = match name {
            "trans" => "3 finite numbers",
            _ => "3 finite numbers per joint",
        };
        let fits = !vectors.is_empty()
            && rest.is_empty()
            && (name != "trans" || vectors.len() == 1)
            && values.iter().all(|x| x.is_finite());
        if !fits {
            let found = match values.iter().find(|x| !x.is_finite()) {
                Some(bad) => bad.to_string(),
                None => format!("{} numbers", values.len()),
            };
            return Err(DatasetError::invalid(place, expected, found).in_file(path));
        }
        rows.insert(frame, vectors.to_vec());
        Ok(())
    };
    if item.is_dict() {
        for (key, value) in item.entries(&place)? {
            let frame = key.int().or_else(|| key.text()?.parse().ok());
            let Some(frame) = frame else {
                return Err(item.invalid(&place, "frame numbers as keys", key.describe()));
            };
            insert(frame, &value.numbers(&place)?.values)?;
        }
    } else {
        let array = item.numbers(&place)?;
        let frames = array.shape.first().copied().unwrap_or(0);
        if frames == 0 || array.values.is_empty() {
            let found = format!("shape {:?}", array.shape);
            return Err(item.invalid(&place, "one row a frame", found));
        }
        let width = array.values.len() / frames;
        for (frame, values) in array.values.chunks_exact(width).enumerate() {
            insert(frame as i64, values)?;
        }
    }
    Ok(rows)
}
