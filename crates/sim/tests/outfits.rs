//! What every outfit that is handed out guarantees, on drawn bodies and cuts.

use std::collections::BTreeSet;

use drape_dataset::patches::Patches;
use drape_dataset::registry::GarmentKind;
use drape_geometry::intersect::{count_between, count_within};
use drape_geometry::mesh;
use drape_sim::body::Body;
use drape_sim::engine::EngineSettings;
use drape_sim::garment::{METRES_PER_UV, Outfit, OutfitRequest};
use drape_sim::scene::SceneRanges;
use rayon::prelude::*;

/// Outfits of `count` drawn recipes; those that do not fit say so and are drawn again by the program.
fn drawn(ranges: &SceneRanges, count: usize) -> Vec<Outfit> {
    let body = Body::load().unwrap();
    (0..count)
        .into_par_iter()
        .filter_map(|number| {
            let name = format!("law_{number:04}");
            let recipe = ranges.sample(&name, number, 5, 48, &EngineSettings::default());
            let garments: Vec<_> = recipe
                .garments
                .iter()
                .map(|garment| (garment.parameters, garment.material))
                .collect();
            let request = OutfitRequest {
                garments: &garments,
                edge_m: recipe.edge_m,
                trimmed_layers: recipe.trimmed_layers,
            };
            Outfit::fit(&body, &body.shaped(&recipe.shape), &request)
                .map_err(|error| println!("{name}: {error}"))
                .ok()
        })
        .collect()
}

#[test]
fn outfits_are_free_of_intersections_even_and_large_enough_for_the_model() {
    let body = Body::load().unwrap();
    let outfits = drawn(&SceneRanges::default(), 4);
    assert!(outfits.len() >= 3, "only {} of 4 fit", outfits.len());
    for outfit in &outfits {
        check(&body, outfit);
        let vertices: usize = outfit.garments.iter().map(|g| g.rest.len()).sum();
        assert!((1350..2600).contains(&vertices), "{vertices} vertices");
        let patches = Patches::of_outfit(&outfit.garments, 0.06 / METRES_PER_UV as f32);
        assert!(patches.unwrap().count() >= 300);
    }
}

#[test]
fn every_kind_in_up_to_three_layers_fits_without_intersections_on_drawn_bodies() {
    let body = Body::load().unwrap();
    let ranges = wardrobe();
    let asked = 2 * ranges.outfits.len();
    let outfits = drawn(&ranges, asked);
    println!("{} of {asked} outfits fit at the first draw", outfits.len());
    assert!(
        100 * outfits.len() >= 95 * asked,
        "{} of {asked} fit",
        outfits.len()
    );
    let mut kinds = BTreeSet::new();
    let mut layers = BTreeSet::new();
    for outfit in &outfits {
        check(&body, outfit);
        kinds.extend(outfit.garments.iter().map(|garment| garment.kind));
        layers.insert(outfit.garments.len());
    }
    assert_eq!(kinds.len(), GarmentKind::ALL.len(), "{kinds:?}");
    assert_eq!(layers, BTreeSet::from([1, 2, 3]));
}

/// The ranges of `configs/wardrobe.toml`.
fn wardrobe() -> SceneRanges {
    let text = include_str!("../../../configs/wardrobe.toml");
    let mut table: toml::Table = toml::from_str(text).unwrap();
    table.remove("scene").unwrap().try_into().unwrap()
}

/// Whole meshes, no intersection anywhere, panels of the garment's own size.
fn check(body: &Body, outfit: &Outfit) {
    for (i, garment) in outfit.garments.iter().enumerate() {
        garment.check().unwrap();
        mesh::validate(&garment.rest, &garment.faces).unwrap();
        assert_eq!(count_within(&garment.rest, &garment.faces), 0);
        let against = |positions: &[[f32; 3]], faces: &[[u32; 3]]| {
            count_between(&garment.rest, &garment.faces, positions, faces)
        };
        assert_eq!(against(&outfit.body, body.faces()), 0, "{}", garment.name);
        for other in &outfit.garments[i + 1..] {
            assert_eq!(against(&other.rest, &other.faces), 0, "{}", other.name);
        }
        let mut used = vec![false; garment.rest.len()];
        garment
            .faces
            .iter()
            .flatten()
            .for_each(|&v| used[v as usize] = true);
        assert!(used.into_iter().all(|used| used), "{}", garment.name);
        let area = |uv: bool| -> f64 {
            let corners = |face: usize| -> [[f64; 3]; 3] {
                std::array::from_fn(|k| {
                    if uv {
                        let [u, v] = garment.uv[garment.uv_faces[face][k] as usize];
                        [u, v, 0.0].map(|x| f64::from(x) * METRES_PER_UV * 10.0)
                    } else {
                        garment.rest[garment.faces[face][k] as usize].map(f64::from)
                    }
                })
            };
            (0..garment.faces.len())
                .map(|face| {
                    let [a, b, c] = corners(face).map(glam::DVec3::from_array);
                    0.5 * (b - a).cross(c - a).length()
                })
                .sum()
        };
        // Panels have the garment's own size: one texel density.
        let share = area(true) / area(false);
        assert!((0.93..1.07).contains(&share), "{}: {share}", garment.name);
    }
}
