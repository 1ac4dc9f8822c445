//! The D-LAYERS data set as published (Shao et al., Towards Multi-Layered 3D
//! Garments Animation, ICCV 2023), turned into sequences.
//!
//! ```text
//! ROOT/data/train_val_test.json         {"train": [...], "val": [...], "test": [...]}
//! ROOT/data/SEQ/meta.json               body, garments (inner first), wind
//! ROOT/data/SEQ/GARMENT.pkl             vertices [frame, vertex, 3], faces [face, 3], tpose [vertex, 3]
//! ROOT/data/SEQ/uv_GARMENT.pkl          {panel: {vertices: {vertex: uv}, faces: [[vertex, 3]]}}
//! ROOT/MOTION                           poses, trans; MOTION is human.motion_path of meta.json
//! DIR/model_f.pkl, DIR/model_m.pkl      SMPL (or .npz), licensed, not part of the data set
//! ```
//!
//! What is taken over, and what is derived (each sequence's warnings repeat it):
//!
//! | ours | from |
//! |---|---|
//! | frame f | row f of `vertices`; pose `seq_start + f` of the motion. The published reader adds `seq_start` to body frames twice; it counts once here |
//! | body | `scale` · (SMPL(pose, betas) + trans + root offset), see [`smpl`](super::smpl); empty without a model |
//! | root | `scale` · trans, the origin that the published program uses (the root joint is there plus `scale` · root offset); rotation of joint 0 |
//! | rest positions | `tpose`, and SMPL's rest pose with joint 0 in the origin: both Y-up, turned Z-up by (x, y, z) → (x, −z, y) |
//! | layer | place in `garment[]` |
//! | kind | the 12 published garment names, see [`kind_of`] |
//! | panel | UV groups; UVs are unchanged, so the published patch size 0.04 holds in UV units |
//! | `metres_per_uv` | ratio of the areas in space and in UV |
//! | wind | the last pivot whose `frame_start` − `human.frame_start` is not after f; none before the first |
//! | material | `cloth`; compression and shear stiffness are the tension stiffness where `cloth` lacks them |
//! | fps | 30, from the paper |
//! | gravity | Blender's default, acting in frame time: 0.001 · 9.81 units/frame² |
//! | effects | what the paper says of its generator |
//! | recipe | `meta.json` |
//!
//! Keys of `meta.json` are looked up at the top and, failing that, under
//! `simulate`: both styles are in use.
//!
//! Limitation: written from the published layout and reader, tested on files
//! made in that layout; it has not been run on the data set itself.

mod header;
mod meta;
mod motion;
mod panels;
mod recording;
mod wind;

pub use header::kind_of;
pub use recording::Recording;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use self::meta::Sex;
use super::smpl::BodyModel;
use crate::error::{DatasetError, Result};
use crate::splits::Split;

/// Frames per second of every sequence.
const FPS: f32 = 30.0;
/// A `meta.json` has a few kilobytes, the list of splits less than a hundred.
const MAX_JSON: u64 = 16 << 20;

/// A D-LAYERS folder.
pub struct DLayers {
    root: PathBuf,
    splits: BTreeMap<String, Split>,
    smpl: Option<PathBuf>,
    models: BTreeMap<Sex, Arc<BodyModel>>,
}

impl DLayers {
    /// Opens the data set in `root`; bodies are posed with the SMPL models in
    /// `smpl`, and missing without it.
    ///
    /// # Errors
    /// No list of splits, a split of another name, a sequence in two splits.
    pub fn open(root: impl AsRef<Path>, smpl: Option<&Path>) -> Result<Self> {
        let root = root.as_ref().to_path_buf();
        let path = root.join("data/train_val_test.json");
        let invalid = |place: &str, expected: &str, found: String| {
            DatasetError::invalid(place, expected, found).in_file(&path)
        };
        if !path.is_file() {
            let expected = "the data set's root: the folder that holds data/ and human/";
            return Err(invalid("splits", expected, "no such file".into()));
        }
        let lists: BTreeMap<String, Vec<String>> = serde_json::from_slice(&read_json(&path)?)
            .map_err(|error| {
                let expected = "JSON {\"train\": [names], \"val\": [names], \"test\": [names]}";
                invalid("splits", expected, error.to_string())
            })?;
        let mut splits = BTreeMap::new();
        for (split, names) in lists {
            let split: Split = split.parse().map_err(|e: DatasetError| e.in_file(&path))?;
            for name in names {
                // Names become file names here and there.
                if name.is_empty() || Path::new(&name).file_name() != Some(name.as_ref()) {
                    let expected = "names of folders in ROOT/data";
                    return Err(invalid(split.name(), expected, format!("{name:?}")));
                }
                if let Some(other) = splits.insert(name.clone(), split) {
                    let found = format!("{name:?} in {other} and {split}");
                    return Err(invalid("splits", "each sequence once", found));
                }
            }
        }
        Ok(Self {
            root,
            splits,
            smpl: smpl.map(Path::to_path_buf),
            models: BTreeMap::new(),
        })
    }

    /// Sequences by name, with their splits, as the list says; some may not be
    /// there ([`has`](Self::has)).
    pub fn sequences(&self) -> impl Iterator<Item = (&str, Split)> {
        self.splits
            .iter()
            .map(|(name, &split)| (name.as_str(), split))
    }

    /// Whether the folder of a sequence is there.
    pub fn has(&self, name: &str) -> bool {
        self.folder(name).is_dir()
    }

    /// Opens a sequence: everything but its frames is read.
    ///
    /// # Errors
    /// A missing file or key, shapes or indices that do not fit, a garment of
    /// another kind, a motion that is too short; the error names file and place.
    pub fn open_sequence(&mut self, name: &str) -> Result<Recording> {
        let folder = self.folder(name);
        let meta = meta::read(&folder)?;
        let model = match &self.smpl {
            None => None,
            Some(smpl) => Some(match self.models.get(&meta.human.sex) {
                Some(model) => Arc::clone(model),
                None => {
                    let model = Arc::new(load_model(smpl, meta.human.sex)?);
                    self.models.insert(meta.human.sex, Arc::clone(&model));
                    model
                }
            }),
        };
        recording::open(&self.root, &folder, name, meta, model)
    }

    fn folder(&self, name: &str) -> PathBuf {
        self.root.join("data").join(name)
    }
}

fn load_model(folder: &Path, sex: Sex) -> Result<BodyModel> {
    let stem = match sex {
        Sex::Female => "model_f",
        Sex::Male => "model_m",
    };
    for ending in ["pkl", "npz"] {
        let path = folder.join(stem).with_extension(ending);
        if path.is_file() {
            return BodyModel::load(path);
        }
    }
    let expected = format!("{stem}.pkl or {stem}.npz, a SMPL model (from smpl.is.tue.mpg.de)");
    Err(DatasetError::invalid("body models", expected, "neither").in_file(folder))
}

/// The bytes of a JSON file, unless it is much larger than such a file is.
fn read_json(path: &Path) -> Result<Vec<u8>> {
    let size = fs::metadata(path)
        .map_err(DatasetError::io("read", path))?
        .len();
    if size > MAX_JSON {
        let expected = format!("JSON of at most {MAX_JSON} bytes");
        return Err(DatasetError::invalid("size", expected, size.to_string()).in_file(path));
    }
    fs::read(path).map_err(DatasetError::io("read", path))
}
