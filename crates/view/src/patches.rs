//! Patches as colours: on the garments' rest positions, and in UV space.
//!
//! One row for each garment: front, back, UV map (zoomed to what is used of it). A patch has one colour in
//! all three; colours step by the golden ratio around the hue circle, so that
//! patches with neighbouring numbers differ most.

use drape_dataset::sequence::Garment;
use plotters::element::PathElement;
use plotters::style::{Color, RGBColor};

use crate::error::ViewError;
use crate::picture::{Anchor, Picture, Rgb};
use crate::raster::{Camera, Paint, Surface, render};
use crate::sheet::{BACKGROUND, INK, check_mesh};

const CELL: usize = 520;
const STRIP_HEIGHT: usize = 30;
/// Draws all garments of an outfit; `patch_of_face` holds a patch number for
/// each face of each garment, `[garment][face]`.
///
/// # Errors
/// No garments; patch numbers, faces or UV tables that do not fit each other.
pub fn patch_sheet(garments: &[Garment], patch_of_face: &[Vec<u32>]) -> Result<Picture, ViewError> {
    if garments.is_empty() {
        return Err(ViewError::Empty {
            what: "picture of patches",
            item: "garment",
        });
    }
    if patch_of_face.len() != garments.len() {
        return Err(ViewError::Mismatch {
            place: "patches".into(),
            expected: format!("{} garments", garments.len()),
            found: format!("{}", patch_of_face.len()),
        });
    }
    let row_height = CELL + STRIP_HEIGHT;
    let mut sheet = Picture::new(3 * CELL, garments.len() * row_height, BACKGROUND);
    for (row, (garment, patches)) in garments.iter().zip(patch_of_face).enumerate() {
        check(garment, patches)?;
        let colours: Vec<Rgb> = patches.iter().map(|&patch| patch_colour(patch)).collect();
        let top = row * row_height;
        let mut distinct = patches.clone();
        distinct.sort_unstable();
        distinct.dedup();
        let title = format!(
            "{}: {} patches, {} faces, {} panels",
            garment.name,
            distinct.len(),
            garment.faces.len(),
            garment.panels.len()
        );
        sheet.text(
            (14, top + STRIP_HEIGHT / 2),
            &title,
            15.0,
            Anchor::Left,
            INK,
        )?;
        let cells = [
            on_mesh(garment, &colours, 24.0),
            on_mesh(garment, &colours, 204.0),
            in_uv(garment, &colours)?,
        ];
        for (column, cell) in cells.iter().enumerate() {
            sheet.paste(cell, column * CELL, top + STRIP_HEIGHT);
        }
    }
    Ok(sheet)
}

/// Colour of a patch.
pub fn patch_colour(patch: u32) -> Rgb {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let hue = (f64::from(patch) * GOLDEN).fract();
    // Hue alone repeats visually after a dozen: vary lightness and strength too.
    let lightness = [0.62, 0.74, 0.52][patch as usize % 3];
    let strength = [0.55, 0.75][patch as usize / 3 % 2];
    let chroma = (1.0 - (2.0 * lightness - 1.0f64).abs()) * strength;
    std::array::from_fn(|channel| {
        let place = (hue * 6.0 + [0.0, 4.0, 2.0][channel]) % 6.0;
        let rise = ((place - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        ((lightness + chroma * (rise - 0.5)) * 255.0).round() as u8
    })
}

fn check(garment: &Garment, patches: &[u32]) -> Result<(), ViewError> {
    let faces = garment.faces.len();
    for (what, found) in [
        ("patch numbers", patches.len()),
        ("UV faces", garment.uv_faces.len()),
    ] {
        if found != faces {
            return Err(ViewError::Mismatch {
                place: format!("garment {}", garment.name),
                expected: format!("as many {what} as faces ({faces})"),
                found: format!("{found}"),
            });
        }
    }
    check_mesh(
        || format!("garment {}", garment.name),
        garment.rest.len(),
        &garment.faces,
    )?;
    check_mesh(
        || format!("garment {}, UV", garment.name),
        garment.uv.len(),
        &garment.uv_faces,
    )
}

fn on_mesh(garment: &Garment, colours: &[Rgb], azimuth: f32) -> Picture {
    let camera = Camera::looking(azimuth, 8.0).frame(&garment.rest, CELL, CELL);
    let paint = Paint::Faces(colours);
    let surface = Surface {
        positions: &garment.rest,
        faces: &garment.faces,
        paint,
    };
    render(&[surface], &camera, CELL, CELL, BACKGROUND)
}

fn in_uv(garment: &Garment, colours: &[Rgb]) -> Result<Picture, ViewError> {
    // UV space as a wall seen from the front: u to the right, v upwards.
    let wall: Vec<[f32; 3]> = garment.uv.iter().map(|&[u, v]| [u, 0.0, v]).collect();
    let turned: Vec<[u32; 3]> = garment
        .uv_faces
        .iter()
        .map(|&[a, b, c]| {
            let [p, q, r] = [a, b, c].map(|i| garment.uv[i as usize]);
            let area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
            if area < 0.0 { [a, c, b] } else { [a, b, c] }
        })
        .collect();
    let camera = Camera::looking(0.0, 0.0).frame(&wall, CELL, CELL);
    let surface = Surface {
        positions: &wall,
        faces: &turned,
        paint: Paint::Faces(colours),
    };
    let mut picture = render(&[surface], &camera, CELL, CELL, BACKGROUND);

    let place = |u: f32, v: f32| {
        let x = CELL as f32 / 2.0 + (u - camera.centre[0]) / camera.units_per_pixel;
        let y = CELL as f32 / 2.0 - (v - camera.centre[2]) / camera.units_per_pixel;
        (x.round() as i32, y.round() as i32)
    };
    let area = picture.drawing_area();
    let draw = |path: Vec<(i32, i32)>, opacity: f64| {
        area.draw(&PathElement::new(path, RGBColor(40, 40, 44).mix(opacity)))
            .map_err(|error| ViewError::drawing("UV map", error))
    };
    for [a, b] in drape_geometry::mesh::edges(&garment.uv_faces) {
        let [p, q] = [a, b].map(|i| garment.uv[i as usize]);
        if p.iter().chain(&q).all(|x| x.is_finite()) {
            draw(vec![place(p[0], p[1]), place(q[0], q[1])], 0.22)?;
        }
    }
    drop(area);
    Ok(picture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sheet::tests::header;

    #[test]
    fn patches_appear_on_the_mesh_and_in_uv_and_must_fit_the_faces() {
        let garments = header().garments;
        let sheet = patch_sheet(&garments, &[vec![4]]).unwrap();
        let [r, g, b] = patch_colour(4).map(i32::from);
        let similar = |x: usize, y: usize| {
            let [p, q, s] = sheet.pixel(x, y).map(i32::from);
            // Shading changes brightness, hardly the ratio of channels.
            (p * g - q * r).abs() < 2500 && (q * b - s * g).abs() < 2500 && p + q + s < 700
        };
        for column in [0, 2] {
            let count = (column * CELL..(column + 1) * CELL)
                .flat_map(|x| (STRIP_HEIGHT..sheet.height()).map(move |y| (x, y)))
                .filter(|&(x, y)| similar(x, y))
                .count();
            assert!(count > CELL * CELL / 10, "column {column}: {count} pixels");
        }
        let message = patch_sheet(&garments, &[vec![0, 1]])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("sheet") && message.contains("found 2"),
            "{message}"
        );
        assert!(matches!(
            patch_sheet(&[], &[]),
            Err(ViewError::Empty { .. })
        ));
    }

    #[test]
    fn consecutive_patches_have_clearly_different_colours() {
        for patch in 0..500 {
            let (a, b) = (patch_colour(patch), patch_colour(patch + 1));
            let apart: i32 = (0..3)
                .map(|i| (i32::from(a[i]) - i32::from(b[i])).abs())
                .sum();
            assert!(apart > 80, "patch {patch}: {a:?} and {b:?}");
        }
    }
}
