//! Landmarks of a fitted body that patterns refer to, in units.

use glam::{DVec2, DVec3};

use super::field::{ramp, vector};
use super::sections::Sections;
use crate::body::{Body, Pose, ShapedBody};
use crate::error::Result;

/// Where things are on a body in the fitting pose. The left side is given;
/// the right one is its mirror image at x → −x.
#[derive(Clone, Debug)]
pub(super) struct Anatomy {
    pub shoulder: DVec3,
    pub elbow: DVec3,
    pub wrist: DVec3,
    pub hip: DVec3,
    pub knee: DVec3,
    pub ankle: DVec3,
    pub neck: DVec3,
    pub armpit: DVec3,
    pub waist_z: f64,
    pub crotch_z: f64,
    /// Centre and half axes of the neck's section a little above its base.
    pub neck_section: (DVec2, DVec2),
    /// Hulls of the trunk and both legs, without arms.
    pub trunk: Sections,
    /// Where the neck meets the head.
    pub chin_z: f64,
    /// Hulls of head and neck, each covering what is above it from the widest level down;
    /// shoulders do not count.
    pub head: Sections,
    /// Where a hood's edge runs beside the face, seen from the side.
    pub face_y: f64,
}

impl Anatomy {
    pub fn new(
        body: &Body,
        shaped: &ShapedBody,
        pose: &Pose,
        positions: &[[f32; 3]],
    ) -> Result<Self> {
        let joints = shaped.joints(pose);
        let at = |name: &str| body.joint(name).map(|j| joints[j.index()].0);
        let mut arm = Vec::new();
        for side in ["Left", "Right"] {
            for part in ["Arm", "ForeArm", "Hand", "FingerBase", "HandFinger1"] {
                arm.push(body.joint(&format!("{side}{part}"))?);
            }
        }
        arm.push(body.joint("LThumb")?);
        arm.push(body.joint("RThumb")?);
        let chosen: Vec<bool> = body.main_joint().iter().map(|j| !arm.contains(j)).collect();
        let p: Vec<DVec3> = positions.iter().map(|&p| vector(p)).collect();
        let shoulder = at("LeftArm")?;
        let top = at("Neck")?.z;
        let hip = at("LeftUpLeg")?;
        let neck: Vec<&DVec3> = p.iter().filter(|p| (p.z - top - 0.3).abs() < 0.2).collect();
        let extent = |f: fn(&DVec3) -> f64| neck.iter().map(|p| f(p)).fold(0.0, f64::max);
        let (front, back) = (extent(|p| -p.y), extent(|p| p.y));
        // The chin is not part of the neck.
        let front = front.min(0.85 - at("Neck")?.y);
        let neck_section = (
            DVec2::new(0.0, 0.5 * (back - front)),
            DVec2::new(extent(|p| p.x).min(1.0), 0.5 * (back + front)),
        );
        let (spine, lower) = (at("Spine")?, at("LowerBack")?);
        let crown = p.iter().map(|p| p.z).fold(0.0, f64::max);
        let (neck_joint, head_joint) = (at("Neck")?, at("Head")?);
        let mut head = Sections::cut(
            &p,
            body.faces(),
            &chosen,
            0.0,
            0.15,
            (crown / 0.15) as usize + 2,
        );
        head.clear_below(neck_joint.z + 0.4);
        head.hang_from(head_joint.z + 0.8);
        Ok(Self {
            shoulder,
            elbow: at("LeftForeArm")?,
            wrist: at("LeftHand")?,
            hip,
            knee: at("LeftLeg")?,
            ankle: at("LeftFoot")?,
            neck: neck_joint,
            chin_z: head_joint.z,
            armpit: shoulder + DVec3::new(0.05, 0.0, -0.65),
            waist_z: 0.5 * (spine.z + lower.z),
            crotch_z: hip.z - 0.75,
            neck_section,
            trunk: Sections::cut(&p, body.faces(), &chosen, 0.0, 0.15, (top / 0.15) as usize),
            head,
            face_y: head_joint.y - 0.45,
        })
    }

    /// Positive on the arm's side of a plane from the armpit that halves the
    /// angle between arm and trunk; nothing below the crotch belongs to an arm.
    pub fn arm_side(&self, p: DVec3) -> f64 {
        let arm = (self.elbow - self.shoulder).normalize();
        let along = (arm - DVec3::Z).normalize(); // half way between the arm and straight down
        let away = DVec3::new(-along.z, 0.0, along.x).normalize();
        let from_armpit = DVec3::new(p.x.abs() - self.armpit.x, 0.0, p.z - self.armpit.z);
        from_armpit.dot(away).min(p.z - self.crotch_z)
    }

    /// Place along the arm: 0 shoulder, 1 elbow, 2 wrist; and how far behind that place's plane the point is, negative nearer to the shoulder.
    pub fn beyond_sleeve(&self, p: DVec3, sleeve: f64) -> f64 {
        let p = DVec3::new(p.x.abs(), p.y, p.z);
        let upper = (self.elbow - self.shoulder).normalize();
        let fore = (self.wrist - self.elbow).normalize();
        // Direction changes smoothly over the elbow.
        let axis = upper.lerp(fore, ramp(0.6, 1.4, sleeve)).normalize();
        let centre = if sleeve <= 1.0 {
            self.shoulder.lerp(self.elbow, sleeve)
        } else {
            self.elbow.lerp(self.wrist, sleeve - 1.0)
        };
        (p - centre).dot(axis)
    }

    /// Distance along the upper arm from the shoulder.
    pub fn along_arm(&self, p: DVec3) -> f64 {
        let p = DVec3::new(p.x.abs(), p.y, p.z);
        (p - self.shoulder).dot((self.elbow - self.shoulder).normalize())
    }

    /// Coronal seam surface: positive behind.
    pub fn behind(&self, p: DVec3) -> f64 {
        let x = p.x.abs();
        let line = |points: [(f64, f64); 3], t: f64| {
            let [(t0, y0), (t1, y1), (t2, y2)] = points;
            if t <= t0 {
                y0
            } else if t <= t1 {
                y0 + (y1 - y0) * ramp(t0, t1, t)
            } else {
                y1 + (y2 - y1) * ((t - t1) / (t2 - t1)).min(1.5)
            }
        };
        let arm = line(
            [
                (self.shoulder.x, self.shoulder.y),
                (self.elbow.x, self.elbow.y),
                (self.wrist.x, self.wrist.y),
            ],
            x,
        );
        let leg = line(
            [
                (-self.hip.z, self.hip.y),
                (-self.knee.z, self.knee.y + 0.1),
                (-self.ankle.z, self.ankle.y),
            ],
            -p.z,
        );
        let y = if self.arm_side(p) > 0.0 {
            arm
        } else {
            leg + (self.shoulder.y - leg) * ramp(self.hip.z, self.waist_z, p.z)
        };
        p.y - y
    }
}
