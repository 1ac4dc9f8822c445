//! What a garment is asked to be: kind and cut, in a person's terms.

use drape_dataset::registry::GarmentKind;
use serde::{Deserialize, Serialize};

use crate::error::{Result, SimError};

/// Parameters of a garment; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GarmentParameters {
    /// Kind.
    pub kind: GarmentKind,
    /// 0 shortest, 1 longest of its kind: a T-shirt ends between hip bone and
    /// crotch, a skirt or dress between mid-thigh and mid-shin, pants and
    /// jumpsuits between knee and ankle.
    pub length: f64,
    /// Extra room around trunk or legs where the garment hangs free.
    pub ease_m: f64,
    /// Sleeve's end: 0 none, 1 at the elbow, 2 at the wrist. Ignored by skirts and pants.
    pub sleeve: f64,
    /// Widening per metre of fall. Only for skirts, dresses, and the legs of pants and jumpsuits.
    pub flare: f64,
    /// Panels of a skirt: 2, 4 or 8. Other kinds have theirs, and 2 here.
    #[serde(default = "two", skip_serializing_if = "is_two")]
    pub panels: u32,
}

fn two() -> u32 {
    2
}

fn is_two(panels: &u32) -> bool {
    *panels == 2
}

impl GarmentParameters {
    /// Whether arms come out without sleeves.
    pub(super) fn is_sleeveless(&self) -> bool {
        self.sleeve < 0.15
    }

    /// Whether it hangs from shoulders, and so has a neckline and armholes.
    pub(super) fn covers_trunk(&self) -> bool {
        match self.kind {
            GarmentKind::TShirt
            | GarmentKind::Jacket
            | GarmentKind::JacketHood
            | GarmentKind::Dress
            | GarmentKind::Jumpsuit => true,
            GarmentKind::Skirt | GarmentKind::Pants => false,
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(self.error(name, format!("{low} to {high}"), value))
        };
        within("length", self.length, 0.0, 1.0)?;
        within("ease_m", self.ease_m, 0.0, 0.12)?;
        within("sleeve", self.sleeve, 0.0, 1.9)?;
        within("flare", self.flare, 0.0, 0.6)?;
        match (self.kind, self.panels) {
            (GarmentKind::Skirt, 2 | 4 | 8) | (_, 2) => Ok(()),
            (GarmentKind::Skirt, found) => Err(self.error("panels", "2, 4 or 8", found)),
            (_, found) => Err(self.error("panels", "2; only skirts have a choice", found)),
        }
    }

    fn error(
        &self,
        name: &str,
        expected: impl Into<String>,
        found: impl std::fmt::Display,
    ) -> SimError {
        SimError::value(
            format!("garment {}: {name}", self.kind.name()),
            expected,
            found,
        )
    }
}
