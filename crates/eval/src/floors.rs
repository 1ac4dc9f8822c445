//! Methods that learn nothing. A learned method that does not beat them all is
//! broken.

mod frozen;
mod hold;
mod root_frame;
mod skinned;

pub use frozen::Frozen;
pub use hold::Hold;
pub use skinned::Skinned;

#[cfg(test)]
mod tests;
