//! Patches: equal to the published program's, and what follows from their definition.

#[allow(dead_code)]
mod reference;

use drape_dataset::patches::{Csr, Patches, patch_of_face};
use reference::{GARMENT, PATCH_SIZE, Reference};

#[test]
fn patches_are_the_published_ones() {
    let file = Reference::read("tiny_preprocess");
    let header = file.header();
    let patches = Patches::of_outfit(&header.garments, PATCH_SIZE).unwrap();
    let mut membership = Vec::new();
    let mut first = 0;
    for garment in 0..2 {
        let patch = file.values(&format!("patch.garment{garment}.patch"));
        let vertex = file.values(&format!("patch.garment{garment}.vertex"));
        membership.extend(
            (patch.iter().zip(&vertex))
                .map(|(p, v)| (first + *p as u32, *v as u32 + (garment * GARMENT) as u32)),
        );
        first += 1 + patch.iter().fold(0f64, |top, p| top.max(*p)) as u32;
    }
    assert_eq!(patches.members, Csr::from_pairs(first as usize, membership));
    // Neighbours as in the batch made from this sequence.
    let dense = Reference::read("tiny_inputs").values("pmesh_mask");
    let count = patches.count();
    let expected = (dense.iter().enumerate())
        .filter(|(_, value)| **value > 0.0)
        .map(|(at, _)| ((at / count) as u32, (at % count) as u32));
    assert_eq!(
        patches.neighbours,
        Csr::from_pairs(count, expected.collect())
    );
}

#[test]
fn every_vertex_is_covered_and_neighbours_are_mutual() {
    let header = Reference::read("tiny_preprocess").header();
    for size in [0.05, 0.25, 2.0] {
        let patches = Patches::of_outfit(&header.garments, size).unwrap();
        assert!(patches.of_vertex.iter().all(|all| !all.is_empty()));
        assert!(
            patches.members.iter().all(|all| all.len() >= 3),
            "a patch has a triangle"
        );
        for (p, q) in patches.neighbours.pairs() {
            assert!(patches.neighbours.row(q as usize).contains(&p));
        }
        for p in 0..patches.count() {
            assert!(patches.neighbours.row(p).contains(&(p as u32)));
        }
    }
    // Cells larger than the map: one patch a panel.
    let patches = Patches::of_outfit(&header.garments, 2.0).unwrap();
    assert_eq!(patches.count(), 4);
}

#[test]
fn a_cells_border_belongs_to_the_upper_cell() {
    let mut garment = Reference::read("tiny_preprocess")
        .header()
        .garments
        .remove(0);
    garment.faces = vec![[0, 1, 2]; 3];
    garment.uv_faces = vec![[0, 0, 0], [1, 1, 1], [2, 2, 2]];
    garment.panel_of_face = vec![0; 3];
    // 0.5 is exact in binary: the border itself and both neighbours.
    garment.uv = vec![[0.499, 0.1], [0.5, 0.1], [0.501, 0.1]];
    let (ids, count) = patch_of_face(&garment, 0.5).unwrap();
    assert_eq!((ids, count), (vec![0, 1, 1], 2));
}

#[test]
fn unusable_uv_is_refused_by_name() {
    let garment = Reference::read("tiny_preprocess")
        .header()
        .garments
        .remove(0);
    let refused = |change: fn(&mut drape_dataset::sequence::Garment), size: f32| {
        let mut garment = garment.clone();
        change(&mut garment);
        patch_of_face(&garment, size).unwrap_err().to_string()
    };
    let message = refused(|_| (), 0.0);
    assert!(
        message.contains("garment0") && message.contains("patch size 0"),
        "{message}"
    );
    let message = refused(|g| g.uv[3] = [f32::NAN, 0.0], 0.25);
    assert!(message.contains("finite coordinates"), "{message}");
    let message = refused(|g| g.uv_faces[7][2] = 999, 0.25);
    assert!(message.contains("face 7 names UV 999"), "{message}");
    let message = refused(|g| g.uv_faces.truncate(5), 0.25);
    assert!(message.contains("5 UV faces"), "{message}");
}
