//! A sequence of the data set: its header, and its frames one after the other.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use drape_geometry::rigid::quaternion_from_matrix;

use super::header;
use super::meta::Meta;
use super::motion::{self, Motion};
use super::wind::{Pivot, wind_at};
use crate::error::{DatasetError, Result};
use crate::import::pickle::Frames;
use crate::import::smpl::{BodyModel, ShapedBody, rotation_of};
use crate::sequence::{Frame, Root, SequenceHeader};

/// A sequence whose frames are read in order: an iterator over them.
///
/// It holds the header, the motion and one frame, whatever the sequence's length.
pub struct Recording {
    header: SequenceHeader,
    folder: PathBuf,
    garments: Vec<Frames>,
    body: Option<ShapedBody>,
    motion: Motion,
    wind: Vec<Pivot>,
    scale: f64,
    next: usize,
    frame_count: usize,
}

pub(super) fn open(
    root: &Path,
    folder: &Path,
    name: &str,
    mut meta: Meta,
    model: Option<Arc<BodyModel>>,
) -> Result<Recording> {
    let mut notes = std::mem::take(&mut meta.notes);
    let mut garments = Vec::new();
    let mut streams: Vec<Frames> = Vec::new();
    for (layer, garment) in meta.garments.iter().enumerate() {
        let (garment, frames) = header::garment(folder, layer, garment, &meta.path, &mut notes)?;
        if let Some(first) = streams.first()
            && first.frame_count() != frames.frame_count()
        {
            let place = format!("garment {:?}, vertices", garment.name);
            let expected = format!("{} frames, as the first garment has", first.frame_count());
            let found = frames.frame_count().to_string();
            return Err(DatasetError::invalid(place, expected, found).in_file(folder));
        }
        garments.push(garment);
        streams.push(frames);
    }
    let Some(first) = streams.first() else {
        let error = DatasetError::invalid("garment", "at least one garment", "none");
        return Err(error.in_file(&meta.path));
    };
    let frame_count = first.frame_count();
    let [start, end] = meta.human.range;
    if frame_count as u64 != end - start {
        notes.push(format!(
            "meta.json tells of {} frames (seq_start {start}, seq_end {end}), the garments have \
             {frame_count}: all of these are taken",
            end - start
        ));
    }
    let motion = motion::read(&root.join(&meta.human.motion), start, frame_count)?;
    let body = model
        .map(|model| model.shaped(&meta.human.betas))
        .transpose()
        .map_err(|error| error.in_file(&meta.path))?;
    let header = header::header(name, &meta, garments, body.as_ref(), notes)?;
    Ok(Recording {
        header,
        folder: folder.to_path_buf(),
        garments: streams,
        body,
        motion,
        wind: meta.wind,
        scale: meta.human.scale,
        next: 0,
        frame_count,
    })
}

impl Recording {
    /// What is fixed; its warnings tell what was derived.
    pub fn header(&self) -> &SequenceHeader {
        &self.header
    }

    /// Number of frames, those handed out included.
    pub fn frame_count(&self) -> usize {
        self.frame_count
    }

    fn read(&mut self, index: usize) -> Result<Frame> {
        let pose = &self.motion.poses[index];
        let translation = self.motion.translations[index];
        let body = match &self.body {
            None => Vec::new(),
            Some(body) => {
                let offset = body.root_offset();
                let shift = std::array::from_fn(|k| translation[k] + offset[k]);
                let units = |p: [f64; 3]| p.map(|x| (x * self.scale) as f32);
                body.posed(pose, shift)?.into_iter().map(units).collect()
            }
        };
        let garments = self
            .garments
            .iter_mut()
            .map(Frames::next)
            .collect::<Result<_>>()?;
        let frame = Frame {
            body,
            root: Root {
                translation: translation.map(|x| (x * self.scale) as f32),
                rotation: quaternion_from_matrix(&rotation_of(pose[0])).map(|x| x as f32),
            },
            garments,
            wind: wind_at(&self.wind, index),
            intersections: None,
        };
        frame.check(&self.header)?;
        Ok(frame)
    }
}

/// Frames in order; after an error there are no further ones. Nobody has counted
/// intersections: [`count_intersections`](crate::intersections::count_intersections) does.
impl Iterator for Recording {
    type Item = Result<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        let index = self.next;
        if index >= self.frame_count {
            return None;
        }
        let frame = self.read(index).map_err(|error| match error {
            DatasetError::Invalid { .. } => {
                error.at(&format!("frame {index}")).in_file(&self.folder)
            }
            // It says where already.
            other => other,
        });
        self.next = if frame.is_ok() {
            index + 1
        } else {
            self.frame_count
        };
        Some(frame)
    }
}
