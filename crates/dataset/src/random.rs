//! Named random streams: one seed, one stream per consumer.
//!
//! The stream's number is the first eight bytes of SHA-256 of the consumer's
//! name, so adding a consumer changes nobody else's numbers.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

/// The stream of consumer `name` under `seed`.
pub fn stream(seed: u64, name: &str) -> ChaCha8Rng {
    let digest = Sha256::digest(name.as_bytes());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(u64::from_le_bytes(
        digest[..8].try_into().expect("a digest has 32 bytes"),
    ));
    rng
}
