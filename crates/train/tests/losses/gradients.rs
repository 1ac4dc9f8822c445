//! Gradients by position against central differences. Step 1e-6: the formula's own
//! error is 1e-12, rounding adds 1e-10; hits and nearest vertices do not change.

use drape_geometry::mesh::on_border;
use drape_train::losses::collision::{CollisionRoom, body_collision, layer_collision};
use drape_train::losses::normal::{MeshNormals, NormalRoom, normal_loss};
use drape_train::losses::{LossConfig, Term, Vector, squared_error};

use crate::{body, outfit, sheet, sheet_faces, term};

fn check(x: &[Vector], f: impl Fn(&[Vector]) -> Term) {
    let term = f(x);
    assert!(
        term.value > 0.0,
        "a term of zero would pass whatever its gradient"
    );
    let size = term
        .gradient
        .as_flattened()
        .iter()
        .fold(0f64, |top, g| top.max(g.abs()));
    for vertex in 0..x.len() {
        for axis in 0..3 {
            let at = |shift: f64| {
                let mut moved = x.to_vec();
                moved[vertex][axis] += shift;
                f(&moved).value
            };
            let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
            let found = term.gradient[vertex][axis];
            assert!(
                (found - expected).abs() < 1e-6 * size,
                "vertex {vertex}, axis {axis}: {found}, expected {expected}"
            );
        }
    }
}

fn wavy(x: f64, y: f64) -> f64 {
    0.1 * (1.7 * x + 0.3).sin() + 0.07 * (2.1 * y).cos()
}

#[test]
fn position() {
    let x = sheet(4, 0.5, wavy);
    let target = sheet(4, 0.47, |x, y| 0.9 * wavy(y, x));
    check(&x, |x| term(|term| squared_error(x, &target, term)));
}

#[test]
fn normals() {
    let (faces, x) = (sheet_faces(4, 0), sheet(4, 0.5, wavy));
    let target = sheet(4, 0.47, |x, y| 0.9 * wavy(y, x));
    check(&x, |x| normal_term(x, &target, &faces));
}

fn normal_term(x: &[Vector], target: &[Vector], faces: &[[u32; 3]]) -> Term {
    let mut rooms = [NormalRoom::default(), NormalRoom::default()];
    let [room, true_room] = &mut rooms;
    let normals = MeshNormals::new(x, faces, room);
    let true_normals = MeshNormals::new(target, faces, true_room);
    term(|term| normal_loss(&normals, &true_normals, &mut Term::default(), term))
}

#[test]
fn body_collision_in_both_presets() {
    let body_rows = body(&sheet(7, 0.4, |x, y| 0.5 * wavy(y, x)));
    // Half of the sheet lies below the body's surface.
    let x = sheet(5, 0.37, |x, y| 0.2 * x + wavy(x, y) - 0.05);
    for config in [
        LossConfig::default().collision,
        LossConfig::released().collision,
    ] {
        check(&x, |x| {
            let mut room = CollisionRoom::default();
            term(|term| {
                body_collision(
                    &config,
                    x,
                    &body_rows,
                    &sheet_faces(7, 0),
                    &on_border(49, &sheet_faces(7, 0)),
                    &mut room,
                    term,
                )
            })
        });
    }
}

#[test]
fn layer_collision_moves_inner_positions_and_normals_too() {
    let mut x = sheet(7, 0.4, |x, y| 0.5 * wavy(y, x));
    x.extend(sheet(5, 0.37, |x, y| 0.2 * x + wavy(x, y) - 0.05));
    let faces = [sheet_faces(7, 0), sheet_faces(5, 49)].concat();
    let both = outfit(49, 25, faces.clone());
    for config in [
        LossConfig::default().collision,
        LossConfig::released().collision,
    ] {
        let config = &config;
        let of = |x: &[Vector]| {
            let mut room = NormalRoom::default();
            let normals = MeshNormals::new(x, &faces, &mut room);
            let mut room = CollisionRoom::default();
            term(|term| layer_collision(config, &both, x, &normals, &mut room, term))
        };
        check(&x, of);
        let term = of(&x);
        // The term depends on differences only, so its gradients cancel.
        for axis in 0..3 {
            let sum: f64 = term.gradient.iter().map(|g| g[axis]).sum();
            assert!(sum.abs() < 1e-12, "momentum along {axis}: {sum}");
        }
    }
}

#[test]
fn a_zero_area_face_passes_no_gradient() {
    let mut x = sheet(3, 0.5, wavy);
    let mut faces = sheet_faces(3, 0);
    let target = sheet(3, 0.47, |x, y| 0.9 * wavy(y, x));
    let clean = normal_term(&x, &target, &faces).gradient;
    // A needle: three points on a line, two of them the sheet's own.
    let middle = |x: &[Vector]| [0, 1, 2].map(|axis| (x[0][axis] + x[1][axis]) / 2.0);
    x.push(middle(&x));
    let with_point = [&target[..], &[middle(&target)]].concat();
    let before = normal_term(&x, &with_point, &faces);
    faces.push([0, 9, 1]);
    let after = normal_term(&x, &with_point, &faces);
    assert_eq!(before.gradient[..9].len(), clean.len());
    for (a, b) in after
        .gradient
        .iter()
        .flatten()
        .zip(before.gradient.iter().flatten())
    {
        assert!(
            (a - b).abs() < 1e-9 && a.abs() < 1e2,
            "{a} with the needle, {b} without"
        );
    }
}
