//! Normal along the frame's seed axis.
//!
//! Symptom: a frame made from a normal and the fixed axis x loses orthogonality
//! near n = ±x (error 0.45 for (1, 2e-7, 2e-7)) and has rank 1 for n = 0.
//! Guarantee: the default starts from the smallest component's axis; its frames are
//! rotations for every unit normal, and the identity without a normal.

use drape_model::FrameAxis;
use drape_model::frames::{IDENTITY, Matrix, frame};
use drape_tests::scene::{Scene, SceneConfig};

/// Largest entry of `R Rᵀ − I`.
fn defect(r: &Matrix) -> f32 {
    let mut worst = 0f32;
    for i in 0..3 {
        for j in 0..3 {
            let product: f32 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
            worst = worst.max((product - f32::from(u8::from(i == j))).abs());
        }
    }
    worst
}

fn determinant(r: &Matrix) -> f32 {
    let [a, b, c] = r;
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

#[test]
fn default_frames_are_rotations_for_every_normal() {
    for tiny in [0.0f32, 1e-30, 5e-8, 1e-7, 2e-7, 1e-5, 3e-4, 0.5] {
        for sign in [1.0, -1.0] {
            for axis in 0..3 {
                let mut n = [tiny; 3];
                n[axis] = sign;
                let length = n.iter().map(|x| x * x).sum::<f32>().sqrt();
                let n = n.map(|x| x / length);
                let r = frame(n, FrameAxis::SmallestComponent);
                assert_eq!(r[2], n);
                assert!(
                    defect(&r) < 1e-6 && (determinant(&r) - 1.0).abs() < 1e-6,
                    "{n:?}: {r:?}"
                );
            }
        }
    }
    assert_eq!(frame([0.0; 3], FrameAxis::SmallestComponent), IDENTITY);
    assert_eq!(
        frame([9e-8, 0.0, 0.0], FrameAxis::SmallestComponent),
        IDENTITY,
        "below the threshold"
    );
}

#[test]
fn the_released_axis_degenerates_as_published() {
    let found = defect(&frame([1.0, 2e-7, 2e-7], FrameAxis::FixedX));
    assert!((found - 0.45).abs() < 0.02, "{found}");
    assert!(
        defect(&frame([1.0, 0.0, 0.0], FrameAxis::FixedX)) < 1e-6,
        "exactly x is handled"
    );
}

#[test]
fn a_body_with_such_normals_anchors_by_rotations() {
    // The capsule's side 0 faces +x, side 6 −x.
    let (sample, statistics) = Scene::new(SceneConfig::default()).sample(4);
    let run = super::run(&sample, &statistics);
    let graph = run.trained.evaluation.graph();
    let anchored: Vec<_> = graph
        .vertex_anchors
        .iter()
        .filter(|anchor| anchor.row.is_some())
        .collect();
    assert!(anchored.len() > 100);
    assert!(
        anchored.iter().any(|anchor| anchor.frame[2][0] > 0.999),
        "some normal is along x"
    );
    for anchor in anchored {
        assert!(defect(&anchor.frame) < 1e-5, "{:?}", anchor.frame);
    }
}
