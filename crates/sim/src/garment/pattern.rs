//! What each kind of garment is: how far it stands off the body. Where it is
//! cut and sewn is told by `cuts`.

use drape_dataset::registry::GarmentKind;

use glam::DVec2;

use super::anatomy::Anatomy;
use super::cuts::hem;
use super::field::{BAND, Field, ramp, smooth_min};
use super::parameters::GarmentParameters;
use crate::error::Result;

/// Distance from the body that every garment keeps at least, in units (with
/// the mesh's chords cutting corners about 8 mm of real cloth remain).
const OFFSET: f64 = 0.15;

/// Room between a hood and the head's outline, in units.
const HOOD_ROOM: f64 = 0.3;

/// How much nearer than at the head's outline a hood comes to the neck, in units.
const HOOD_CLOSES: f64 = 0.45;

/// Corners, seen from above, of the box that garments around trunk and legs stay in when
/// they are worn over one another, with room to spare: wide skirts stand farther off than
/// any limb.
pub(super) fn reach(
    garments: &[&GarmentParameters],
    anatomy: &Anatomy,
    layer_gap: f64,
) -> [DVec2; 2] {
    const SPARE: f64 = 0.4;
    let lowest = garments
        .iter()
        .map(|spec| hem(spec, anatomy))
        .fold(anatomy.waist_z, f64::min);
    let widest = garments
        .iter()
        .map(|spec| 10.0 * spec.ease_m + spec.flare * (anatomy.waist_z - lowest))
        .fold(0.0, f64::max);
    let room = OFFSET + widest + layer_gap * garments.len() as f64 + SPARE;
    let [low, high] = anatomy.trunk.bounds();
    [low - DVec2::splat(room), high + DVec2::splat(room)]
}

/// The field whose zero surface a garment is cut from; `inner` is the one of the layer below.
pub(super) fn field(
    spec: &GarmentParameters,
    anatomy: &Anatomy,
    body: &Field,
    inner: Option<&Field>,
    layer_gap: f64,
) -> Result<Field> {
    spec.check()?;
    let mut field = stand_off(spec, anatomy, body);
    if let Some(inner) = inner {
        let gap = layer_gap;
        field = field.map(|i, _| smooth_min(field.values[i], inner.values[i] - gap, 0.1));
    }
    field.smooth();
    // Smoothing must not eat the room between layers.
    if let Some(inner) = inner {
        field = field.map(|i, _| field.values[i].min(inner.values[i] - 0.8 * layer_gap));
    }
    Ok(field)
}

/// The garment's own field: negative within it.
fn stand_off(spec: &GarmentParameters, a: &Anatomy, body: &Field) -> Field {
    let ease = 10.0 * spec.ease_m;
    let mut trunk = a.trunk.clone();
    let hangs = matches!(spec.kind, GarmentKind::Skirt | GarmentKind::Dress);
    if hangs {
        trunk.hang_from(a.waist_z);
    }
    body.map(|i, p| {
        let distance = body.values[i];
        // Distances are cut off at the band: what lies beyond is outside, however much room is asked for.
        let off_skin = |room: f64| {
            if distance < BAND {
                distance - room
            } else {
                (distance - room).max(0.3)
            }
        };
        // Tube and ease above the armpits fade out: shoulders carry the cloth.
        let free = ramp(a.armpit.z + 0.2, a.armpit.z - 1.6, p.z);
        let fall = (a.waist_z - p.z).max(0.0);
        let legs = || {
            let below = ramp(a.waist_z, a.crotch_z, p.z);
            let leg = (a.hip.z - 0.5 - p.z).max(0.0);
            off_skin(OFFSET + ease * below * 0.6 + (spec.flare * leg).min(0.45))
        };
        let upper = || {
            let arm = ramp(-0.2, 0.5, a.arm_side(p));
            let sleeve_ease = (0.35 * ease + 0.06) * ramp(-0.2, 1.4, a.along_arm(p));
            let skin = off_skin(OFFSET + (1.0 - arm) * 0.4 * ease * free + arm * sleeve_ease);
            let fade = 1.5 * (p.z - a.armpit.z + 0.3).max(0.0);
            let flare = if hangs { spec.flare * fall } else { 0.0 };
            let room = OFFSET + ease * free + flare;
            match trunk.distance(p) {
                Some(d) if a.arm_side(p) < 0.6 => {
                    let mut tube = d - room + fade;
                    if spec.kind == GarmentKind::Jumpsuit {
                        // Sections of both legs are one hull: the tube ends above them.
                        tube += 0.8 * (a.crotch_z + 1.7 - p.z).max(0.0);
                    }
                    smooth_min(skin, tube, 0.3)
                }
                _ => skin,
            }
        };
        match spec.kind {
            GarmentKind::Pants => legs(),
            GarmentKind::Skirt => {
                let room =
                    OFFSET + ease * ramp(a.waist_z, a.waist_z - 2.0, p.z) + spec.flare * fall;
                trunk.distance(p).map_or(0.8, |d| d - room)
            }
            GarmentKind::Jumpsuit if p.z < a.crotch_z => legs(),
            GarmentKind::Jumpsuit => {
                let down = ramp(a.hip.z, a.crotch_z, p.z);
                upper() * (1.0 - down) + legs() * down
            }
            GarmentKind::JacketHood => {
                // The hood hangs from the head's widest outline and closes around the neck:
                // if it came down onto the shoulders as wide as that, it would hold the jacket up.
                let closing = HOOD_CLOSES * ramp(a.chin_z + 0.3, a.neck.z, p.z);
                let fade = 1.5 * (a.neck.z - 0.2 - p.z).max(0.0);
                let room = HOOD_ROOM - closing - fade;
                let hood = a.head.distance(p).map_or(BAND, |d| d - room);
                smooth_min(upper(), hood, 0.2)
            }
            GarmentKind::TShirt | GarmentKind::Jacket | GarmentKind::Dress => upper(),
        }
    })
}
