//! All terms of one step, in memory that the next sample uses again.

use drape_dataset::sample::{Outfit, State, Step};

use super::collision::{CollisionRoom, body_collision, layer_collision};
use super::normal::{MeshNormals, NormalRoom, normal_loss};
use super::{LossConfig, LossValues, Term, Vector, position, squared_error, zeros};

/// What the losses of one step are computed from, what comes out, and room for what lies between.
#[derive(Default)]
pub struct Terms {
    /// Predicted position of each vertex: the caller's.
    pub predicted: Vec<Vector>,
    /// Predicted position of each patch: the caller's.
    pub predicted_patches: Vec<Vector>,
    /// State that each vertex shall reach: the caller's.
    pub reference: Vec<State>,
    /// Its position.
    pub truth: Vec<Vector>,
    /// Gradient of the whole loss by vertex position.
    pub by_vertex: Vec<Vector>,
    /// Gradient of the whole loss by patch position.
    pub by_patch: Vec<Vector>,
    patch_truth: Vec<Vector>,
    term: Term,
    normal_difference: Term,
    predicted_normals: NormalRoom,
    true_normals: NormalRoom,
    collision: CollisionRoom,
}

impl Terms {
    /// Values of all terms, and their gradients; `with_collisions` is false during the warm-up.
    pub fn evaluate(
        &mut self,
        config: &LossConfig,
        outfit: &Outfit,
        step: &Step,
        with_collisions: bool,
    ) -> LossValues {
        let Self {
            predicted, term, ..
        } = self;
        self.truth.clear();
        self.truth.extend(self.reference.iter().map(position));
        zeros(&mut self.by_vertex, predicted.len());
        zeros(&mut self.by_patch, self.predicted_patches.len());
        let mut values = LossValues::default();
        squared_error(predicted, &self.truth, term);
        values.position = term.add_to(&mut self.by_vertex, config.position);
        let faces = &outfit.faces;
        let predicted_normals = MeshNormals::new(predicted, faces, &mut self.predicted_normals);
        let true_normals = MeshNormals::new(&self.truth, faces, &mut self.true_normals);
        let difference = &mut self.normal_difference;
        normal_loss(&predicted_normals, &true_normals, difference, term);
        values.normal = term.add_to(&mut self.by_vertex, config.normal);
        let room = &mut self.collision;
        if with_collisions && config.body_collision > 0.0 && outfit.body_vertices > 0 {
            body_collision(
                &config.collision,
                predicted,
                &step.body,
                &outfit.body_faces,
                &outfit.body_on_border,
                room,
                term,
            );
            values.body_collision = term.add_to(&mut self.by_vertex, config.body_collision);
        }
        if with_collisions && config.layer_collision > 0.0 && outfit.garments() > 1 {
            let normals = &predicted_normals;
            layer_collision(&config.collision, outfit, predicted, normals, room, term);
            values.layer_collision = term.add_to(&mut self.by_vertex, config.layer_collision);
        }
        let patch_truth = outfit.patches.means(&self.reference);
        self.patch_truth.clear();
        self.patch_truth
            .extend(patch_truth.map(|row| position(&row)));
        squared_error(&self.predicted_patches, &self.patch_truth, term);
        values.patch = term.add_to(&mut self.by_patch, config.patch);
        values
    }
}
