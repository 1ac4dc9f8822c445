//! UVs of an imported outfit: into `[0, 1]` by one factor for all garments, and
//! the metres that one UV unit then stands for, from the ratio of the areas in
//! space and in UV.

use crate::error::{DatasetError, Result};
use crate::import::density::{DENSITY_TOLERANCE, area, uv_area};
use crate::sequence::Garment;

/// Metres that one UV unit stands for after the import (the source's UVs are
/// scaled into `[0, 1]` by one factor for the whole outfit). The same for
/// every file, so that patches are equally large in UV, too; a larger outfit
/// raises it to its own size.
pub const METRES_PER_UV: f32 = 3.0;

/// Scales all UVs into `[0, 1]` by one factor; returns metres per UV unit,
/// from the ratio of the garments' areas in space and in UV.
pub(super) fn fit_uv(
    garments: &mut [Garment],
    scale: f64,
    warnings: &mut Vec<String>,
) -> Result<f32> {
    let mut total = (0.0, 0.0);
    let mut largest_extent = 0.0f64;
    let mut densities = Vec::new();
    let mut corners = Vec::new();
    for garment in garments.iter() {
        garment_indices_fit(garment)?;
        let (space, uv) = (area(&garment.rest, &garment.faces), uv_area(garment));
        total = (total.0 + space, total.1 + uv);
        densities.push((space / uv).sqrt() / scale);
        let corner: [f32; 2] =
            std::array::from_fn(|k| garment.uv.iter().map(|uv| uv[k]).fold(f32::MAX, f32::min));
        for uv in &garment.uv {
            for k in 0..2 {
                largest_extent = largest_extent.max(f64::from(uv[k]) - f64::from(corner[k]));
            }
        }
        corners.push(corner);
    }
    let source = (total.0 / total.1).sqrt() / scale;
    let metres_per_uv = f64::from(METRES_PER_UV).max(largest_extent * source);
    let factor = source / metres_per_uv;
    for (garment, corner) in garments.iter_mut().zip(corners) {
        for uv in &mut garment.uv {
            // Rounding may push the largest one a hair past 1.
            *uv = std::array::from_fn(|k| {
                ((f64::from(uv[k]) - f64::from(corner[k])) * factor).min(1.0) as f32
            });
        }
    }
    warnings.push(format!(
        "metres_per_uv estimated from areas: {source:.4} m per unit of the source, UVs scaled \
         to {metres_per_uv:.4}"
    ));
    for (garment, density) in garments.iter().zip(densities) {
        if (density / source - 1.0).abs() > DENSITY_TOLERANCE {
            warnings.push(format!(
                "garment {:?} alone has {density:.4} m per UV unit of the source: its patches \
                 differ in size",
                garment.name
            ));
        }
    }
    Ok(metres_per_uv as f32)
}

/// Areas need valid indices before the header's check runs.
fn garment_indices_fit(garment: &Garment) -> Result<()> {
    let invalid = |place: &str, expected: &str, found: String| {
        Err(DatasetError::invalid(
            format!("garment {:?}, {place}", garment.name),
            expected,
            found,
        ))
    };
    let vertices = garment.rest.len();
    if let Some(i) = garment
        .faces
        .as_flattened()
        .iter()
        .find(|&&i| i as usize >= vertices)
    {
        return invalid("faces", &format!("indices below {vertices}"), i.to_string());
    }
    let (space, uv) = (area(&garment.rest, &garment.faces), uv_area(garment));
    if !(space > 0.0 && uv > 0.0) {
        return invalid("rest and UV", "areas above 0", format!("{space} and {uv}"));
    }
    Ok(())
}
