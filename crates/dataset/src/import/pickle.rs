//! Python pickles of numbers: dicts, lists, text and numpy arrays, from a file
//! nobody vouches for.
//!
//! A pickle is a program for a stack machine that may call any Python function.
//! This reader runs the stack machine and calls nothing: what numpy, scipy and
//! chumpy need to describe an array is understood by name (see [`globals`]),
//! every other name is refused by name.
//!
//! - Protocols 0 to 5 are read, written by Python 2 (whose byte strings are
//!   taken as Latin-1, which is how numpy data travels in them) or Python 3.
//!   Source: the opcode table in the comments of CPython's `pickletools.py`.
//! - Arrays are not copied: long strings stay in the file as a range of it, and
//!   [`Frames`] reads an array of frames one frame at a time. A recording of a
//!   gigabyte costs as much memory as one of its frames.
//! - What is in memory is counted and limited ([`MEMORY_LIMIT`],
//!   [`MAX_VALUES`]); a length in the file is believed only if so many bytes are
//!   there. Values refer to each other by number, so neither nesting nor cycles
//!   cost stack.
//!
//! Left out, and refused by name: persistent ids, extension codes, buffers
//! outside the file, old-style instances, integers beyond 64 bits.

mod calls;
mod frames;
mod globals;
mod machine;
mod numbers;
mod opcodes;
mod source;
mod value;

pub(super) use frames::Frames;
pub(super) use value::Item;

use std::path::{Path, PathBuf};

use self::globals::{Class, Dtype};
use self::machine::Machine;
use self::source::{Source, Stored};
use crate::error::{DatasetError, Result};

/// Bytes of values in memory, not of arrays that stay in the file; while a table
/// grows, twice as much for a moment. A body model with everything in memory
/// takes 100 MB, the UV map of a garment 40 MB.
const MEMORY_LIMIT: usize = 256 << 20;

/// Numbers taken out of one array or nested list at once: 256 MB. The largest
/// array that is taken whole, a body model's pose directions, has 4.3 million.
const MAX_VALUES: usize = 32 << 20;

/// What a pickle file holds. Bytes of long arrays are still in the file.
pub(super) struct Pickle {
    path: PathBuf,
    nodes: Vec<Node>,
    root: Id,
}

/// Number of a value.
type Id = u32;

/// One value.
#[derive(Debug)]
enum Node {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// Text, bytes, or a Python 2 string, which is either.
    Str(Stored),
    Tuple(Vec<Id>),
    /// A list or a set.
    List(Vec<Id>),
    /// Entries in the file's order; of two with one key the later counts.
    Dict(Vec<(Id, Id)>),
    /// A name that the reader knows.
    Class(Class),
    Dtype(Dtype),
    Array(Box<ArrayNode>),
    /// An instance and its state.
    Object(Class, Option<Id>),
}

/// A numpy array.
#[derive(Debug)]
struct ArrayNode {
    shape: Vec<u64>,
    dtype: Dtype,
    /// The first index runs fastest.
    fortran: bool,
    /// Its bytes: [`Node::Str`]. None before the array got its state.
    data: Option<Id>,
}

impl Pickle {
    /// Reads a pickle file.
    ///
    /// # Errors
    /// No such file; anything that is not a pickle of the supported values: the
    /// error names the byte, what was expected there and what was found.
    pub fn open(path: &Path) -> Result<Self> {
        let source = Source::open(path).map_err(DatasetError::io("open", path))?;
        let (nodes, root) = Machine::new(source).run().map_err(|error| {
            let place = format!("pickle, byte {}", error.position);
            DatasetError::invalid(place, error.expected, error.found).in_file(path)
        })?;
        Ok(Self {
            path: path.into(),
            nodes,
            root,
        })
    }

    /// The value that was pickled.
    pub fn root(&self) -> Item<'_> {
        Item::new(self, self.root)
    }

    /// Error about a value of this file.
    pub fn invalid(
        &self,
        place: &str,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> DatasetError {
        DatasetError::invalid(place, expected, found).in_file(&self.path)
    }
}
