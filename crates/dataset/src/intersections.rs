//! Exact edge–triangle hits of one frame, as sequence files store them.

use drape_geometry::intersect::{count_between, count_within};

use crate::sequence::{Frame, Intersections, SequenceHeader};

/// Counts the hits between garments, within garments and with the body.
///
/// # Panics
/// If the frame does not have the header's shapes ([`Frame::check`]).
pub fn count_intersections(header: &SequenceHeader, frame: &Frame) -> Intersections {
    let mut found = Intersections::default();
    let garments: Vec<_> = header.garments.iter().zip(&frame.garments).collect();
    for (index, (garment, positions)) in garments.iter().enumerate() {
        found.within_garments += count_within(positions, &garment.faces);
        found.with_body +=
            count_between(positions, &garment.faces, &frame.body, &header.body.faces);
        for (other, others) in &garments[index + 1..] {
            found.between_garments +=
                count_between(positions, &garment.faces, others, &other.faces);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::GarmentKind;
    use crate::sequence::{BodyTopology, Garment, Material, SceneMeta};

    /// One triangle flat at z = 0, one that stands on its tip 1 below and has
    /// two edges through the first; the body is one triangle wherever it is put.
    fn scene(body_height: f32) -> (SequenceHeader, Frame) {
        let material = Material {
            mass: 1.0,
            tension: 0.0,
            compression: 0.0,
            shear: 0.0,
            bending: 0.0,
            friction: 0.0,
        };
        let garment = |name: &str, layer| Garment {
            name: name.into(),
            kind: GarmentKind::Skirt,
            layer,
            rest: vec![[0.0; 3]; 3],
            faces: vec![[0, 1, 2]],
            uv: Vec::new(),
            uv_faces: Vec::new(),
            panel_of_face: Vec::new(),
            panels: Vec::new(),
            material,
        };
        let header = SequenceHeader {
            name: "two triangles and a body".into(),
            scene: SceneMeta::default(),
            body: BodyTopology {
                rest: Vec::new(),
                faces: vec![[0, 1, 2]],
                vertex_count: 3,
            },
            garments: vec![garment("flat", 0), garment("tip", 1)],
        };
        let frame = Frame {
            body: [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]]
                .map(|[x, y]| [x, y, body_height])
                .into(),
            garments: vec![
                vec![[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]],
                vec![[0.0, 0.0, -1.0], [0.5, 0.0, 1.0], [-0.5, 0.0, 1.0]],
            ],
            ..Frame::default()
        };
        (header, frame)
    }

    #[test]
    fn hits_are_counted_where_they_are() {
        let counts = |height| {
            let (header, frame) = scene(height);
            let found = count_intersections(&header, &frame);
            [
                found.between_garments,
                found.within_garments,
                found.with_body,
            ]
        };
        assert_eq!(counts(-2.0), [2, 0, 0], "below both");
        assert_eq!(counts(-0.5), [2, 0, 2], "between the tip and the flat one");
        assert_eq!(counts(2.0), [2, 0, 0], "above both");
        let (mut header, mut frame) = scene(0.5);
        (header.body.faces, header.body.vertex_count) = (Vec::new(), 0);
        frame.body.clear();
        assert_eq!(count_intersections(&header, &frame).with_body, 0, "no body");
    }
}
