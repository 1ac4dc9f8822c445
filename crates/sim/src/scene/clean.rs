//! Only clean frames are kept: Blender gives no promise that surfaces stay apart.

use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};

use crate::error::{Result, SimError};

/// Share of the frames that must be clean from the first on.
const NEEDED: f64 = 0.9;

/// Cuts a sequence off before its first intersection, and says so in its header.
///
/// # Errors
/// [`SimError::NotClean`] if less than nine tenths would be left.
pub(super) fn keep_clean(header: &mut SequenceHeader, frames: &mut Vec<Frame>) -> Result<()> {
    let hits = |frame: &Frame| frame.intersections.unwrap_or_default();
    let dirty = |frame: &Frame| hits(frame) != Intersections::default();
    let Some(first) = frames.iter().position(dirty) else {
        return Ok(());
    };
    let of = frames.len();
    let found = hits(&frames[first]);
    let needed = (NEEDED * of as f64).ceil() as usize;
    if first < needed {
        return Err(SimError::NotClean {
            frame: first,
            found,
            of,
            needed,
        });
    }
    frames.truncate(first);
    header.scene.warnings.push(format!(
        "cut before the first intersection: {first} of {of} frames are kept"
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use drape_dataset::sequence::{BodyTopology, SceneMeta};

    use super::*;

    fn header() -> SequenceHeader {
        SequenceHeader {
            name: "x".into(),
            scene: SceneMeta {
                scale: 10.0,
                fps: 30.0,
                seed: 0,
                engine: String::new(),
                engine_version: String::new(),
                effects: Vec::new(),
                gravity: [0.0; 3],
                body_friction: 0.0,
                metres_per_uv: 1.0,
                recipe: String::new(),
                warnings: Vec::new(),
            },
            body: BodyTopology {
                rest: Vec::new(),
                faces: Vec::new(),
                vertex_count: 0,
            },
            garments: Vec::new(),
        }
    }

    /// Frames of which the ones listed have one hit, each of another sort.
    fn frames(count: usize, dirty: &[usize]) -> Vec<Frame> {
        let hit = |k: usize| {
            let mut hits = Intersections::default();
            match k % 3 {
                0 => hits.between_garments = 1,
                1 => hits.within_garments = 1,
                _ => hits.with_body = 1,
            }
            hits
        };
        (0..count)
            .map(|k| Frame {
                intersections: Some(if dirty.contains(&k) {
                    hit(k)
                } else {
                    Intersections::default()
                }),
                ..Frame::default()
            })
            .collect()
    }

    #[test]
    fn clean_sequences_stay_whole_and_others_end_before_the_first_hit() {
        for (dirty, left) in [(vec![], 20), (vec![19], 19), (vec![18, 19], 18)] {
            let (mut header, mut frames) = (header(), frames(20, &dirty));
            keep_clean(&mut header, &mut frames).unwrap();
            assert_eq!(frames.len(), left);
            assert_eq!(header.scene.warnings.len(), usize::from(left < 20));
        }
    }

    #[test]
    fn less_than_nine_tenths_is_refused_with_frame_and_counts() {
        for dirty in [17, 0] {
            let error = keep_clean(&mut header(), &mut frames(20, &[dirty])).unwrap_err();
            let message = error.to_string();
            assert!(message.contains(&format!("frame {dirty}:")), "{message}");
            assert!(message.contains("18 of 20"), "{message}");
        }
    }
}
