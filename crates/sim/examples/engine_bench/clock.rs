//! Processor time of this thread.

use std::time::Instant;

/// Measures processor time where the system tells it, else time on the wall.
pub struct Clock {
    wall: Instant,
    cpu_ns: Option<u64>,
}

impl Clock {
    pub fn start() -> Self {
        Self {
            wall: Instant::now(),
            cpu_ns: cpu_ns(),
        }
    }

    /// Seconds since the start.
    pub fn seconds(&self) -> f64 {
        match (self.cpu_ns, cpu_ns()) {
            (Some(start), Some(now)) => 1e-9 * (now - start) as f64,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }

    /// What [`Clock::seconds`] measures here.
    pub fn kind() -> &'static str {
        if cpu_ns().is_some() {
            "processor time"
        } else {
            "time on the wall: this system does not tell processor time"
        }
    }
}

/// Linux: the first number is the time spent on a processor, in nanoseconds.
fn cpu_ns() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split_whitespace().next()?.parse().ok()
}
