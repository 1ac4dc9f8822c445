//! Laws that Blender itself is held to, where it is installed.

use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{Garment, Material, Wind};

use super::{Blender, BlenderSettings, Job, Run, SharedMaterials};

const FPS: f32 = 24.0;
const FRAMES: usize = 6;

/// A square of cloth, 1 unit wide, that lies in the air far from the body.
fn square() -> Garment {
    Garment {
        name: "square".into(),
        kind: GarmentKind::Skirt,
        layer: 0,
        rest: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .map(|[x, y]| [x, y, 50.0])
            .into(),
        faces: vec![[0, 1, 2], [0, 2, 3]],
        uv: Vec::new(),
        uv_faces: Vec::new(),
        panel_of_face: Vec::new(),
        panels: Vec::new(),
        material: Material {
            mass: 0.5,
            tension: 50.0,
            compression: 50.0,
            shear: 50.0,
            bending: 50.0,
            friction: 50.0,
        },
    }
}

/// Heights of the middle of the square in each frame.
fn heights(blender: &Blender, settings: &BlenderSettings, wind: f32) -> Vec<f32> {
    let garments = [square()];
    let shared = SharedMaterials::of(&[garments[0].material]).unwrap();
    let body = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let upwards = Wind {
        rotation: [1.0, 0.0, 0.0, 0.0],
        strength: wind,
    };
    let job = Job {
        settings,
        garments: &garments,
        waistbands: &[],
        body_faces: &[[0, 1, 2]],
        bodies: &vec![body; FRAMES + 1],
        wind: &[upwards; FRAMES + 1],
        body_friction: 50.0,
        fps: FPS,
        scale: 10.0,
        warm_up_frames: 1,
    };
    let mut run = Run::start(blender, &job, &shared).unwrap();
    let height = |run: &Run| run.garments()[0].iter().map(|p| p[2]).sum::<f32>() / 4.0;
    let mut heights = vec![height(&run)];
    for _ in 0..FRAMES {
        run.advance().unwrap();
        heights.push(height(&run));
    }
    heights
}

/// Second differences times frames per second squared, after the first frames.
fn accelerations(heights: &[f32]) -> Vec<f32> {
    heights[1..]
        .windows(3)
        .map(|z| (z[0] - 2.0 * z[1] + z[2]) * FPS * FPS)
        .collect()
}

#[test]
fn where_blender_is_installed_cloth_falls_with_the_acceleration_that_files_say() {
    let blender = match Blender::find() {
        Ok(blender) => blender,
        Err(reason) => return eprintln!("not tested: {reason}"),
    };
    for gravity in [9.81, 40.0] {
        let settings = BlenderSettings {
            gravity,
            air_damping: 0.0,
            ..BlenderSettings::default()
        };
        let [.., expected] = settings.acceleration(FPS);
        for found in accelerations(&heights(&blender, &settings, 0.0)) {
            assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
        }
    }
}

#[test]
fn where_blender_is_installed_wind_pushes_where_it_blows_and_twice_as_much_if_twice_as_strong() {
    let blender = match Blender::find() {
        Ok(blender) => blender,
        Err(reason) => return eprintln!("not tested: {reason}"),
    };
    let settings = BlenderSettings {
        gravity: 0.0,
        air_damping: 0.0,
        ..BlenderSettings::default()
    };
    let rise = |strength| {
        let heights = heights(&blender, &settings, strength);
        heights[FRAMES] - heights[0]
    };
    let (one, two) = (rise(100.0), rise(200.0));
    assert!(one > 0.01, "{one}");
    assert!((two / one - 2.0).abs() < 0.1, "{one} {two}");
}
