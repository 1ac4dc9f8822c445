//! Arrays of an `.npz` file by name, with their shapes checked and in C order.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use npyz::npz::{self, NpzArchive};
use npyz::{DType, Deserialize, NpyFile, Order, TypeChar};

use crate::error::{DatasetError, Result};
use crate::import::array::Array;

/// An open `.npz` file (compressed or not).
pub(in crate::import) struct Arrays {
    archive: NpzArchive<BufReader<File>>,
    path: PathBuf,
}

impl Arrays {
    pub fn open(path: &Path) -> Result<Self> {
        let io = |error| DatasetError::io("open", path)(error);
        let file = BufReader::new(File::open(path).map_err(io)?);
        let archive = NpzArchive::new(file).map_err(|error| {
            DatasetError::invalid("file", "an .npz file (a zip of arrays)", error.to_string())
                .in_file(path)
        })?;
        Ok(Self {
            archive,
            path: path.into(),
        })
    }

    pub fn has(&self, name: &str) -> bool {
        self.archive.array_names().any(|other| other == name)
    }

    /// Error about the array `name`.
    pub fn invalid(&self, name: &str, expected: &str, found: impl Into<String>) -> DatasetError {
        DatasetError::invalid(format!("array {name:?}"), expected, found).in_file(&self.path)
    }

    /// Rows of `N` numbers, `[row, N]`.
    pub fn rows<const N: usize>(&mut self, name: &str) -> Result<Vec<[f32; N]>> {
        let array = self.array(name)?;
        let [_, columns] = array.shape[..] else {
            return Err(self.shape(name, &format!("[rows, {N}]"), &array.shape));
        };
        if columns != N {
            return Err(self.shape(name, &format!("[rows, {N}]"), &array.shape));
        }
        Ok(array.rows())
    }

    /// Rows of `N` indices, `[row, N]`.
    pub fn index_rows<const N: usize>(&mut self, name: &str) -> Result<Vec<[u32; N]>> {
        let array = self.array(name)?;
        if array.shape.len() != 2 || array.shape[1] != N {
            return Err(self.shape(name, &format!("[rows, {N}]"), &array.shape));
        }
        array
            .index_rows()
            .map_err(|bad| self.invalid(name, "indices from 0", bad.to_string()))
    }

    /// Positions of every frame, `[frame, vertex, 3]`.
    pub fn frames(&mut self, name: &str) -> Result<Vec<Vec<[f32; 3]>>> {
        let array = self.array(name)?;
        let [_, vertices, 3] = array.shape[..] else {
            return Err(self.shape(name, "[frames, vertices, 3]", &array.shape));
        };
        if vertices == 0 {
            return Err(self.shape(name, "at least one vertex", &array.shape));
        }
        Ok(array
            .values
            .chunks_exact(vertices * 3)
            .map(|frame| {
                let (rows, _) = frame.as_chunks::<3>();
                rows.iter().map(|row| row.map(|x| x as f32)).collect()
            })
            .collect())
    }

    /// Rotation matrices of one joint, `[frame, joint, 3, 3]` → `[frame][3][3]`.
    pub fn joint_matrices(&mut self, name: &str, joint: usize) -> Result<Vec<[[f64; 3]; 3]>> {
        let array = self.array(name)?;
        let [_, joints, 3, 3] = array.shape[..] else {
            return Err(self.shape(name, "[frames, joints, 3, 3]", &array.shape));
        };
        if joint >= joints {
            let expected = format!("more than {joint} joints, as in joint_names");
            return Err(self.shape(name, &expected, &array.shape));
        }
        Ok(array
            .values
            .chunks_exact(joints * 9)
            .map(|frame| {
                std::array::from_fn(|i| std::array::from_fn(|k| frame[joint * 9 + i * 3 + k]))
            })
            .collect())
    }

    /// One number.
    pub fn number(&mut self, name: &str) -> Result<f64> {
        let array = self.array(name)?;
        match array.values[..] {
            [value] => Ok(value),
            _ => Err(self.shape(name, "one number", &array.shape)),
        }
    }

    /// Number of entries.
    pub fn len(&mut self, name: &str) -> Result<usize> {
        Ok(self.array(name)?.values.len())
    }

    /// Unicode strings.
    pub fn strings(&mut self, name: &str) -> Result<Vec<String>> {
        let file = self.entry(name)?;
        let dtype = file.dtype().descr();
        file.into_vec()
            .map_err(|error| self.invalid(name, "text (dtype <U)", format!("{dtype} ({error})")))
    }

    /// One string that holds JSON.
    pub fn json(&mut self, name: &str) -> Result<serde_json::Value> {
        let strings = self.strings(name)?;
        let [text] = strings.as_slice() else {
            return Err(self.invalid(name, "one text", format!("{} texts", strings.len())));
        };
        serde_json::from_str(text).map_err(|error| self.invalid(name, "JSON", error.to_string()))
    }

    fn shape(&self, name: &str, expected: &str, found: &[usize]) -> DatasetError {
        self.invalid(
            name,
            &format!("shape {expected}"),
            format!("shape {found:?}"),
        )
    }

    fn entry(&mut self, name: &str) -> Result<NpyFile<Cursor<Vec<u8>>>> {
        if !self.has(name) {
            let mut names: Vec<_> = self.archive.array_names().map(str::to_owned).collect();
            names.sort();
            return Err(self.invalid(name, "this array", format!("only {}", names.join(", "))));
        }
        // Whole entry first: the zip's checksum is compared only at its end.
        let entry = npz::file_name_from_array_name(name);
        let mut bytes = Vec::new();
        let read = match self.archive.zip_archive().by_name(&entry) {
            Ok(mut entry) => entry.read_to_end(&mut bytes).map(drop),
            Err(error) => Err(io::Error::other(error)),
        };
        read.and_then(|()| NpyFile::new(Cursor::new(bytes)))
            .map_err(|error| self.invalid(name, "a readable array", error.to_string()))
    }

    /// Any numeric array.
    pub fn array(&mut self, name: &str) -> Result<Array> {
        let file = self.entry(name)?;
        let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
        let order = file.order();
        let dtype = file.dtype();
        let kind = match &dtype {
            DType::Plain(plain) => Some((plain.type_char(), plain.size_field())),
            _ => None,
        };
        let values = match kind {
            Some((TypeChar::Float, 4)) => numbers(file, |x: f32| f64::from(x)),
            Some((TypeChar::Float, 8)) => numbers(file, |x: f64| x),
            Some((TypeChar::Int, 4)) => numbers(file, |x: i32| f64::from(x)),
            Some((TypeChar::Int, 8)) => numbers(file, |x: i64| x as f64),
            Some((TypeChar::Uint, 4)) => numbers(file, |x: u32| f64::from(x)),
            _ => {
                let expected = "numbers of type f4, f8, i4, i8 or u4";
                return Err(self.invalid(name, expected, dtype.descr()));
            }
        };
        let values =
            values.map_err(|error| self.invalid(name, "a readable array", error.to_string()))?;
        Ok(match order {
            Order::Fortran => Array::from_fortran(shape, &values),
            Order::C => Array { shape, values },
        })
    }
}

/// All entries, in the file's order.
fn numbers<T: Deserialize>(
    file: NpyFile<Cursor<Vec<u8>>>,
    to_f64: impl Fn(T) -> f64,
) -> io::Result<Vec<f64>> {
    file.data::<T>()
        .map_err(io::Error::other)?
        .map(|value| value.map(&to_f64))
        .collect()
}
