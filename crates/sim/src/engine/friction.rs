//! Coulomb friction of a contact, on positions: what slides along the surface
//! in a substep is taken back, in all by at most μ times the push along the
//! normal.

use glam::DVec3;

/// New total push along the surface, after `rubbed` so far, for a contact that
/// slid by `slid`; no longer than `limit`.
pub(super) fn total(rubbed: DVec3, slid: DVec3, normal: DVec3, limit: f64, mobility: f64) -> DVec3 {
    let tangent = slid - slid.dot(normal) * normal;
    let wanted = rubbed - tangent * mobility;
    let length = wanted.length();
    if length > limit {
        wanted * (limit / length)
    } else {
        wanted
    }
}
