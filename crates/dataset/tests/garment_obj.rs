//! Garments from OBJ: what is read is what stands there, and what is not a
//! garment is refused with its line.

use std::fs;

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
            "flat part of a quad",
            "f 1/1 2/2 4/3 3/3\n",
            &["triangle with an area"],
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
        (
            "inwards",
            "v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nvt 0 0\nf 2/1 3/1 4/1 1/1\n",
            &["line 6", "points inwards", "by hand"],
        ),
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
    // A mark of the text's encoding is no statement.
    let square = format!("{mesh}v 1 0 0\nf 1/1 3/3 5/2\n");
    let loose = GarmentMesh::parse(&square).unwrap_err().to_string();
    let marked = GarmentMesh::parse(&format!("\u{feff}{square}"));
    assert_eq!(marked.unwrap_err().to_string(), loose);
    // Nor do names in an old encoding matter; in a statement they do.
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("old.obj");
    let sound = format!("{mesh}f 1/1 3/3 2/2\nf 1/1 3/3 4/2\n");
    fs::write(&path, [b"# gr\xfc\xdfe\n", sound.as_bytes()].concat()).unwrap();
    assert_eq!(GarmentMesh::read(&path).unwrap().faces.len(), 2);
    fs::write(&path, [sound.as_bytes(), b"f 1/1 3/3 \xfc/2\n"].concat()).unwrap();
    let message = GarmentMesh::read(&path).unwrap_err().to_string();
    assert!(message.contains("line 10"), "{message}");
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

/// A garment-sized cylinder of n quads around the axis of `up`, `height` above the
/// ground, with its seam closed or with a second row of vertices on it.
fn tube(n: usize, up: usize, height: f32, size: f32, welded: bool) -> String {
    let mut text = String::new();
    let columns = if welded { n } else { n + 1 };
    for column in 0..columns {
        let (sin, cos) = ((column % n) as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
        for level in [0.0, 1.0] {
            // Z up, then the axis turned: Y up is (x, y, z) to (x, z, -y).
            let [x, y, z] = [cos, sin, height + level].map(|x| 3.0 * size * x);
            let [x, y, z] = if up == 1 { [x, z, -y] } else { [x, y, z] };
            text += &format!("v {x} {y} {z}\n");
        }
    }
    text += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
    for column in 0..n {
        let next = (column + 1) % columns;
        let [a, b, c, d] = [2 * column + 1, 2 * next + 1, 2 * next + 2, 2 * column + 2];
        text += &format!("f {a}/1 {b}/2 {c}/3 {d}/4\n");
    }
    text
}

fn notes(text: &str) -> Vec<String> {
    GarmentMesh::parse(text).unwrap().notes
}

#[test]
fn a_polygon_is_cut_into_a_fan_of_the_same_area_and_told_with_its_line() {
    let hexagon = |skip: &str| {
        let mut text = String::from("vt 0 0\nvt 1 0\nvt 0 1\n");
        for corner in 0..6 {
            let (sin, cos) = (f64::from(corner) * std::f64::consts::PI / 3.0).sin_cos();
            text += &format!("v {} {} 0\n", 5.0 * cos, 5.0 * sin);
        }
        text + "f 1/1 2/2 3/3 4/1 5/2 6/3" + skip
    };
    let mesh = GarmentMesh::parse(&hexagon("\n")).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]);
    assert_eq!(mesh.uv_faces, [[0, 1, 2], [0, 2, 0], [0, 0, 1], [0, 1, 2]]);
    let area = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|i| mesh.rest[i as usize].map(f64::from));
        ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2.0
    };
    let whole: f64 = mesh.faces.iter().map(area).sum();
    assert!((whole - 1.5 * 3f64.sqrt() * 25.0).abs() < 1e-4, "{whole}");
    assert!(mesh.notes[0].contains("line 10") && mesh.notes[0].contains("6 corners"));
    // A comment is no corner.
    assert_eq!(GarmentMesh::parse(&hexagon(" # six\n")).unwrap(), mesh);
}

#[test]
fn a_sound_tube_gets_no_note_but_the_one_on_its_polygons() {
    let found = notes(&tube(12, 2, 2.0, 1.0, true));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("12 such faces"), "{found:?}");
}

#[test]
fn faces_without_area_in_the_uv_map_are_named() {
    let text = |last: &str| {
        format!(
            "v 0 0 0\nv 10 0 0\nv 10 0 10\nv 0 0 10\nvt 0 0\nvt 0.5 0.5\nvt 0 1\nvt {last}\n\
             f 1/1 2/2 3/3\nf 1/1 3/2 4/4\n"
        )
    };
    // On a line, in one point, and beside both.
    for (last, flat) in [("1 1", true), ("0.5 0.5", true), ("1 0.99", false)] {
        let found = notes(&text(last)).join("\n");
        let told = found.contains("line 10: a face without area in the UV map (1 such");
        assert_eq!(told, flat, "{last}: {found}");
    }
}

#[test]
fn unwelded_seams_pieces_and_bad_edges_are_named() {
    let found = notes(&tube(12, 2, 2.0, 1.0, false)).join("\n");
    assert!(
        found.contains("vertices 0 and 24 lie in one place (2 such"),
        "{found}"
    );
    assert!(!found.contains("pieces"), "{found}");

    // A second tube above.
    let vertices = tube(12, 2, 2.0, 1.0, true);
    let (places, faces) = vertices.split_at(vertices.find("vt").unwrap());
    let above = tube(12, 2, 2.5, 1.0, true);
    let above = &above[..above.find("vt").unwrap()];
    // The same faces again, on the vertices above: every index 24 higher.
    let mut shifted = String::new();
    for line in faces.lines().filter(|line| line.starts_with('f')) {
        shifted += "f";
        for word in line[2..].split(' ') {
            let (vertex, uv) = word.split_once('/').unwrap();
            shifted += &format!(" {}/{uv}", vertex.parse::<usize>().unwrap() + 24);
        }
        shifted += "\n";
    }
    let two = format!("{places}{faces}{above}{shifted}");
    let found = notes(&two).join("\n");
    assert!(
        found.contains("2 pieces") && found.contains("(24, 24 vertices)"),
        "{found}"
    );

    // Three faces on one edge, and a neighbour that faces the other way.
    let fan = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nv 0 -9 0\nvt 0 0\n";
    let found = notes(&format!(
        "{fan}f 1/1 2/1 3/1\nf 2/1 1/1 4/1\nf 1/1 2/1 5/1\n"
    ))
    .join("\n");
    assert!(
        found.contains("lines 7, 8, 9") && found.contains("[0, 1]"),
        "{found}"
    );
    let turned = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 -9 0\nvt 0 0\nvt 1 0\nvt 0 1\n\
                  f 1/1 2/2 3/3\nf 1/1 2/2 4/3\n";
    let found = notes(turned).join("\n");
    assert!(
        found.contains("lines 8 and 9") && found.contains("opposite ways"),
        "{found}"
    );
    let sound = turned.replace("f 1/1 2/2 4/3", "f 2/2 1/1 4/3");
    assert!(notes(&sound).is_empty(), "{:?}", notes(&sound));
}

#[test]
fn another_unit_and_y_up_are_guessed_and_the_guess_says_what_to_do() {
    for (size, expected) in [
        (
            0.1,
            "metres; scenes have 10 units to a metre by default, so multiply by 10",
        ),
        (
            10.0,
            "centimetres; scenes have 10 units to a metre by default, so multiply by 0.1",
        ),
        (
            100.0,
            "millimetres; scenes have 10 units to a metre by default, so multiply by 0.01",
        ),
        (1e4, "is that size"),
    ] {
        let found = notes(&tube(12, 2, 2.0, size, true)).join("\n");
        assert!(found.contains(expected), "{size}: {found}");
    }
    for (height, told) in [(2.0, true), (-0.5, false)] {
        let found = notes(&tube(12, 1, height, 1.0, true)).join("\n");
        assert_eq!(found.contains("as if Y were up"), told, "{height}: {found}");
        // Undone as the note says, it hangs around Z.
        let found = notes(&tube(12, 2, height, 1.0, true)).join("\n");
        assert!(!found.contains("Y were up"), "{found}");
    }
}
