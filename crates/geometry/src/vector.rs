//! Three-vectors as plain arrays.
//!
//! The f32 functions fix the order of operations, because LayersNet's results
//! are compared bit by bit near ties: `dot` is `(x·x' + y·y') + z·z'`, without
//! fused multiply-add. The f64 ones carry the suffix `64`.

/// `a − b`.
#[inline]
pub fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `(x·x' + y·y') + z·z'`.
#[inline]
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// `a × b`.
#[inline]
pub fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Squared distance of two points by direct subtraction.
#[inline]
pub fn distance2(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = sub(a, b);
    dot(d, d)
}

/// A point in f64.
#[inline]
pub fn to64(a: [f32; 3]) -> [f64; 3] {
    [f64::from(a[0]), f64::from(a[1]), f64::from(a[2])]
}

/// `a − b` in f64.
#[inline]
pub fn sub64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + s·b` in f64.
#[inline]
pub fn add_scaled64(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// `a · b` in f64.
#[inline]
pub fn dot64(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
}

/// `a × b` in f64.
#[inline]
pub fn cross64(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Squared distance of two points in f64.
#[inline]
pub fn distance2_64(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = sub64(a, b);
    dot64(d, d)
}
