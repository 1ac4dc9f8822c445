//! Closed lists that files refer to by name: garment kinds and effects.
//!
//! Files hold the names of [`GarmentKind::name`] and [`Effect::name`]
//! (kebab-case); tables print `Display` (the paper's spelling). The lists are
//! part of the format: `data-spec/README.md` repeats them.

/// Declares a registry: the enum, its names in files, its titles in tables.
macro_rules! registry {
    (
        $(#[$doc:meta])* $name:ident, $what:literal;
        $($(#[$variant_doc:meta])* $variant:ident = $file:literal, $title:literal;)*
    ) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash,
            serde::Serialize, serde::Deserialize,
        )]
        pub enum $name {
            $($(#[$variant_doc])* #[serde(rename = $file)] $variant,)*
        }

        impl $name {
            /// Every entry, in the registry's order.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Name in files and on the command line.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $file,)* }
            }
        }

        /// Title in tables; honours width and alignment.
        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(match self { $(Self::$variant => $title,)* })
            }
        }

        impl std::str::FromStr for $name {
            type Err = $crate::DatasetError;

            fn from_str(name: &str) -> Result<Self, $crate::DatasetError> {
                match name {
                    $($file => Ok(Self::$variant),)*
                    other => Err($crate::DatasetError::invalid(
                        $what,
                        concat!("one of" $(, " ", $file)*),
                        format!("{other:?}"),
                    )),
                }
            }
        }
    };
}

pub(crate) use registry;

registry! {
    /// The paper's seven garment types (its Table 5).
    GarmentKind, "garment kind";
    /// Jacket, open at the front.
    Jacket = "jacket", "Jacket";
    /// Jacket with a hood.
    JacketHood = "jacket-hood", "Jacket + Hood";
    /// Dress.
    Dress = "dress", "Dress";
    /// Jumpsuit.
    Jumpsuit = "jumpsuit", "Jumpsuit";
    /// Skirt.
    Skirt = "skirt", "Skirt";
    /// Pants.
    Pants = "pants", "Pants";
    /// T-shirt.
    TShirt = "t-shirt", "T-shirt";
}

registry! {
    /// One physical influence that a scene may call for.
    Effect, "effect";
    /// Gravity.
    Gravity = "gravity", "gravity";
    /// Wind that pushes on faces.
    Wind = "wind", "wind";
    /// Drag of still air.
    AirDrag = "air-drag", "air drag";
    /// Resistance to stretching and compressing along edges.
    Stretch = "stretch", "stretch";
    /// Resistance to shear.
    Shear = "shear", "shear";
    /// Resistance to bending.
    Bending = "bending", "bending";
    /// Contact between garments and the body.
    BodyContact = "body-contact", "body contact";
    /// Contact between different garments.
    LayerContact = "layer-contact", "layer contact";
    /// Contact of a garment with itself.
    SelfContact = "self-contact", "self contact";
    /// Friction in contacts.
    Friction = "friction", "friction";
    /// A waist band that follows the body.
    Waistband = "waistband", "waistband";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_parses_back_and_serde_uses_the_same_name() {
        for &kind in GarmentKind::ALL {
            assert_eq!(kind.name().parse::<GarmentKind>().unwrap(), kind);
            assert_eq!(
                serde_json::to_string(&kind).unwrap(),
                format!("{:?}", kind.name())
            );
        }
        for &effect in Effect::ALL {
            assert_eq!(effect.name().parse::<Effect>().unwrap(), effect);
            assert_eq!(
                serde_json::to_string(&effect).unwrap(),
                format!("{:?}", effect.name())
            );
        }
        assert_eq!(GarmentKind::JacketHood.to_string(), "Jacket + Hood");
        let message = "cape".parse::<GarmentKind>().unwrap_err().to_string();
        assert!(
            message.contains("jacket-hood") && message.contains("\"cape\""),
            "{message}"
        );
    }
}
