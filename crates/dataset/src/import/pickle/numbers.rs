//! Numbers out of arrays, lists of lists, and chumpy's wrappings of arrays.

use std::io::Read;

use super::globals::Class;
use super::source::Stored;
use super::{ArrayNode, Frames, Item, MAX_VALUES, Node};
use crate::error::{DatasetError, Result};
use crate::import::array::Array;

/// Lists within lists are taken as an array down to this depth.
const MAX_DEPTH: usize = 6;

impl<'a> Item<'a> {
    /// An array of numbers, or lists of numbers taken as one.
    pub fn numbers(self, place: &str) -> Result<Array> {
        let mut values = Vec::new();
        let mut budget = MAX_VALUES;
        let shape = self.collect(place, MAX_DEPTH, &mut budget, &mut values)?;
        Ok(Array { shape, values })
    }

    /// An array `[frame, vertex, 3]`, to be read frame by frame.
    pub fn frames(self, place: &str) -> Result<Frames> {
        let Node::Array(array) = self.node() else {
            return Err(self.invalid(place, "a numpy array", self.describe()));
        };
        let shape = self.shape(array, place)?;
        let [frames, vertices, 3] = shape[..] else {
            let found = format!("shape {shape:?}");
            return Err(self.invalid(place, "shape [frames, vertices, 3]", found));
        };
        if frames == 0 || vertices == 0 {
            let found = format!("shape {shape:?}");
            return Err(self.invalid(place, "at least one frame and one vertex", found));
        }
        if array.fortran && frames > 1 {
            // The numbers of a frame are all over the file.
            let whole = self.numbers(place)?;
            return Ok(Frames::in_memory(self.pickle, place, vertices, whole));
        }
        let bytes = self.bytes(array, place)?;
        Ok(Frames::streaming(
            self.pickle,
            place,
            [frames, vertices],
            array,
            bytes,
        ))
    }

    /// Appends the numbers inside; returns their shape.
    fn collect(
        self,
        place: &str,
        depth: usize,
        budget: &mut usize,
        values: &mut Vec<f64>,
    ) -> Result<Vec<usize>> {
        let too_many = || {
            let expected = format!("at most {MAX_VALUES} numbers");
            Err(self.invalid(place, expected, "more"))
        };
        if depth == 0 {
            return Err(self.invalid(place, "an array", "lists within lists within lists …"));
        }
        // Empty lists cost, too: a list may be in another one many times.
        let Some(rest) = budget.checked_sub(1) else {
            return too_many();
        };
        *budget = rest;
        match self.node() {
            Node::Int(value) => values.push(*value as f64),
            Node::Float(value) => values.push(*value),
            Node::Bool(value) => values.push(f64::from(u8::from(*value))),
            Node::List(items) | Node::Tuple(items) => {
                let mut inner: Option<Vec<usize>> = None;
                for &id in items {
                    let shape = self.other(id).collect(place, depth - 1, budget, values)?;
                    match &inner {
                        Some(first) if *first != shape => {
                            let found = format!("shapes {first:?} and {shape:?}");
                            return Err(self.invalid(place, "rows of one shape", found));
                        }
                        _ => inner = Some(shape),
                    }
                }
                let mut shape = vec![items.len()];
                shape.extend(inner.unwrap_or_default());
                return Ok(shape);
            }
            Node::Array(array) => {
                let shape = self.shape(array, place)?;
                let count: usize = shape.iter().product();
                let Some(rest) = budget.checked_sub(count) else {
                    return too_many();
                };
                *budget = rest;
                let read = self.array_values(array, place, count)?;
                values.extend(match array.fortran {
                    true => Array::from_fortran(shape.clone(), &read).values,
                    false => read,
                });
                return Ok(shape);
            }
            Node::Object(Class::Chumpy, Some(_)) => {
                return self
                    .get("x", place)?
                    .collect(place, depth - 1, budget, values);
            }
            Node::Object(Class::ChumpySelect, Some(_)) => {
                return self.selected(place, depth, budget, values);
            }
            _ => return Err(self.invalid(place, "numbers", self.describe())),
        }
        Ok(Vec::new())
    }

    /// `a.ravel()[idxs].reshape(preferred_shape)`.
    fn selected(
        self,
        place: &str,
        depth: usize,
        budget: &mut usize,
        values: &mut Vec<f64>,
    ) -> Result<Vec<usize>> {
        let mut part = |key: &str| {
            let mut values = Vec::new();
            let item = self.get(key, place)?;
            item.collect(place, depth - 1, budget, &mut values)?;
            Ok::<_, DatasetError>(values)
        };
        let (all, indices, shape) = (part("a")?, part("idxs")?, part("preferred_shape")?);
        for &index in &indices {
            match all.get(index as usize) {
                Some(&value) if index >= 0.0 && index.fract() == 0.0 => values.push(value),
                _ => {
                    let expected = format!("indices below {}", all.len());
                    return Err(self.invalid(place, expected, index.to_string()));
                }
            }
        }
        let shape: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
        let count = shape
            .iter()
            .try_fold(1usize, |count, &n| count.checked_mul(n));
        if count != Some(indices.len()) {
            let found = format!("{} numbers for shape {shape:?}", indices.len());
            return Err(self.invalid(place, "as many numbers as the shape has", found));
        }
        Ok(shape)
    }

    /// The shape, if the file has so many bytes.
    fn shape(self, array: &ArrayNode, place: &str) -> Result<Vec<usize>> {
        let number = array.dtype.number.ok_or_else(|| {
            let expected = "numbers (f4, f8, i1–i8, u1–u8, b1)";
            self.invalid(place, expected, format!("dtype {}", array.dtype.name))
        })?;
        let stored = self.bytes(array, place)?;
        let bytes = array
            .shape
            .iter()
            .try_fold(number.size() as u64, |bytes, &n| bytes.checked_mul(n));
        // UTF-8 takes one or two bytes for each; reading to the end tells.
        let fits = |bytes: &u64| match stored.utf8 {
            true => (stored.len().div_ceil(2)..=stored.len()).contains(bytes),
            false => *bytes == stored.len(),
        };
        match bytes.filter(fits) {
            Some(_) => Ok(array.shape.iter().map(|&n| n as usize).collect()),
            None => {
                let expected = format!(
                    "the bytes of shape {:?} and dtype {}",
                    array.shape, array.dtype.name
                );
                let found = format!("{} bytes", stored.len());
                Err(self.invalid(place, expected, found))
            }
        }
    }

    fn bytes(self, array: &ArrayNode, place: &str) -> Result<&'a Stored> {
        match array.data.map(|id| self.other(id).node()) {
            Some(Node::Str(stored)) => Ok(stored),
            Some(node) => Err(self.invalid(place, "an array of numbers", node.describe())),
            None => Err(self.invalid(place, "an array with its numbers", "one without")),
        }
    }

    fn array_values(self, array: &ArrayNode, place: &str, count: usize) -> Result<Vec<f64>> {
        // `shape` has seen to both.
        let number = array.dtype.number.expect("a numeric type");
        let stored = self.bytes(array, place)?;
        let read = || {
            let mut bytes = vec![0; count * number.size()];
            let mut reader = stored.reader(&self.pickle.path)?;
            reader.read_exact(&mut bytes)?;
            super::frames::expect_end(&mut reader)?;
            Ok(bytes)
        };
        let bytes = read().map_err(|error: std::io::Error| {
            self.invalid(place, "the array's bytes", error.to_string())
        })?;
        Ok(bytes
            .chunks_exact(number.size())
            .map(|entry| number.read(entry, array.dtype.big_endian))
            .collect())
    }
}
