//! What the cloth is made of, fixed for the whole sequence: faces, edges and
//! hinges of all garments in one numbering, rest lengths, masses.

use std::collections::BTreeMap;
use std::ops::Range;

use drape_dataset::sequence::Garment;
use glam::DVec3;

use super::material::Cloth;
use super::state::metres;
use crate::error::SimError;

/// Shorter lengths than this are no lengths: coincident vertices.
const SHORTEST_M: f64 = 1e-6;

/// All garments, inner layer first.
#[derive(Clone, Debug)]
pub(super) struct Fabric {
    pub garments: Vec<Piece>,
    pub faces: Vec<[u32; 3]>,
    pub edges: Vec<[u32; 2]>,
    /// Garment of each vertex.
    pub garment_of: Vec<u32>,
    /// Rest positions, metres.
    pub rest: Vec<DVec3>,
    /// Rest area of each face, m².
    pub area: Vec<f64>,
    /// The one or two faces at each edge: their number and opposite vertex.
    pub sides: Vec<Vec<(u32, u32)>>,
    /// Faces at each vertex.
    pub faces_of: Vec<Vec<u32>>,
    /// Edges at each vertex.
    pub edges_of: Vec<Vec<u32>>,
    /// Inverse masses, 1/kg.
    pub inverse_mass: Vec<f64>,
}

/// One garment's place in the arrays.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub vertices: Range<usize>,
    pub faces: Range<usize>,
    pub edges: Range<usize>,
    pub layer: u32,
    pub cloth: Cloth,
}

impl Fabric {
    pub fn new(garments: &[Garment], scale: f64) -> Result<Self, SimError> {
        let mut fabric = Self {
            garments: Vec::new(),
            faces: Vec::new(),
            edges: Vec::new(),
            garment_of: Vec::new(),
            rest: Vec::new(),
            area: Vec::new(),
            sides: Vec::new(),
            faces_of: Vec::new(),
            edges_of: Vec::new(),
            inverse_mass: Vec::new(),
        };
        for garment in garments {
            fabric.add(garment, scale)?;
        }
        let mut sides: BTreeMap<[u32; 2], Vec<(u32, u32)>> = BTreeMap::new();
        for (number, &[a, b, c]) in fabric.faces.iter().enumerate() {
            for (i, j, opposite) in [(a, b, c), (b, c, a), (c, a, b)] {
                if i != j {
                    let side = sides.entry([i.min(j), i.max(j)]).or_default();
                    side.push((number as u32, opposite));
                }
            }
        }
        (fabric.edges, fabric.sides) = sides.into_iter().unzip();
        // Edges are in the order of their vertices, so those of a garment follow each other.
        for piece in &mut fabric.garments {
            let before = |v: usize| fabric.edges.partition_point(|edge| (edge[0] as usize) < v);
            piece.edges = before(piece.vertices.start)..before(piece.vertices.end);
        }
        fabric.faces_of = incidence(fabric.rest.len(), &fabric.faces);
        fabric.edges_of = incidence(fabric.rest.len(), &fabric.edges);
        Ok(fabric)
    }

    fn add(&mut self, garment: &Garment, scale: f64) -> Result<(), SimError> {
        let cloth = Cloth::new(&garment.name, &garment.material)?;
        check_mesh(&garment.name, &garment.rest, &garment.faces)?;
        let first = self.rest.len();
        let first_face = self.faces.len();
        let number = self.garments.len() as u32;
        self.rest
            .extend(garment.rest.iter().map(|&p| metres(p, scale)));
        let mut mass = vec![0.0; garment.rest.len()];
        for face in &garment.faces {
            let [a, b, c] = face.map(|v| self.rest[first + v as usize]);
            let area = 0.5 * (b - a).cross(c - a).length();
            self.area.push(area);
            self.faces.push(face.map(|v| v + first as u32));
            for &v in face {
                mass[v as usize] += cloth.density * area / 3.0;
            }
        }
        // Vertices without area (loose ones, needles) get a share that keeps the solver sane.
        let mean = mass.iter().sum::<f64>() / mass.len().max(1) as f64;
        let least = (0.01 * mean).max(1e-9);
        self.inverse_mass
            .extend(mass.iter().map(|m| 1.0 / m.max(least)));
        self.garment_of.extend(garment.rest.iter().map(|_| number));
        self.garments.push(Piece {
            vertices: first..self.rest.len(),
            faces: first_face..self.faces.len(),
            edges: 0..0,
            layer: garment.layer,
            cloth,
        });
        Ok(())
    }

    /// Material of a vertex.
    pub fn cloth_of(&self, vertex: u32) -> &Cloth {
        &self.garments[self.garment_of[vertex as usize] as usize].cloth
    }

    /// Rest length of an edge, never 0.
    pub fn rest_length(&self, [a, b]: [u32; 2]) -> f64 {
        self.rest[a as usize]
            .distance(self.rest[b as usize])
            .max(SHORTEST_M)
    }

    /// Mean edge of the garment with the finest mesh, m; infinite without edges.
    pub fn finest_edge_m(&self) -> f64 {
        let mean = |piece: &Piece| {
            let edges = &self.edges[piece.edges.clone()];
            let sum: f64 = edges.iter().map(|&edge| self.rest_length(edge)).sum();
            sum / edges.len() as f64
        };
        let means = self.garments.iter().map(mean);
        means.fold(f64::INFINITY, f64::min)
    }

    /// Rest area of the faces at an edge, m².
    pub fn area_at(&self, edge: usize) -> f64 {
        self.sides[edge]
            .iter()
            .map(|&(face, _)| self.area[face as usize])
            .sum()
    }
}

/// Features at each vertex.
fn incidence<const N: usize>(vertices: usize, features: &[[u32; N]]) -> Vec<Vec<u32>> {
    let mut of = vec![Vec::new(); vertices];
    for (number, feature) in features.iter().enumerate() {
        for &v in feature {
            of[v as usize].push(number as u32);
        }
    }
    of
}

/// Refuses meshes whose faces point nowhere or whose vertices are nowhere.
pub(super) fn check_mesh(
    name: &str,
    positions: &[[f32; 3]],
    faces: &[[u32; 3]],
) -> Result<(), SimError> {
    check_finite(name, positions)?;
    let count = positions.len();
    for (number, face) in faces.iter().enumerate() {
        if let Some(vertex) = face.iter().find(|&&v| v as usize >= count) {
            let expected = format!("vertex numbers below {count}");
            return Err(SimError::value(
                format!("{name}, face {number}"),
                expected,
                vertex,
            ));
        }
    }
    Ok(())
}

/// Refuses NaN and infinity.
pub(super) fn check_finite(name: &str, positions: &[[f32; 3]]) -> Result<(), SimError> {
    match positions
        .iter()
        .position(|p| !p.iter().all(|x| x.is_finite()))
    {
        None => Ok(()),
        Some(vertex) => Err(SimError::NotFinite {
            surface: name.into(),
            vertex,
            found: positions[vertex],
        }),
    }
}
