//! Whether the cloth of a sequence is still cloth: strain, fit over the
//! shoulders, movement, jitter. Hits are counted per frame already
//! ([`Frame::intersections`]); here is what they do not tell.
//!
//! Lengths are real metres.

use std::collections::BTreeMap;
use std::fmt;

use drape_dataset::sequence::{Frame, Garment, SequenceHeader};
use drape_geometry::closest::point_triangle;
use drape_geometry::grid::Grid;
use drape_geometry::mesh::{Incidence, edges};
use drape_geometry::normals::vertex_normals;
use drape_geometry::vector::{distance2, to64};

/// Distances to the body are taken in every so many frames.
const GAP_EVERY: usize = 5;
/// Heights of shoulders as shares of the body's at rest.
const SHOULDERS: std::ops::Range<f32> = 0.77..0.9;
/// Steepest skin (upward part of the normal) that carries cloth.
const CARRIES: f32 = 0.6;

/// Measures of one or more sequences.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Quality {
    strain: Counts,
    shoulder_gap_m: Counts,
    second_difference_m: Counts,
    speed_m_s: Counts,
}

/// How many values lie in each of many bins, each 1 % wider than the last: as
/// much memory for a data set as for a frame, quantiles to half a per cent.
#[derive(Clone, Debug, Default, PartialEq)]
struct Counts {
    bins: BTreeMap<i32, u64>,
    all: u64,
}

/// Smaller values than this share one bin.
const LEAST: f64 = 1e-7;
/// Width of a bin.
const WIDTH: f64 = 1.01;

impl Counts {
    fn add(&mut self, value: f32) {
        let bin = (f64::from(value).max(LEAST).ln() / WIDTH.ln()).round() as i32;
        *self.bins.entry(bin).or_default() += 1;
        self.all += 1;
    }

    fn merge(&mut self, other: &Self) {
        for (bin, count) in &other.bins {
            *self.bins.entry(*bin).or_default() += count;
        }
        self.all += other.all;
    }

    /// The value that a share of all values does not exceed.
    fn quantile(&self, share: f64) -> Option<f64> {
        let mut left = (share * self.all as f64).ceil().max(1.0) as u64;
        self.bins.iter().find_map(|(bin, &count)| {
            let here = left <= count;
            left = left.saturating_sub(count);
            here.then(|| WIDTH.powi(*bin))
        })
    }
}

impl Quality {
    /// Measures the frames of a sequence.
    pub fn of(header: &SequenceHeader, frames: &[Frame]) -> Self {
        let mut out = Self::default();
        let metre = header.scene.scale;
        for (number, garment) in header.garments.iter().enumerate() {
            out.add_strain(garment, number, frames);
            out.add_movement(number, frames, metre, header.scene.fps);
        }
        let over = header
            .garments
            .iter()
            .enumerate()
            .map(|(number, garment)| (number, over_shoulders(header, garment)))
            .find(|(_, vertices)| !vertices.is_empty());
        if let Some((number, vertices)) = over {
            for frame in frames.iter().step_by(GAP_EVERY) {
                let skin = Skin::new(&frame.body, &header.body.faces, metre);
                let gaps = vertices
                    .iter()
                    .filter_map(|&v| skin.distance(frame.garments[number][v as usize]));
                gaps.for_each(|gap| out.shoulder_gap_m.add(gap / metre));
            }
        }
        out
    }

    /// Adds another sequence's measures.
    pub fn merge(&mut self, other: &Self) {
        self.strain.merge(&other.strain);
        self.shoulder_gap_m.merge(&other.shoulder_gap_m);
        self.second_difference_m.merge(&other.second_difference_m);
        self.speed_m_s.merge(&other.speed_m_s);
    }

    /// The relative change of length that 95 % of all edges in all frames stay below.
    pub fn strain_95(&self) -> Option<f64> {
        self.strain.quantile(0.95)
    }

    /// Median distance to the skin of the innermost garment over the shoulders; none where no garment covers them.
    pub fn shoulder_gap_m(&self) -> Option<f64> {
        self.shoulder_gap_m.quantile(0.5)
    }

    /// What 95 % of the second differences of positions, relative to the body's root, stay below.
    pub fn second_difference_95_m(&self) -> Option<f64> {
        self.second_difference_m.quantile(0.95)
    }

    /// Median speed of vertices relative to the body's root.
    pub fn speed_m_s(&self) -> Option<f64> {
        self.speed_m_s.quantile(0.5)
    }

    fn add_strain(&mut self, garment: &Garment, number: usize, frames: &[Frame]) {
        let length = |positions: &[[f32; 3]], [a, b]: [u32; 2]| {
            distance2(positions[a as usize], positions[b as usize]).sqrt()
        };
        for edge in edges(&garment.faces) {
            let rest = length(&garment.rest, edge);
            for frame in frames {
                let now = length(&frame.garments[number], edge);
                self.strain.add((now / rest - 1.0).abs());
            }
        }
    }

    fn add_movement(&mut self, number: usize, frames: &[Frame], metre: f32, fps: f32) {
        let local = |frame: &Frame, v: usize| -> [f32; 3] {
            let root = frame.root.translation;
            std::array::from_fn(|k| (frame.garments[number][v][k] - root[k]) / metre)
        };
        for three in frames.windows(3) {
            for v in 0..three[0].garments[number].len() {
                let [a, b, c] = [0, 1, 2].map(|k: usize| local(&three[k], v));
                let bend: [f32; 3] = std::array::from_fn(|k| a[k] - 2.0 * b[k] + c[k]);
                self.second_difference_m
                    .add(distance2(bend, [0.0; 3]).sqrt());
                self.speed_m_s.add(0.5 * fps * distance2(a, c).sqrt());
            }
        }
    }
}

/// One line: strain, gap, speed and shaking.
impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |value: Option<f64>, times: f64, unit: &str| {
            value.map_or_else(
                || "–".into(),
                |value| format!("{:.1} {unit}", times * value),
            )
        };
        write!(
            f,
            "95 % of edges strained below {}; over the shoulders {} off the skin in the median; \
             median speed {}; 95 % of second differences below {}",
            number(self.strain_95(), 100.0, "%"),
            number(self.shoulder_gap_m(), 1e3, "mm"),
            number(self.speed_m_s(), 1e3, "mm/s"),
            number(self.second_difference_95_m(), 1e3, "mm"),
        )
    }
}

/// Vertices that lie on shoulders at rest.
fn over_shoulders(header: &SequenceHeader, garment: &Garment) -> Vec<u32> {
    let rest = &header.body.rest;
    if rest.is_empty() {
        return Vec::new();
    }
    let metre = header.scene.scale;
    let top = rest.iter().map(|p| p[2]).fold(f32::NEG_INFINITY, f32::max);
    let bottom = rest.iter().map(|p| p[2]).fold(f32::INFINITY, f32::min);
    let normals = vertex_normals(rest, &header.body.faces);
    let skin = Skin::new(rest, &header.body.faces, metre);
    (0..garment.rest.len() as u32)
        .filter(|&v| {
            let p = garment.rest[v as usize];
            let share = (p[2] - bottom) / (top - bottom);
            SHOULDERS.contains(&share)
                && skin
                    .nearest_vertex(p)
                    .is_some_and(|near| normals[near as usize][2] > CARRIES)
        })
        .collect()
}

/// A body to measure distances to.
struct Skin<'a> {
    positions: &'a [[f32; 3]],
    faces: &'a [[u32; 3]],
    around: Incidence,
    grid: Grid,
}

impl<'a> Skin<'a> {
    fn new(positions: &'a [[f32; 3]], faces: &'a [[u32; 3]], metre: f32) -> Self {
        Self {
            positions,
            faces,
            around: Incidence::new(positions.len(), faces),
            grid: Grid::build(positions, 0.02 * metre),
        }
    }

    fn nearest_vertex(&self, p: [f32; 3]) -> Option<u32> {
        self.grid.nearest(p).map(|(vertex, _)| vertex)
    }

    /// Distance to the faces around the nearest vertex; none without a body.
    fn distance(&self, p: [f32; 3]) -> Option<f32> {
        let vertex = self.nearest_vertex(p)?;
        self.around
            .faces_of(vertex as usize)
            .iter()
            .map(|&face| {
                let corners = self.faces[face as usize].map(|v| to64(self.positions[v as usize]));
                point_triangle(to64(p), corners).distance2.sqrt() as f32
            })
            .min_by(f32::total_cmp)
    }
}

#[cfg(test)]
mod tests {
    use drape_dataset::registry::GarmentKind;
    use drape_dataset::sequence::{BodyTopology, Material, Root, SceneMeta};

    use super::*;

    /// A flat square of cloth of 1 m, 5 mm above a flat square of body at 1.65 m
    /// whose feet are one triangle at the ground.
    fn scene() -> (SequenceHeader, Frame) {
        let square = |z: f32| -> Vec<[f32; 3]> {
            [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]
                .map(|[x, y]| [x, y, z])
                .into()
        };
        let faces = vec![[0, 1, 2], [0, 2, 3]];
        let mut body = square(16.5);
        body.extend([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 20.0]]);
        let mut body_faces = faces.clone();
        body_faces.push([4, 5, 6]);
        let cloth = square(16.55);
        let header = SequenceHeader {
            name: "square".into(),
            scene: SceneMeta::default(),
            body: BodyTopology {
                rest: body.clone(),
                faces: body_faces,
                vertex_count: body.len(),
            },
            garments: vec![Garment {
                name: "square".into(),
                kind: GarmentKind::TShirt,
                layer: 0,
                rest: cloth.clone(),
                faces,
                uv: Vec::new(),
                uv_faces: Vec::new(),
                panel_of_face: Vec::new(),
                panels: Vec::new(),
                material: Material {
                    mass: 1.0,
                    tension: 0.0,
                    compression: 0.0,
                    shear: 0.0,
                    bending: 0.0,
                    friction: 0.0,
                },
            }],
        };
        let frame = Frame {
            body,
            garments: vec![cloth],
            ..Frame::default()
        };
        (header, frame)
    }

    /// Within the width of a bin.
    fn near(found: Option<f64>, expected: f64) -> bool {
        (found.unwrap() / expected - 1.0).abs() < 0.006
    }

    #[test]
    fn quantiles_are_those_of_the_sorted_values_to_half_a_bin() {
        let values: Vec<f32> = (1..=999).map(|k| (k * 37 % 1000) as f32 * 1e-3).collect();
        let (mut one, mut other) = (Counts::default(), Counts::default());
        for (k, value) in values.iter().enumerate() {
            if k % 3 == 0 { &mut one } else { &mut other }.add(*value);
        }
        one.merge(&other);
        let mut sorted = values;
        sorted.sort_by(f32::total_cmp);
        for share in [0.01, 0.5, 0.95, 1.0] {
            let place = (share * 999.0_f64).ceil() as usize - 1;
            assert!(
                near(one.quantile(share), f64::from(sorted[place])),
                "{share}"
            );
        }
        assert_eq!(Counts::default().quantile(0.5), None);
    }

    #[test]
    fn cloth_that_follows_the_body_has_no_strain_no_speed_and_its_own_gap() {
        let (header, frame) = scene();
        let frames: Vec<Frame> = (0..4)
            .map(|step| {
                let up = step as f32;
                let mut moved = frame.clone();
                moved.root = Root {
                    translation: [0.0, 0.0, up],
                    ..Root::default()
                };
                moved.body.iter_mut().for_each(|p| p[2] += up);
                moved.garments[0].iter_mut().for_each(|p| p[2] += up);
                moved
            })
            .collect();
        let found = Quality::of(&header, &frames);
        assert!(found.strain_95().unwrap() < 1e-6);
        assert!(found.speed_m_s().unwrap() < 1e-4);
        assert!(found.second_difference_95_m().unwrap() < 1e-6);
        assert!(near(found.shoulder_gap_m(), 0.005));
    }

    #[test]
    fn stretch_lifting_and_shaking_are_seen_in_real_units() {
        let (header, frame) = scene();
        let stretched = |by: f32, lift: f32| {
            let mut frame = frame.clone();
            for p in &mut frame.garments[0] {
                *p = [p[0] * by, p[1] * by, p[2] + lift];
            }
            frame
        };
        let found = Quality::of(&header, &[stretched(1.1, 0.0)]);
        assert!(near(found.strain_95(), 0.1));
        let found = Quality::of(&header, &[stretched(1.0, 0.2)]);
        assert!(near(found.shoulder_gap_m(), 0.025));
        assert_eq!(found.speed_m_s(), None, "one frame has no speed");
        let shaken: Vec<Frame> = (0..4)
            .map(|step| stretched(1.0, 0.1 * (step % 2) as f32))
            .collect();
        let found = Quality::of(&header, &shaken);
        // 10 mm up and down: the second difference is 20 mm, places two frames apart are equal.
        assert!(near(found.second_difference_95_m(), 0.02));
        assert!(found.speed_m_s().unwrap() < 1e-4);
        let moving: Vec<Frame> = (0..4)
            .map(|step| stretched(1.0, 0.1 * step as f32))
            .collect();
        let found = Quality::of(&header, &moving);
        assert!(near(found.speed_m_s(), 0.3));
    }
}
