//! Canonical JSON of a sequence file: the schema's field names, tables of numbers as
//! nested lists, and numbers as the shortest decimals that read back as the same f32.
//! A file that must be refused is `{"error": CLASS}`.

use drape_dataset::sequence::{BodyTopology, Frame, Garment, SceneMeta, SequenceHeader};
use serde_json::{Value, json};

/// A sequence as JSON.
pub fn sequence(header: &SequenceHeader, frames: &[Frame]) -> Value {
    json!({
        "header": {
            "name": header.name,
            "scene": scene(&header.scene),
            "body": body(&header.body),
            "garments": header.garments.iter().map(garment).collect::<Vec<_>>(),
        },
        "frames": frames.iter().map(frame).collect::<Vec<_>>(),
    })
}

/// Pretty text: what fits into a line stands in one.
pub fn text(value: &Value) -> String {
    let mut text = String::new();
    layout(value, 0, &mut text);
    text + "\n"
}

fn layout(value: &Value, depth: usize, text: &mut String) {
    let line = value.to_string();
    let children: Vec<(String, &Value)> = match value {
        _ if line.len() <= 90 => return text.push_str(&line),
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by_key(|(key, _)| *key);
            let named = |(key, value)| (format!("{}: ", Value::from(key as &str)), value);
            entries.into_iter().map(|(k, v)| named((k, v))).collect()
        }
        Value::Array(items) => items.iter().map(|item| (String::new(), item)).collect(),
        _ => return text.push_str(&line),
    };
    let (open, close) = if value.is_object() {
        ('{', '}')
    } else {
        ('[', ']')
    };
    text.push(open);
    for (at, (key, child)) in children.into_iter().enumerate() {
        text.push_str(if at == 0 { "\n" } else { ",\n" });
        text.push_str(&"  ".repeat(depth + 1));
        text.push_str(&key);
        layout(child, depth + 1, text);
    }
    text.push('\n');
    text.push_str(&"  ".repeat(depth));
    text.push(close);
}

fn scene(scene: &SceneMeta) -> Value {
    json!({
        "scale": number(scene.scale),
        "fps": number(scene.fps),
        "seed": scene.seed,
        "engine": scene.engine,
        "engine_version": scene.engine_version,
        "effects": scene.effects.iter().map(|effect| effect.name()).collect::<Vec<_>>(),
        "gravity": numbers(&scene.gravity),
        "body_friction": number(scene.body_friction),
        "metres_per_uv": number(scene.metres_per_uv),
        "recipe": scene.recipe,
        "warnings": scene.warnings,
    })
}

fn body(body: &BodyTopology) -> Value {
    json!({
        "vertex_count": body.vertex_count,
        "rest": rows(&body.rest),
        "faces": body.faces,
    })
}

fn garment(garment: &Garment) -> Value {
    let m = &garment.material;
    json!({
        "name": garment.name,
        "kind": garment.kind.name(),
        "layer": garment.layer,
        "rest": rows(&garment.rest),
        "faces": garment.faces,
        "uv": rows(&garment.uv),
        "uv_faces": garment.uv_faces,
        "panel_of_face": garment.panel_of_face,
        "panels": garment.panels,
        "material": {
            "mass": number(m.mass),
            "tension": number(m.tension),
            "compression": number(m.compression),
            "shear": number(m.shear),
            "bending": number(m.bending),
            "friction": number(m.friction),
        },
    })
}

fn frame(frame: &Frame) -> Value {
    json!({
        "body": rows(&frame.body),
        "root": {
            "translation": numbers(&frame.root.translation),
            "rotation": numbers(&frame.root.rotation),
        },
        "garments": frame.garments.iter().map(|positions| rows(positions)).collect::<Vec<_>>(),
        "wind": {
            "rotation": numbers(&frame.wind.rotation),
            "strength": number(frame.wind.strength),
        },
        "intersections": frame.intersections.map(|count| json!({
            "between_garments": count.between_garments,
            "within_garments": count.within_garments,
            "with_body": count.with_body,
        })),
    })
}

fn rows<const N: usize>(rows: &[[f32; N]]) -> Value {
    rows.iter().map(|row| numbers(row)).collect()
}

fn numbers(values: &[f32]) -> Value {
    values.iter().map(|&value| number(value)).collect()
}

/// The f64 that prints like the f32, so that 0.1 is not 0.10000000149011612.
fn number(value: f32) -> Value {
    let decimal: f64 = value.to_string().parse().expect("a decimal");
    decimal.into()
}
