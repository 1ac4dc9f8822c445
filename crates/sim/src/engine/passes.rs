//! How often each effect was computed: the evidence that an effect which a
//! scene does not call for costs nothing.

use std::collections::BTreeMap;

use drape_dataset::registry::Effect;

/// Passes per effect since the engine was made.
#[derive(Clone, Debug, Default)]
pub(super) struct Passes(BTreeMap<Effect, u64>);

impl Passes {
    pub fn count(&mut self, effect: Effect) {
        *self.0.entry(effect).or_default() += 1;
    }

    pub fn of(&self, effect: Effect) -> u64 {
        self.0.get(&effect).copied().unwrap_or(0)
    }
}
