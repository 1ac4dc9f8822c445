//! A data set on disk: a folder of sequence files and the index
//! `dataset.json`, which says what each file holds and which split it belongs to.
//!
//! The index carries each file's SHA-256; [`DatasetIndex::data_hash`] over them
//! names the data that a run was trained or evaluated on, whatever the
//! folder, the files' order or their names.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::ScopedJoinHandle;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::atomic;
use crate::error::{DatasetError, Result};
use crate::file::{EXACT_MINOR, FORMAT_MAJOR, SequenceReader, Storage};
use crate::registry::{GarmentKind, registry};

/// Name of the index in its folder.
pub const INDEX_FILE: &str = "dataset.json";

registry! {
    /// What a sequence is used for.
    Split, "split";
    /// Training.
    Train = "train", "train";
    /// Choosing between models while training.
    Val = "val", "val";
    /// Held out: measured once, never chosen by.
    Test = "test", "test";
}

/// One sequence of a data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequenceEntry {
    /// File name inside the folder.
    pub file: String,
    /// Its split.
    pub split: Split,
    /// Garment kinds, inner layer first.
    pub garments: Vec<GarmentKind>,
    /// Number of frames.
    pub frames: usize,
    /// SHA-256 of the file, lower-case hexadecimal.
    pub sha256: String,
}

/// The index of a data set folder.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetIndex {
    folder: PathBuf,
    contents: Contents,
}

/// What `dataset.json` holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Contents {
    name: String,
    /// `[major, minor]`
    format: [u32; 2],
    sequences: Vec<SequenceEntry>,
}

impl DatasetIndex {
    /// An index without sequences for `folder`; nothing is written yet.
    pub fn new(folder: impl AsRef<Path>, name: impl Into<String>) -> Self {
        let contents = Contents {
            name: name.into(),
            format: [FORMAT_MAJOR, EXACT_MINOR],
            sequences: Vec::new(),
        };
        Self {
            folder: folder.as_ref().to_path_buf(),
            contents,
        }
    }

    /// Reads the index of a folder and looks whether its files are there.
    ///
    /// # Errors
    /// No such folder or index, not the index's JSON (an unknown split or
    /// garment kind is named), a newer format, a file listed twice or missing.
    pub fn load(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref().to_path_buf();
        let path = folder.join(INDEX_FILE);
        let text = fs::read_to_string(&path).map_err(DatasetError::io("read", &path))?;
        // The version first: the rest of a newer index may look different.
        let version: serde_json::Value = parse(&path, &text)?;
        if let Some(major) = version["format"][0].as_u64()
            && major > u64::from(FORMAT_MAJOR)
        {
            let found = format!("{major}");
            return Err(DatasetError::NewerFormat {
                path,
                found,
                supported: FORMAT_MAJOR,
            });
        }
        let index = Self {
            folder,
            contents: parse(&path, &text)?,
        };
        let mut names = BTreeSet::new();
        for entry in index.sequences() {
            let place = format!("sequence {:?}", entry.file);
            let invalid = |expected: &str, found: &str| {
                Err(DatasetError::invalid(&place, expected, found).in_file(&path))
            };
            if Path::new(&entry.file).file_name() != Some(entry.file.as_ref()) {
                return invalid("a file name without folders", &entry.file);
            }
            if !names.insert(&entry.file) {
                return invalid("each file once", "a file listed twice");
            }
            if !index.path(entry).is_file() {
                return invalid("a file in the data set's folder", "no such file");
            }
        }
        Ok(index)
    }

    /// Writes `dataset.json`; an existing one is replaced in one step.
    pub fn save(&self) -> Result<()> {
        let path = self.folder.join(INDEX_FILE);
        let mut text = serde_json::to_string_pretty(&self.contents)
            .map_err(|error| DatasetError::io("write", &path)(io::Error::other(error)))?;
        text.push('\n');
        atomic::write(&path, text.as_bytes())
    }

    /// Opens a finished sequence file of the folder, and lists it.
    /// A file of that name that is listed already is listed anew.
    ///
    /// # Errors
    /// As [`SequenceReader::open`]; a quantised file.
    pub fn add(&mut self, file: impl Into<String>, split: Split) -> Result<()> {
        let file = file.into();
        let path = self.folder.join(&file);
        let reader = open_exact(&path)?;
        let entry = SequenceEntry {
            split,
            garments: reader
                .header()
                .garments
                .iter()
                .map(|garment| garment.kind)
                .collect(),
            frames: reader.frame_count(),
            sha256: file_sha256(&path)?,
            file,
        };
        self.contents
            .sequences
            .retain(|other| other.file != entry.file);
        self.contents.sequences.push(entry);
        Ok(())
    }

    /// The data set's name.
    pub fn name(&self) -> &str {
        &self.contents.name
    }

    /// The data set's folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// All sequences, in the index's order.
    pub fn sequences(&self) -> &[SequenceEntry] {
        &self.contents.sequences
    }

    /// The sequences of one split.
    ///
    /// # Errors
    /// The split is empty; the error says how many the others have.
    pub fn split(&self, split: Split) -> Result<Vec<&SequenceEntry>> {
        let of = |split| {
            self.sequences()
                .iter()
                .filter(move |entry| entry.split == split)
        };
        let entries: Vec<_> = of(split).collect();
        if entries.is_empty() {
            let mut found = String::from("none (");
            for (i, &other) in Split::ALL.iter().enumerate() {
                let comma = if i == 0 { "" } else { ", " };
                // Writing to a String cannot fail.
                write!(found, "{comma}{other}: {}", of(other).count()).expect("memory");
            }
            let place = format!("split {split}");
            return Err(
                DatasetError::invalid(place, "at least one sequence", found + ")")
                    .in_file(self.folder.join(INDEX_FILE)),
            );
        }
        Ok(entries)
    }

    /// Path of a sequence.
    pub fn path(&self, entry: &SequenceEntry) -> PathBuf {
        self.folder.join(&entry.file)
    }

    /// Opens a sequence.
    ///
    /// # Errors
    /// As [`SequenceReader::open`]; a quantised file.
    pub fn open(&self, entry: &SequenceEntry) -> Result<SequenceReader> {
        open_exact(&self.path(entry))
    }

    /// What `work` makes of each of `entries`, in their order. Sequences are opened and
    /// decoded on `threads` threads, which changes the time and nothing else.
    ///
    /// # Errors
    /// That of the first entry, in their order, which cannot be opened or on which `work` fails.
    pub fn map<T: Send>(
        &self,
        entries: &[&SequenceEntry],
        threads: NonZeroUsize,
        work: impl Fn(&SequenceEntry, SequenceReader) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        let next = AtomicUsize::new(0);
        let worker = || {
            let mut done = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(entry) = entries.get(number) else {
                    return done;
                };
                let result = self.open(entry).and_then(|reader| work(entry, reader));
                done.push((number, result));
            }
        };
        let mut done = std::thread::scope(|scope| {
            let workers: Vec<_> = (0..threads.get().min(entries.len()))
                .map(|_| scope.spawn(worker))
                .collect();
            let join = |worker: ScopedJoinHandle<'_, Vec<_>>| {
                worker.join().unwrap_or_else(|panic| resume_unwind(panic))
            };
            workers.into_iter().flat_map(join).collect::<Vec<_>>()
        });
        done.sort_by_key(|(number, _)| *number);
        done.into_iter().map(|(_, result)| result).collect()
    }

    /// Name of the data: SHA-256 over the sorted SHA-256s of the files.
    pub fn data_hash(&self) -> String {
        let mut hashes: Vec<_> = self.sequences().iter().map(|entry| &entry.sha256).collect();
        hashes.sort();
        let mut hasher = Sha256::new();
        for hash in hashes {
            hasher.update(hash);
            hasher.update("\n");
        }
        hex(&hasher.finalize())
    }

    /// Reads every file and compares its SHA-256 with the index's.
    pub fn verify(&self) -> Result<()> {
        for entry in self.sequences() {
            let path = self.path(entry);
            let found = file_sha256(&path)?;
            if found != entry.sha256 {
                return Err(DatasetError::Corrupt {
                    path,
                    place: "the whole file".into(),
                    expected: format!("SHA-256 {} as in {INDEX_FILE}", entry.sha256),
                    found,
                });
            }
        }
        Ok(())
    }
}

/// A data set is there to learn and to measure from: quantised positions are not.
fn open_exact(path: &Path) -> Result<SequenceReader> {
    let reader = SequenceReader::open(path)?;
    match reader.storage() {
        Storage::Exact => Ok(reader),
        quantised => {
            let expected = "exact positions in a data set (accelerations feel the steps)";
            Err(DatasetError::invalid("storage", expected, quantised.to_string()).in_file(path))
        }
    }
}

fn parse<'a, T: Deserialize<'a>>(path: &Path, text: &'a str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| {
        DatasetError::invalid("index", "a drape data set's JSON", error.to_string()).in_file(path)
    })
}

fn file_sha256(path: &Path) -> Result<String> {
    let io = |error| DatasetError::io("read", path)(error);
    let mut hasher = Sha256::new();
    let mut file = BufReader::with_capacity(1 << 20, File::open(path).map_err(io)?);
    io::copy(&mut file, &mut hasher).map_err(io)?;
    Ok(hex(&hasher.finalize()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
