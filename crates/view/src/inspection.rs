//! What a sequence file holds, and whether it can be believed, as text.
//!
//! Reading already proves the checksums, shapes and finite numbers of every
//! frame; here each frame is read once and the rest is checked on top: bytes that
//! reading never uses, stored intersections against a recount on some frames,
//! sizes and speeds against what fits a person, rest meshes against defects.
//! Memory: two frames.

use std::fmt;

use drape_dataset::SequenceReader;
use drape_dataset::intersections::count_intersections;
use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};
use drape_geometry::mesh::defects;

/// Heights in metres that a person in any pose may take, arms up included.
const BODY_EXTENT_M: std::ops::RangeInclusive<f32> = 0.8..=2.8;
/// A garment vertex faster than this is an explosion: a kick reaches 20 m/s.
const FASTEST_M_S: f32 = 30.0;
/// Defects named for one garment.
const NAMED_DEFECTS: usize = 3;

/// Contents and checks of one file.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// Contents, line by line.
    pub contents: Vec<String>,
    /// Checks in the order they were made.
    pub checks: Vec<Check>,
}

/// One check and its outcome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// Outcome.
    pub outcome: Outcome,
    /// What was found.
    pub detail: String,
}

/// Outcome of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// As it should be.
    Ok,
    /// Worth knowing, not wrong.
    Note,
    /// Wrong.
    Failed,
}

impl Inspection {
    /// Reads a whole file; `recount` names the frames whose intersections are counted anew.
    pub fn of(reader: &SequenceReader, recount: &[usize]) -> Self {
        let header = reader.header();
        let mut survey = Survey::default();
        for index in 0..reader.frame_count() {
            match reader.frame(index) {
                Ok(frame) => survey.add(header, index, frame, recount.contains(&index)),
                Err(error) => survey.unreadable.push(error.to_string()),
            }
        }
        let mut checks = vec![every_byte(reader), survey.readable(reader.frame_count())];
        checks.push(rest_meshes(header));
        checks.push(survey.size(header));
        checks.push(survey.speed());
        checks.push(survey.stored_intersections());
        checks.push(survey.recounted_intersections());
        for warning in &header.scene.warnings {
            let detail = warning.clone();
            checks.push(Check {
                name: "stored warning",
                outcome: Outcome::Note,
                detail,
            });
        }
        Self {
            contents: contents(reader),
            checks,
        }
    }

    /// Whether no check failed.
    pub fn passed(&self) -> bool {
        self.checks
            .iter()
            .all(|check| check.outcome != Outcome::Failed)
    }
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.contents {
            writeln!(f, "{line}")?;
        }
        writeln!(f, "\nchecks")?;
        for check in &self.checks {
            let mark = match check.outcome {
                Outcome::Ok => "ok    ",
                Outcome::Note => "note  ",
                Outcome::Failed => "FAILED",
            };
            writeln!(f, "  {mark} {}: {}", check.name, check.detail)?;
        }
        Ok(())
    }
}

/// What is gathered while reading frames.
#[derive(Default)]
struct Survey {
    frames_read: usize,
    unreadable: Vec<String>,
    /// Largest extent of the body, of the garments without a body, in metres.
    extent_m: Option<(f32, f32)>,
    /// Fastest garment vertex: metres per second, frame, garment.
    fastest: Option<(f32, usize, String)>,
    previous: Option<(usize, Frame)>,
    stored: Vec<(usize, Intersections)>,
    recounted: Vec<(usize, Intersections, Option<Intersections>)>,
}

impl Survey {
    fn add(&mut self, header: &SequenceHeader, index: usize, frame: Frame, recount: bool) {
        self.frames_read += 1;
        let scale = header.scene.scale;
        let extent = if frame.body.is_empty() {
            extent(frame.garments.iter().flatten())
        } else {
            extent(frame.body.iter())
        } / scale;
        let (least, most) = self.extent_m.unwrap_or((extent, extent));
        self.extent_m = Some((least.min(extent), most.max(extent)));
        if let Some((before, previous)) = &self.previous
            && before + 1 == index
        {
            for (garment, (old, new)) in header
                .garments
                .iter()
                .zip(previous.garments.iter().zip(&frame.garments))
            {
                let speed = old
                    .iter()
                    .zip(new)
                    .map(|(a, b)| distance(a, b))
                    .fold(0.0, f32::max)
                    * header.scene.fps
                    / scale;
                if self
                    .fastest
                    .as_ref()
                    .is_none_or(|(fastest, ..)| speed > *fastest)
                {
                    self.fastest = Some((speed, index, garment.name.clone()));
                }
            }
        }
        if let Some(stored) = frame.intersections {
            self.stored.push((index, stored));
        }
        if recount {
            self.recounted.push((
                index,
                count_intersections(header, &frame),
                frame.intersections,
            ));
        }
        self.previous = Some((index, frame));
    }

    fn readable(&self, frame_count: usize) -> Check {
        let name = "checksums, shapes, finite numbers";
        match self.unreadable.first() {
            None => Check {
                name,
                outcome: Outcome::Ok,
                detail: format!("all {frame_count} frames"),
            },
            Some(first) => {
                let bad = self.unreadable.len();
                let detail =
                    format!("{bad} of {frame_count} frames cannot be read; first: {first}");
                Check {
                    name,
                    outcome: Outcome::Failed,
                    detail,
                }
            }
        }
    }

    fn size(&self, header: &SequenceHeader) -> Check {
        let name = "size";
        let Some((least, most)) = self.extent_m else {
            return Check {
                name,
                outcome: Outcome::Failed,
                detail: "no frame could be read".into(),
            };
        };
        let what = if header.body.vertex_count > 0 {
            "body"
        } else {
            "garments"
        };
        let measured = format!("the {what}'s longest side is {least:.2} to {most:.2} m");
        let scale = header.scene.scale;
        if BODY_EXTENT_M.contains(&most) {
            return Check {
                name,
                outcome: Outcome::Ok,
                detail: measured,
            };
        }
        let detail = format!(
            "{measured}; expected {} to {} m for a person: is the scale ({scale} units per metre) right?",
            BODY_EXTENT_M.start(),
            BODY_EXTENT_M.end()
        );
        Check {
            name,
            outcome: Outcome::Failed,
            detail,
        }
    }

    fn speed(&self) -> Check {
        let name = "speed";
        let Some((speed, frame, garment)) = &self.fastest else {
            let detail = "fewer than two frames in a row".into();
            return Check {
                name,
                outcome: Outcome::Note,
                detail,
            };
        };
        let measured = format!("fastest vertex {speed:.1} m/s ({garment}, frame {frame})");
        if *speed <= FASTEST_M_S {
            return Check {
                name,
                outcome: Outcome::Ok,
                detail: measured,
            };
        }
        let detail = format!("{measured}; above {FASTEST_M_S} m/s the garment has exploded");
        Check {
            name,
            outcome: Outcome::Failed,
            detail,
        }
    }

    fn stored_intersections(&self) -> Check {
        let name = "stored intersections";
        if self.stored.is_empty() {
            return Check {
                name,
                outcome: Outcome::Note,
                detail: "none were stored".into(),
            };
        }
        let series = |of: fn(&Intersections) -> u32| {
            let counts = || self.stored.iter().map(|(_, hits)| of(hits));
            let sum: u64 = counts().map(u64::from).sum();
            let (most, frame) = self
                .stored
                .iter()
                .map(|(frame, hits)| (of(hits), *frame))
                .max_by_key(|&(hits, frame)| (hits, std::cmp::Reverse(frame)))
                .unwrap_or_default();
            match most {
                0 => "0".to_string(),
                _ => format!(
                    "{:.1} a frame (most {most}, frame {frame}; {} frames clean)",
                    sum as f64 / self.stored.len() as f64,
                    counts().filter(|&hits| hits == 0).count()
                ),
            }
        };
        let detail = format!(
            "between garments {}, within {}, with the body {}",
            series(|hits| hits.between_garments),
            series(|hits| hits.within_garments),
            series(|hits| hits.with_body)
        );
        let clean = self
            .stored
            .iter()
            .all(|(_, hits)| *hits == Intersections::default());
        Check {
            name,
            outcome: if clean { Outcome::Ok } else { Outcome::Note },
            detail,
        }
    }

    fn recounted_intersections(&self) -> Check {
        let name = "recounted intersections";
        let mut frames = Vec::new();
        let mut outcome = Outcome::Ok;
        for (frame, found, stored) in &self.recounted {
            let text = |hits: &Intersections| {
                format!(
                    "{}/{}/{}",
                    hits.between_garments, hits.within_garments, hits.with_body
                )
            };
            match stored {
                Some(stored) if stored != found => {
                    outcome = Outcome::Failed;
                    frames.push(format!(
                        "frame {frame} {} but stored {}",
                        text(found),
                        text(stored)
                    ));
                }
                _ => frames.push(format!("frame {frame} {}", text(found))),
            }
        }
        let detail = format!("between/within/body: {}", frames.join(", "));
        Check {
            name,
            outcome,
            detail,
        }
    }
}

fn every_byte(reader: &SequenceReader) -> Check {
    let (outcome, detail) = match reader.check_bytes() {
        Ok(()) => (Outcome::Ok, "as it was written".into()),
        Err(error) => (Outcome::Failed, error.to_string()),
    };
    Check {
        name: "every byte",
        outcome,
        detail,
    }
}

fn rest_meshes(header: &SequenceHeader) -> Check {
    let name = "rest meshes";
    let mut found = Vec::new();
    for garment in &header.garments {
        for defect in defects(&garment.rest, &garment.faces, NAMED_DEFECTS) {
            found.push(format!("{}: {defect}", garment.name));
        }
    }
    if found.is_empty() {
        let detail = "no face without area, no edge of more than two faces".into();
        return Check {
            name,
            outcome: Outcome::Ok,
            detail,
        };
    }
    Check {
        name,
        outcome: Outcome::Note,
        detail: found.join("; "),
    }
}

fn contents(reader: &SequenceReader) -> Vec<String> {
    let header = reader.header();
    let scene = &header.scene;
    let frames = reader.frame_count();
    let names = |effects: Vec<&Effect>| {
        let names: Vec<String> = effects.iter().map(|effect| effect.to_string()).collect();
        if names.is_empty() {
            "none".to_string()
        } else {
            names.join(", ")
        }
    };
    let absent = Effect::ALL
        .iter()
        .filter(|effect| !scene.effects.contains(effect))
        .collect();
    let [gx, gy, gz] = scene.gravity;
    let mut lines = vec![
        format!("sequence  {}", header.name),
        format!("file      {}", reader.path().display()),
        format!(
            "frames    {frames} at {} per second ({:.2} s)",
            scene.fps,
            frames as f32 / scene.fps
        ),
        format!(
            "units     {} per metre; one UV unit is {} m",
            scene.scale, scene.metres_per_uv
        ),
        format!("storage   {}", reader.storage()),
        format!(
            "engine    {} {}, seed {}",
            scene.engine, scene.engine_version, scene.seed
        ),
        format!("effects   {}", names(scene.effects.iter().collect())),
        format!("absent    {}", names(absent)),
        format!(
            "gravity   ({gx}, {gy}, {gz}) units/s²; body friction {}",
            scene.body_friction
        ),
        format!(
            "body      {} vertices, {} faces",
            header.body.vertex_count,
            header.body.faces.len()
        ),
        String::new(),
        "garments, inner layer first".to_string(),
    ];
    for garment in &header.garments {
        let m = &garment.material;
        lines.push(format!(
            "  {} {} ({}): {} vertices, {} faces, {} panels ({})",
            garment.layer,
            garment.name,
            garment.kind,
            garment.rest.len(),
            garment.faces.len(),
            garment.panels.len(),
            garment.panels.join(", ")
        ));
        lines.push(format!(
            "    mass {}, tension {}, compression {}, shear {}, bending {}, friction {}",
            m.mass, m.tension, m.compression, m.shear, m.bending, m.friction
        ));
    }
    lines
}

/// Longest side of the bounding box.
fn extent<'a>(points: impl Iterator<Item = &'a [f32; 3]>) -> f32 {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points {
        low = std::array::from_fn(|axis| low[axis].min(point[axis]));
        high = std::array::from_fn(|axis| high[axis].max(point[axis]));
    }
    (0..3)
        .map(|axis| high[axis] - low[axis])
        .fold(0.0, f32::max)
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    drape_geometry::vector::distance2(*a, *b).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use drape_dataset::SequenceWriter;
    use drape_dataset::registry::GarmentKind;
    use drape_dataset::sequence::{BodyTopology, Garment, Material, SceneMeta};

    /// A pyramid of 1.7 m as body, and a sheet of cloth that floats or cuts through it.
    fn inspect(scale: f32, stored: Option<Intersections>, drop: f32) -> Inspection {
        let body = vec![[-5., -5., 0.], [5., -5., 0.], [0., 5., 0.], [0., 0., 17.]];
        let sheet: Vec<[f32; 3]> = vec![[-9., -9., 20.], [9., -9., 20.], [0., 9., 20.]];
        let material = Material {
            mass: 0.3,
            tension: 50.0,
            compression: 50.0,
            shear: 50.0,
            bending: 50.0,
            friction: 60.0,
        };
        let header = SequenceHeader {
            name: "pyramid".into(),
            scene: SceneMeta {
                scale,
                fps: 30.0,
                seed: 7,
                engine: "by hand".into(),
                engine_version: "1".into(),
                effects: vec![Effect::Gravity],
                gravity: [0.0, 0.0, -98.1],
                body_friction: 60.0,
                metres_per_uv: 2.0,
                recipe: String::new(),
                warnings: vec!["only a test".into()],
            },
            body: BodyTopology {
                rest: body.clone(),
                faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
                vertex_count: 4,
            },
            garments: vec![Garment {
                name: "sheet".into(),
                kind: GarmentKind::Skirt,
                layer: 0,
                rest: sheet.clone(),
                faces: vec![[0, 1, 2]],
                uv: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
                uv_faces: vec![[0, 1, 2]],
                panel_of_face: vec![0],
                panels: vec!["front".into()],
                material,
            }],
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pyramid.mcap");
        let mut writer = SequenceWriter::create(&path, &header).unwrap();
        for index in 0..2 {
            let moved = sheet
                .iter()
                .map(|p| [p[0], p[1], p[2] - drop * index as f32])
                .collect();
            let frame = Frame {
                body: body.clone(),
                garments: vec![moved],
                intersections: stored,
                ..Frame::default()
            };
            writer.push(&frame).unwrap();
        }
        writer.finish().unwrap();
        Inspection::of(&SequenceReader::open(&path).unwrap(), &[0, 1])
    }

    fn failed(inspection: &Inspection) -> Vec<&'static str> {
        let checks = inspection.checks.iter();
        checks
            .filter(|check| check.outcome == Outcome::Failed)
            .map(|check| check.name)
            .collect()
    }

    #[test]
    fn a_sound_file_passes_and_says_what_it_holds() {
        let inspection = inspect(10.0, Some(Intersections::default()), 1.0);
        assert!(inspection.passed(), "{inspection}");
        let text = inspection.to_string();
        for part in [
            "pyramid",
            "seed 7",
            "effects   gravity",
            "wind",
            "Skirt",
            "only a test",
        ] {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }

    #[test]
    fn each_lie_fails_its_own_check() {
        assert_eq!(failed(&inspect(1.0, None, 0.0)), ["size"]);
        assert_eq!(failed(&inspect(10.0, None, -20.0)), ["speed"]);
        // Dropped by 5 units, the sheet is cut by the three sides that meet at the tip.
        let cut = inspect(10.0, Some(Intersections::default()), 5.0);
        assert_eq!(failed(&cut), ["recounted intersections"]);
        assert!(
            cut.to_string().contains("frame 1 0/0/3 but stored 0/0/0"),
            "{cut}"
        );
    }
}
