//! What garments hang from: poses of supports whose body moves as a rigid piece.

use drape_dataset::registry::GarmentKind;
use drape_dataset::sample::StatePair;
use drape_dataset::sequence::{BodyTopology, Garment, Material, SceneMeta, SequenceHeader};
use drape_dataset::support::Support;
use drape_geometry::rigid::{matrix_from_quaternion, rotate};

/// A waist: body vertices on a circle of radius 1 at height 8, and another at height 5.
fn body() -> Vec<[f32; 3]> {
    let ring = |height: f32| {
        (0..12).map(move |side| {
            let (sin, cos) = (side as f32 * std::f32::consts::TAU / 12.0).sin_cos();
            [cos, sin, height]
        })
    };
    ring(8.0).chain(ring(5.0)).collect()
}

/// A skirt's rest shape: `distance` from the body at the waist, wide at the hem.
fn skirt(distance: f32) -> Garment {
    let waist = body()[..12].to_vec();
    let out = |x: &[f32; 3], by: f32, height: f32| [x[0] * (1.0 + by), x[1] * (1.0 + by), height];
    let top = waist.iter().map(|x| out(x, distance, 8.0));
    let hem = waist.iter().map(|x| out(x, 1.5, 4.0));
    garment(top.chain(hem).collect())
}

fn garment(rest: Vec<[f32; 3]>) -> Garment {
    Garment {
        name: "skirt".into(),
        kind: GarmentKind::Skirt,
        layer: 0,
        rest,
        faces: Vec::new(),
        uv: Vec::new(),
        uv_faces: Vec::new(),
        panel_of_face: Vec::new(),
        panels: Vec::new(),
        material: Material {
            mass: 0.5,
            tension: 20.0,
            compression: 20.0,
            shear: 20.0,
            bending: 20.0,
            friction: 50.0,
        },
    }
}

fn header(garments: Vec<Garment>, rest: Vec<[f32; 3]>) -> SequenceHeader {
    SequenceHeader {
        name: "waist".into(),
        scene: SceneMeta::default(),
        body: BodyTopology {
            vertex_count: rest.len(),
            rest,
            faces: Vec::new(),
        },
        garments,
    }
}

type Motion = ([f64; 4], [f64; 3]);

fn moved((turn, shift): Motion, x: [f32; 3]) -> [f64; 3] {
    let x = rotate(&matrix_from_quaternion(turn), x.map(f64::from));
    [0, 1, 2].map(|axis| x[axis] + shift[axis])
}

/// Body states of a body whose waist moves from one pose to another; what is lower does as it likes.
fn states(next: Motion, now: Motion) -> Vec<StatePair> {
    let pair = |(vertex, x): (usize, [f32; 3])| {
        let mut state = [7.0 * vertex as f32; 12];
        if vertex < 12 {
            for (start, pose) in [(0, next), (6, now)] {
                let x = moved(pose, x);
                (0..3).for_each(|axis| state[start + axis] = x[axis] as f32);
            }
        }
        state
    };
    body().into_iter().enumerate().map(pair).collect()
}

fn close(found: [f32; 3], expected: [f64; 3]) {
    let near = (0..3).all(|axis| (f64::from(found[axis]) - expected[axis]).abs() < 1e-5);
    assert!(near, "{found:?}, expected {expected:?}");
}

#[test]
fn a_point_moves_as_if_rigid_on_the_waist_and_hangs_upright_below_it() {
    let skirt = skirt(0.2);
    let supports = Support::of_outfit(&header(vec![skirt.clone()], body()));
    let support = supports[0].as_ref().expect("the waist is near");
    assert_eq!(support.body, (0..12).collect::<Vec<u32>>());
    let half = |angle: f64| ((angle / 2.0).cos(), (angle / 2.0).sin());
    let yaw = |angle| {
        let (cos, sin) = half(angle);
        [cos, 0.0, 0.0, sin]
    };
    // Bent forward by a right angle less a bit, after a turn by 0.7.
    let (cos, sin) = half(1.2);
    let (c, s) = half(0.7);
    let bent = [cos * c, -sin * s, sin * c, cos * s];
    let before = (yaw(0.5), [0.3, -0.2, -8.0]);
    for (next, heading) in [
        ((yaw(0.7), [0.5, 0.1, -8.2]), 0.7),
        ((yaw(-2.9), [0.0, 0.0, -8.0]), -2.9),
        ((bent, [0.0, 0.0, -8.0]), f64::NAN),
    ] {
        let body = states(next, before);
        let pose = support.pose(&body, &mut Vec::new()).expect("finite");
        for x in &skirt.rest {
            let rest = [0, 1, 2].map(|axis| x[axis] - support.centre[axis]);
            let (to, from) = (moved(next, *x), moved(before, *x));
            close(
                pose.velocity(rest),
                [0, 1, 2].map(|axis| to[axis] - from[axis]),
            );
            let (centre, hanging) = (moved(next, support.centre), pose.hanging(rest));
            if heading.is_finite() {
                // Upright already: hanging is where the rigid motion puts it.
                close(hanging, to);
            }
            // As far below the centre as at rest, whatever the bend.
            assert!((hanging[2] - (rest[2] + centre[2] as f32)).abs() < 1e-5);
            let out = |x: [f64; 2]| x[0].hypot(x[1]);
            let (rest, hanging) = (rest.map(f64::from), hanging.map(f64::from));
            let away = out([hanging[0] - centre[0], hanging[1] - centre[1]]);
            assert!((away - out([rest[0], rest[1]])).abs() < 1e-5);
        }
    }
}

#[test]
fn without_a_body_at_its_top_a_garment_hangs_from_nothing() {
    let none = |garment: Garment, body: Vec<[f32; 3]>| {
        assert_eq!(Support::of_outfit(&header(vec![garment], body)), [None]);
    };
    none(skirt(0.2), Vec::new());
    none(skirt(1.2), body());
    none(skirt(0.2), body()[..2].to_vec());
    none(garment(Vec::new()), body());
    // A rest pose that is not the body's.
    let mut short = header(vec![skirt(0.2)], body());
    short.body.vertex_count += 1;
    assert_eq!(Support::of_outfit(&short), [None]);
    let other = Support::of_outfit(&header(vec![skirt(0.2), skirt(1.2)], body()));
    assert!(other[0].is_some() && other[1].is_none());
}

#[test]
fn a_body_that_is_not_finite_has_no_pose() {
    let supports = Support::of_outfit(&header(vec![skirt(0.2)], body()));
    let still = ([1.0, 0.0, 0.0, 0.0], [0.0; 3]);
    let mut body = states(still, still);
    body[3][1] = f32::NAN;
    let support = supports[0].as_ref().expect("the waist is near");
    assert_eq!(support.pose(&body, &mut Vec::new()), None);
}
