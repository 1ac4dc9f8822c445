//! All garments' vertices in one set of arrays.

use std::ops::Range;

use drape_dataset::sequence::Garment;
use glam::DVec3;

use super::physics::Fabric;
use crate::error::SimError;

/// Vertices and faces of all garments, inner layer first.
#[derive(Clone, Debug)]
pub(super) struct Cloth {
    /// Positions at the end of the step, metres.
    pub x: Vec<DVec3>,
    /// Positions at the start of the step.
    pub old: Vec<DVec3>,
    /// Velocities, m/s.
    pub v: Vec<DVec3>,
    /// Inverse masses, 1/kg; 0 where something else moves the vertex.
    pub w: Vec<f64>,
    /// Masses, kg.
    pub mass: Vec<f64>,
    /// Rest positions, metres.
    pub rest: Vec<DVec3>,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// Garment of each vertex.
    pub garment: Vec<u16>,
    /// Garment of each face.
    pub garment_of_face: Vec<u16>,
    /// Vertices of each garment.
    pub ranges: Vec<Range<usize>>,
    /// Layer of each garment.
    pub layers: Vec<u32>,
    /// Materials.
    pub fabrics: Vec<Fabric>,
}

impl Cloth {
    pub fn new(garments: &[Garment], scale: f64) -> Result<Self, SimError> {
        let mut cloth = Self {
            x: Vec::new(),
            old: Vec::new(),
            v: Vec::new(),
            w: Vec::new(),
            mass: Vec::new(),
            rest: Vec::new(),
            faces: Vec::new(),
            garment: Vec::new(),
            garment_of_face: Vec::new(),
            ranges: Vec::new(),
            layers: Vec::new(),
            fabrics: Vec::new(),
        };
        for (g, garment) in garments.iter().enumerate() {
            cloth.append(g, garment, scale)?;
        }
        Ok(cloth)
    }

    fn append(&mut self, g: usize, garment: &Garment, scale: f64) -> Result<(), SimError> {
        let name = format!("garment {:?}", garment.name);
        check_finite(&name, &garment.rest)?;
        check_faces(&name, garment.rest.len(), &garment.faces)?;
        let fabric = Fabric::new(&garment.material, &garment.name)?;
        let first = self.rest.len();
        self.rest
            .extend(garment.rest.iter().map(|p| metres(p, scale)));
        let faces: Vec<[u32; 3]> = garment
            .faces
            .iter()
            .map(|f| f.map(|v| v + first as u32))
            .collect();
        self.mass.resize(self.rest.len(), 0.0);
        for face in &faces {
            let third = fabric.density * area(&self.rest, face) / 3.0;
            for v in face {
                self.mass[*v as usize] += third;
            }
        }
        // Loose vertices and needles: at least a thousandth of the mean mass.
        let masses = &mut self.mass[first..];
        let mean = masses.iter().sum::<f64>() / masses.len().max(1) as f64;
        for mass in masses.iter_mut() {
            *mass = mass.max(1e-3 * mean).max(1e-9);
        }
        self.w.extend(masses.iter().map(|m| 1.0 / m));
        self.x.extend_from_slice(&self.rest[first..]);
        self.old.extend_from_slice(&self.rest[first..]);
        self.v.resize(self.rest.len(), DVec3::ZERO);
        self.garment.resize(self.rest.len(), g as u16);
        self.garment_of_face
            .resize(self.faces.len() + faces.len(), g as u16);
        self.faces.extend(faces);
        self.ranges.push(first..self.rest.len());
        self.layers.push(garment.layer);
        self.fabrics.push(fabric);
        Ok(())
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.x.len()
    }
}

/// Scene units to metres.
pub(super) fn metres(p: &[f32; 3], scale: f64) -> DVec3 {
    DVec3::from_array(p.map(f64::from)) / scale
}

/// Area of a triangle.
pub(super) fn area(x: &[DVec3], face: &[u32; 3]) -> f64 {
    let [a, b, c] = face.map(|v| x[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// Refuses NaN and infinity, naming the vertex.
pub(super) fn check_finite(surface: &str, positions: &[[f32; 3]]) -> Result<(), SimError> {
    match positions
        .iter()
        .position(|p| !p.iter().all(|x| x.is_finite()))
    {
        None => Ok(()),
        Some(vertex) => Err(SimError::NotFinite {
            surface: surface.to_string(),
            vertex,
            found: positions[vertex],
        }),
    }
}

/// Refuses faces that point beyond the vertices.
pub(super) fn check_faces(
    surface: &str,
    vertices: usize,
    faces: &[[u32; 3]],
) -> Result<(), SimError> {
    for (number, face) in faces.iter().enumerate() {
        if face.iter().any(|&v| v as usize >= vertices) {
            return Err(SimError::value(
                format!("{surface}, face {number}"),
                format!("vertices below {vertices}"),
                format!("{face:?}"),
            ));
        }
    }
    Ok(())
}
