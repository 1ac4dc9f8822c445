//! Zero-area face.
//!
//! Symptom: the derivative of n/(|n| + 1e-7) at n = 0 is 1e7; one collapsed face
//! makes the normal loss throw the weights away.
//! Guarantee: a collapsed face adds nothing to its vertices' normals and passes no
//! gradient; its neighbours' gradients are those of the mesh without it.

use drape_tests::scene::{Scene, SceneConfig};
use drape_train::losses::normal::{MeshNormals, NormalRoom};

#[test]
fn a_collapsed_face_changes_neither_normals_nor_gradients() {
    // A tent of two faces, and a face whose corners 3, 4, 5 coincide.
    let mut x: Vec<[f64; 3]> = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.2],
        [0.0, 1.0, 0.1],
        [1.0, 1.0, 0.4],
    ];
    x.extend([[1.0, 1.0, 0.4]; 2]);
    let with = [[0, 1, 2], [1, 3, 2], [3, 4, 5]];
    let by_normal: Vec<[f64; 3]> = (0..6).map(|i| [1.0, -0.5, 0.1 * f64::from(i)]).collect();
    let run = |faces: &[[u32; 3]]| {
        let mut room = NormalRoom::default();
        let normals = MeshNormals::new(&x, faces, &mut room);
        let mut gradient = vec![[0.0; 3]; 6];
        normals.backward(&mut by_normal.clone(), &mut gradient);
        (normals.normals.to_vec(), gradient)
    };
    let (whole, collapsed) = (run(&with[..2]), run(&with));
    assert_eq!(whole, collapsed);
    assert_eq!(
        collapsed.0[4], [0.0; 3],
        "a vertex of collapsed faces only has no normal"
    );
    assert_eq!(collapsed.1[4], [0.0; 3], "and gets no gradient");
}

#[test]
fn a_garment_with_collapsed_faces_trains() {
    let (mut sample, statistics) = Scene::new(SceneConfig::default()).sample(4);
    // Collapse the first face of the outer tube, in the state and in the reference.
    let face = *sample
        .outfit
        .faces
        .iter()
        .find(|face| face[0] as usize >= sample.outfit.garment_offsets[1])
        .unwrap();
    for vertex in [face[1], face[2]] {
        sample.state[vertex as usize] = sample.state[face[0] as usize];
        for states in &mut sample.reference {
            states[vertex as usize] = states[face[0] as usize];
        }
    }
    let healthy = Scene::new(SceneConfig::default()).sample(4);
    let size = |run: &super::Run| {
        run.trained
            .gradients
            .values()
            .flatten()
            .fold(0f32, |top, g| top.max(g.abs()))
    };
    let (healthy, collapsed) = (
        super::run(&healthy.0, &healthy.1),
        super::run(&sample, &statistics),
    );
    // The collapsed corner bends the mesh, so gradients differ, but by no power of ten.
    assert!(
        size(&collapsed) < 10.0 * size(&healthy),
        "{} against {}",
        size(&collapsed),
        size(&healthy)
    );
}
