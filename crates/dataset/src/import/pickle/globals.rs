//! The names that a pickle may use, what calling them means, and numpy's types.

/// A known name. Nothing is called: the machine describes what Python would make.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    /// `numpy.core.multiarray._reconstruct`: an empty array, its state follows.
    Reconstruct,
    /// `numpy.core.numeric._frombuffer`: an array from bytes (protocol 5).
    FromBuffer,
    /// `numpy.core.multiarray.scalar`.
    Scalar,
    NdArray,
    Dtype,
    /// `_codecs.encode`: bytes, spelled as text (protocols up to 2).
    Encode,
    OrderedDict,
    DefaultDict,
    Set,
    /// A type that only names what a container holds.
    Builtin,
    /// `object`, from which `copy_reg._reconstructor` starts.
    Object,
    /// `copy_reg._reconstructor`: an instance, its state follows.
    NewInstance,
    /// `scipy.sparse.csc_matrix`.
    CscMatrix,
    /// `chumpy.ch.Ch`: an array in the entry `x` of its state.
    Chumpy,
    /// `chumpy.reordering.Select`: entries `idxs` of the flat array `a`, as `preferred_shape`.
    ChumpySelect,
}

impl Class {
    /// The name's meaning; none for a name that is refused.
    pub fn of(module: &str, name: &str) -> Option<Self> {
        // numpy 2 moved its core, scipy 1.8 its matrices, Python 3 its builtins.
        let module = match module.strip_prefix("numpy._core") {
            Some(rest) => format!("numpy.core{rest}"),
            None => module.to_owned(),
        };
        Some(match (module.as_str(), name) {
            ("numpy.core.multiarray", "_reconstruct") => Self::Reconstruct,
            ("numpy.core.multiarray", "scalar") => Self::Scalar,
            ("numpy.core.numeric", "_frombuffer") => Self::FromBuffer,
            ("numpy", "ndarray") => Self::NdArray,
            ("numpy", "dtype") => Self::Dtype,
            ("_codecs", "encode") => Self::Encode,
            ("collections", "OrderedDict") => Self::OrderedDict,
            ("collections", "defaultdict") => Self::DefaultDict,
            ("builtins" | "__builtin__", "set" | "frozenset") => Self::Set,
            ("builtins" | "__builtin__", "list" | "dict" | "int" | "float") => Self::Builtin,
            ("builtins" | "__builtin__", "object") => Self::Object,
            ("copyreg" | "copy_reg", "_reconstructor") => Self::NewInstance,
            ("scipy.sparse.csc" | "scipy.sparse._csc", "csc_matrix") => Self::CscMatrix,
            ("chumpy.ch", "Ch") => Self::Chumpy,
            ("chumpy.reordering", "Select") => Self::ChumpySelect,
            _ => return None,
        })
    }

    /// Whether instances of it may appear.
    pub fn has_instances(self) -> bool {
        matches!(self, Self::CscMatrix | Self::Chumpy | Self::ChumpySelect)
    }
}

/// Type of an array's entries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Dtype {
    /// numpy's name, for messages: `f8`.
    pub name: String,
    pub big_endian: bool,
    /// How to read an entry; none for text, objects and records, which are never read.
    pub number: Option<Number>,
}

/// A numeric type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    Float32,
    Float64,
    /// Bytes.
    Signed(u8),
    /// Bytes; truth values are `Unsigned(1)`.
    Unsigned(u8),
}

impl Dtype {
    /// From numpy's name, with or without the mark of the byte order.
    pub fn parse(name: &str) -> Self {
        let big_endian = name.starts_with('>');
        let name = name.trim_start_matches(['<', '>', '|', '=']);
        let number = match name {
            "f4" => Some(Number::Float32),
            "f8" => Some(Number::Float64),
            "i1" => Some(Number::Signed(1)),
            "i2" => Some(Number::Signed(2)),
            "i4" => Some(Number::Signed(4)),
            "i8" => Some(Number::Signed(8)),
            "b1" | "u1" => Some(Number::Unsigned(1)),
            "u2" => Some(Number::Unsigned(2)),
            "u4" => Some(Number::Unsigned(4)),
            "u8" => Some(Number::Unsigned(8)),
            _ => None,
        };
        Self {
            // Nobody needs more of a name that is made up.
            name: name.chars().take(16).collect(),
            big_endian,
            number,
        }
    }
}

impl Number {
    /// Bytes of one entry.
    pub fn size(self) -> usize {
        match self {
            Self::Float32 => 4,
            Self::Float64 => 8,
            Self::Signed(size) | Self::Unsigned(size) => size.into(),
        }
    }

    pub fn is_integer(self) -> bool {
        matches!(self, Self::Signed(_) | Self::Unsigned(_))
    }

    /// One entry from its [`size`](Self::size) bytes.
    pub fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        let size = self.size();
        let mut word = [0; 8];
        word[..size].copy_from_slice(&bytes[..size]);
        if big_endian {
            word[..size].reverse();
        }
        let bits = u64::from_le_bytes(word);
        match self {
            Self::Float32 => f64::from(f32::from_bits(bits as u32)),
            Self::Float64 => f64::from_bits(bits),
            Self::Unsigned(_) => bits as f64,
            Self::Signed(size) => {
                let unused = 64 - 8 * u32::from(size);
                ((bits << unused) as i64 >> unused) as f64
            }
        }
    }
}
