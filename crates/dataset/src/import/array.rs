//! Numeric arrays as Python programs store them, in C order.

/// One array: the last index runs fastest in `values`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

impl Array {
    /// The values as rows of `N`; the shape must end in `N`.
    pub fn rows<const N: usize>(&self) -> Vec<[f32; N]> {
        let (rows, _) = self.values.as_chunks::<N>();
        rows.iter().map(|row| row.map(|x| x as f32)).collect()
    }

    /// The values as rows of `N` indices, or the first value that is none.
    pub fn index_rows<const N: usize>(&self) -> Result<Vec<[u32; N]>, f64> {
        let bad = |x: &&f64| x.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(*x);
        if let Some(&bad) = self.values.iter().find(bad) {
            return Err(bad);
        }
        let (rows, _) = self.values.as_chunks::<N>();
        Ok(rows.iter().map(|row| row.map(|x| x as u32)).collect())
    }

    /// From values stored with the first index fastest (Fortran order).
    pub fn from_fortran(shape: Vec<usize>, values: &[f64]) -> Self {
        let mut index = vec![0; shape.len()];
        let values = (0..values.len())
            .map(|_| {
                let at = index
                    .iter()
                    .zip(&shape)
                    .rev()
                    .fold(0, |at, (i, n)| at * n + i);
                for (i, n) in index.iter_mut().zip(&shape).rev() {
                    *i += 1;
                    if *i < *n {
                        break;
                    }
                    *i = 0;
                }
                values[at]
            })
            .collect();
        Self { shape, values }
    }
}
