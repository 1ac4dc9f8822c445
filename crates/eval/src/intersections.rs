//! Exact edge–triangle hits of one frame, as sequence files store them.

use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};
use drape_geometry::intersect::{count_between, count_within};

/// Counts the hits between garments, within garments and with the body.
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
