//! What each kind of garment is: how far it stands off the body, where it is
//! cut, where its seams run.

use drape_dataset::registry::GarmentKind;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

use super::anatomy::Anatomy;
use super::field::{BAND, Field, ramp, smooth_min};
use super::surface::Cut;
use crate::error::{Result, SimError};

/// Parameters of a garment; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GarmentParameters {
    /// Kind: jacket, dress, skirt, pants or T-shirt.
    pub kind: GarmentKind,
    /// 0 shortest, 1 longest of its kind: a T-shirt ends between hip bone and
    /// crotch, a skirt or dress between mid-thigh and mid-shin, pants between
    /// knee and ankle.
    pub length: f64,
    /// Extra room around trunk or legs where the garment hangs free.
    pub ease_m: f64,
    /// Sleeve's end: 0 none, 1 at the elbow, 2 at the wrist. Ignored by skirts and pants.
    pub sleeve: f64,
    /// Widening per metre of fall. Only for skirts, dresses and pants' legs.
    pub flare: f64,
}

/// Distance from the body that every garment keeps at least, in units (with
/// the mesh's chords cutting corners about 8 mm of real cloth remain).
const OFFSET: f64 = 0.15;

/// A field with the cuts and seams that make it a garment.
pub(super) struct Pattern {
    pub field: Field,
    pub removed: Vec<Cut>,
    pub seams: Vec<Cut>,
    /// Height below which vertices from the top edge belong to the waistband.
    pub waistband_z: Option<f64>,
    /// Panel name of each seam label.
    pub panel: fn(u32) -> String,
}

impl GarmentParameters {
    fn check(&self) -> Result<()> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                Err(SimError::value(
                    format!("garment {:?}: {name}", self.kind),
                    format!("{low} to {high}"),
                    value,
                ))
            }
        };
        within("length", self.length, 0.0, 1.0)?;
        within("ease_m", self.ease_m, 0.0, 0.12)?;
        within("sleeve", self.sleeve, 0.0, 1.9)?;
        within("flare", self.flare, 0.0, 0.6)
    }
}

/// Makes the pattern on a body; `inner` is the field of the layer below.
pub(super) fn pattern(
    spec: &GarmentParameters,
    anatomy: &Arc<Anatomy>,
    body: &Field,
    inner: Option<&Field>,
    layer_gap: f64,
) -> Result<Pattern> {
    spec.check()?;
    let a = anatomy;
    let ease = 10.0 * spec.ease_m;
    let mut trunk = a.trunk.clone();
    let hangs = matches!(spec.kind, GarmentKind::Skirt | GarmentKind::Dress);
    if hangs {
        trunk.hang_from(a.waist_z);
    }
    // Tube and ease above the armpits fade out: shoulders carry the cloth.
    let own = |i: usize, p: DVec3| -> f64 {
        let distance = body.values[i];
        // Distances are cut off at the band: what lies beyond is outside, however much room is asked for.
        let off_skin = |room: f64| {
            if distance < BAND {
                distance - room
            } else {
                (distance - room).max(0.3)
            }
        };
        let free = ramp(a.armpit.z + 0.2, a.armpit.z - 1.6, p.z);
        let fall = (a.waist_z - p.z).max(0.0);
        match spec.kind {
            GarmentKind::Pants => {
                let below = ramp(a.waist_z, a.crotch_z, p.z);
                let leg = (a.hip.z - 0.5 - p.z).max(0.0);
                off_skin(OFFSET + ease * below * 0.6 + (spec.flare * leg).min(0.45))
            }
            GarmentKind::Skirt => {
                let room =
                    OFFSET + ease * ramp(a.waist_z, a.waist_z - 2.0, p.z) + spec.flare * fall;
                trunk.distance(p).map_or(0.8, |d| d - room)
            }
            _ => {
                let arm = ramp(-0.2, 0.5, a.arm_side(p));
                let sleeve_ease = (0.35 * ease + 0.06) * ramp(-0.2, 1.4, a.along_arm(p));
                let skin = off_skin(OFFSET + (1.0 - arm) * 0.4 * ease * free + arm * sleeve_ease);
                let fade = 1.5 * (p.z - a.armpit.z + 0.3).max(0.0);
                let flare = if hangs { spec.flare * fall } else { 0.0 };
                let room = OFFSET + ease * free + flare;
                match trunk.distance(p) {
                    Some(d) if a.arm_side(p) < 0.6 => smooth_min(skin, d - room + fade, 0.3),
                    _ => skin,
                }
            }
        }
    };
    let mut field = body.map(own);
    if let Some(inner) = inner {
        let gap = layer_gap;
        field = field.map(|i, _| smooth_min(field.values[i], inner.values[i] - gap, 0.1));
    }
    field.smooth();
    // Smoothing must not eat the room between layers.
    if let Some(inner) = inner {
        field = field.map(|i, _| field.values[i].min(inner.values[i] - 0.8 * layer_gap));
    }

    let z_between = |low: f64, high: f64| high + (low - high) * spec.length;
    let mut removed: Vec<Cut> = Vec::new();
    let mut seams: Vec<Cut> = Vec::new();
    let coronal = {
        let a = Arc::clone(a);
        move |p: DVec3| a.behind(p)
    };
    seams.push(Box::new(coronal));
    let mut waistband_z = None;
    let upper = matches!(
        spec.kind,
        GarmentKind::TShirt | GarmentKind::Jacket | GarmentKind::Dress
    );
    let hem = match spec.kind {
        GarmentKind::TShirt => z_between(a.crotch_z + 0.1, a.hip.z + 0.7),
        GarmentKind::Jacket => z_between(a.crotch_z - 0.4, a.hip.z + 0.3),
        GarmentKind::Pants => z_between(a.ankle.z + 0.4, a.knee.z - 0.6),
        GarmentKind::Skirt | GarmentKind::Dress => {
            z_between(0.5 * (a.knee.z + a.ankle.z), 0.5 * (a.crotch_z + a.knee.z))
        }
        other => {
            return Err(SimError::value(
                "garment kind",
                "jacket, dress, skirt, pants or t-shirt",
                format!("{other:?}"),
            ));
        }
    };
    removed.push(Box::new(move |p| hem - p.z));
    if upper {
        // An elliptic hole around the neck, wider for outer kinds and towards the throat.
        let neck = a.neck;
        let (centre, half) = a.neck_section;
        let wide = if spec.kind == GarmentKind::TShirt {
            0.32
        } else {
            0.46
        };
        let half = half + DVec2::splat(wide);
        removed.push(Box::new(move |p| {
            let q = (p.truncate() - centre) / half;
            (half.x * (1.0 - q.length())).min(p.z - neck.z + 2.2)
        }));
        let (arm, sleeve) = (Arc::clone(a), spec.sleeve);
        let at_armhole = a.shoulder.x - 0.05;
        if sleeve < 0.15 {
            removed.push(Box::new(move |p| {
                smooth_min(p.x.abs() - at_armhole, arm.arm_side(p) + 0.15, 0.4)
            }));
        } else {
            removed.push(Box::new(move |p| {
                arm.beyond_sleeve(p, sleeve)
                    .min(arm.arm_side(p) - 0.02)
                    .min(p.x.abs() - at_armhole)
            }));
            let arm = Arc::clone(a);
            seams.push(Box::new(move |p| {
                smooth_min(p.x.abs() - at_armhole - 0.05, arm.arm_side(p), 0.4)
            }));
        }
    } else {
        let top = if spec.kind == GarmentKind::Pants {
            a.waist_z - 0.35
        } else {
            a.waist_z
        };
        removed.push(Box::new(move |p| p.z - top));
        let arm = Arc::clone(a);
        removed.push(Box::new(move |p| arm.arm_side(p) - 0.3));
        waistband_z = Some(top - 0.25);
    }
    match spec.kind {
        GarmentKind::Jacket => {
            removed.push(Box::new(|p| (0.18 - p.x.abs()).min(-p.y - 0.1)));
        }
        GarmentKind::Pants => seams.push(Box::new(|p| p.x)),
        GarmentKind::Dress => {
            let waist = a.waist_z;
            let arm = Arc::clone(a);
            seams.push(Box::new(move |p| (waist - p.z).min(-arm.arm_side(p))));
        }
        _ => {}
    }
    let panel = match (spec.kind, spec.sleeve < 0.15) {
        (GarmentKind::Pants, _) => pants_panel,
        (GarmentKind::Dress, true) => sleeveless_dress_panel,
        _ => upper_panel,
    };
    Ok(Pattern {
        field,
        removed,
        seams,
        waistband_z,
        panel,
    })
}

fn upper_panel(label: u32) -> String {
    let side = if label & 1 == 0 { "front" } else { "back" };
    match label >> 1 {
        0 => side.into(),
        1 => format!("sleeve-{side}"),
        _ => format!("skirt-{side}"),
    }
}

fn sleeveless_dress_panel(label: u32) -> String {
    let side = if label & 1 == 0 { "front" } else { "back" };
    if label >> 1 == 0 {
        side.into()
    } else {
        format!("skirt-{side}")
    }
}

fn pants_panel(label: u32) -> String {
    let side = if label & 1 == 0 { "front" } else { "back" };
    format!(
        "{side}-{}",
        if label >> 1 & 1 == 0 { "right" } else { "left" }
    )
}
