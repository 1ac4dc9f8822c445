//! Positions for viewing: whole multiples of a grid's step, less what constant velocity
//! would make of the two frames before, smallest number subtracted, by byte planes,
//! under zstd.
//!
//! Every coordinate becomes q = round(x / step) and comes back as f32(q · step), so a
//! vertex moves by at most step · √3 / 2 and a rounding of f32; the writer compares
//! each vertex with the error that it promises. Differences wrap in 32 bits, which
//! loses nothing: adding wraps back. Numbers are exact integers, so errors do not grow
//! with the frames since the last key frame.
//!
//! Measured on a sequence of two layers and a body (48 frames, 3,590 vertices): packed
//! frames are 5.6 times smaller than f32; 4.0 times with the last frame as prediction.

use std::fmt;

use prost::bytes::Bytes;
use zstd::bulk::{Compressor, Decompressor};

use super::messages::{self, proto};
use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, SequenceHeader};

/// How a file holds positions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Storage {
    /// f32, the same bits back. The only storage to learn or measure from.
    #[default]
    Exact,
    /// Smaller, for viewing: no vertex is farther than this from where it was, metres of
    /// real size. Accelerations are second differences of positions and feel the steps.
    Quantised {
        /// The bound, stated in the file; smaller bounds make larger files.
        max_error_m: f32,
    },
}

impl Storage {
    /// Steps that no picture shows: 0.05 mm.
    pub const VIEWING: Self = Self::Quantised { max_error_m: 5e-5 };
}

impl fmt::Display for Storage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact => write!(f, "exact (f32)"),
            Self::Quantised { max_error_m } => {
                write!(f, "quantised, for viewing: off by up to {max_error_m} m")
            }
        }
    }
}

/// Frames from one key frame to the next. A random frame decodes half as many on
/// average; with 64 the frames of the sequence above would be 9 % smaller.
const KEY_INTERVAL: u32 = 16;
/// Highest `since_key` of the format.
pub(super) const MAX_SINCE_KEY: u32 = 255;
/// Most vertices of the body or of a garment, so that a small hostile file cannot
/// ask for more than 200 MB.
const MAX_VERTICES: usize = 1 << 24;
/// Share of the promised error that the grid uses; the rest is for rounding to f32,
/// which at 100 units from the origin is 4e-6 units.
const GRID_SHARE: f64 = 0.99;
/// zstd's default; 9 made the frames above 1.4 % smaller.
const LEVEL: i32 = 3;

/// Grid positions of body and garments, `[mesh][vertex, 3]`.
type Grid = Vec<Vec<[i32; 3]>>;

/// Turns frames into messages, in order.
pub(super) struct Quantiser {
    max_error_m: f32,
    max_error_units: f64,
    step: f64,
    /// Numbers of the last frame, and of the one before.
    last: [Grid; 2],
    since_key: u32,
    compressor: Compressor<'static>,
}

impl Quantiser {
    pub(super) fn new(header: &SequenceHeader, max_error_m: f32) -> Result<Self> {
        let max_error_units = f64::from(max_error_m) * f64::from(header.scene.scale);
        let step = 2.0 * max_error_units / 3f64.sqrt() * GRID_SHARE;
        if !(step.is_finite() && step > 0.0) {
            let expected = "a length in metres above 0";
            return Err(DatasetError::invalid(
                "max_error_m",
                expected,
                max_error_m.to_string(),
            ));
        }
        check_sizes(header)?;
        let compressor = Compressor::new(LEVEL).map_err(|error| broken("compressor", error))?;
        Ok(Self {
            max_error_m,
            max_error_units,
            step,
            last: Default::default(),
            since_key: 0,
            compressor,
        })
    }

    /// The message of the next frame, which fits the header.
    pub(super) fn message(&mut self, index: u64, frame: &Frame) -> Result<proto::QuantisedFrame> {
        let mut grid = Grid::new();
        for (mesh, positions) in meshes(frame).enumerate() {
            let numbers = positions.iter().enumerate().map(|(vertex, &x)| {
                self.quantise(x)
                    .map_err(|error| error.at(&place(mesh, vertex)))
            });
            grid.push(numbers.collect::<Result<_>>()?);
        }
        let key = self.last[0].is_empty() || self.since_key + 1 == KEY_INTERVAL;
        self.since_key = if key { 0 } else { self.since_key + 1 };
        let [last, before] = &mut self.last;
        last.resize(grid.len(), Vec::new());
        for (last, now) in last.iter_mut().zip(&grid) {
            last.resize(now.len(), [0; 3]);
        }
        predict(self.since_key, last, before);
        let mut packed = Vec::new();
        for (now, predicted) in grid.iter().zip(&*before) {
            packed.push(pack(now, predicted, &mut self.compressor)?);
        }
        *before = std::mem::replace(last, grid);
        // The scene's part of the message without positions.
        let scene = Frame {
            body: Vec::new(),
            root: frame.root,
            garments: Vec::new(),
            wind: frame.wind,
            intersections: frame.intersections,
        };
        let plain = messages::frame_to_message(index, &scene);
        let garments = packed.split_off(1);
        Ok(proto::QuantisedFrame {
            index,
            root: plain.root,
            wind: plain.wind,
            intersections: plain.intersections,
            since_key: self.since_key,
            step: self.step,
            max_error_m: self.max_error_m,
            body: packed.pop(),
            garments,
        })
    }

    fn quantise(&self, x: [f32; 3]) -> Result<[i32; 3]> {
        let q = x.map(|x| (f64::from(x) / self.step).round());
        let distance: f64 = (0..3)
            .map(|axis| (f64::from(x[axis]) - f64::from((q[axis] * self.step) as f32)).powi(2))
            .sum();
        let fits = q
            .iter()
            .all(|q| (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(q));
        if !fits || distance > self.max_error_units.powi(2) {
            let expected = format!(
                "a position that {} m can be kept at (nearer to the origin, or a larger error)",
                self.max_error_m
            );
            return Err(DatasetError::invalid(
                "position",
                expected,
                format!("{x:?}"),
            ));
        }
        Ok(q.map(|q| q as i32))
    }
}

/// What a [`Dequantiser`] remembers.
struct Last {
    index: usize,
    since_key: u32,
    /// Numbers of the last frame, and of the one before.
    grids: [Grid; 2],
}

/// Turns messages into frames; remembers the last one.
pub(super) struct Dequantiser<'a> {
    header: &'a SequenceHeader,
    decompressor: Option<Decompressor<'static>>,
    last: Option<Last>,
}

impl<'a> Dequantiser<'a> {
    pub(super) fn new(header: &'a SequenceHeader) -> Self {
        Self {
            header,
            decompressor: None,
            last: None,
        }
    }

    /// Whether the message of frame `index` can be taken now.
    pub(super) fn follows(&self, index: usize, message: &proto::QuantisedFrame) -> bool {
        message.since_key == 0
            || self.last.as_ref().is_some_and(|last| {
                last.index.checked_add(1) == Some(index)
                    && last.since_key.checked_add(1) == Some(message.since_key)
            })
    }

    /// Takes the numbers of frame `index` without making a frame of them.
    pub(super) fn take(&mut self, index: usize, message: &proto::QuantisedFrame) -> Result<()> {
        if !self.follows(index, message) || message.since_key > MAX_SINCE_KEY {
            let expected = "a key frame at most 255 frames before";
            let found = format!("{} frames", message.since_key);
            return Err(DatasetError::invalid("since_key", expected, found));
        }
        if !(message.step.is_finite() && message.step > 0.0) {
            let found = message.step.to_string();
            return Err(DatasetError::invalid("step", "a number above 0", found));
        }
        check_sizes(self.header)?;
        let shapes: Vec<usize> = shapes(self.header).collect();
        let packed: Vec<_> = message.body.iter().chain(&message.garments).collect();
        if packed.len() != shapes.len() || message.body.is_none() {
            let (expected, found) = (shapes.len().to_string(), packed.len().to_string());
            return Err(DatasetError::invalid("body and garments", expected, found));
        }
        let [mut last, mut before] = match self.last.take() {
            Some(last) if message.since_key > 0 => last.grids,
            _ => [0, 1].map(|_| shapes.iter().map(|_| Vec::new()).collect()),
        };
        for (grid, &vertices) in last.iter_mut().zip(&shapes) {
            grid.resize(vertices, [0; 3]);
        }
        predict(message.since_key, &last, &mut before);
        for ((mesh, packed), grid) in packed.into_iter().enumerate().zip(&mut before) {
            unpack(packed, grid, &mut self.decompressor)
                .map_err(|error| error.at(&place(mesh, 0)))?;
        }
        self.last = Some(Last {
            index,
            since_key: message.since_key,
            grids: [before, last],
        });
        Ok(())
    }

    /// The frame of `message`, which was taken last.
    pub(super) fn frame(&self, message: proto::QuantisedFrame) -> Result<Frame> {
        let last = self.last.as_ref().expect("a message was taken");
        let grid = &last.grids[0];
        let positions = |numbers: &Vec<[i32; 3]>| -> Vec<[f32; 3]> {
            let place = |q: i32| (f64::from(q) * message.step) as f32;
            numbers.iter().map(|q| q.map(place)).collect()
        };
        let plain = proto::Frame {
            index: message.index,
            body: Bytes::new(),
            root: message.root,
            garments: Vec::new(),
            wind: message.wind,
            intersections: message.intersections,
        };
        let mut frame = messages::frame_from_message(plain)?;
        frame.body = positions(&grid[0]);
        frame.garments = grid[1..].iter().map(positions).collect();
        frame.check(self.header)?;
        Ok(frame)
    }
}

/// Body, then garments.
fn meshes(frame: &Frame) -> impl Iterator<Item = &[[f32; 3]]> {
    std::iter::once(&frame.body[..]).chain(frame.garments.iter().map(Vec::as_slice))
}

/// Vertices of body and garments.
fn shapes(header: &SequenceHeader) -> impl Iterator<Item = usize> {
    let garments = header.garments.iter().map(|garment| garment.rest.len());
    std::iter::once(header.body.vertex_count).chain(garments)
}

fn check_sizes(header: &SequenceHeader) -> Result<()> {
    match shapes(header).find(|&vertices| vertices > MAX_VERTICES) {
        None => Ok(()),
        Some(found) => {
            let expected = format!("at most {MAX_VERTICES} in a quantised file");
            Err(DatasetError::invalid(
                "vertices",
                expected,
                found.to_string(),
            ))
        }
    }
}

fn place(mesh: usize, vertex: usize) -> String {
    match mesh.checked_sub(1) {
        None => format!("body, vertex {vertex}"),
        Some(garment) => format!("garment {garment}, vertex {vertex}"),
    }
}

/// Makes the numbers `before` the last ones those that the next are told against:
/// zeros in a key frame, then the last frame's, then those of constant velocity.
fn predict(since_key: u32, last: &Grid, before: &mut Grid) {
    let forward = |last: i32, before: i32| match since_key {
        0 => 0,
        1 => last,
        _ => last.wrapping_add(last.wrapping_sub(before)),
    };
    before.resize(last.len(), Vec::new());
    for (last, before) in last.iter().zip(before) {
        before.resize(last.len(), [0; 3]);
        for (last, before) in last.iter().zip(before) {
            *before = [0, 1, 2].map(|axis| forward(last[axis], before[axis]));
        }
    }
}

/// Numbers `now`, less the predicted ones.
fn pack(
    now: &[[i32; 3]],
    predicted: &[[i32; 3]],
    compressor: &mut Compressor,
) -> Result<proto::QuantisedPositions> {
    let mut numbers: Vec<[i32; 3]> = now.to_vec();
    for (number, predicted) in numbers.iter_mut().zip(predicted) {
        for axis in 0..3 {
            number[axis] = number[axis].wrapping_sub(predicted[axis]);
        }
    }
    let mut least = [i32::MAX; 3];
    let mut most = [i32::MIN; 3];
    for number in &numbers {
        for axis in 0..3 {
            least[axis] = least[axis].min(number[axis]);
            most[axis] = most[axis].max(number[axis]);
        }
    }
    let spread = (0..3)
        .map(|axis| most[axis].wrapping_sub(least[axis]) as u32)
        .max();
    let spread = spread.filter(|_| !numbers.is_empty()).unwrap_or(0);
    let width = (4 - spread.leading_zeros() / 8) as usize;
    let mut planes = Vec::with_capacity(3 * width * numbers.len());
    for axis in 0..3 {
        for byte in 0..width {
            let digit = |number: &[i32; 3]| {
                (number[axis].wrapping_sub(least[axis]) as u32 >> (8 * byte)) as u8
            };
            planes.extend(numbers.iter().map(digit));
        }
    }
    Ok(proto::QuantisedPositions {
        least: if numbers.is_empty() {
            vec![0; 3]
        } else {
            least.to_vec()
        },
        width: width as u32,
        planes: match planes.is_empty() {
            true => Bytes::new(),
            false => compressor
                .compress(&planes)
                .map_err(|error| broken("planes", error))?
                .into(),
        },
    })
}

/// Adds packed numbers to the predicted ones.
fn unpack(
    packed: &proto::QuantisedPositions,
    grid: &mut [[i32; 3]],
    decompressor: &mut Option<Decompressor<'static>>,
) -> Result<()> {
    let least: [i32; 3] =
        packed.least.as_slice().try_into().map_err(|_| {
            DatasetError::invalid("least", "3 numbers", packed.least.len().to_string())
        })?;
    let vertices = grid.len();
    let width = packed.width as usize;
    if width > 4 {
        return Err(DatasetError::invalid("width", "0 to 4", width.to_string()));
    }
    let size = 3 * width * vertices;
    let planes = if size == 0 {
        Vec::new()
    } else {
        // The size is in zstd's own head; memory is asked for when it is the right one.
        let stated = zstd::zstd_safe::get_frame_content_size(&packed.planes)
            .ok()
            .flatten();
        if stated != Some(size as u64) {
            let found = stated.map_or("unknown".into(), |size| size.to_string());
            return Err(DatasetError::invalid(
                "planes",
                format!("{size} bytes under zstd"),
                found,
            ));
        }
        if decompressor.is_none() {
            *decompressor = Some(Decompressor::new().map_err(|error| broken("planes", error))?);
        }
        let zstd = decompressor.as_mut().expect("it was just made");
        zstd.decompress(&packed.planes, size)
            .map_err(|error| broken("planes", error))?
    };
    if planes.len() != size {
        let (expected, found) = (format!("{size} bytes"), planes.len().to_string());
        return Err(DatasetError::invalid("planes", expected, found));
    }
    for axis in 0..3 {
        grid.iter_mut()
            .for_each(|q| q[axis] = q[axis].wrapping_add(least[axis]));
        for byte in 0..width {
            let plane = &planes[(axis * width + byte) * vertices..][..vertices];
            for (q, &digit) in grid.iter_mut().zip(plane) {
                q[axis] = q[axis].wrapping_add(((digit as u32) << (8 * byte)) as i32);
            }
        }
    }
    Ok(())
}

fn broken(place: &str, error: std::io::Error) -> DatasetError {
    DatasetError::invalid(place, "what zstd can read", error.to_string())
}
