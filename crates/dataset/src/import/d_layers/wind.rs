//! Wind of a sequence: pivots, each of which holds until the next.

use serde_json::Value;

use super::meta::{Keys, finite, short, whole};
use crate::check::UNIT_TOLERANCE;
use crate::error::Result;
use crate::sequence::Wind;

/// Wind from a frame on.
pub(super) struct Pivot {
    /// Frame of the sequence; before 0 for wind that blows at its beginning.
    pub frame: i64,
    pub wind: Wind,
}

/// The pivots of `meta.json`, ordered by frame.
pub(super) fn pivots(keys: &Keys<'_>, notes: &mut Vec<String>) -> Result<Vec<Pivot>> {
    let Some(winds) = keys.find("/wind") else {
        return Ok(Vec::new());
    };
    let Some(winds) = winds.as_array() else {
        return Err(keys.invalid("/wind", "a list", short(winds)));
    };
    let Some(first) = winds.first() else {
        return Ok(Vec::new());
    };
    if winds.len() > 1 {
        notes.push(format!(
            "meta.json has {} winds: the first is taken, as the published reader does",
            winds.len()
        ));
    }
    let Some(list) = first["pivot_list"].as_array() else {
        return Err(keys.invalid("/wind[0]/pivot_list", "a list", short(&first["pivot_list"])));
    };
    let mut pivots: Vec<Pivot> = Vec::new();
    for (i, pivot) in list.iter().enumerate() {
        let start = keys.value("/human/frame_start", "a frame number", whole)?;
        let invalid = |key: &str, expected: &str| {
            let place = format!("/wind[0]/pivot_list[{i}]/{key}");
            keys.invalid(&place, expected, short(&pivot[key]))
        };
        let frame = whole(&pivot["frame_start"])
            .and_then(|frame| frame.checked_sub(start))
            .filter(|frame| pivots.last().is_none_or(|last| last.frame <= *frame))
            .ok_or_else(|| invalid("frame_start", "a frame number, not before the last pivot's"))?;
        // One number, or a list of one.
        let strength = match &pivot["strength"] {
            Value::Array(list) if list.len() == 1 => finite(&list[0]),
            value => finite(value),
        };
        let strength = strength
            .filter(|strength| *strength >= 0.0)
            .ok_or_else(|| invalid("strength", "a number of at least 0"))?;
        let rotation = pivot["rotation_quaternion"]
            .as_array()
            .and_then(|list| list.iter().map(finite).collect::<Option<Vec<_>>>())
            .and_then(|list| <[f64; 4]>::try_from(list).ok())
            .filter(|q| {
                let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
                let calm = strength == 0.0 && *q == [0.0; 4];
                calm || (length - 1.0).abs() <= f64::from(UNIT_TOLERANCE)
            })
            .ok_or_else(|| invalid("rotation_quaternion", "a unit quaternion [w, x, y, z]"))?;
        pivots.push(Pivot {
            frame,
            wind: Wind {
                rotation: rotation.map(|x| x as f32),
                strength: strength as f32,
            },
        });
    }
    Ok(pivots)
}

/// The last wind that has started by frame `index`; none before the first.
pub(super) fn wind_at(pivots: &[Pivot], index: usize) -> Wind {
    let started = pivots.partition_point(|pivot| pivot.frame <= index as i64);
    match started.checked_sub(1) {
        Some(last) => pivots[last].wind,
        None => Wind::default(),
    }
}
