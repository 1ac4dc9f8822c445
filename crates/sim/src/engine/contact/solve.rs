//! Solving contacts: push apart along fixed normals, rub by Coulomb's law.
//!
//! A contact asks for n·Σ w p ≥ target at the substep's end, with normal and
//! weights fixed at its start. The target is the thickness for pairs that
//! still have room, so that what approaches lands at its distance without a
//! bounce; pairs that are too close are pushed apart at a limited speed, and
//! that speed is taken back from the velocities afterwards, so closing a
//! defect adds no energy.

use glam::DVec3;

use super::pair::{Pair, Separation};
use crate::engine::friction;
use crate::engine::state::State;

/// One contact of the present substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact {
    pub vertices: [u32; 4],
    pub weights: [f64; 4],
    pub normal: DVec3,
    pub target: f64,
    pub friction: f64,
    /// 1 / Σ w² m⁻¹.
    pub mobility: f64,
    /// Distance that is only pushed out, not moved to by inertia.
    pub pushed: f64,
    /// Total push so far.
    pub lambda: f64,
    /// Total push along the surface so far.
    pub rubbed: DVec3,
}

/// How fast defects are closed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PushOut {
    /// Largest distance per substep while the gap is positive, m.
    pub close: f64,
    /// The same while it is negative, m.
    pub through: f64,
}

impl Contact {
    /// `None` if nothing in the pair can move.
    pub fn new(
        pair: &Pair,
        separation: &Separation,
        gap: f64,
        push: PushOut,
        state: &State,
    ) -> Option<Self> {
        let mut inverse = 0.0;
        for (weight, &v) in separation.weights.iter().zip(&pair.vertices) {
            inverse += weight * weight * state.w[v as usize];
        }
        if inverse <= 0.0 {
            return None;
        }
        let thickness = f64::from(pair.thickness);
        let step = if gap < 0.0 { push.through } else { push.close };
        let target = thickness.min(gap + step);
        Some(Self {
            vertices: pair.vertices,
            weights: separation.weights,
            normal: pair.normal,
            target,
            friction: f64::from(pair.friction),
            mobility: 1.0 / inverse,
            pushed: if gap < thickness { target - gap } else { 0.0 },
            lambda: 0.0,
            rubbed: DVec3::ZERO,
        })
    }

    fn combine(&self, from: &[DVec3]) -> DVec3 {
        combine(&self.weights, &self.vertices, from)
    }
}

/// Σ w x.
#[inline(always)]
pub(crate) fn combine(weights: &[f64; 4], vertices: &[u32; 4], from: &[DVec3]) -> DVec3 {
    let at = |k: usize| weights[k] * from[vertices[k] as usize];
    at(0) + at(1) + at(2) + at(3)
}

/// One pass over contacts; `rub` adds friction.
pub(crate) fn solve(contacts: &mut [Contact], state: &mut State, rub: bool) {
    for contact in contacts {
        let d = contact.combine(&state.p);
        let missing = contact.target - contact.normal.dot(d);
        // A contact that pushed too far in an earlier pass gives back, but never pulls.
        let lambda = (missing * contact.mobility).max(-contact.lambda);
        contact.lambda += lambda;
        let mut push = lambda * contact.normal;
        if rub && contact.lambda > 0.0 {
            let slid = d - contact.combine(&state.x);
            let limit = contact.friction * contact.lambda;
            let rubbed = friction::total(
                contact.rubbed,
                slid,
                contact.normal,
                limit,
                contact.mobility,
            );
            push += rubbed - contact.rubbed;
            contact.rubbed = rubbed;
        }
        if push == DVec3::ZERO {
            continue;
        }
        for (weight, &v) in contact.weights.iter().zip(&contact.vertices) {
            let i = v as usize;
            state.p[i] += (state.w[i] * weight) * push;
        }
    }
}

/// Takes the speed of pushing out back from the velocities.
pub(crate) fn forget_push(contacts: &[Contact], state: &mut State, h: f64) {
    for contact in contacts {
        if contact.lambda <= 0.0 || contact.pushed <= 0.0 {
            continue;
        }
        let separating = contact.normal.dot(contact.combine(&state.v));
        let excess = separating.min(contact.pushed / h);
        if excess > 0.0 {
            for (weight, &v) in contact.weights.iter().zip(&contact.vertices) {
                let i = v as usize;
                state.v[i] -= (state.w[i] * weight * excess * contact.mobility) * contact.normal;
            }
        }
    }
}
