//! Closed lists that files refer to by name: garment kinds and effects.

use serde::{Deserialize, Serialize};

/// The paper's seven garment types (its Table 5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GarmentKind {
    /// Jacket, open at the front.
    Jacket,
    /// Jacket with a hood.
    JacketHood,
    /// Dress.
    Dress,
    /// Jumpsuit.
    Jumpsuit,
    /// Skirt.
    Skirt,
    /// Pants.
    Pants,
    /// T-shirt.
    TShirt,
}

/// One physical influence that a scene may call for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// Gravity.
    Gravity,
    /// Wind that pushes on faces.
    Wind,
    /// Drag of still air.
    AirDrag,
    /// Resistance to stretching and compressing along edges.
    Stretch,
    /// Resistance to shear.
    Shear,
    /// Resistance to bending.
    Bending,
    /// Contact between garments and the body.
    BodyContact,
    /// Contact between different garments.
    LayerContact,
    /// Contact of a garment with itself.
    SelfContact,
    /// Friction in contacts.
    Friction,
    /// A waist band that follows the body.
    Waistband,
}
