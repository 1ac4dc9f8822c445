//! Garments from OBJ: what is read is what stands there, and what is not a
//! garment is refused with its line.

use drape_dataset::obj::{GarmentMesh, write_garment};
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::Material;
use tempfile::TempDir;

/// Two panels that share the edge 2–3 in space but not in UV.
const SOUND: &str = "\
# two panels
o shirt
v 0 0 0
v 1 0 0.1
v 1 1 0
v 0 1 0
vn 0 0 1
vt 0 0
vt 0.4 0
vt 0.4 0.4
vt 0.6 0.6
vt 1 1
vt 0.6 1
g front
f 4/1/1 2/2/1 3/3/1
g back
f -4/-3 -3/-2/1 -1/-1
";

const MATERIAL: Material = Material {
    mass: 0.3,
    tension: 20.0,
    compression: 20.0,
    shear: 20.0,
    bending: 20.0,
    friction: 50.0,
};

#[test]
fn order_of_vertices_is_the_files_and_uv_islands_are_panels() {
    let mesh = GarmentMesh::parse(SOUND).unwrap();
    assert_eq!(mesh.rest[1], [1.0, 0.0, 0.1]);
    assert_eq!(mesh.faces, [[3, 1, 2], [0, 1, 3]]);
    assert_eq!(mesh.uv_faces, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!((mesh.panel_of_face, mesh.panel_count), (vec![0, 1], 2));
}

#[test]
fn a_written_garment_reads_back_bit_for_bit() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("shirt.obj");
    let mut garment =
        GarmentMesh::parse(SOUND)
            .unwrap()
            .into_garment("shirt", GarmentKind::TShirt, 0, MATERIAL);
    garment.rest[2] = [1.0 / 3.0, 1e-30, -12345.678];
    garment.check().unwrap();
    write_garment(&path, &garment, &garment.rest).unwrap();
    let read =
        GarmentMesh::read(&path)
            .unwrap()
            .into_garment("shirt", GarmentKind::TShirt, 0, MATERIAL);
    assert_eq!(read, garment);
    let message = write_garment(&path, &garment, &[[0.0; 3]])
        .unwrap_err()
        .to_string();
    assert!(message.contains("expected 4, found 1"), "{message}");
}

#[test]
fn what_is_no_garment_is_refused_with_its_line() {
    let cases: &[(&str, &str, &[&str])] = &[
        ("NaN", "v 0 0 NaN\n", &["line 1", "vertex", "finite", "NaN"]),
        ("infinite", "v 0 inf 0\n", &["line 1", "inf"]),
        ("overflow", "v 0 1e39 0\n", &["line 1", "1e39"]),
        ("word", "v 0 x 0\n", &["line 1", "\"x\""]),
        ("short vertex", "v 0 1\n", &["line 1", "end of the line"]),
        ("NaN UV", "vt nan 0\n", &["line 1", "UV"]),
        (
            "UV range",
            "f 1/1 2/2 3/3\nvt 0 1.25\n",
            &["line 9", "[0, 1]", "1.25"],
        ),
        (
            "quad",
            "f 1/1 2/2 3/3 4/1\n",
            &["three corners", "found 4", "triangulate"],
        ),
        ("line face", "f 1/1 2/2\n", &["three corners", "found 2"]),
        ("no UV", "f 1 2 3\n", &["position/UV", "unwrap"]),
        ("no UV, normals", "f 1//1 2//1 3//1\n", &["position/UV"]),
        ("mixed", "f 1/1 2/2 3\n", &["position/UV", "\"3\""]),
        (
            "range",
            "f 1/1 2/2 9/3\n",
            &["vertex index from 1 to 4", "\"9\""],
        ),
        (
            "UV range",
            "f 1/1 2/2 3/7\n",
            &["UV index from 1 to 3", "\"7\""],
        ),
        ("zero index", "f 0/1 2/2 3/3\n", &["\"0\""]),
        ("negative", "f -5/1 2/2 3/3\n", &["\"-5\""]),
        (
            "huge",
            "f 99999999999999999999/1 2/2 3/3\n",
            &["vertex index"],
        ),
        ("repeated", "f 1/1 2/2 2/3\n", &["triangle with an area"]),
        (
            "collinear",
            "f 1/1 2/2 4/3\n",
            &["triangle with an area", "face 0"],
        ),
        ("line", "l 1 2\n", &["\"l\""]),
        (
            "loose vertex",
            "f 1/1 2/2 3/3\n",
            &["line 4", "vertex 3", "at least one face"],
        ),
        ("no faces", "", &["at least one triangle"]),
    ];
    // Vertices 0, 1, 3 lie on a line.
    let mesh = "v 0 0 0\nv 1 1 1\nv 0 1 0\nv 3 3 3\nvt 0 0\nvt 1 0\nvt 0 1\n";
    for (name, text, parts) in cases {
        let text = if text.starts_with('f') {
            format!("{mesh}{text}")
        } else {
            (*text).into()
        };
        let message = GarmentMesh::parse(&text).expect_err(name).to_string();
        for part in *parts {
            assert!(
                message.contains(part),
                "{name}: {part:?} is not in: {message}"
            );
        }
        if text.starts_with(mesh) && !parts[0].contains("line") {
            assert!(message.contains("line 8"), "{name}: {message}");
        }
    }
    let message = GarmentMesh::read("no/such.obj").unwrap_err().to_string();
    assert!(message.contains("no/such.obj"), "{message}");
}

#[test]
fn a_thin_triangle_is_a_triangle_and_a_thinner_one_is_not() {
    let with_height = |height: f64| {
        let text =
            format!("v 0 0 0\nv 1 0 0\nv 0.5 {height} 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n");
        GarmentMesh::parse(&text).is_ok()
    };
    assert!(with_height(2e-6), "above the threshold");
    assert!(!with_height(5e-7), "below it");
    assert!(!with_height(0.0), "flat");
}
