//! How garments of a kind are cut: lengths, sleeves, ease, flare, panels.

use drape_dataset::registry::GarmentKind;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::ranges::between;
use crate::garment::GarmentParameters;

/// What cuts are drawn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CutRange {
    /// Cuts that look like the kind: jackets have long sleeves, T-shirts short ones.
    Common,
    /// All cuts: T-shirts and jumpsuits with and without sleeves, sleeves of any
    /// length, skirts of 2, 4 and 8 panels, narrow and wide. Each layer ends at its
    /// hems for those over it too.
    All,
}

impl CutRange {
    /// Draws a cut; `under_jacket` says whether a jacket comes over it.
    pub fn sample(
        self,
        kind: GarmentKind,
        under_jacket: bool,
        rng: &mut ChaCha8Rng,
    ) -> GarmentParameters {
        match self {
            Self::Common => common(kind, rng),
            Self::All => {
                let mut cut = any(kind, rng);
                // What is wider than the jacket's hem would carry it out to the hands.
                if under_jacket {
                    cut.flare *= 0.6;
                }
                cut
            }
        }
    }
}

fn common(kind: GarmentKind, rng: &mut ChaCha8Rng) -> GarmentParameters {
    let mut draw = |low: f64, high: f64| between(rng, [low, high]);
    let (ease_m, sleeve, flare) = match kind {
        GarmentKind::TShirt => (draw(0.02, 0.06), draw(0.4, 0.8), 0.0),
        GarmentKind::Jacket | GarmentKind::JacketHood => (draw(0.025, 0.05), draw(1.3, 1.75), 0.0),
        GarmentKind::Dress => (draw(0.02, 0.04), 0.0, draw(0.1, 0.35)),
        GarmentKind::Skirt => (draw(0.01, 0.03), 0.0, draw(0.1, 0.4)),
        GarmentKind::Pants | GarmentKind::Jumpsuit => (draw(0.01, 0.04), 0.0, draw(0.0, 0.15)),
    };
    GarmentParameters {
        kind,
        length: draw(0.1, 0.9),
        ease_m,
        sleeve,
        flare,
        panels: 2,
    }
}

fn any(kind: GarmentKind, rng: &mut ChaCha8Rng) -> GarmentParameters {
    let sleeveless = rng.random_bool(0.4);
    let panels = [2, 4, 8][rng.random_range(0..3)];
    let mut draw = |low: f64, high: f64| between(rng, [low, high]);
    let (ease_m, long_sleeve, flare) = match kind {
        GarmentKind::TShirt => (draw(0.015, 0.07), draw(0.45, 1.6), 0.0),
        GarmentKind::Jacket | GarmentKind::JacketHood => (draw(0.025, 0.07), draw(1.2, 1.8), 0.0),
        GarmentKind::Dress => (draw(0.02, 0.05), draw(0.45, 1.6), draw(0.1, 0.4)),
        GarmentKind::Jumpsuit => (draw(0.015, 0.05), draw(0.45, 1.6), draw(0.0, 0.15)),
        GarmentKind::Skirt => (draw(0.01, 0.04), 0.0, draw(0.1, 0.48)),
        GarmentKind::Pants => (draw(0.01, 0.05), 0.0, draw(0.0, 0.2)),
    };
    let jacket = matches!(kind, GarmentKind::Jacket | GarmentKind::JacketHood);
    GarmentParameters {
        kind,
        length: draw(0.0, 1.0),
        ease_m,
        sleeve: if sleeveless && !jacket {
            0.0
        } else {
            long_sleeve
        },
        flare,
        panels: if kind == GarmentKind::Skirt {
            panels
        } else {
            2
        },
    }
}
