//! The fuzz target's corpus, replayed, and small changes of it: no input panics, and
//! none asks for more memory than a bound.

#[path = "../fuzz/harness.rs"]
mod harness;

use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Most bytes that may be asked for at once by an input of a few kilobytes.
const BOUND: usize = 256 << 20;

/// Counts bytes in use.
struct Counting;

static USED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let used = USED.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(used, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), Ordering::Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes of four kinds of change, a few at once.
fn changed(input: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = input.to_vec();
    for _ in 0..rng.random_range(1..5) {
        // The first byte tells what the rest is taken for.
        let at = rng.random_range(1..bytes.len());
        match rng.random_range(0..4) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][rng.random_range(0..5)],
            2 => bytes.truncate(at + 1),
            _ => {
                let end = (at + rng.random_range(1..9)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
        }
    }
    bytes
}

#[test]
fn the_corpus_and_changes_of_it_neither_panic_nor_take_much_memory() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/file");
    let mut paths: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    paths.sort();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut sound, mut tried) = (0, 0);
    for path in &paths {
        let input = fs::read(path).unwrap();
        sound += usize::from(harness::run(&input));
        for _ in 0..100 {
            let input = changed(&input, &mut rng);
            let before = USED.load(Ordering::Relaxed);
            PEAK.store(before, Ordering::Relaxed);
            harness::run(&input);
            let peak = PEAK.load(Ordering::Relaxed) - before;
            assert!(
                peak < BOUND,
                "{peak} bytes for a change of {}",
                path.display()
            );
            tried += 1;
        }
    }
    assert!(sound >= 5, "{sound} sound inputs: seeds have gone stale");
    assert!(tried >= 1000, "{tried} changes");
}
