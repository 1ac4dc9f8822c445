//! Memory that is used again: what a warm frame or training step takes from the allocator does
//! not grow with the mesh.
//!
//! An allocator counts what the test's thread takes. The scene is measured once, and once four
//! times as long, at the same density. Kernels run on this thread alone (inside a pool of one), so
//! that the numbers do not depend on who steals what.
//!
//! Counted apart is the room that each matrix product of the `gemm` crate takes for itself and gives
//! back at once: packed factors on cache lines, which nothing of ours is, and flags for them. A
//! product is one of a tile of rows, so there are more products in a larger mesh but none larger.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::{Mutex, PoisonError};

use drape_dataset::sample::State;
use drape_eval::layersnet::LayersNetMethod;
use drape_eval::method::Method;
use drape_eval::task::Clip;
use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{PATCH_SIZE_M, Scene, SceneConfig};
use drape_train::losses::terms::Terms;
use drape_train::losses::{LossConfig, LossValues, Vector, position};
use drape_train::step::{advance_pairs, roll_in, sample_gradient};

/// Blocks of memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Blocks {
    count: usize,
    bytes: usize,
    largest: usize,
}

impl Blocks {
    const NONE: Self = Self {
        count: 0,
        bytes: 0,
        largest: 0,
    };

    fn add(&mut self, bytes: usize) {
        self.count += 1;
        self.bytes += bytes;
        self.largest = self.largest.max(bytes);
    }
}

/// What a thread took from the allocator: for products, and else.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Taken {
    own: Blocks,
    products: Blocks,
}

thread_local! {
    static TAKEN: Cell<Taken> = const {
        Cell::new(Taken { own: Blocks::NONE, products: Blocks::NONE })
    };
}

/// Alignment of packed factors, at least; and bytes of their flags, at most.
const CACHE_LINE: usize = 64;
const FLAGS: usize = 256;

struct Counting;

impl Counting {
    fn count(bytes: usize, of_product: bool) {
        // A thread that ends has no counter any more.
        let _ = TAKEN.try_with(|taken| {
            let mut now = taken.get();
            match of_product {
                true => now.products.add(bytes),
                false => now.own.add(bytes),
            }
            taken.set(now);
        });
    }
}

// SAFETY: every call is the system allocator's; counting touches only a thread's own cell, which
// needs no memory from the allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::count(layout.size(), layout.align() >= CACHE_LINE);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        let flags = layout.align() == 1 && layout.size() <= FLAGS;
        Self::count(layout.size(), flags || layout.align() >= CACHE_LINE);
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Self::count(size, layout.align() >= CACHE_LINE);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What `work` takes once it is warm, on one thread. One at a time: another thread's would leave
/// its own, smaller buffers to be used again.
fn taken(mut work: impl FnMut() + Send) -> Taken {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build().unwrap().install(|| {
        for _ in 0..3 {
            work();
        }
        TAKEN.set(Taken::default());
        work();
        TAKEN.get()
    })
}

/// Blocks and bytes by which what is taken may differ: lists of another frame's length double later.
const SLACK: [usize; 2] = [8, 4096];

/// A mesh four times as large takes no more, and no product more room at once.
fn assert_same(one: Taken, four: Taken) {
    println!("{one:?} and, four times as long, {four:?}");
    let (less, more) = (one.own, four.own);
    assert!(more.count <= less.count + SLACK[0], "{one:?}, {four:?}");
    assert!(more.bytes <= less.bytes + SLACK[1], "{one:?}, {four:?}");
    assert!(more.largest <= less.largest, "{one:?}, {four:?}");
    let [less, more] = [one, four].map(|taken| taken.products.largest);
    assert!(more <= less, "{one:?}, {four:?}");
}

/// `length` times the usual scene.
fn scene(length: usize) -> Scene {
    Scene::new(SceneConfig {
        length,
        ..SceneConfig::default()
    })
}

/// Lengths that are compared: 864 and 3456 garment vertices.
const LENGTHS: [usize; 2] = [4, 16];

fn vertices(length: usize) -> usize {
    scene(length).outfit().vertices()
}

#[test]
fn longer_scenes_have_more_of_everything_at_the_same_density() {
    let graphs = LENGTHS.map(|length| {
        let (sample, statistics) = scene(length).sample(1);
        let config = ModelConfig::default();
        let net = LayersNet::frozen(&config, &Parameters::new(&config, 1).unwrap()).unwrap();
        let columns = &statistics.vertices;
        net.forward(&sample.outfit, columns, &sample.state, &sample.steps[0])
            .unwrap()
            .graph
    });
    let sizes = graphs.map(|graph| {
        [
            graph.own_patch.len(),
            graph.patch_states.len(),
            graph.body_rows.len(),
            graph.edges.mesh.items.len(),
            graph.edges.world.items.len(),
            graph.edges.body.items.len(),
            graph.slots.len(),
        ]
    });
    for (one, four) in sizes[0].into_iter().zip(sizes[1]) {
        let times = four as f64 / one as f64;
        assert!((3.4..4.6).contains(&times), "{sizes:?}");
    }
}

#[test]
fn counting_sees_what_a_thread_takes() {
    let mut kept = Vec::new();
    let found = taken(|| kept.push(vec![0u8; 12_345])).own;
    assert!(
        found.bytes >= 12_345 && found.largest >= 12_345,
        "{found:?}"
    );
}

/// A warm frame: evaluation and integration.
fn frame(length: usize) -> Taken {
    let (sample, statistics) = scene(length).sample(1);
    let config = ModelConfig::default();
    let net = LayersNet::frozen(&config, &Parameters::new(&config, 1).unwrap()).unwrap();
    let (mut state, mut accelerations) = (Vec::new(), Vec::new());
    taken(|| {
        state.clone_from(&sample.state);
        let (outfit, step) = (&sample.outfit, &sample.steps[0]);
        let evaluation = net
            .evaluate(outfit, &statistics.vertices, &state, step)
            .unwrap();
        evaluation.accelerations(&mut accelerations);
        advance_pairs(&mut state, &accelerations);
    })
}

#[test]
fn a_warm_frame_takes_nothing_that_grows_with_the_mesh() {
    let [one, four] = LENGTHS.map(frame);
    assert_same(one, four);
}

/// A warm frame of a rollout as evaluation does it.
fn rollout_step(length: usize) -> Taken {
    let scene = scene(length);
    let (_, statistics) = scene.sample(1);
    let config = ModelConfig::default();
    let net = LayersNet::frozen(&config, &Parameters::new(&config, 1).unwrap()).unwrap();
    let clip = Clip {
        header: scene.header.clone(),
        frames: scene.frames(4),
    };
    let (task, _) = clip.split(2, 1).unwrap();
    let mut method = LayersNetMethod::new("network", net, statistics, PATCH_SIZE_M);
    method.begin(&task).unwrap();
    let mut last = Vec::new();
    let found = taken(|| last = method.step(&task, 3).unwrap());
    assert_eq!(last.iter().map(Vec::len).sum::<usize>(), vertices(length));
    found
}

#[test]
fn a_warm_rollout_takes_the_positions_that_it_returns_and_nothing_else_that_grows() {
    let [one, four] = LENGTHS.map(|length| {
        let mut found = rollout_step(length);
        // Two garments, 12 bytes a vertex: the caller keeps them.
        found.own.bytes -= 12 * vertices(length);
        found
    });
    assert_same(one, four);
}

/// A warm training step without its optimiser.
fn training_step(length: usize, with_collisions: bool) -> Taken {
    let (sample, statistics) = scene(length).sample(1);
    let config = ModelConfig::default();
    let parameters = Parameters::new(&config, 1).unwrap();
    let net = LayersNet::trainable(&config, &parameters).unwrap();
    let (losses, columns) = (LossConfig::default(), &statistics.vertices);
    taken(|| {
        let state = &sample.state;
        let result = sample_gradient(
            &net,
            &parameters,
            columns,
            &losses,
            &sample,
            state,
            with_collisions,
        );
        assert!(!result.unwrap().gradients.is_empty());
    })
}

/// Forward and backward pass without losses.
fn there_and_back(length: usize) -> Taken {
    let (sample, statistics) = scene(length).sample(1);
    let config = ModelConfig::default();
    let parameters = Parameters::new(&config, 1).unwrap();
    let net = LayersNet::trainable(&config, &parameters).unwrap();
    let outfit = &sample.outfit;
    let by_vertex = vec![[0.5, -1.0, 0.25]; outfit.vertices()];
    let by_patch = vec![[-0.5, 0.5, 1.0]; outfit.patches.count()];
    taken(|| {
        let columns = &statistics.vertices;
        let mut evaluation = net
            .evaluate(outfit, columns, &sample.state, &sample.steps[0])
            .unwrap();
        let gradients = net.gradients(&parameters, &mut evaluation, &by_vertex, &by_patch);
        assert!(!gradients.unwrap().is_empty());
    })
}

#[test]
fn forward_and_backward_take_nothing_that_grows_with_the_mesh() {
    let [one, four] = LENGTHS.map(there_and_back);
    assert_same(one, four);
}

#[test]
fn a_warm_training_step_takes_nothing_that_grows_with_the_mesh() {
    for with_collisions in [false, true] {
        println!("collisions {with_collisions}");
        let [one, four] = LENGTHS.map(|length| training_step(length, with_collisions));
        assert_same(one, four);
    }
}

/// Three warm steps without gradient, of which the reference takes the place of the first.
fn rolling_in(length: usize) -> Taken {
    let (sample, statistics) = scene(length).sample(4);
    let config = ModelConfig::default();
    let net = LayersNet::frozen(&config, &Parameters::new(&config, 1).unwrap()).unwrap();
    let mut state = Vec::new();
    taken(|| roll_in(&net, &statistics.vertices, &sample, 1, &mut state).unwrap())
}

#[test]
fn warm_steps_without_gradient_take_nothing_that_grows_with_the_mesh() {
    let [one, four] = LENGTHS.map(rolling_in);
    assert_same(one, four);
}

/// Losses of a state that is squeezed, the outer garment more, so that everything collides.
fn losses_of(length: usize, terms: &mut Terms) -> (LossValues, [Vec<Vector>; 2]) {
    let (sample, _) = scene(length).sample(1);
    terms.reference.clone_from(&sample.reference[0]);
    let squeezed = |row: &State, least: f64| {
        let [x, y, z] = position(row);
        let wave = least + 0.2 * (3.0 * z).sin();
        [wave * x, wave * y, z]
    };
    let outer = sample.outfit.garment_offsets[1];
    let rows = terms.reference.iter().enumerate();
    let rows = rows.map(|(vertex, row)| squeezed(row, if vertex < outer { 0.8 } else { 0.5 }));
    terms.predicted = rows.collect();
    let means = sample.outfit.patches.means(&terms.reference);
    terms.predicted_patches = means.map(|row| squeezed(&row, 0.7)).collect();
    let config = LossConfig::default();
    let values = terms.evaluate(&config, &sample.outfit, &sample.steps[0], true);
    (values, [terms.by_vertex.clone(), terms.by_patch.clone()])
}

#[test]
fn what_another_sample_left_in_the_losses_memory_changes_no_bit() {
    let [fresh, larger] = [1, 2].map(|length| losses_of(length, &mut Terms::default()));
    let values = fresh.0;
    for value in [
        values.position,
        values.patch,
        values.normal,
        values.body_collision,
        values.layer_collision,
    ] {
        assert!(value > 0.0, "a term that is not there: {values:?}");
    }
    assert_ne!(fresh, larger);
    let mut terms = Terms::default();
    for length in [2, 1, 2, 1] {
        let expected = if length == 1 { &fresh } else { &larger };
        assert_eq!(losses_of(length, &mut terms), *expected);
    }
}
