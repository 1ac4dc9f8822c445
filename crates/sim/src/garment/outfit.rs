//! Garments of an outfit on one body: made inner to outer, checked for gaps
//! and intersections.

use std::sync::Arc;

use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{Garment, Material};
use drape_geometry::intersect;
use drape_geometry::mesh::edges;
use drape_geometry::vector::distance2;
use glam::{DQuat, DVec2, DVec3};

use super::anatomy::Anatomy;
use super::cuts::{Alteration, Cuts, cuts};
use super::field::Field;
use super::flatten::{Flat, flatten, pack};
use super::parameters::GarmentParameters;
use super::pattern;
use super::remesh::remesh;
use super::surface::{Cut, Surface};
use crate::body::{Body, Pose, ShapedBody};
use crate::error::{Result, SimError};

/// Metres that one UV unit stands for.
pub const METRES_PER_UV: f64 = 2.5;
/// Units per metre of bodies and garments.
const SCALE: f64 = 10.0;
/// Distance between the fields of two layers, in units.
const LAYER_GAP: f64 = 0.14;

/// What is tried in turn: edge lengths, as multiples of the one asked for, and how
/// far (units) the side and shoulder seams and the nape's edge come forward. A remeshing that comes
/// out crooked somewhere does not do so at another edge length, unless two cuts
/// nearly touch: then one of them has to go elsewhere.
const TRIALS: [(f64, f64); 8] = [
    (1.0, 0.0),
    (0.97, 0.0),
    (1.03, 0.0),
    (0.94, 0.0),
    (1.06, 0.0),
    (1.0, 0.3),
    (0.97, 0.3),
    (1.03, 0.3),
];
/// Shortest and longest target edge length in metres.
pub const EDGES_M: [f64; 2] = [0.01, 0.06];
/// Shortest edge allowed, as a multiple of the target.
const SHORTEST_EDGE: f64 = 0.1;

/// What to make.
#[derive(Clone, Debug)]
pub struct OutfitRequest<'a> {
    /// Garments with their materials, inner layer first.
    pub garments: &'a [(GarmentParameters, Material)],
    /// Target edge length in metres, in [`EDGES_M`].
    pub edge_m: f64,
    /// Inner garments end at their hems for the garments over them too: pants
    /// over a T-shirt are pants. Otherwise the outer garment follows the inner
    /// one's shape also where that was cut away.
    pub trimmed_layers: bool,
}

/// Garments that fit, and the body they were fitted on.
#[derive(Clone, Debug)]
pub struct Outfit {
    /// Garments, inner layer first.
    pub garments: Vec<Garment>,
    /// Vertices of each garment that follow the body, `[garment]`.
    pub waistbands: Vec<Vec<u32>>,
    /// Body in the fitting pose, `[vertex, 3]`.
    pub body: Vec<[f32; 3]>,
}

/// The pose garments are fitted in: arms away from the trunk, legs apart.
///
/// # Errors
/// The body's rig lacks a joint.
pub fn fitting_pose(body: &Body, shaped: &ShapedBody) -> Result<Pose> {
    let mut pose = shaped.rest_pose();
    for (side, sign) in [("Left", 1.0), ("Right", -1.0)] {
        let apart = DQuat::from_rotation_y(-sign * 4.0_f64.to_radians());
        pose.rotations[body.joint(&format!("{side}UpLeg"))?.index()] = apart;
        pose.rotations[body.joint(&format!("{side}Foot"))?.index()] = apart.inverse();
    }
    let lowest = shaped
        .pose(&pose)
        .iter()
        .map(|p| p[2])
        .fold(f32::INFINITY, f32::min);
    pose.root.z -= f64::from(lowest);
    Ok(pose)
}

impl Outfit {
    /// Makes the garments on a body in the fitting pose.
    ///
    /// # Errors
    /// A parameter is out of range, or a garment does not fit: it would meet
    /// the body, the layer below or itself, or its panels do not fit the UV square.
    pub fn fit(body: &Body, shaped: &ShapedBody, request: &OutfitRequest) -> Result<Self> {
        let [least, most] = EDGES_M;
        if !(least..=most).contains(&request.edge_m) {
            let expected = format!("{least} to {most}");
            return Err(SimError::value("edge_m", expected, request.edge_m));
        }
        let pose = fitting_pose(body, shaped)?;
        let positions = shaped.pose(&pose);
        let anatomy = Arc::new(Anatomy::new(body, shaped, &pose, &positions)?);
        let edge = request.edge_m * SCALE;
        let step = (0.65 * edge).clamp(0.1, 0.2);
        let specs: Vec<&GarmentParameters> =
            request.garments.iter().map(|(spec, _)| spec).collect();
        let reach = pattern::reach(&specs, &anatomy, LAYER_GAP);
        let margin = DVec3::new(0.6, 3.0, 0.6);
        let distance = Field::body(&positions, body.faces(), step, margin, reach);
        let mut inner: Option<Field> = None;
        let mut outfit = Self {
            garments: Vec::new(),
            waistbands: Vec::new(),
            body: positions,
        };
        for (layer, (parameters, material)) in request.garments.iter().enumerate() {
            let field = pattern::field(parameters, &anatomy, &distance, inner.as_ref(), LAYER_GAP)?;
            let collar = request.trimmed_layers.then_some(LAYER_GAP * layer as f64);
            let attempt = |(scale, forward): (f64, f64)| {
                let alteration = Alteration { forward, collar };
                let cuts = cuts(parameters, &anatomy, alteration);
                let made = sew(
                    &field,
                    &cuts,
                    parameters.kind,
                    layer,
                    *material,
                    scale * edge,
                )?;
                outfit.check(body, &made.0, edge)?;
                Ok(made)
            };
            let (garment, waistband) = TRIALS[1..]
                .iter()
                .fold(attempt(TRIALS[0]), |made, &trial| {
                    made.or_else(|_: SimError| attempt(trial))
                })?;
            outfit.garments.push(garment);
            outfit.waistbands.push(waistband);
            inner = Some(if request.trimmed_layers {
                let forward = 0.0;
                let cuts = cuts(parameters, &anatomy, Alteration { forward, collar });
                let worn = field.trimmed(&cuts.removed);
                inner.map_or_else(|| worn.clone(), |inner| inner.joined(&worn))
            } else {
                field
            });
        }
        Ok(outfit)
    }

    fn check(&self, body: &Body, garment: &Garment, edge: f64) -> Result<()> {
        let length2 =
            |e: &[u32; 2]| distance2(garment.rest[e[0] as usize], garment.rest[e[1] as usize]);
        let shortest = edges(&garment.faces)
            .into_iter()
            .min_by(|a, b| length2(a).total_cmp(&length2(b)));
        if let Some(e) = shortest {
            let length = f64::from(length2(&e)).sqrt();
            if length < SHORTEST_EDGE * edge {
                let [x, y, z] = garment.rest[e[0] as usize];
                let reason = format!(
                    "an edge of {length:.4} units, too short for the mesh, at ({x:.2}, {y:.2}, {z:.2})"
                );
                return Err(SimError::fit(&garment.name, reason));
            }
        }
        let problem = |count: u32, with: &str| {
            if count == 0 {
                return Ok(());
            }
            Err(SimError::fit(
                &garment.name,
                format!("{count} intersections with {with}"),
            ))
        };
        problem(
            intersect::count_within(&garment.rest, &garment.faces),
            "itself",
        )?;
        let with = |positions: &[[f32; 3]], faces: &[[u32; 3]]| {
            intersect::count_between(&garment.rest, &garment.faces, positions, faces)
        };
        problem(with(&self.body, body.faces()), "the body")?;
        for other in &self.garments {
            problem(with(&other.rest, &other.faces), &other.name)?;
        }
        Ok(())
    }
}

fn sew(
    field: &Field,
    made: &Cuts,
    kind: GarmentKind,
    layer: usize,
    material: Material,
    edge: f64,
) -> Result<(Garment, Vec<u32>)> {
    let name = kind.name();
    let mut surface = Surface::extract(field);
    for (k, cut) in made.removed.iter().enumerate() {
        surface.cut(cut, k as u32, true);
    }
    surface.keep_largest();
    let first_seam = made.removed.len() as u32;
    if let Some(p) = surface.torn() {
        let found = format!("it ends where nothing was cut, at ({p:.2})");
        return Err(SimError::fit(name, found));
    }
    for (k, cut) in made.seams.iter().enumerate() {
        surface.cut(cut, first_seam + k as u32, false);
    }
    surface.keep_features();
    let cuts: Vec<&Cut> = made.removed.iter().chain(&made.seams).collect();
    let surface = remesh(surface, field, &cuts, edge, 8);
    if surface.faces.is_empty() {
        return Err(SimError::fit(name, "nothing is left of it"));
    }
    // Labels of sides that share a seam: left and right pieces become panels of their own.
    let pieces = connected_pieces(&surface);
    let mut panels = Vec::new();
    let mut names = Vec::new();
    let mut panel_of_face = vec![0; surface.faces.len()];
    for (p, members) in pieces.iter().enumerate() {
        let faces: Vec<[u32; 3]> = members.iter().map(|&f| surface.faces[f as usize]).collect();
        let label = surface.labels[members[0] as usize] >> first_seam;
        let back = label & 1 == 1;
        let start = |p: DVec3| DVec2::new(if back { -p.x } else { p.x }, p.z);
        let flat = flatten(&surface.positions, &faces, &start);
        if flat.flipped() > 0 {
            let found = format!(
                "{} triangles of a panel cannot be laid flat",
                flat.flipped()
            );
            return Err(SimError::fit(name, found));
        }
        let x: f64 = faces
            .iter()
            .flatten()
            .map(|&v| surface.positions[v as usize].x)
            .sum();
        let side = if x > 0.0 { "left" } else { "right" };
        let base = (made.panel)(label);
        let twins = pieces
            .iter()
            .filter(|q| surface.labels[q[0] as usize] >> first_seam == label)
            .count();
        names.push(if twins > 1 {
            format!("{base}-{side}")
        } else {
            base
        });
        members
            .iter()
            .for_each(|&f| panel_of_face[f as usize] = p as u32);
        panels.push(flat);
    }
    let side = METRES_PER_UV * SCALE;
    if !pack(&mut panels, side, 0.3) {
        return Err(SimError::fit(
            name,
            format!("its panels do not fit {METRES_PER_UV} m × {METRES_PER_UV} m"),
        ));
    }
    let (uv, uv_faces) = uv_of(&panels, &pieces, surface.faces.len(), side);
    let waistband = made.waistband_z.map_or_else(Vec::new, |z| {
        (0..surface.positions.len() as u32)
            .filter(|&v| surface.positions[v as usize].z > z)
            .collect()
    });
    let garment = Garment {
        name: name.into(),
        kind,
        layer: layer as u32,
        rest: surface
            .positions
            .iter()
            .map(|p| p.to_array().map(|x| x as f32))
            .collect(),
        faces: surface.faces,
        uv,
        uv_faces,
        panel_of_face,
        panels: names,
        material,
    };
    Ok((garment, waistband))
}

/// Connected sets of faces of one label, in order of their first face.
fn connected_pieces(surface: &Surface) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::new(); surface.positions.len()];
    for (i, f) in surface.faces.iter().enumerate() {
        f.iter().for_each(|&v| around[v as usize].push(i as u32));
    }
    let mut piece = vec![false; surface.faces.len()];
    let mut pieces = Vec::new();
    for start in 0..surface.faces.len() as u32 {
        if std::mem::replace(&mut piece[start as usize], true) {
            continue;
        }
        let mut members = vec![start];
        let mut next = 0;
        while next < members.len() {
            let f = surface.faces[members[next] as usize];
            for k in 0..3 {
                let other = &around[f[(k + 1) % 3] as usize];
                for &g in around[f[k] as usize].iter().filter(|g| other.contains(g)) {
                    let same = surface.labels[g as usize] == surface.labels[start as usize];
                    if same && !std::mem::replace(&mut piece[g as usize], true) {
                        members.push(g);
                    }
                }
            }
            next += 1;
        }
        members.sort_unstable();
        pieces.push(members);
    }
    pieces
}

fn uv_of(
    panels: &[Flat],
    pieces: &[Vec<u32>],
    faces: usize,
    side: f64,
) -> (Vec<[f32; 2]>, Vec<[u32; 3]>) {
    let mut uv = Vec::new();
    let mut uv_faces = vec![[0; 3]; faces];
    for (flat, members) in panels.iter().zip(pieces) {
        let start = uv.len() as u32;
        uv.extend(
            flat.uv
                .iter()
                .map(|p| (*p / side).to_array().map(|x| x as f32)),
        );
        for (&f, corners) in members.iter().zip(&flat.faces) {
            uv_faces[f as usize] = corners.map(|c| start + c);
        }
    }
    (uv, uv_faces)
}
