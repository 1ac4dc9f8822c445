//! What a garment does in one frame, in four kinds of numbers.
//!
//! | number | of | unit |
//! |---|---|---|
//! | hem | mean height of the border vertices within 3 cm of the garment's lowest at rest | units |
//! | strain | edges: length over length at rest, minus 1, its size | – |
//! | gap | vertices: distance to the skin, faces around the three nearest body vertices | mm real |
//! | speed | vertices, relative to the body's root, since the frame before | units/s |

use drape_dataset::sequence::{Frame, Garment, SequenceHeader};
use drape_geometry::closest::point_triangle;
use drape_geometry::grid::Grid;
use drape_geometry::mesh::{Incidence, edges, on_border};
use drape_geometry::vector::{distance2, sub, to64};

/// Names of what [`Gauge::measure`] gives, in its order.
pub const NAMES: [&str; 7] = [
    "hem height, units",
    "strain, mean",
    "strain, 95th percentile",
    "gap to the body, mean, mm",
    "gap to the body, 5th percentile, mm",
    "gap to the body, 95th percentile, mm",
    "speed relative to the root, units/s",
];

/// One number of each name.
pub type Numbers = [f64; NAMES.len()];

/// Border vertices this far above the lowest one belong to the hem, m.
const HEM_M: f32 = 0.03;

/// What is fixed about a garment.
pub struct Gauge<'a> {
    garment: &'a Garment,
    number: usize,
    hem: Vec<usize>,
    edges: Vec<([u32; 2], f32)>,
    scale: f32,
    fps: f32,
}

impl<'a> Gauge<'a> {
    pub fn new(header: &'a SequenceHeader, number: usize) -> Self {
        let garment = &header.garments[number];
        let scale = header.scene.scale;
        let border = on_border(garment.rest.len(), &garment.faces);
        let lowest = garment.rest.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
        let hem = (0..garment.rest.len())
            .filter(|&v| border[v] && garment.rest[v][2] < lowest + HEM_M * scale)
            .collect();
        let edges = edges(&garment.faces)
            .into_iter()
            .map(|edge| (edge, length(&garment.rest, edge)))
            .collect();
        Self {
            garment,
            number,
            hem,
            edges,
            scale,
            fps: header.scene.fps,
        }
    }

    pub fn name(&self) -> &str {
        &self.garment.name
    }

    /// Numbers of a frame; the speed is 0 without a frame before.
    pub fn measure(&self, frame: &Frame, before: Option<&Frame>, skin: &Skin) -> Numbers {
        let now = &frame.garments[self.number];
        let hem = mean(self.hem.iter().map(|&v| f64::from(now[v][2])));
        let strain = sorted(
            self.edges
                .iter()
                .map(|&(edge, rest)| f64::from((length(now, edge) / rest - 1.0).abs())),
        );
        let to_mm = 1e3 / f64::from(self.scale);
        let gap = sorted(now.iter().map(|&p| to_mm * skin.distance(frame, p)));
        let speed = before.map_or(0.0, |before| {
            let old = &before.garments[self.number];
            let root = sub(frame.root.translation, before.root.translation);
            let moved = |(a, b): (&[f32; 3], &[f32; 3])| distance2(sub(*a, *b), root).sqrt();
            mean(now.iter().zip(old).map(moved).map(f64::from)) * f64::from(self.fps)
        });
        [
            hem,
            mean(strain.iter().copied()),
            at(&strain, 0.95),
            mean(gap.iter().copied()),
            at(&gap, 0.05),
            at(&gap, 0.95),
            speed,
        ]
    }
}

/// The body's faces around each vertex, and where its vertices are in one frame.
pub struct Skin<'a> {
    faces: &'a [[u32; 3]],
    around: Incidence,
    grid: Grid,
    cell: f32,
}

impl<'a> Skin<'a> {
    pub fn new(header: &'a SequenceHeader) -> Self {
        let faces = &header.body.faces;
        let cell = 0.05 * header.scene.scale;
        Self {
            faces,
            around: Incidence::new(header.body.vertex_count, faces),
            grid: Grid::build(&[], cell),
            cell,
        }
    }

    pub fn pose(&mut self, frame: &Frame) {
        self.grid.rebuild(&frame.body, self.cell);
    }

    fn distance(&self, frame: &Frame, p: [f32; 3]) -> f64 {
        let mut near = Vec::new();
        let Some((_, first)) = self.grid.nearest(p) else {
            return f64::NAN;
        };
        self.grid
            .k_nearest(p, 3, first.sqrt() + self.cell, &mut near);
        near.iter()
            .flat_map(|&(vertex, _)| self.around.faces_of(vertex as usize))
            .map(|&face| {
                let corners = self.faces[face as usize].map(|v| to64(frame.body[v as usize]));
                point_triangle(to64(p), corners).distance2.sqrt()
            })
            .fold(f64::INFINITY, f64::min)
    }
}

fn length(positions: &[[f32; 3]], [a, b]: [u32; 2]) -> f32 {
    distance2(positions[a as usize], positions[b as usize]).sqrt()
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The value that a share of the sorted values does not exceed.
fn at(sorted: &[f64], share: f64) -> f64 {
    let index = share * (sorted.len() - 1) as f64;
    sorted[index.round() as usize]
}

pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
    sum / f64::from(count.max(1))
}
