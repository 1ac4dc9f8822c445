//! Where each kind of garment ends (hems, neckline, armholes, openings), where
//! its seams run, and what the panels between them are called.
//!
//! A cut is the zero surface of a function: what lies where it is positive is
//! taken away, or, for a seam, becomes another panel.

use drape_dataset::registry::GarmentKind;
use glam::{DVec2, DVec3};
use std::sync::Arc;

use super::anatomy::Anatomy;
use super::field::smooth_min;
use super::parameters::GarmentParameters;
use super::surface::Cut;

/// Half the width of a jacket's front opening, in units.
const OPENING: f64 = 0.18;

/// How far sleeves reach beyond the armhole's seam at least, in units of [`beyond_armhole`]:
/// in wide garments the armpit hangs as low as a short sleeve's end, and where seam and
/// hem meet at a slant there is no even mesh.
const LEAST_SLEEVE: f64 = 0.2;

/// Cuts of a garment.
pub(super) struct Cuts {
    pub removed: Vec<Cut>,
    pub seams: Vec<Cut>,
    /// Height below which vertices from the top edge belong to the waistband.
    pub waistband_z: Option<f64>,
    /// Panel name of each seam label.
    pub panel: fn(u32) -> String,
}

/// How the cuts of a garment depart from the usual; in units.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Alteration {
    /// How far the side and shoulder seams, and the neckline at the nape, come forward.
    pub forward: f64,
    /// How far necklines move away from the neck for the layers below, and that
    /// nothing but a hood reaches above the neck, however many layers there are.
    pub collar: Option<f64>,
}

/// The cuts of a kind on a body.
pub(super) fn cuts(spec: &GarmentParameters, a: &Arc<Anatomy>, alteration: Alteration) -> Cuts {
    let forward = alteration.forward;
    let mut cuts = Cuts {
        removed: Vec::new(),
        seams: Vec::new(),
        waistband_z: None,
        panel: panel_name(spec),
    };
    let coronal = Arc::clone(a);
    cuts.seams
        .push(Box::new(move |p| coronal.behind(p) + forward));
    let hem = hem(spec, a);
    cuts.removed.push(Box::new(move |p| hem - p.z));
    if spec.covers_trunk() {
        if spec.kind == GarmentKind::JacketHood {
            cuts.removed.push(face_opening(a));
        } else {
            let jumpsuit = spec.kind == GarmentKind::Jumpsuit;
            let higher = if jumpsuit { 0.3 } else { forward };
            cuts.removed
                .push(neckline(spec.kind, a, higher, alteration.collar));
        }
        cuts.sleeves(spec, a);
    } else {
        let top = if spec.kind == GarmentKind::Pants {
            a.waist_z - 0.35
        } else {
            a.waist_z
        };
        cuts.removed.push(Box::new(move |p| p.z - top));
        let arm = Arc::clone(a);
        cuts.removed.push(Box::new(move |p| arm.arm_side(p) - 0.3));
        cuts.waistband_z = Some(top - 0.25);
    }
    cuts.of_kind(spec, a);
    cuts
}

/// Height of the lower hem.
pub(super) fn hem(spec: &GarmentParameters, a: &Anatomy) -> f64 {
    let between = |low: f64, high: f64| high + (low - high) * spec.length;
    match spec.kind {
        GarmentKind::TShirt => between(a.crotch_z + 0.1, a.hip.z + 0.7),
        GarmentKind::Jacket | GarmentKind::JacketHood => between(a.crotch_z - 0.4, a.hip.z + 0.3),
        GarmentKind::Pants | GarmentKind::Jumpsuit => between(a.ankle.z + 0.4, a.knee.z - 0.6),
        GarmentKind::Skirt | GarmentKind::Dress => {
            between(0.5 * (a.knee.z + a.ankle.z), 0.5 * (a.crotch_z + a.knee.z))
        }
    }
}

/// An elliptic hole around the neck, wider for outer kinds and towards the throat.
/// `higher` units are left standing at the nape: where the hole's edge is nearly
/// parallel to a back, it would run far down.
fn neckline(kind: GarmentKind, a: &Anatomy, higher: f64, collar: Option<f64>) -> Cut {
    let neck = a.neck;
    let (centre, half) = a.neck_section;
    let wide = if kind == GarmentKind::TShirt {
        0.32
    } else {
        0.46
    };
    let wide = wide + collar.unwrap_or(0.0);
    let half = half + DVec2::new(wide, wide - 0.5 * higher);
    // From a little above the neck's base on the hole opens like a funnel.
    let funnel = if collar.is_some() { 2.0 } else { 0.0 };
    let centre = centre - DVec2::new(0.0, 0.5 * higher);
    Box::new(move |p| {
        let half = half + DVec2::splat(funnel * (p.z - neck.z - 0.2).max(0.0));
        let q = (p.truncate() - centre) / half;
        (half.x * (1.0 - q.length())).min(p.z - neck.z + 2.2)
    })
}

/// What a hood leaves open: the face, and the throat down to the collar.
fn face_opening(a: &Anatomy) -> Cut {
    let (neck, face_y) = (a.neck, a.face_y);
    Box::new(move |p| {
        let half = 0.75 + 2.0 * (p.z - neck.z).max(0.0);
        let above = smooth_min(p.z - (neck.z - 0.6), half - p.x.abs(), 0.3);
        smooth_min(above, face_y - p.y, 0.3)
    })
}

/// Positive on the arm's side of the armhole's seam.
fn beyond_armhole(a: &Anatomy, p: DVec3) -> f64 {
    smooth_min(p.x.abs() - a.shoulder.x, a.arm_side(p), 0.4)
}

impl Cuts {
    fn sleeves(&mut self, spec: &GarmentParameters, a: &Arc<Anatomy>) {
        let (arm, sleeve) = (Arc::clone(a), spec.sleeve);
        if spec.is_sleeveless() {
            let at_armhole = a.shoulder.x - 0.05;
            self.removed.push(Box::new(move |p| {
                smooth_min(p.x.abs() - at_armhole, arm.arm_side(p) + 0.15, 0.4)
            }));
            return;
        }
        self.removed.push(Box::new(move |p| {
            smooth_min(
                arm.beyond_sleeve(p, sleeve),
                beyond_armhole(&arm, p) - LEAST_SLEEVE,
                0.3,
            )
        }));
        let arm = Arc::clone(a);
        self.seams.push(Box::new(move |p| beyond_armhole(&arm, p)));
    }

    fn of_kind(&mut self, spec: &GarmentParameters, a: &Arc<Anatomy>) {
        let arm = Arc::clone(a);
        match spec.kind {
            GarmentKind::Jacket => {
                self.removed
                    .push(Box::new(|p| (OPENING - p.x.abs()).min(-p.y - 0.1)));
            }
            GarmentKind::JacketHood => {
                let neck = a.neck.z;
                self.removed.push(Box::new(move |p| {
                    (OPENING - p.x.abs()).min(-p.y - 0.1).min(neck + 0.2 - p.z)
                }));
                self.seams.push(Box::new(move |p| p.z - neck - 0.1));
                self.seams.push(Box::new(|p| p.x));
            }
            GarmentKind::Pants | GarmentKind::Jumpsuit => self.seams.push(Box::new(|p| p.x)),
            GarmentKind::Dress => {
                let waist = a.waist_z;
                self.seams
                    .push(Box::new(move |p| (waist - p.z).min(-arm.arm_side(p))));
            }
            GarmentKind::Skirt => {
                if spec.panels >= 4 {
                    self.seams.push(Box::new(|p| p.x));
                }
                if spec.panels == 8 {
                    for side in [-1.0, 1.0] {
                        let arm = Arc::clone(a);
                        self.seams
                            .push(Box::new(move |p| GORE * p.x + side * arm.behind(p)));
                    }
                }
            }
            GarmentKind::TShirt => {}
        }
    }
}

/// Slope of a skirt's slanting seams from above: hips are wider than deep.
const GORE: f64 = 0.75;

fn panel_name(spec: &GarmentParameters) -> fn(u32) -> String {
    match (spec.kind, spec.is_sleeveless()) {
        (GarmentKind::Pants, _) => in_halves,
        (GarmentKind::Skirt, _) => match spec.panels {
            2 => front_or_back,
            4 => in_halves,
            _ => gores,
        },
        (GarmentKind::Jumpsuit, true) => in_halves,
        (GarmentKind::Jumpsuit, false) => |label| with_sleeves(label, label >> 2),
        (GarmentKind::JacketHood, true) => |label| with_hood(label, 0, label >> 1),
        (GarmentKind::JacketHood, false) => |label| with_hood(label, label >> 1, label >> 2),
        (GarmentKind::Dress, true) => |label| skirted(label, 0, label >> 1),
        (GarmentKind::Dress, false) => |label| skirted(label, label >> 1, label >> 2),
        (GarmentKind::Jacket | GarmentKind::TShirt, _) => |label| skirted(label, label >> 1, 0),
    }
}

fn front_or_back(label: u32) -> String {
    if label & 1 == 0 { "front" } else { "back" }.into()
}

fn side(bit: u32) -> &'static str {
    if bit & 1 == 0 { "right" } else { "left" }
}

fn skirted(label: u32, sleeve: u32, skirt: u32) -> String {
    let face = front_or_back(label);
    match (sleeve & 1, skirt & 1) {
        (0, 0) => face,
        (0, _) => format!("skirt-{face}"),
        _ => format!("sleeve-{face}"),
    }
}

fn in_halves(label: u32) -> String {
    format!("{}-{}", front_or_back(label), side(label >> 1))
}

fn with_sleeves(label: u32, left: u32) -> String {
    format!("{}-{}", skirted(label, label >> 1, 0), side(left))
}

fn with_hood(label: u32, sleeve: u32, hood_and_side: u32) -> String {
    let part = if hood_and_side & 1 == 1 {
        format!("hood-{}", front_or_back(label))
    } else {
        skirted(label, sleeve, 0)
    };
    format!("{part}-{}", side(hood_and_side >> 1))
}

fn gores(label: u32) -> String {
    // The two slanting seams agree where the outline is more sideways than forward.
    let place = if label >> 2 & 1 == label >> 3 & 1 {
        "side"
    } else {
        "middle"
    };
    format!("{}-{place}", in_halves(label))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn panels_of_a_skirt_have_names_of_their_own() {
        for panels in [2u32, 4, 8] {
            let spec = GarmentParameters {
                kind: GarmentKind::Skirt,
                length: 0.5,
                ease_m: 0.02,
                sleeve: 0.0,
                flare: 0.2,
                panels,
            };
            let name = panel_name(&spec);
            let mut labels = BTreeSet::new();
            // Points around the axis, each with the label that the seams give it.
            for step in 0..64 {
                let (y, x) = (f64::from(step) / 64.0 * std::f64::consts::TAU + 0.01).sin_cos();
                let bit = |positive: bool, bit: u32| u32::from(positive) << bit;
                let mut label = bit(y > 0.0, 0);
                if panels >= 4 {
                    label |= bit(x > 0.0, 1);
                }
                if panels == 8 {
                    label |= bit(GORE * x - y > 0.0, 2) | bit(GORE * x + y > 0.0, 3);
                }
                labels.insert(label);
            }
            assert_eq!(labels.len(), panels as usize);
            let names: BTreeSet<String> = labels.into_iter().map(name).collect();
            assert_eq!(names.len(), panels as usize, "{names:?}");
        }
    }
}
