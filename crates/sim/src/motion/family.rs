//! Families of motions: what a body does in the main, with seeded parameters
//! and mostly a second movement blended in.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::Motion;
use super::movement::Movement;

/// What a motion is in the main.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionFamily {
    /// Any of walk, turn, arm raise, squat and bow, all of them calm.
    Mixed,
    /// Walking, straight or in a curve.
    Walk,
    /// Running.
    Run,
    /// Knees up in turn, on the spot.
    March,
    /// One to two turns of the whole body on the spot.
    Spin,
    /// Arms go up.
    ArmRaise,
    /// Arms swing forward and back.
    ArmSwing,
    /// Arms cross in front of the chest.
    CrossArms,
    /// Knees bend half or deep down.
    Squat,
    /// Knees bend as far as they can.
    DeepSquat,
    /// The torso twists and sways.
    Twist,
    /// The torso bends forward.
    Bow,
    /// A leg goes up slowly.
    LegLift,
    /// A leg is thrown forward.
    Kick,
    /// Jumps from a crouch.
    Jump,
    /// A long step forward, knees bent.
    Lunge,
    /// Hips, torso, arms and heading at the same time.
    Dance,
}

impl MotionFamily {
    /// Every family but the mixed one.
    pub const SINGLE: [Self; 16] = [
        Self::Walk,
        Self::Run,
        Self::March,
        Self::Spin,
        Self::ArmRaise,
        Self::ArmSwing,
        Self::CrossArms,
        Self::Squat,
        Self::DeepSquat,
        Self::Twist,
        Self::Bow,
        Self::LegLift,
        Self::Kick,
        Self::Jump,
        Self::Lunge,
        Self::Dance,
    ];

    /// Draws a motion of the family, at a brisk pace.
    pub fn sample(self, rng: &mut ChaCha8Rng) -> Motion {
        if self == Self::Mixed {
            return mixed(rng);
        }
        let main = Draw(rng).main(self);
        let mut movements = main;
        if rng.random_bool(0.6) {
            movements.extend(Draw(rng).blend(self));
        }
        Motion {
            movements,
            arms_down_deg: rng.random_range(0.0..12.0),
            clip: None,
        }
    }
}

/// Draws movements.
struct Draw<'a>(&'a mut ChaCha8Rng);

impl Draw<'_> {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    fn phase(&mut self) -> f64 {
        self.between(0.0, 1.0)
    }

    fn coin(&mut self) -> bool {
        self.0.random_bool(0.5)
    }

    /// To either side.
    fn signed(&mut self, low: f64, high: f64) -> f64 {
        let size = self.between(low, high);
        if self.coin() { size } else { -size }
    }

    /// The family's own movements.
    fn main(&mut self, family: MotionFamily) -> Vec<Movement> {
        match family {
            MotionFamily::Mixed => Vec::new(),
            MotionFamily::Walk => vec![Movement::Walk {
                period_s: self.between(1.0, 1.4),
                stride_deg: self.between(16.0, 28.0),
                arms: self.between(0.5, 1.1),
                phase: self.phase(),
            }],
            MotionFamily::Run => vec![Movement::Run {
                period_s: self.between(0.7, 0.9),
                stride_deg: self.between(24.0, 36.0),
                phase: self.phase(),
            }],
            MotionFamily::March => vec![Movement::March {
                angle_deg: self.between(40.0, 65.0),
                period_s: self.between(1.1, 1.6),
                phase: self.phase(),
            }],
            MotionFamily::Spin => vec![
                Movement::Turn {
                    angle_deg: self.signed(360.0, 720.0),
                    start_s: self.between(0.0, 0.4),
                    duration_s: self.between(2.0, 2.6),
                },
                self.arm_raise(20.0, 60.0),
            ],
            MotionFamily::ArmRaise => vec![self.arm_raise(60.0, 115.0)],
            MotionFamily::ArmSwing => vec![Movement::ArmSwing {
                angle_deg: self.between(35.0, 70.0),
                period_s: self.between(1.0, 1.8),
                phase: self.phase(),
            }],
            MotionFamily::CrossArms => vec![Movement::CrossArms {
                angle_deg: self.between(55.0, 63.0),
                period_s: self.between(1.6, 2.6),
                phase: self.phase(),
            }],
            MotionFamily::Squat => vec![self.squat(55.0, 100.0)],
            MotionFamily::DeepSquat => vec![self.squat(105.0, 120.0)],
            MotionFamily::Twist => vec![
                Movement::Twist {
                    angle_deg: self.between(25.0, 45.0),
                    period_s: self.between(1.4, 2.4),
                    phase: self.phase(),
                },
                self.sway(),
            ],
            MotionFamily::Bow => vec![Movement::Bow {
                angle_deg: self.between(35.0, 75.0),
                period_s: self.between(2.0, 3.2),
                phase: self.phase(),
            }],
            MotionFamily::LegLift => vec![Movement::LegLift {
                left: self.coin(),
                angle_deg: self.between(40.0, 70.0),
                period_s: self.between(1.8, 2.8),
                phase: self.phase(),
            }],
            MotionFamily::Kick => vec![Movement::Kick {
                left: self.coin(),
                angle_deg: self.between(50.0, 75.0),
                period_s: self.between(1.4, 2.0),
                phase: self.phase(),
            }],
            MotionFamily::Jump => vec![Movement::Jump {
                height_m: self.between(0.12, 0.35),
                period_s: self.between(1.6, 2.2),
                phase: self.phase(),
            }],
            MotionFamily::Lunge => vec![Movement::Lunge {
                left: self.coin(),
                knee_deg: self.between(60.0, 85.0),
                period_s: self.between(1.8, 2.8),
                phase: self.phase(),
            }],
            MotionFamily::Dance => vec![
                self.sway(),
                self.arm_raise(50.0, 100.0),
                Movement::Twist {
                    angle_deg: self.between(15.0, 30.0),
                    period_s: self.between(1.2, 2.0),
                    phase: self.phase(),
                },
                self.turn(40.0, 120.0),
            ],
        }
    }

    /// A second movement that goes with the family.
    fn blend(&mut self, family: MotionFamily) -> Vec<Movement> {
        match family {
            MotionFamily::Mixed | MotionFamily::Spin | MotionFamily::Dance => Vec::new(),
            MotionFamily::Walk | MotionFamily::Run | MotionFamily::March => {
                vec![self.turn(20.0, 70.0)]
            }
            MotionFamily::ArmRaise | MotionFamily::ArmSwing => {
                vec![if self.coin() {
                    self.sway()
                } else {
                    self.turn(20.0, 60.0)
                }]
            }
            MotionFamily::CrossArms | MotionFamily::LegLift | MotionFamily::Kick => {
                vec![self.turn(20.0, 50.0)]
            }
            MotionFamily::Squat
            | MotionFamily::DeepSquat
            | MotionFamily::Jump
            | MotionFamily::Lunge
            | MotionFamily::Twist
            | MotionFamily::Bow => vec![self.arm_raise(15.0, 50.0)],
        }
    }

    fn arm_raise(&mut self, low: f64, high: f64) -> Movement {
        let angle = self.between(low, high);
        let other = if self.0.random_bool(0.3) { 0.3 } else { 1.0 };
        Movement::ArmRaise {
            angle_deg: [angle, other * angle],
            period_s: self.between(1.8, 3.2),
            phase: self.phase(),
        }
    }

    fn squat(&mut self, low: f64, high: f64) -> Movement {
        Movement::Squat {
            knee_deg: self.between(low, high),
            period_s: self.between(2.0, 3.0),
            phase: self.phase(),
        }
    }

    fn sway(&mut self) -> Movement {
        Movement::Sway {
            angle_deg: self.between(6.0, 14.0),
            period_s: self.between(1.4, 2.4),
            phase: self.phase(),
        }
    }

    fn turn(&mut self, low: f64, high: f64) -> Movement {
        Movement::Turn {
            angle_deg: self.signed(low, high),
            start_s: self.between(0.0, 0.5),
            duration_s: self.between(1.2, 2.0),
        }
    }
}

/// A calm main movement and mostly a second one.
fn mixed(rng: &mut ChaCha8Rng) -> Motion {
    let mut movements = Vec::new();
    let side = |rng: &mut _, low: f64, high: f64| {
        let size = Rng::random_range(rng, low..high);
        if Rng::random_bool(rng, 0.5) {
            size
        } else {
            -size
        }
    };
    let arm_raise = |rng: &mut _| {
        let angle = Rng::random_range(rng, 50.0..100.0);
        let one = Rng::random_bool(rng, 0.3);
        Movement::ArmRaise {
            angle_deg: [angle, if one { 0.3 * angle } else { angle }],
            period_s: Rng::random_range(rng, 2.2..3.4),
            phase: Rng::random_range(rng, 0.0..1.0),
        }
    };
    match rng.random_range(0..6) {
        0 | 1 => {
            movements.push(Movement::Walk {
                period_s: rng.random_range(1.1..1.4),
                stride_deg: rng.random_range(16.0..26.0),
                arms: rng.random_range(0.6..1.1),
                phase: rng.random_range(0.0..1.0),
            });
            if rng.random_bool(0.5) {
                movements.push(Movement::Turn {
                    angle_deg: side(rng, 20.0, 50.0),
                    start_s: rng.random_range(0.0..0.5),
                    duration_s: rng.random_range(1.2..1.8),
                });
            }
        }
        2 => {
            movements.push(Movement::Turn {
                angle_deg: side(rng, 30.0, 70.0),
                start_s: rng.random_range(0.0..0.4),
                duration_s: rng.random_range(1.3..2.0),
            });
            movements.push(if rng.random_bool(0.5) {
                arm_raise(rng)
            } else {
                Movement::Sway {
                    angle_deg: rng.random_range(8.0..14.0),
                    period_s: rng.random_range(1.6..2.4),
                    phase: rng.random_range(0.0..1.0),
                }
            });
        }
        3 => {
            movements.push(arm_raise(rng));
            movements.push(if rng.random_bool(0.5) {
                Movement::Twist {
                    angle_deg: rng.random_range(20.0..40.0),
                    period_s: rng.random_range(1.8..2.8),
                    phase: rng.random_range(0.0..1.0),
                }
            } else {
                Movement::LegLift {
                    left: rng.random_bool(0.5),
                    angle_deg: rng.random_range(35.0..60.0),
                    period_s: rng.random_range(2.0..3.0),
                    phase: rng.random_range(0.0..1.0),
                }
            });
        }
        4 => {
            movements.push(Movement::Squat {
                knee_deg: rng.random_range(60.0..100.0),
                period_s: rng.random_range(2.0..3.2),
                phase: rng.random_range(0.0..1.0),
            });
            if rng.random_bool(0.5) {
                movements.push(arm_raise(rng));
            }
        }
        _ => {
            movements.push(Movement::Bow {
                angle_deg: rng.random_range(30.0..60.0),
                period_s: rng.random_range(2.0..3.2),
                phase: rng.random_range(0.0..1.0),
            });
            movements.push(Movement::Twist {
                angle_deg: rng.random_range(20.0..35.0),
                period_s: rng.random_range(1.8..2.6),
                phase: rng.random_range(0.0..1.0),
            });
        }
    }
    Motion {
        movements,
        arms_down_deg: rng.random_range(0.0..10.0),
        clip: None,
    }
}
