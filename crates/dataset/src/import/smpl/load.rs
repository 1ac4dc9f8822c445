//! SMPL model files: Python pickles (`.pkl`) and archives of arrays (`.npz`).
//!
//! | name | shape | |
//! |---|---|---|
//! | `v_template` | `[vertex, 3]` | |
//! | `shapedirs` | `[vertex, 3, shape]` | array, or a chumpy array |
//! | `posedirs` | `[vertex, 3, 9·(joint − 1)]` | |
//! | `J_regressor` | `[joint, vertex]` | array, or a scipy csc matrix |
//! | `weights` | `[vertex, joint]` | |
//! | `kintree_table` | `[2, joint]` | parents, then ids |
//! | `f` | `[face, 3]` | |
//!
//! Vertex and joint counts are the file's; other entries are not looked at.

use std::path::Path;

use super::BodyModel;
use crate::error::{DatasetError, Result};
use crate::import::array::Array;
use crate::import::pickle::{Item, Pickle};

/// A file's arrays by name.
struct Parts<'a> {
    path: &'a Path,
    read: &'a mut dyn FnMut(&str) -> Result<Array>,
}

impl BodyModel {
    /// Reads a model file, `.pkl` or `.npz` (the latter with feature `npz`).
    ///
    /// # Errors
    /// A file that cannot be read, a missing array, shapes that do not fit each
    /// other, indices out of range, numbers that are not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        if path.extension().is_some_and(|ending| ending == "npz") {
            return load_npz(path);
        }
        let pickle = Pickle::open(path)?;
        let root = pickle.root();
        let regressor = root.get("J_regressor", "body model")?;
        let entries = match regressor.is_sparse() {
            true => Some(sparse_entries(regressor)?),
            false => None,
        };
        let mut read = |name: &str| {
            root.get(name, "body model")?
                .numbers(&format!("array \"{name}\""))
        };
        assemble(
            Parts {
                path,
                read: &mut read,
            },
            entries,
        )
    }
}

#[cfg(feature = "npz")]
fn load_npz(path: &Path) -> Result<BodyModel> {
    let mut arrays = crate::import::npz::Arrays::open(path)?;
    let mut read = |name: &str| arrays.array(name);
    assemble(
        Parts {
            path,
            read: &mut read,
        },
        None,
    )
}

#[cfg(not(feature = "npz"))]
fn load_npz(path: &Path) -> Result<BodyModel> {
    let expected = "a .pkl file (this program was built without the feature npz)";
    Err(DatasetError::invalid("body model", expected, "an .npz file").in_file(path))
}

/// Entries (row, column, value) of a csc matrix, and its shape.
type Sparse = (Vec<(usize, usize, f64)>, Vec<usize>);

fn sparse_entries(matrix: Item<'_>) -> Result<Sparse> {
    const PLACE: &str = "matrix \"J_regressor\"";
    let part = |key: &str| matrix.get(key, PLACE)?.numbers(&format!("{PLACE}, {key}"));
    // scipy renamed it.
    let shape = part("_shape").or_else(|_| part("shape"))?.values;
    let (data, rows, starts) = (part("data")?, part("indices")?, part("indptr")?);
    let (data, rows, starts) = (data.values, rows.values, starts.values);
    let whole = |x: &f64| x.fract() == 0.0 && (0.0..9e15).contains(x);
    let ordered = starts.windows(2).all(|pair| pair[0] <= pair[1]);
    let fits = shape.len() == 2
        && shape.iter().chain(&rows).chain(&starts).all(whole)
        && starts.len() as f64 == shape[1] + 1.0
        && ordered
        && starts[0] == 0.0
        && starts[starts.len() - 1] == data.len() as f64
        && data.len() == rows.len()
        && rows.iter().all(|&row| row < shape[0]);
    if !fits {
        let found = format!(
            "{} values, {} row indices, {} column starts, shape {shape:?}",
            data.len(),
            rows.len(),
            starts.len()
        );
        return Err(matrix.invalid(PLACE, "a csc matrix whose parts fit", found));
    }
    let mut entries = Vec::with_capacity(data.len());
    for (column, bounds) in starts.windows(2).enumerate() {
        for i in bounds[0] as usize..bounds[1] as usize {
            entries.push((rows[i] as usize, column, data[i]));
        }
    }
    Ok((entries, shape.iter().map(|&n| n as usize).collect()))
}

fn assemble(mut parts: Parts<'_>, sparse: Option<Sparse>) -> Result<BodyModel> {
    let template = parts.array("v_template", &[None, Some(3)])?;
    let vertices = template.shape[0];
    let weights = parts.array("weights", &[Some(vertices), None])?;
    let joints = weights.shape[1];
    if vertices == 0 || joints == 0 {
        return Err(parts.invalid("weights", "vertices and joints", "none"));
    }
    let shape_directions = parts.array("shapedirs", &[Some(vertices), Some(3), None])?;
    let pose_columns = Some(9 * (joints - 1));
    let pose_directions = parts.array("posedirs", &[Some(vertices), Some(3), pose_columns])?;
    let mut regressor = match sparse {
        Some((entries, shape)) if shape == [joints, vertices] => entries,
        Some((_, shape)) => {
            let expected = format!("shape [{joints}, {vertices}]");
            return Err(parts.invalid("J_regressor", &expected, format!("shape {shape:?}")));
        }
        None => {
            let dense = parts.array("J_regressor", &[Some(joints), Some(vertices)])?;
            let entry = |(i, &value): (usize, &f64)| (i / vertices, i % vertices, value);
            dense.values.iter().enumerate().map(entry).collect()
        }
    };
    // One order of summation, however the file stores it: the same model gives the same bits.
    regressor.retain(|entry| entry.2 != 0.0);
    regressor.sort_by_key(|&(joint, vertex, _)| (joint, vertex));
    if regressor.iter().any(|entry| !entry.2.is_finite()) {
        return Err(parts.invalid("J_regressor", "finite numbers", "NaN or infinity"));
    }
    let tree = parts.array("kintree_table", &[Some(2), Some(joints)])?;
    let (parents, ids) = tree.values.split_at(joints);
    let parents = (1..joints)
        .map(|joint| {
            let parent = ids[..joint].iter().position(|&id| id == parents[joint]);
            parent.ok_or_else(|| {
                let found = format!("parent {} of joint {joint}", parents[joint]);
                parts.invalid(
                    "kintree_table",
                    "parents that come before their joints",
                    found,
                )
            })
        })
        .collect::<Result<_>>()?;
    let faces = parts.array("f", &[None, Some(3)])?;
    let faces = match faces.index_rows() {
        Ok(rows) if rows.as_flattened().iter().all(|&i| (i as usize) < vertices) => rows,
        _ => {
            let expected = format!("vertex indices below {vertices}");
            return Err(parts.invalid("f", &expected, "others"));
        }
    };
    let (rows, _) = template.values.as_chunks::<3>();
    Ok(BodyModel {
        template: rows.to_vec(),
        shapes: shape_directions.shape[2],
        shape_directions: shape_directions.values,
        pose_directions: pose_directions.values,
        regressor,
        weights: weights
            .values
            .chunks_exact(joints)
            .map(|row| {
                row.iter()
                    .copied()
                    .enumerate()
                    .filter(|w| w.1 != 0.0)
                    .collect()
            })
            .collect(),
        parents,
        faces,
    })
}

impl Parts<'_> {
    /// An array of finite numbers whose shape has the sizes that are given.
    fn array(&mut self, name: &str, sizes: &[Option<usize>]) -> Result<Array> {
        let array = (self.read)(name)?;
        let fits = array.shape.len() == sizes.len()
            && array
                .shape
                .iter()
                .zip(sizes)
                .all(|(&found, size)| size.is_none_or(|size| size == found));
        if !fits {
            let sizes: Vec<_> = sizes
                .iter()
                .map(|size| size.map_or("any".into(), |size| size.to_string()))
                .collect();
            let expected = format!("shape [{}]", sizes.join(", "));
            return Err(self.invalid(name, &expected, format!("shape {:?}", array.shape)));
        }
        // The root's parent in the kinematic tree is any number; none is infinite.
        if let Some(bad) = array.values.iter().find(|x| !x.is_finite()) {
            return Err(self.invalid(name, "finite numbers", bad.to_string()));
        }
        Ok(array)
    }

    fn invalid(&self, name: &str, expected: &str, found: impl Into<String>) -> DatasetError {
        let place = format!("array \"{name}\"");
        DatasetError::invalid(place, expected, found).in_file(self.path)
    }
}
