//! Finer meshes of the same surfaces: the longest edge is halved until a mesh
//! has as many vertices as asked for.

use std::collections::{BTreeMap, BinaryHeap};

use drape_dataset::sequence::Garment;

/// Which vertices a finer mesh adds, each between two that were there before.
pub struct Refined {
    /// Ends of the halved edges, `[added vertex]`.
    pub parents: Vec<[u32; 2]>,
    /// The finer mesh.
    pub faces: Vec<[u32; 3]>,
    /// Original face of each face.
    pub origin: Vec<u32>,
}

impl Refined {
    /// Halves edges of a mesh with these positions until it has `vertices` vertices.
    pub fn new(positions: &[[f32; 3]], faces: &[[u32; 3]], vertices: usize) -> Self {
        let mut x = positions.to_vec();
        let mut refined = Self {
            parents: Vec::new(),
            faces: faces.to_vec(),
            origin: (0..faces.len() as u32).collect(),
        };
        let mut faces_at: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
        for (number, &face) in faces.iter().enumerate() {
            for edge in sides(face) {
                faces_at.entry(edge).or_default().push(number as u32);
            }
        }
        let mut queue: BinaryHeap<(u32, [u32; 2])> =
            faces_at.keys().map(|&e| (squared(&x, e), e)).collect();
        while x.len() < vertices {
            let Some((_, edge)) = queue.pop() else { break };
            let [a, b] = edge;
            let middle = x.len() as u32;
            x.push(half_way(x[a as usize], x[b as usize]));
            refined.parents.push(edge);
            let around = faces_at.remove(&edge).unwrap_or_default();
            let mut fresh = vec![[a, middle], [b, middle]];
            for face in around {
                let corners = refined.faces[face as usize];
                let with = |old: u32| corners.map(|v| if v == old { middle } else { v });
                let (keeps_a, keeps_b) = (with(b), with(a));
                let other = refined.faces.len() as u32;
                refined.faces[face as usize] = keeps_a;
                refined.faces.push(keeps_b);
                refined.origin.push(refined.origin[face as usize]);
                let opposite = corners.into_iter().find(|&v| v != a && v != b);
                fresh.extend(opposite.map(|v| [v, middle]));
                for (corners, number) in [(keeps_a, face), (keeps_b, other)] {
                    for side in sides(corners) {
                        let at = faces_at.entry(side).or_default();
                        at.retain(|&f| f != face && f != other || f == number);
                        if !at.contains(&number) {
                            at.push(number);
                        }
                    }
                }
                // The side between the halves belongs to both.
                if let Some(v) = opposite {
                    faces_at.insert([v.min(middle), v.max(middle)], vec![face, other]);
                }
            }
            queue.extend(fresh.into_iter().map(|edge| (squared(&x, edge), edge)));
        }
        refined
    }

    /// Positions of the finer mesh from those of the coarse one.
    pub fn positions(&self, coarse: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let mut x = coarse.to_vec();
        for &[a, b] in &self.parents {
            x.push(half_way(x[a as usize], x[b as usize]));
        }
        x
    }
}

/// A garment on a finer mesh, without the panels that the engine does not look at.
pub fn garment(coarse: &Garment, vertices: usize) -> Garment {
    let refined = Refined::new(&coarse.rest, &coarse.faces, vertices);
    Garment {
        rest: refined.positions(&coarse.rest),
        uv: Vec::new(),
        uv_faces: Vec::new(),
        panel_of_face: refined
            .origin
            .iter()
            .map(|&face| coarse.panel_of_face[face as usize])
            .collect(),
        faces: refined.faces,
        ..coarse.clone()
    }
}

fn sides([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[i, j]| [i.min(j), i.max(j)])
}

/// Bits of a squared length: positive floats are ordered as their bits are.
fn squared(x: &[[f32; 3]], [a, b]: [u32; 2]) -> u32 {
    let (a, b) = (x[a as usize], x[b as usize]);
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().to_bits()
}

fn half_way(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|k| 0.5 * (a[k] + b[k]))
}
