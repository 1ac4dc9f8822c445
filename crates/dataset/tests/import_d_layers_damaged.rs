//! Files that nobody vouches for: whatever bytes a file has, reading it ends
//! with data or with an error that names the file, without a panic, and with
//! memory in proportion to the file. Alone in its process: it measures memory.

mod d_layers;

use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use d_layers::{make, python_is_there};
use drape_dataset::import::DLayers;
use drape_dataset::import::smpl::BodyModel;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

/// The system's allocator, counting.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Relaxed) + layout.size();
        PEAK.fetch_max(now, Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes that `work` has at the same time at most.
fn peak_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = NOW.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    (result, PEAK.load(Relaxed) - before)
}

fn read_all(root: &Path, name: &str) -> Result<usize, String> {
    let models = root.join("smpl/model");
    let mut source = DLayers::open(root, Some(&models)).map_err(|e| e.to_string())?;
    let recording = source.open_sequence(name).map_err(|e| e.to_string())?;
    let frames: Result<Vec<_>, _> = recording.collect();
    frames.map(|frames| frames.len()).map_err(|e| e.to_string())
}

#[test]
fn damaged_and_hostile_files_end_in_errors_or_data_within_little_memory() {
    hostile_pickles();
    if python_is_there() {
        damaged_files();
        long_recordings();
    }
}

/// 21 MB of positions, read with the memory of the motion and a frame.
fn long_recordings() {
    for protocol in [2, 5] {
        let made = make(json!({
            "protocol": protocol, "grid": 24, "frames": 1000, "light": true, "motion": "array",
            "sequences": {"train": ["00007"]},
        }));
        let models = made.root.join("smpl/model");
        let mut source = DLayers::open(&made.root, Some(&models)).unwrap();
        let (frames, peak) = peak_of(|| {
            let recording = source.open_sequence("00007").unwrap();
            recording.filter(|frame| frame.is_ok()).count()
        });
        assert_eq!(frames, 1000);
        assert!(peak < 6 << 20, "protocol {protocol}: {peak} bytes");
    }
}

/// Every file that a sequence needs, mutated: bytes changed, cut off, doubled.
fn damaged_files() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut refused = 0;
    let mut trials = 0;
    for (protocol, writer) in [
        (0, "python2"),
        (2, "python3"),
        (4, "python3"),
        (5, "python3"),
    ] {
        let options = json!({
            "protocol": protocol, "writer": writer, "models": "chumpy",
            "sequences": {"train": ["00007", "00396"]},
        });
        let made = make(options);
        // The second sequence has the female model.
        let name = "00396";
        let folder = made.root.join("data").join(name);
        let files: [PathBuf; 6] = [
            folder.join("meta.json"),
            folder.join("jumpsuit_sleeveless.pkl"),
            folder.join("uv_jacket_hood.pkl"),
            made.root.join("human/003/00396_poses.pkl"),
            made.root.join("smpl/model/model_f.pkl"),
            made.root.join("data/train_val_test.json"),
        ];
        let frames = made.expected[name]["frames"].as_u64();
        for path in files {
            let sound = fs::read(&path).unwrap();
            for trial in 0..20 {
                let mut bytes = sound.clone();
                let at = rng.random_range(0..bytes.len());
                match trial % 4 {
                    0 => bytes.truncate(at),
                    1 => bytes[at] = rng.random(),
                    // The instructions are at the beginning and at the end.
                    2 => {
                        let at = rng.random_range(0..bytes.len().min(200));
                        bytes[at] = rng.random();
                    }
                    _ => {
                        let end = rng.random_range(at..bytes.len());
                        let part = bytes[at..end].to_vec();
                        bytes.splice(at..at, part);
                    }
                }
                fs::write(&path, &bytes).unwrap();
                let (result, peak) = peak_of(|| read_all(&made.root, name));
                let file = path.file_name().unwrap().to_string_lossy();
                trials += 1;
                if let Err(message) = result {
                    refused += 1;
                    assert!(
                        message.contains("expected") || message.contains("cannot open"),
                        "{file}: {message}"
                    );
                }
                // The largest file, a body model in protocol 0, has 400 kB.
                assert!(peak < 24 << 20, "{file}, protocol {protocol}: {peak} bytes");
            }
            fs::write(&path, &sound).unwrap();
        }
        assert_eq!(read_all(&made.root, name).ok().map(|n| n as u64), frames);
    }
    println!("{trials} damaged files, {refused} refused");
    assert!(trials >= 200 && refused > trials / 3);
}

/// Small programs that cost much where they are believed.
fn hostile_pickles() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("model.pkl");
    let refused = |bytes: &[u8], parts: &[&str], limit: usize| {
        fs::write(&path, bytes).unwrap();
        let (result, peak) = peak_of(|| BodyModel::load(&path).unwrap_err().to_string());
        for part in ["model.pkl"].iter().chain(parts) {
            assert!(result.contains(part), "{part:?} is not in: {result}");
        }
        assert!(peak < limit, "{peak} bytes for {parts:?}");
    };
    const SMALL: usize = 1 << 20;
    // Lengths that are not there: bytes, text, a frame, an integer.
    refused(
        b"\x80\x05\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.",
        &["byte 11", "truncated"],
        SMALL,
    );
    refused(b"\x80\x05X\xff\xff\xff\xff.", &["truncated"], SMALL);
    refused(
        b"\x80\x05\x95\xff\xff\xff\xff\xff\xff\xff\xff.",
        &["a frame"],
        SMALL,
    );
    refused(
        b"\x80\x02\x8b\xff\xff\xff\x7f.",
        &["at most 64 bits"],
        SMALL,
    );
    // Calls.
    refused(
        b"cos\nsystem\n(S'true'\ntR.",
        &["os.system", "refused"],
        SMALL,
    );
    refused(
        b"\x80\x04\x8c\x02os\x8c\x06system\x93.",
        &["os.system", "refused"],
        SMALL,
    );
    refused(
        b"(ios\nsystem\n.",
        &["old-style instance of os.system"],
        SMALL,
    );
    refused(b"cbuiltins\neval\n.", &["builtins.eval", "refused"], SMALL);
    refused(b"cnumpy\nndarray\n)\x81.", &["class with instances"], SMALL);
    refused(b"cnumpy\ndtype\n)R.", &["arguments that fit Dtype"], SMALL);
    refused(b"Pid\n.", &["persistent id"], SMALL);
    refused(b"\x80\x06.", &["protocol 0 to 5", "6"], SMALL);
    // The stack and the memo.
    refused(b".", &["empty stack"], SMALL);
    refused(b"0.", &["empty stack"], SMALL);
    refused(b"(K\x01.", &["a dict", "1"], SMALL);
    refused(b"K\x01(0.", &["empty stack"], SMALL);
    refused(b"t.", &["mark"], SMALL);
    refused(b"h\x05.", &["no number 5"], SMALL);
    refused(b"}K\x01(K\x02u.", &["a dict to add to"], SMALL);
    refused(b"}(K\x02u.", &["a key alone"], SMALL);
    refused(b"", &["instructions", "truncated"], SMALL);

    // A million tuples in each other, and a list in itself.
    let mut deep = b"K\x01".to_vec();
    deep.extend([0x85; 1_000_000]);
    deep.push(b'.');
    refused(&deep, &["a dict", "a tuple of 1"], 128 << 20);
    refused(&entry(b"]q\x00h\x00a"), &["lists within lists"], SMALL);
    // Lists of lists, each holding the one before a hundred times: 100^5 numbers.
    let mut wide = b"K\x01".to_vec();
    for _ in 0..5 {
        wide.extend(b"q\x000](");
        wide.extend(b"h\x00".repeat(100));
        wide.extend(b"e");
    }
    refused(&entry(&wide), &["numbers", "more"], 600 << 20);
    // A shape with more numbers than bytes, and one whose size overflows.
    for shape in [
        &b"K\x09\x85"[..],
        b"J\xff\xff\xff\x7fJ\xff\xff\xff\x7fJ\xff\xff\xff\x7f\x87",
    ] {
        let mut array =
            b"cnumpy.core.numeric\n_frombuffer\n(C\x08abcdefghcnumpy\ndtype\nU\x02f8\x85R".to_vec();
        array.extend(shape);
        array.extend(b"U\x01CtR");
        refused(&entry(&array), &["v_template", "8 bytes"], SMALL);
    }
    // Values that fill the memory: refused at the limit. A byte makes a value of 40.
    refused(&b"]".repeat(30 << 20), &["at most 256 MB"], 800 << 20);
}

/// A model whose `v_template` is a value.
fn entry(value: &[u8]) -> Vec<u8> {
    let mut bytes = b"}(U\x0bJ_regressorNU\x0av_template".to_vec();
    bytes.extend(value);
    bytes.extend(b"u.");
    bytes
}
