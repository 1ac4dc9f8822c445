//! `meta.json`: body, garments and wind of a sequence, in both styles of keys.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::read_json;
use super::wind::{self, Pivot};
use crate::error::{DatasetError, Result};
use crate::sequence::Material;

/// A sequence's `meta.json`, checked.
pub(super) struct Meta {
    pub path: PathBuf,
    pub human: Human,
    /// Inner first.
    pub garments: Vec<GarmentMeta>,
    /// Ordered by frame.
    pub wind: Vec<Pivot>,
    /// All of it.
    pub json: Value,
    /// What was assumed.
    pub notes: Vec<String>,
}

pub(super) struct Human {
    pub sex: Sex,
    /// Below the data set's root.
    pub motion: PathBuf,
    /// First pose of the motion, and the one after the last.
    pub range: [u64; 2],
    pub betas: Vec<f64>,
    pub scale: f64,
    pub friction: f32,
}

/// Which body model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Sex {
    Female,
    Male,
}

pub(super) struct GarmentMeta {
    pub name: String,
    pub material: Material,
}

pub(super) fn read(folder: &Path) -> Result<Meta> {
    let path = folder.join("meta.json");
    let json: Value = serde_json::from_slice(&read_json(&path)?).map_err(|error| {
        DatasetError::invalid("content", "JSON", error.to_string()).in_file(&path)
    })?;
    let keys = Keys {
        json: &json,
        path: &path,
    };
    let mut notes = keys.contradictions();
    let human = human(&keys)?;
    let garments = garments(&keys, &mut notes)?;
    let wind = wind::pivots(&keys, &mut notes)?;
    Ok(Meta {
        human,
        garments,
        wind,
        notes,
        path: path.clone(),
        json,
    })
}

/// Lookup at the top, then under `simulate`.
pub(super) struct Keys<'a> {
    json: &'a Value,
    path: &'a Path,
}

/// Where the keys are in both styles.
const STYLES: [&str; 2] = ["", "/simulate"];

impl<'a> Keys<'a> {
    /// The value at a JSON pointer such as `/human/scale`.
    pub fn find(&self, pointer: &str) -> Option<&'a Value> {
        STYLES
            .iter()
            .find_map(|style| self.json.pointer(&format!("{style}{pointer}")))
            .filter(|value| !value.is_null())
    }

    pub fn value<T>(
        &self,
        pointer: &str,
        expected: &str,
        convert: impl Fn(&'a Value) -> Option<T>,
    ) -> Result<T> {
        let value = self.find(pointer);
        value.and_then(convert).ok_or_else(|| {
            let found = value.map_or("no such key, nor under simulate".into(), short);
            self.invalid(pointer, expected, found)
        })
    }

    fn number(&self, pointer: &str) -> Result<f64> {
        self.value(pointer, "a number", finite)
    }

    /// Error about a key.
    pub fn invalid(&self, pointer: &str, expected: &str, found: String) -> DatasetError {
        let place = pointer.trim_start_matches('/').replace('/', ".");
        DatasetError::invalid(place, expected, found).in_file(self.path)
    }

    /// Keys that are in both places and differ.
    fn contradictions(&self) -> Vec<String> {
        let used = [
            "/human/gender",
            "/human/motion_path",
            "/human/seq_start",
            "/human/seq_end",
            "/human/frame_start",
            "/human/betas",
            "/human/scale",
            "/human/collision/friction",
            "/garment",
            "/wind",
        ];
        let of = |pointer: &str| STYLES.map(|s| self.json.pointer(&format!("{s}{pointer}")));
        used.iter()
            .filter(|pointer| matches!(of(pointer), [Some(a), Some(b)] if a != b && !a.is_null()))
            .map(|pointer| {
                let key = pointer[1..].replace('/', ".");
                format!("meta.json has {key} and another simulate.{key}: the first is taken")
            })
            .collect()
    }
}

fn human(keys: &Keys<'_>) -> Result<Human> {
    let sex = keys.value("/human/gender", "\"female\" or \"male\"", |v| {
        match v.as_str()? {
            "female" => Some(Sex::Female),
            "male" => Some(Sex::Male),
            _ => None,
        }
    })?;
    let motion = keys.value(
        "/human/motion_path",
        "a path below the data set's root",
        |v| {
            let path = Path::new(v.as_str()?);
            let inside = |part| matches!(part, std::path::Component::Normal(_));
            (path.components().count() > 0 && path.components().all(inside)).then(|| path.into())
        },
    )?;
    let frame = |key: &str| {
        keys.value(key, "a frame number from 0", |v| {
            u64::try_from(whole(v)?).ok()
        })
    };
    let range = [frame("/human/seq_start")?, frame("/human/seq_end")?];
    if range[0] >= range[1] {
        let expected = format!("a frame after seq_start, which is {}", range[0]);
        return Err(keys.invalid("/human/seq_end", &expected, range[1].to_string()));
    }
    let betas = keys.value("/human/betas", "a list of numbers", |v| {
        v.as_array()?.iter().map(finite).collect()
    })?;
    let scale = keys.value("/human/scale", "a number above 0", |v| {
        finite(v).filter(|x| *x > 0.0)
    })?;
    let friction = keys.number("/human/collision/friction")? as f32;
    Ok(Human {
        sex,
        motion,
        range,
        betas,
        scale,
        friction,
    })
}

fn garments(keys: &Keys<'_>, notes: &mut Vec<String>) -> Result<Vec<GarmentMeta>> {
    let list = keys.value(
        "/garment",
        "a list of garments, inner first",
        Value::as_array,
    )?;
    let mut garments: Vec<GarmentMeta> = Vec::new();
    for (i, garment) in list.iter().enumerate() {
        let name = garment["name"].as_str().unwrap_or_default();
        // The name is also the name of the garment's file.
        if Path::new(name).file_name() != Some(name.as_ref()) {
            let place = format!("/garment[{i}]/name");
            return Err(keys.invalid(&place, "a garment's name", short(&garment["name"])));
        }
        let optional = |key: &str| match &garment["cloth"][key] {
            Value::Null => Ok(None),
            value => match finite(value) {
                Some(number) => Ok(Some(number as f32)),
                None => {
                    let place = format!("/garment[{i}]/cloth/{key}");
                    Err(keys.invalid(&place, "a number", short(value)))
                }
            },
        };
        let required = |key: &str| {
            optional(key)?.ok_or_else(|| {
                let place = format!("/garment[{i}]/cloth/{key}");
                keys.invalid(&place, "a number", "no such key".into())
            })
        };
        let tension = required("tension_stiffness")?;
        let mut or_tension = |key: &str| {
            Ok::<_, DatasetError>(match optional(key)? {
                Some(value) => value,
                None => {
                    notes.push(format!(
                        "garment {name:?}: no {key} in meta.json, the tension stiffness is taken"
                    ));
                    tension
                }
            })
        };
        let material = Material {
            mass: required("mass")?,
            tension,
            compression: or_tension("compression_stiffness")?,
            shear: or_tension("shear_stiffness")?,
            bending: required("bending_stiffness")?,
            friction: required("self_friction")?,
        };
        garments.push(GarmentMeta {
            name: name.to_owned(),
            material,
        });
    }
    Ok(garments)
}

pub(super) fn finite(value: &Value) -> Option<f64> {
    // f32 is what it becomes.
    value.as_f64().filter(|x| (*x as f32).is_finite())
}

/// A whole number, which Python may write as 60.0.
pub(super) fn whole(value: &Value) -> Option<i64> {
    value.as_i64().or_else(|| {
        value
            .as_f64()
            .filter(|x| x.fract() == 0.0 && x.abs() < 1e15)
            .map(|x| x as i64)
    })
}

/// A value for a message.
pub(super) fn short(value: &Value) -> String {
    let mut text = value.to_string();
    if text.chars().count() > 60 {
        text = text.chars().take(60).chain(['…']).collect();
    }
    text
}
