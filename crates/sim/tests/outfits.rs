//! What every outfit that is handed out guarantees, on drawn bodies and cuts.

use drape_dataset::patches::Patches;
use drape_geometry::intersect::{count_between, count_within};
use drape_geometry::mesh;
use drape_sim::body::Body;
use drape_sim::engine::EngineSettings;
use drape_sim::garment::{METRES_PER_UV, Outfit, OutfitRequest};
use drape_sim::scene::SceneRanges;
use rayon::prelude::*;

/// Outfits of `count` drawn recipes; those that do not fit say so and are drawn again by the program.
fn drawn(count: usize) -> Vec<Outfit> {
    let ranges = SceneRanges::default();
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
    let outfits = drawn(4);
    assert!(outfits.len() >= 3, "only {} of 4 fit", outfits.len());
    for outfit in &outfits {
        let mut vertices = 0;
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
            vertices += garment.rest.len();
        }
        assert!((1350..2600).contains(&vertices), "{vertices} vertices");
        let patches = Patches::of_outfit(&outfit.garments, 0.06 / METRES_PER_UV as f32);
        assert!(patches.unwrap().count() >= 300);
    }
}
