//! Where the engine's time goes: one row per effect and stage.
//!
//! [`recorded`] runs a function and returns, beside its result, the times of
//! all engines that were made and moved by it on the calling thread. Engines
//! made elsewhere keep no time: they ask no clock.
//!
//! Times are those of the clock on the wall: other programs on the same cores
//! are in them. Friction is solved together with its contacts; its row is what
//! a pass with friction takes longer than the same pass without, which is
//! made on a copy for the comparison and counted nowhere.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use drape_dataset::registry::Effect;

/// What a row of the table is about, in the table's order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The whole of an effect that is no contact; friction's share of solving contacts.
    Effect(Effect),
    /// Inertia: predicted positions, limits of speed, new velocities.
    Inertia,
    /// Tubes, and boxes and trees around them, for all contact effects.
    Trees,
    /// A contact effect's search for pairs.
    Search(Effect),
    /// A contact effect's narrow phase: gaps and normals of its pairs.
    Narrow(Effect),
    /// A contact effect's share of the solver.
    Solve(Effect),
    /// Certifying that no pair crosses, and moving those that would.
    Certificate,
    /// Looking up what left its tube.
    Strays,
    /// Looking whether layers cross.
    Sides,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Self::Effect(effect) => effect.to_string(),
            Self::Inertia => "inertia".into(),
            Self::Trees => "contacts: tubes and trees".into(),
            Self::Search(effect) => format!("{effect}: search"),
            Self::Narrow(effect) => format!("{effect}: narrow phase"),
            Self::Solve(effect) => format!("{effect}: solve"),
            Self::Certificate => "contacts: certificate".into(),
            Self::Strays => "contacts: strays".into(),
            Self::Sides => "layers' sides".into(),
        };
        f.pad(&text)
    }
}

/// Time and number of runs of one part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Spent {
    /// Time in all.
    pub time: Duration,
    /// How often it ran.
    pub runs: u64,
}

/// Times of all parts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Profile {
    /// Frames that engines moved.
    pub frames: u64,
    /// Time in [`Engine::advance`](super::Engine::advance), what is in no part included.
    pub total: Duration,
    /// Parts that ran; a fixed order.
    pub parts: BTreeMap<Part, Spent>,
}

impl Profile {
    /// Adds another profile's times and runs.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.total += other.total;
        for (&part, spent) in &other.parts {
            let sum = self.parts.entry(part).or_default();
            sum.time += spent.time;
            sum.runs += spent.runs;
        }
    }

    /// Time that is in no part.
    pub fn rest(&self) -> Duration {
        let parts = self.parts.values().map(|spent| spent.time).sum();
        self.total.saturating_sub(parts)
    }
}

/// The table.
impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let frames = self.frames.max(1) as f64;
        let ms = |time: Duration| 1e3 * time.as_secs_f64() / frames;
        let all = self.total.as_secs_f64().max(f64::MIN_POSITIVE);
        let share = |time: Duration| 100.0 * time.as_secs_f64() / all;
        writeln!(
            f,
            "{:30} {:>9} {:>7} {:>11}",
            "part", "ms/frame", "share", "runs/frame"
        )?;
        for (part, spent) in &self.parts {
            writeln!(
                f,
                "{part:30} {:>9.3} {:>6.1}% {:>11.1}",
                ms(spent.time),
                share(spent.time),
                spent.runs as f64 / frames
            )?;
        }
        let rest = self.rest();
        writeln!(
            f,
            "{:30} {:>9.3} {:>6.1}%",
            "the rest",
            ms(rest),
            share(rest)
        )?;
        write!(
            f,
            "{:30} {:>9.3} {:>6.1}%  over {} frames",
            "all",
            ms(self.total),
            100.0,
            self.frames
        )
    }
}

thread_local! {
    static RECORDING: RefCell<Option<Profile>> = const { RefCell::new(None) };
}

/// Runs `work` and tells where the engines it makes on this thread spend their
/// time. Within another recording, both get the times.
pub fn recorded<T>(work: impl FnOnce() -> T) -> (T, Profile) {
    let outer = RECORDING.replace(Some(Profile::default()));
    let result = work();
    let profile = RECORDING.replace(outer).unwrap_or_default();
    note(&profile);
    (result, profile)
}

/// Adds to the recording that is going on in this thread, if any.
fn note(profile: &Profile) {
    RECORDING.with_borrow_mut(|recording| {
        if let Some(recording) = recording {
            recording.add(profile);
        }
    });
}

/// An engine's own clock; off unless the engine was made within [`recorded`].
#[derive(Clone, Debug)]
pub(super) struct Stopwatch(Option<Box<Running>>);

#[derive(Clone, Debug, Default)]
struct Running {
    profile: Profile,
    /// Time spent on measuring, no part of the frame.
    aside: Duration,
}

impl Stopwatch {
    /// On if this thread is recording.
    pub fn new() -> Self {
        let on = RECORDING.with_borrow(Option::is_some);
        Self(on.then(Box::default))
    }

    /// Now, if anybody asks.
    #[inline]
    pub fn start(&self) -> Option<Instant> {
        self.0.is_some().then(Instant::now)
    }

    /// Measures something on the side, if anybody asks; `work` times itself.
    pub fn aside(&mut self, work: impl FnOnce() -> Duration) -> Option<Duration> {
        let running = self.0.as_mut()?;
        let start = Instant::now();
        let time = work();
        running.aside += start.elapsed();
        Some(time)
    }

    /// Gives the time since `start` to a part.
    #[inline]
    pub fn stop(&mut self, part: Part, start: Option<Instant>) {
        if let Some(start) = start {
            self.give(part, start.elapsed());
        }
    }

    /// Gives a run of this length to a part.
    pub fn give(&mut self, part: Part, time: Duration) {
        if let Some(running) = &mut self.0 {
            let spent = running.profile.parts.entry(part).or_default();
            spent.time += time;
            spent.runs += 1;
        }
    }

    /// A frame that began at `start` is done: its times go to the recording.
    pub fn end_frame(&mut self, start: Option<Instant>) {
        if let (Some(running), Some(start)) = (&mut self.0, start) {
            running.profile.frames += 1;
            running.profile.total += start.elapsed().saturating_sub(running.aside);
            note(&running.profile);
            **running = Running::default();
        }
    }
}
