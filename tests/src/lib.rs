//! Tests across crates, and the comparison with reference numbers that the
//! binary `oracle` prints.

pub mod dense_attention;
pub mod example;
pub mod oracle;
pub mod programs;
pub mod scene;
