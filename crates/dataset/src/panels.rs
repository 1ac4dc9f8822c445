//! Panels of a garment whose pattern pieces are not named: the islands of its
//! UV map, that is, faces connected through shared UV vertices.

/// Panel of each face and number of panels; panels are numbered in the order
/// of their first face. `uv_faces` index below `uv_count`.
pub fn uv_islands(uv_faces: &[[u32; 3]], uv_count: usize) -> (Vec<u32>, usize) {
    let mut parent: Vec<u32> = (0..uv_count as u32).collect();
    for &[a, b, c] in uv_faces {
        let root = find(&mut parent, a);
        for corner in [b, c] {
            let other = find(&mut parent, corner);
            parent[other as usize] = root;
        }
    }
    let mut panel_of_root = vec![u32::MAX; uv_count];
    let mut panels = 0;
    let panel_of_face = uv_faces
        .iter()
        .map(|face| {
            let panel = &mut panel_of_root[find(&mut parent, face[0]) as usize];
            if *panel == u32::MAX {
                *panel = panels;
                panels += 1;
            }
            *panel
        })
        .collect();
    (panel_of_face, panels as usize)
}

/// Names for `count` panels without names.
pub(crate) fn numbered_names(count: usize) -> Vec<String> {
    (0..count).map(|panel| format!("panel_{panel}")).collect()
}

/// Root of `vertex` in the union-find forest, halving the path on the way.
fn find(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        let grandparent = parent[parent[vertex as usize] as usize];
        parent[vertex as usize] = grandparent;
        vertex = grandparent;
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn islands_are_faces_connected_through_uv_vertices_in_order_of_first_face() {
        // Faces 0 and 2 share UV vertex 2; face 1 stands alone; face 3 joins through 2.
        let faces = [[0, 1, 2], [5, 6, 7], [2, 3, 4], [4, 8, 9]];
        assert_eq!(uv_islands(&faces, 10), (vec![0, 1, 0, 0], 2));
        assert_eq!(uv_islands(&[], 0), (vec![], 0));
    }
}
