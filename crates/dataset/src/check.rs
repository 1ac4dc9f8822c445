//! Rules that every sequence obeys, checked when a file is written and again
//! when it is read: counts, index ranges, finite numbers, unit quaternions.
//! What passes here needs no check further inside.

use std::collections::BTreeSet;

use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, Garment, SequenceHeader};

/// A unit quaternion's norm may differ from one by this much: f32 rounding of
/// an eight-term expression is 1e-6, text formats with four decimals lose 1e-4.
pub(crate) const UNIT_TOLERANCE: f32 = 1e-3;

impl SequenceHeader {
    /// Checks counts, index ranges, finiteness and order of the layers.
    pub fn check(&self) -> Result<()> {
        require(
            !self.name.is_empty(),
            "sequence name",
            "a name",
            "an empty string",
        )?;
        let scene = &self.scene;
        positive(scene.scale, "scene scale")?;
        positive(scene.fps, "scene fps")?;
        positive(scene.metres_per_uv, "scene metres_per_uv")?;
        finite(&[scene.gravity], "scene gravity")?;
        not_negative(scene.body_friction, "scene body_friction")?;
        require(
            scene.effects.windows(2).all(|pair| pair[0] < pair[1]),
            "scene effects",
            "each effect once, in the registry's order",
            &format!("{:?}", scene.effects),
        )?;
        let body = &self.body;
        if !body.rest.is_empty() {
            count(body.rest.len(), body.vertex_count, "body rest positions")?;
        }
        finite(&body.rest, "body rest")?;
        triangles(&body.faces, body.vertex_count, "body")?;
        require(
            !self.garments.is_empty(),
            "garments",
            "at least one garment",
            "none",
        )?;
        let mut names = BTreeSet::new();
        for garment in &self.garments {
            let place = format!("garment {:?}", garment.name);
            require(
                !garment.name.is_empty(),
                "garment name",
                "a name",
                "an empty string",
            )?;
            require(
                names.insert(&garment.name),
                &place,
                "a name of its own",
                "a name used twice",
            )?;
            garment.check().map_err(|error| error.at(&place))?;
        }
        for pair in self.garments.windows(2) {
            require(
                pair[0].layer <= pair[1].layer,
                &format!("garment {:?}", pair[1].name),
                "garments ordered from the inner layer to the outer one",
                &format!("layer {} after layer {}", pair[1].layer, pair[0].layer),
            )?;
        }
        Ok(())
    }
}

impl Garment {
    /// Checks counts, index ranges, finiteness, UV range and material.
    pub fn check(&self) -> Result<()> {
        finite(&self.rest, "rest")?;
        require(
            !self.faces.is_empty(),
            "faces",
            "at least one triangle",
            "none",
        )?;
        triangles(&self.faces, self.rest.len(), "faces")?;
        count(self.uv_faces.len(), self.faces.len(), "uv_faces")?;
        count(self.panel_of_face.len(), self.faces.len(), "panel_of_face")?;
        for (i, uv) in self.uv.iter().enumerate() {
            if !uv.iter().all(|x| (0.0..=1.0).contains(x)) {
                return Err(DatasetError::invalid(
                    format!("UV coordinate {i}"),
                    "two numbers in [0, 1]",
                    format!("{uv:?}"),
                ));
            }
        }
        for (face, corners) in self.uv_faces.iter().enumerate() {
            index_range(
                corners,
                self.uv.len(),
                || format!("uv_faces, face {face}"),
                "UV",
            )?;
        }
        for (face, &panel) in self.panel_of_face.iter().enumerate() {
            index_range(
                &[panel],
                self.panels.len(),
                || format!("panel of face {face}"),
                "panel",
            )?;
        }
        let m = &self.material;
        positive(m.mass, "material mass")?;
        for (value, what) in [
            (m.tension, "material tension"),
            (m.compression, "material compression"),
            (m.shear, "material shear"),
            (m.bending, "material bending"),
            (m.friction, "material friction"),
        ] {
            not_negative(value, what)?;
        }
        Ok(())
    }
}

impl Frame {
    /// Checks that the frame has the header's shapes and only finite numbers.
    pub fn check(&self, header: &SequenceHeader) -> Result<()> {
        count(self.body.len(), header.body.vertex_count, "body positions")?;
        finite(&self.body, "body")?;
        finite(&[self.root.translation], "root translation")?;
        unit(self.root.rotation, "root rotation")?;
        count(self.garments.len(), header.garments.len(), "garments")?;
        for (positions, garment) in self.garments.iter().zip(&header.garments) {
            let place = || format!("garment {:?}", garment.name);
            count(positions.len(), garment.rest.len(), "positions").map_err(|e| e.at(&place()))?;
            finite(positions, "positions").map_err(|e| e.at(&place()))?;
        }
        not_negative(self.wind.strength, "wind strength")?;
        if self.wind.strength > 0.0 || self.wind.rotation != [0.0; 4] {
            unit(self.wind.rotation, "wind rotation")?;
        }
        Ok(())
    }
}

impl DatasetError {
    /// Prefixes an [`DatasetError::Invalid`] with where it happened.
    pub(crate) fn at(self, outer: &str) -> Self {
        match self {
            Self::Invalid {
                place,
                expected,
                found,
            } => Self::Invalid {
                place: format!("{outer}, {place}"),
                expected,
                found,
            },
            other => other,
        }
    }
}

fn require(holds: bool, place: &str, expected: &str, found: &str) -> Result<()> {
    if holds {
        Ok(())
    } else {
        Err(DatasetError::invalid(place, expected, found))
    }
}

fn count(found: usize, expected: usize, what: &str) -> Result<()> {
    require(
        found == expected,
        what,
        &expected.to_string(),
        &found.to_string(),
    )
}

fn positive(value: f32, what: &str) -> Result<()> {
    require(
        value.is_finite() && value > 0.0,
        what,
        "a number above 0",
        &value.to_string(),
    )
}

fn not_negative(value: f32, what: &str) -> Result<()> {
    require(
        value.is_finite() && value >= 0.0,
        what,
        "a number of at least 0",
        &value.to_string(),
    )
}

fn unit(q: [f32; 4], what: &str) -> Result<()> {
    let norm = q.iter().map(|x| x * x).sum::<f32>().sqrt();
    // NaN fails the comparison too.
    let is_unit = (norm - 1.0).abs() <= UNIT_TOLERANCE;
    require(
        is_unit,
        what,
        "a unit quaternion (w, x, y, z)",
        &format!("{q:?}, of length {norm}"),
    )
}

fn finite(positions: &[[f32; 3]], what: &str) -> Result<()> {
    // One branch-free sweep first: the slow search runs only to name the culprit.
    if positions
        .as_flattened()
        .iter()
        .fold(true, |ok, x| ok & x.is_finite())
    {
        return Ok(());
    }
    let vertex = positions
        .iter()
        .position(|p| !p.iter().all(|x| x.is_finite()))
        .unwrap_or(0);
    Err(DatasetError::invalid(
        format!("{what}, vertex {vertex}"),
        "finite numbers",
        format!("{:?}", positions[vertex]),
    ))
}

fn triangles(faces: &[[u32; 3]], vertices: usize, what: &str) -> Result<()> {
    for (i, face) in faces.iter().enumerate() {
        index_range(face, vertices, || format!("{what}, face {i}"), "vertex")?;
        let [a, b, c] = *face;
        if a == b || b == c || c == a {
            return Err(DatasetError::invalid(
                format!("{what}, face {i}"),
                "three different vertices",
                format!("{face:?}"),
            ));
        }
    }
    Ok(())
}

fn index_range(indices: &[u32], len: usize, place: impl Fn() -> String, what: &str) -> Result<()> {
    match indices.iter().find(|&&i| i as usize >= len) {
        None => Ok(()),
        Some(i) => Err(DatasetError::invalid(
            place(),
            format!("{what} indices below {len}"),
            format!("index {i}"),
        )),
    }
}
