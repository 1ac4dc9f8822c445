//! D-LAYERS as published: what Python wrote arrives exactly, whatever protocol
//! and program wrote it; bodies follow an independent implementation; a file
//! that lacks something says what.

mod d_layers;

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use d_layers::{make, python_has, python_is_there};
use drape_dataset::import::DLayers;
use drape_dataset::import::smpl::BodyModel;
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{Frame, SequenceHeader};
use drape_dataset::splits::Split;
use drape_geometry::rigid::matrix_from_quaternion;
use serde_json::{Value, json};

fn read(root: &Path, smpl: bool, name: &str) -> Result<(SequenceHeader, Vec<Frame>), String> {
    let models = root.join("smpl/model");
    let mut source = DLayers::open(root, smpl.then_some(&*models)).map_err(|e| e.to_string())?;
    let recording = source.open_sequence(name).map_err(|e| e.to_string())?;
    let header = recording.header().clone();
    let frames = recording
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| e.to_string())?;
    Ok((header, frames))
}

/// Rows of numbers.
fn rows<const N: usize>(value: &Value) -> Vec<[f64; N]> {
    let row = |row: &Value| std::array::from_fn(|k| row[k].as_f64().unwrap());
    value.as_array().unwrap().iter().map(row).collect()
}

/// Compares everything with what Python computed: garments to the bit of an
/// f32, bodies to f32 rounding of numbers up to 100.
fn check(header: &SequenceHeader, frames: &[Frame], expected: &Value) {
    assert_eq!(header.name, expected["name"].as_str().unwrap());
    assert_eq!(frames.len() as u64, expected["frames"].as_u64().unwrap());
    let z_up = |[x, y, z]: [f64; 3]| [x as f32, -z as f32, y as f32];
    for (layer, garment) in header.garments.iter().enumerate() {
        let expected = &expected["garments"][layer];
        assert_eq!(garment.layer, layer as u32);
        let rest: Vec<_> = rows::<3>(&expected["rest"]).into_iter().map(z_up).collect();
        assert_eq!(garment.rest, rest);
        let faces: Vec<_> = rows::<3>(&expected["faces"])
            .into_iter()
            .map(|f| f.map(|i| i as u32))
            .collect();
        assert_eq!(garment.faces, faces);
        assert_eq!(garment.panels, ["left", "right"]);
        for (face, panel) in expected["panel"].as_array().unwrap().iter().enumerate() {
            assert_eq!(
                u64::from(garment.panel_of_face[face]),
                panel.as_u64().unwrap()
            );
        }
        for (face, corners) in garment.uv_faces.iter().enumerate() {
            let panel = &garment.panels[garment.panel_of_face[face] as usize];
            for (corner, &uv) in corners.iter().enumerate() {
                let vertex = garment.faces[face][corner].to_string();
                let expected = &expected["groups"][panel][&vertex];
                let expected = [0, 1].map(|k| expected[k].as_f64().unwrap() as f32);
                assert_eq!(
                    garment.uv[uv as usize], expected,
                    "face {face}, vertex {vertex}"
                );
            }
        }
    }
    let close = |found: &[[f32; 3]], expected: Vec<[f64; 3]>, what: &str| {
        assert_eq!(found.len(), expected.len(), "{what}");
        for (a, b) in found.as_flattened().iter().zip(expected.as_flattened()) {
            assert!(
                (f64::from(*a) - b).abs() < 1e-5,
                "{what}: {a} instead of {b}"
            );
        }
    };
    let rest = rows::<3>(&expected["body_rest"]);
    close(
        &header.body.rest,
        rest.into_iter().map(|[x, y, z]| [x, -z, y]).collect(),
        "rest",
    );
    for (i, frame) in frames.iter().enumerate() {
        for (layer, positions) in frame.garments.iter().enumerate() {
            let expected: Vec<_> = rows::<3>(&expected["vertices"][layer][i])
                .into_iter()
                .map(|p| p.map(|x| x as f32))
                .collect();
            assert_eq!(*positions, expected, "garment {layer}, frame {i}");
        }
        close(&frame.body, rows(&expected["body"][i]), "body");
        let root = rows::<3>(&json!([expected["roots"][i]]))[0];
        assert_eq!(frame.root.translation, root.map(|x| x as f32));
        let turn = matrix_from_quaternion(frame.root.rotation.map(f64::from));
        for (a, b) in turn.iter().zip(rows::<3>(&expected["turns"][i])) {
            assert!(
                a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6),
                "{turn:?}"
            );
        }
        let [w, x, y, z, strength] = rows::<5>(&json!([expected["wind"][i]]))[0].map(|x| x as f32);
        assert_eq!(frame.wind.rotation, [w, x, y, z], "frame {i}");
        assert_eq!(frame.wind.strength, strength, "frame {i}");
        assert_eq!(frame.intersections, None);
    }
}

#[test]
fn every_protocol_and_every_program_that_wrote_it_reads_back_exactly() {
    if !python_is_there() {
        return;
    }
    let mut cases = Vec::new();
    for protocol in 0..=5 {
        cases.push(json!({"protocol": protocol}));
    }
    for protocol in [0, 1, 2] {
        cases.push(json!({"protocol": protocol, "writer": "python2", "models": "chumpy"}));
    }
    for protocol in [2, 3, 4] {
        cases.push(json!({"protocol": protocol, "writer": "numpy1", "models": "select"}));
    }
    cases.extend([
        json!({"style": "simulate", "motion": "array"}),
        json!({"style": "mixed", "motion": "joints"}),
        json!({"motion": "still", "seq_start": 0}),
        json!({"order": "F"}),
        json!({"order": "F", "protocol": 5}),
    ]);
    if cfg!(feature = "npz") {
        cases.push(json!({"models": "npz"}));
    }
    for mut options in cases {
        options["sequences"] = json!({"train": ["00007", "00396"]});
        eprintln!("{options}");
        let made = make(options);
        for name in ["00007", "00396"] {
            let (header, frames) = read(&made.root, true, name).unwrap();
            check(&header, &frames, &made.expected[name]);
        }
    }
}

/// Strings of hundreds of kilobytes, in UTF-8 too, across the ends of buffers.
#[test]
fn long_arrays_read_back_exactly_frame_by_frame() {
    if !python_is_there() {
        return;
    }
    for (protocol, writer) in [(2, "python3"), (2, "python2"), (5, "python3")] {
        let made = make(json!({
            "protocol": protocol, "writer": writer, "grid": 20, "frames": 60,
            "sequences": {"train": ["00100"]},
        }));
        let (header, frames) = read(&made.root, true, "00100").unwrap();
        check(&header, &frames, &made.expected["00100"]);
    }
}

#[test]
fn kinds_materials_scene_and_splits_are_the_published_ones_and_the_rest_is_said_to_be_derived() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({}));
    let source = DLayers::open(&made.root, None).unwrap();
    let splits: Vec<_> = source.sequences().collect();
    let expected = [
        ("00007", Split::Val),
        ("00100", Split::Test),
        ("00396", Split::Train),
        ("99999", Split::Test),
    ];
    assert_eq!(splits, expected);
    assert!(source.has("00007") && !source.has("99999"));

    let (header, _) = read(&made.root, true, "00396").unwrap();
    let kinds: Vec<_> = header.garments.iter().map(|g| g.kind).collect();
    assert_eq!(kinds, [GarmentKind::Jumpsuit, GarmentKind::JacketHood]);
    let [inner, outer] = [0, 1].map(|layer| header.garments[layer].material);
    assert_eq!(
        [inner.mass, inner.tension, inner.bending, inner.friction],
        [0.25, 40.0, 150.5, 60.0]
    );
    assert_eq!([inner.compression, inner.shear], [40.0, 40.0], "assumed");
    assert_eq!([outer.compression, outer.shear], [30.0, 20.0], "told");
    assert_eq!(
        [
            header.scene.scale,
            header.scene.fps,
            header.scene.body_friction
        ],
        [10.0, 30.0, 44.0]
    );
    assert!(header.scene.effects.contains(&Effect::Wind));
    let recipe: Value = serde_json::from_str(&header.scene.recipe).unwrap();
    assert_eq!(recipe["human"]["scale"], 10.0);
    // A square of 4 × 6 units (a little larger, for it is bent) fills 0.9² of the UV square.
    let side = (24.0f32 / 0.81).sqrt() / 10.0;
    assert!((1.0..1.5).contains(&(header.scene.metres_per_uv / side)));
    let warnings = header.scene.warnings.join("\n");
    for part in [
        "\"jumpsuit_sleeveless\": no compression_stiffness",
        "\"jumpsuit_sleeveless\": no shear_stiffness",
        "fps 30",
        "Y-up to Z-up",
        "root joint is",
        "0.04 UV",
    ] {
        assert!(warnings.contains(part), "{part:?} is not in: {warnings}");
    }
    assert!(!warnings.contains("\"jacket_hood\": no"), "{warnings}");
}

#[test]
fn without_a_model_the_garments_come_in_and_the_body_is_said_to_be_missing() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({}));
    let (with, frames_with) = read(&made.root, true, "00007").unwrap();
    let (header, frames) = read(&made.root, false, "00007").unwrap();
    assert_eq!(header.garments, with.garments);
    assert_eq!(header.body.vertex_count, 0);
    assert!(
        header
            .scene
            .warnings
            .iter()
            .any(|w| w.contains("the body is missing"))
    );
    for (frame, with) in frames.iter().zip(frames_with) {
        assert!(frame.body.is_empty() && !with.body.is_empty());
        assert_eq!((&frame.garments, frame.root), (&with.garments, with.root));
    }
    // A folder without the model that the sequence needs is an error, not a missing body.
    fs::remove_file(made.root.join("smpl/model/model_f.pkl")).unwrap();
    let message = read(&made.root, true, "00007").unwrap_err();
    assert!(
        message.contains("model_f.pkl") && message.contains("smpl.is.tue.mpg.de"),
        "{message}"
    );
}

/// In f64, without the rounding of sequence files: Python wrote pose and result.
#[test]
fn posed_bodies_follow_the_formula_to_rounding() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({"motion": "array"}));
    let meta: Value =
        serde_json::from_slice(&fs::read(made.root.join("data/00007/meta.json")).unwrap()).unwrap();
    let script = "import pickle,json,sys; m=pickle.load(open(sys.argv[1],'rb')); \
                  print(json.dumps([m['poses'].tolist(), m['trans'].tolist()]))";
    let motion = made
        .root
        .join(meta["human"]["motion_path"].as_str().unwrap());
    let output = Command::new("python3")
        .args(["-c", script])
        .arg(motion)
        .output()
        .unwrap();
    let motion: Value = serde_json::from_slice(&output.stdout).unwrap();

    let model = Arc::new(BodyModel::load(made.root.join("smpl/model/model_f.pkl")).unwrap());
    assert_eq!((model.joint_count(), model.vertex_count()), (24, 14));
    let betas: Vec<f64> = rows::<10>(&json!([meta["human"]["betas"]]))[0].to_vec();
    let body = model.shaped(&betas).unwrap();
    for frame in 0..6 {
        let pose = rows::<72>(&json!([motion[0][4 + frame]]))[0];
        let trans = rows::<3>(&json!([motion[1][4 + frame]]))[0];
        let found = body.posed(pose.as_chunks::<3>().0, trans).unwrap();
        let offset = body.root_offset();
        for (found, expected) in found
            .iter()
            .zip(rows::<3>(&made.expected["00007"]["body"][frame]))
        {
            for k in 0..3 {
                let found = 10.0 * (found[k] + offset[k]);
                assert!(
                    (found - expected[k]).abs() < 1e-11,
                    "{found} instead of {}",
                    expected[k]
                );
            }
        }
    }
    assert!(
        body.posed(&[[0.0; 3]; 23], [0.0; 3])
            .unwrap_err()
            .to_string()
            .contains("24 joints")
    );
    assert!(
        model
            .shaped(&[0.0; 11])
            .unwrap_err()
            .to_string()
            .contains("at most 10")
    );
}

#[test]
fn what_is_missing_or_wrong_is_named_with_its_file() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({"motion": "array"}));
    let folder = made.root.join("data/00007");
    let refused = |smpl: bool, parts: &[&str]| {
        let message = read(&made.root, smpl, "00007").unwrap_err();
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    };
    let meta_path = folder.join("meta.json");
    let sound: Value = serde_json::from_slice(&fs::read(&meta_path).unwrap()).unwrap();
    let with_meta = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        let mut meta = sound.clone();
        change(&mut meta);
        fs::write(&meta_path, meta.to_string()).unwrap();
        refused(true, parts);
        fs::write(&meta_path, sound.to_string()).unwrap();
    };
    with_meta(
        &|m| m["human"]["gender"] = json!("other"),
        &["meta.json", "human.gender", "\"other\""],
    );
    with_meta(
        &|m| m["human"]["motion_path"] = json!("../x.pkl"),
        &["human.motion_path", "root"],
    );
    with_meta(
        &|m| m["human"]["motion_path"] = json!("/x.pkl"),
        &["human.motion_path", "root"],
    );
    with_meta(
        &|m| m["human"]["seq_end"] = json!(4),
        &["human.seq_end", "after seq_start", "4"],
    );
    with_meta(
        &|m| m["human"]["seq_start"] = json!(-1),
        &["human.seq_start", "-1"],
    );
    with_meta(
        &|m| m["human"]["betas"] = json!(vec![0; 11]),
        &["betas", "at most 10", "11"],
    );
    with_meta(
        &|m| m["human"]["scale"] = json!(0),
        &["human.scale", "above 0"],
    );
    with_meta(
        &|m| drop(m["human"].as_object_mut().unwrap().remove("collision")),
        &["human.collision.friction", "nor under simulate"],
    );
    with_meta(
        &|m| m["garment"] = json!([]),
        &["meta.json", "at least one garment"],
    );
    with_meta(
        &|m| m["garment"][1]["name"] = json!("cape"),
        &["garment[1].name", "12", "\"cape\""],
    );
    with_meta(
        &|m| m["garment"][1]["name"] = json!("../tee"),
        &["garment[1].name", "../tee"],
    );
    with_meta(
        &|m| m["garment"][1]["name"] = json!("tee"),
        &["tee.pkl", "cannot open"],
    );
    with_meta(
        &|m| m["garment"][0]["cloth"] = json!({}),
        &["garment[0].cloth.tension_stiffness"],
    );
    let pivot = |key: &str, value: Value| {
        let key = key.to_owned();
        move |m: &mut Value| m["wind"][0]["pivot_list"][1][&key] = value.clone()
    };
    with_meta(
        &pivot("frame_start", json!(61)),
        &["pivot_list[1].frame_start", "before", "61"],
    );
    with_meta(
        &pivot("strength", json!(-1)),
        &["pivot_list[1].strength", "-1"],
    );
    with_meta(
        &pivot("rotation_quaternion", json!([1, 1, 0, 0])),
        &["pivot_list[1].rotation_quaternion", "unit"],
    );
    // The motion has frames 0 to 11 and the sequence needs 4 to 9.
    with_meta(
        &|m| (m["human"]["seq_start"], m["human"]["seq_end"]) = (json!(7), json!(13)),
        &["00007_poses.pkl", "poses of frame 5", "frame 12", "0 to 11"],
    );

    // Pickles that Python writes, with something wrong in them.
    let with_pickle = |file: &str, change: &str, smpl: bool, parts: &[&str]| {
        let path = made.root.join(file);
        let sound = fs::read(&path).unwrap();
        let script = format!(
            "import pickle, sys, os, collections, numpy as np\n\
             v = pickle.load(open(sys.argv[1], 'rb'))\n{change}\n\
             pickle.dump(v, open(sys.argv[1], 'wb'), 4)"
        );
        let output = Command::new("python3")
            .args(["-c", &script])
            .arg(&path)
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        refused(smpl, parts);
        fs::write(&path, sound).unwrap();
    };
    let garment = "data/00007/jacket_hood.pkl";
    let uv = "data/00007/uv_jacket_hood.pkl";
    let female = "smpl/model/model_f.pkl";
    with_pickle(
        garment,
        "v['faces'] = os.system",
        true,
        &["jacket_hood.pkl", "posix.system", "refused"],
    );
    with_pickle(
        garment,
        "v = collections.Counter()",
        true,
        &["collections.Counter", "refused"],
    );
    with_pickle(
        garment,
        "del v['tpose']",
        true,
        &["jacket_hood.pkl", "\"tpose\"", "\"vertices\""],
    );
    with_pickle(
        garment,
        "v['vertices'] = v['vertices'][:5]",
        true,
        &["jacket_hood", "6 frames", "5"],
    );
    with_pickle(
        garment,
        "v['vertices'] = v['vertices'][0]",
        true,
        &["[frames, vertices, 3]", "[9, 3]"],
    );
    with_pickle(
        garment,
        "v['vertices'][2, 4, 1] = np.nan",
        true,
        &["frame 2", "\"jacket_hood\"", "vertex 4"],
    );
    with_pickle(
        garment,
        "v['tpose'] = v['tpose'][:8]",
        true,
        &["tpose", "[9, 3]", "[8, 3]"],
    );
    with_pickle(
        garment,
        "v['faces'][0, 0] = 9",
        true,
        &["jacket_hood", "below 9", "index 9"],
    );
    with_pickle(
        garment,
        "v['faces'] = v['faces'] - 1",
        true,
        &["faces", "vertex numbers", "-1"],
    );
    with_pickle(
        garment,
        "v['faces'] = v['faces'].astype(str)",
        true,
        &["faces", "dtype U"],
    );
    with_pickle(
        garment,
        "v['faces'] = v['faces'].astype(object)",
        true,
        &["faces", "dtype O"],
    );
    with_pickle(
        uv,
        "v['left']['faces'] += [[0, 1, 8]]",
        true,
        &["uv_jacket_hood", "[0, 1, 8]"],
    );
    with_pickle(
        uv,
        "v['left']['faces'] += [[0, 1]]",
        true,
        &["uv_jacket_hood", "\"left\", faces", "one shape"],
    );
    with_pickle(
        uv,
        "v['left']['vertices'][0] = (0.5, 1.1)",
        true,
        &["\"left\", vertex 0", "[0, 1]", "1.1"],
    );
    with_pickle(
        uv,
        "del v['left']['vertices'][0]",
        true,
        &["face", "\"left\"", "without UV"],
    );
    with_pickle(uv, "del v['left']", true, &["UV of face 0", "none"]);
    let motion = sound["human"]["motion_path"].as_str().unwrap();
    with_pickle(
        motion,
        "v['trans'] = v['poses']",
        true,
        &["trans, frame 0", "72 numbers"],
    );
    with_pickle(
        motion,
        "v['poses'] = v['poses'][:, :69]",
        true,
        &["frame 0", "24 joints", "23"],
    );
    with_pickle(
        motion,
        "v['poses'][5, 3] = np.inf",
        true,
        &["poses, frame 5", "inf"],
    );
    with_pickle(
        female,
        "v['posedirs'] = v['posedirs'][..., :9]",
        true,
        &["model_f.pkl", "posedirs", "207"],
    );
    with_pickle(
        female,
        "v['kintree_table'][0, 3] = 3",
        true,
        &["kintree_table", "joint 3"],
    );
    with_pickle(
        female,
        "v['f'][0, 0] = 14",
        true,
        &["model_f.pkl", "\"f\"", "below 14"],
    );
    with_pickle(
        female,
        "v['weights'][0, 0] = np.nan",
        true,
        &["weights", "NaN"],
    );
    if python_has("scipy.sparse") {
        let change = "import scipy.sparse as s; v['J_regressor'] = s.csr_matrix(v['J_regressor'])";
        with_pickle(female, change, true, &["csr_matrix", "refused"]);
    }

    fs::write(folder.join("jacket_hood.pkl"), "version https://git-lfs").unwrap();
    refused(true, &["jacket_hood.pkl", "byte 1", "instruction 0x76"]);

    let splits = made.root.join("data/train_val_test.json");
    for (text, part) in [
        (
            r#"{"train": ["1"], "val": ["1"]}"#,
            "\"1\" in train and val",
        ),
        (r#"{"trian": []}"#, "trian"),
        (r#"{"train": ["../1"]}"#, "../1"),
        ("[]", "JSON"),
    ] {
        fs::write(&splits, text).unwrap();
        let message = DLayers::open(&made.root, None).err().unwrap().to_string();
        assert!(
            message.contains(part) && message.contains("train_val_test.json"),
            "{message}"
        );
    }
    let message = DLayers::open(made.root.join("data"), None)
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("holds data/ and human/"), "{message}");
}
