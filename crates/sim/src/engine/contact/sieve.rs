//! A sieve for the candidates that trees give: most of them are further apart
//! than their boxes are.
//!
//! For each candidate a direction is sought, roughly that between the closest
//! points; then the gap along it is taken at the start and at the end of the
//! stretch for which tubes are laid, with the tubes' radii taken off at the
//! end. For a fixed direction and linear motion the gap is concave in time, as
//! in [`super::certificate`]: what is further apart than `reach` at both ends
//! is so in between. So a direction that was badly chosen keeps a candidate
//! for nothing, but never drops one that matters.
//!
//! That makes single precision enough: [`BATCH`] candidates are computed at
//! once, coordinate by coordinate, in wide registers, and what rounding can do
//! is added to `reach`. The same operations in every build give the same bits.

use std::cell::Cell;

use glam::DVec3;

use super::pair::Features;
use super::tree::{ROUNDING_M, widest};
use super::tubes::Tubes;
use crate::engine::state::State;

/// Candidates that are looked at together.
const BATCH: usize = 64;

/// One number of every candidate in a batch.
type Row = [f32; BATCH];

/// Where each vertex is and may be: what the sieve reads of it lies together.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
struct Way {
    place: [f32; 3],
    /// Radius of the tube at its end, m.
    radius: f32,
    /// To the place at the end of the tube.
    along: [f32; 3],
    /// Fills up to eight numbers.
    _pad: f32,
}

/// Ways of all vertices for the coming stretch.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ways(Vec<Way>);

impl Ways {
    /// Takes over what tubes are laid for `substeps`, with places relative to `origin`.
    pub fn lay(&mut self, state: &State, tubes: &Tubes, substeps: f64, origin: DVec3) {
        let way = |(x, tube): (&DVec3, &super::tubes::Tube)| Way {
            place: (*x - origin).as_vec3().to_array(),
            radius: (substeps * tube.radius) as f32,
            along: (substeps * tube.step).as_vec3().to_array(),
            _pad: 0.0,
        };
        self.0.clear();
        self.0.extend(state.x.iter().zip(&tubes.of).map(way));
    }
}

/// Lets candidates through that may come nearer than a distance.
pub(crate) struct Sieve<'a> {
    ways: &'a Ways,
    features: Features,
    reach: f32,
    waiting: Vec<[u32; 4]>,
    batch: Box<Batch>,
    /// Counts what was put in.
    count: &'a Cell<u64>,
}

/// Numbers of the waiting candidates; places relative to the first vertex.
struct Batch {
    place: [[Row; 3]; 4],
    along: [[Row; 3]; 4],
    radius: [Row; 4],
    direction: [Row; 3],
    /// Room beyond what is needed, at the worse end; not above 0 for what passes.
    spare: Row,
}

impl<'a> Sieve<'a> {
    /// A sieve for pairs of these features that may come within `reach`, m.
    pub fn new(ways: &'a Ways, features: Features, reach: f64, count: &'a Cell<u64>) -> Self {
        Self {
            ways,
            features,
            reach: reach as f32 + 4.0 * ROUNDING_M,
            waiting: Vec::with_capacity(BATCH),
            batch: Box::new(Batch {
                place: [[[0.0; BATCH]; 3]; 4],
                along: [[[0.0; BATCH]; 3]; 4],
                radius: [[0.0; BATCH]; 4],
                direction: [[0.0; BATCH]; 3],
                spare: [0.0; BATCH],
            }),
            count,
        }
    }

    /// Puts a candidate in; what passes comes out sooner or later, in the order it was put in.
    #[inline]
    pub fn put(&mut self, vertices: [u32; 4], passed: &mut impl FnMut([u32; 4])) {
        self.waiting.push(vertices);
        if self.waiting.len() == BATCH {
            self.shake(passed);
        }
    }

    /// Lets out what is left.
    pub fn finish(mut self, passed: &mut impl FnMut([u32; 4])) {
        self.shake(passed);
    }

    fn shake(&mut self, passed: &mut impl FnMut([u32; 4])) {
        self.count.set(self.count.get() + self.waiting.len() as u64);
        let (batch, reach) = (&mut *self.batch, self.reach);
        gather(batch, &self.ways.0, &self.waiting);
        match self.features {
            Features::VertexFace => sift_faces(batch, reach),
            Features::EdgeEdge => sift_edges(batch, reach),
        }
        for (vertices, &spare) in self.waiting.iter().zip(&self.batch.spare) {
            // What is no number passes.
            let far = spare > 0.0;
            if !far {
                passed(*vertices);
            }
        }
        self.waiting.clear();
    }
}

fn gather(batch: &mut Batch, ways: &[Way], waiting: &[[u32; 4]]) {
    widest!(gather_all<>(batch: &mut Batch = batch, ways: &[Way] = ways, waiting: &[[u32; 4]] = waiting));
}

/// Candidates whose numbers are turned from rows into columns at once.
const EIGHT: usize = 8;

#[inline(always)]
fn gather_all<const WIDE: bool>(batch: &mut Batch, ways: &[Way], waiting: &[[u32; 4]]) {
    for (number, eight) in waiting.chunks(EIGHT).enumerate() {
        let at = EIGHT * number;
        for i in 0..4 {
            // Where nobody waits, the first one stands in.
            let way = |k: usize| &ways[eight.get(k).unwrap_or(&eight[0])[i] as usize];
            let columns = transposed::<WIDE>(std::array::from_fn(way));
            for (c, column) in columns.iter().enumerate() {
                let row = match c {
                    0..3 => &mut batch.place[i][c],
                    3 => &mut batch.radius[i],
                    4..7 => &mut batch.along[i][c - 4],
                    _ => continue,
                };
                row[at..at + EIGHT].copy_from_slice(column);
            }
        }
        for c in 0..3 {
            let [first, others @ ..] = &mut batch.place;
            let origin = &mut first[c][at..at + EIGHT];
            for place in others {
                for (x, o) in place[c][at..at + EIGHT].iter_mut().zip(&*origin) {
                    *x -= o;
                }
            }
            origin.fill(0.0);
        }
    }
}

/// Numbers of eight ways, each kind together: place, radius, along.
#[inline(always)]
fn transposed<const WIDE: bool>(of: [&Way; EIGHT]) -> [[f32; EIGHT]; EIGHT] {
    #[cfg(target_arch = "x86_64")]
    if WIDE {
        // SAFETY: only who runs on a machine with these registers is wide.
        return unsafe { wide::transposed(of) };
    }
    let mut columns = [[0.0; EIGHT]; EIGHT];
    for (k, way) in of.into_iter().enumerate() {
        let [x, y, z] = way.place;
        let [u, v, w] = way.along;
        let numbers = [x, y, z, way.radius, u, v, w];
        for (column, number) in columns.iter_mut().zip(numbers) {
            column[k] = number;
        }
    }
    columns
}

#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::{
        __m256, _mm256_loadu_ps, _mm256_permute2f128_ps, _mm256_shuffle_ps, _mm256_storeu_ps,
        _mm256_unpackhi_ps, _mm256_unpacklo_ps,
    };

    use super::{EIGHT, Way};

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn transposed(of: [&Way; EIGHT]) -> [[f32; EIGHT]; EIGHT] {
        // SAFETY: a way is eight numbers.
        let r: [__m256; EIGHT] =
            of.map(|way| unsafe { _mm256_loadu_ps(std::ptr::from_ref(way).cast()) });
        let pairs = |a: usize, b: usize| {
            let (low, high) = (
                _mm256_unpacklo_ps(r[a], r[b]),
                _mm256_unpackhi_ps(r[a], r[b]),
            );
            (low, high)
        };
        let quads = |(low, high): (__m256, __m256), (low2, high2): (__m256, __m256)| {
            [
                _mm256_shuffle_ps::<0x44>(low, low2),
                _mm256_shuffle_ps::<0xee>(low, low2),
                _mm256_shuffle_ps::<0x44>(high, high2),
                _mm256_shuffle_ps::<0xee>(high, high2),
            ]
        };
        let first = quads(pairs(0, 1), pairs(2, 3));
        let second = quads(pairs(4, 5), pairs(6, 7));
        let mut columns = [[0.0; EIGHT]; EIGHT];
        for c in 0..4 {
            let low = _mm256_permute2f128_ps::<0x20>(first[c], second[c]);
            let high = _mm256_permute2f128_ps::<0x31>(first[c], second[c]);
            // SAFETY: eight numbers have room.
            unsafe {
                _mm256_storeu_ps(columns[c].as_mut_ptr(), low);
                _mm256_storeu_ps(columns[c + 4].as_mut_ptr(), high);
            }
        }
        columns
    }
}

fn sift_faces(batch: &mut Batch, reach: f32) {
    widest!(sift_all_faces<>(batch: &mut Batch = batch, reach: f32 = reach));
}

fn sift_edges(batch: &mut Batch, reach: f32) {
    widest!(sift_all_edges<>(batch: &mut Batch = batch, reach: f32 = reach));
}

#[inline(always)]
fn sift_all_faces<const WIDE: bool>(batch: &mut Batch, reach: f32) {
    let [_, b, c, d] = &batch.place;
    let [nx, ny, nz] = &mut batch.direction;
    for k in 0..BATCH {
        let at = |x: &[Row; 3]| [x[0][k], x[1][k], x[2][k]];
        let (b, c, d) = (at(b), at(c), at(d));
        let n = from_triangle(b, c, d);
        (nx[k], ny[k], nz[k]) = (n[0], n[1], n[2]);
    }
    let Batch {
        place,
        along,
        radius,
        direction,
        spare,
    } = batch;
    for k in 0..BATCH {
        let n = [direction[0][k], direction[1][k], direction[2][k]];
        let needed = reach * dot(n, n).sqrt();
        let ends = |i: usize| {
            ends(
                n,
                [place[i][0][k], place[i][1][k], place[i][2][k]],
                [along[i][0][k], along[i][1][k], along[i][2][k]],
            )
        };
        let (a, b, c, d) = (ends(0), ends(1), ends(2), ends(3));
        let length = dot(n, n).sqrt();
        let r = |i: usize| length * radius[i][k];
        let now = a.0 - most(most(b.0, c.0), d.0);
        let end = (a.1 - r(0)) - most(most(b.1 + r(1), c.1 + r(2)), d.1 + r(3));
        spare[k] = least(now, end) - needed;
    }
}

#[inline(always)]
fn sift_all_edges<const WIDE: bool>(batch: &mut Batch, reach: f32) {
    let [_, b, c, d] = &batch.place;
    let [nx, ny, nz] = &mut batch.direction;
    for k in 0..BATCH {
        let at = |x: &[Row; 3]| [x[0][k], x[1][k], x[2][k]];
        let (b, c, d) = (at(b), at(c), at(d));
        let n = between_edges(b, c, minus(d, c));
        (nx[k], ny[k], nz[k]) = (n[0], n[1], n[2]);
    }
    let Batch {
        place,
        along,
        radius,
        direction,
        spare,
    } = batch;
    for k in 0..BATCH {
        let n = [direction[0][k], direction[1][k], direction[2][k]];
        let length = dot(n, n).sqrt();
        let ends = |i: usize| {
            ends(
                n,
                [place[i][0][k], place[i][1][k], place[i][2][k]],
                [along[i][0][k], along[i][1][k], along[i][2][k]],
            )
        };
        let (a, b, c, d) = (ends(0), ends(1), ends(2), ends(3));
        let r = |i: usize| length * radius[i][k];
        let now = least(a.0, b.0) - most(c.0, d.0);
        let end = least(a.1 - r(0), b.1 - r(1)) - most(c.1 + r(2), d.1 + r(3));
        spare[k] = least(now, end) - reach * length;
    }
}

/// Along `n`: a place, and where its vertex is at the end.
#[inline(always)]
fn ends(n: [f32; 3], place: [f32; 3], along: [f32; 3]) -> (f32, f32) {
    let now = dot(n, place);
    (now, now + dot(n, along))
}

/// From about the closest point of triangle (b, c, d) to the origin.
#[inline(always)]
fn from_triangle(b: [f32; 3], c: [f32; 3], d: [f32; 3]) -> [f32; 3] {
    let (u, v) = (minus(c, b), minus(d, b));
    let normal = cross(u, v);
    // The nearest of the three sides, unless the foot of the height lies inside.
    let (on_bc, on_cd, on_db) = (on_side(b, c), on_side(c, d), on_side(d, b));
    let nearer = |x: [f32; 3], y: [f32; 3]| if_less(dot(x, x), dot(y, y), x, y);
    let side = nearer(nearer(on_bc, on_cd), on_db);
    let inside = least(
        least(dot(cross(b, c), normal), dot(cross(c, d), normal)),
        dot(cross(d, b), normal),
    );
    // The normal, turned towards the origin.
    let height = -dot(b, normal);
    let foot = [height * normal[0], height * normal[1], height * normal[2]];
    if_less(0.0, inside, foot, [-side[0], -side[1], -side[2]])
}

/// The point of side (a, b) that is closest to the origin.
#[inline(always)]
fn on_side(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    let u = minus(b, a);
    let t = clamp(-dot(a, u) / most(dot(u, u), TINY));
    [a[0] + t * u[0], a[1] + t * u[1], a[2] + t * u[2]]
}

/// From about the closest point of the edge from `c` along `v` to that of the edge from the origin to `u`.
#[inline(always)]
fn between_edges(u: [f32; 3], c: [f32; 3], v: [f32; 3]) -> [f32; 3] {
    let (uu, vv, uv) = (dot(u, u), dot(v, v), dot(u, v));
    let (uc, vc) = (dot(u, c), dot(v, c));
    // Closest points of the lines, then each clamped for the other.
    let s = clamp((uc * vv - uv * vc) / most(uu * vv - uv * uv, TINY));
    let t = clamp((uv * s - vc) / most(vv, TINY));
    let s = clamp((uv * t + uc) / most(uu, TINY));
    let along = |k: usize| s * u[k] - t * v[k] - c[k];
    [along(0), along(1), along(2)]
}

/// Divisors are never smaller, m² or m⁴.
const TINY: f32 = 1e-20;

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

// Comparisons as the processor has them: one instruction, whatever is no number.

#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn clamp(t: f32) -> f32 {
    least(most(t, 0.0), 1.0)
}

#[inline(always)]
fn if_less(a: f32, b: f32, then: [f32; 3], other: [f32; 3]) -> [f32; 3] {
    let choose = |k: usize| if a < b { then[k] } else { other[k] };
    [choose(0), choose(1), choose(2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::contact::pair::separation;

    /// Four vertices within a few centimetres that fly with tubes of their own, told by a number.
    fn scene(number: u32) -> (State, Tubes, f64) {
        let draw = |i: u32| {
            let x = (f64::from(number) * 12.9898 + f64::from(i) * 78.233).sin() * 43758.5453;
            2.0 * (x - x.floor()) - 1.0
        };
        let vector = |i: u32, size: f64| size * DVec3::new(draw(i), draw(i + 1), draw(i + 2));
        let size = [0.005, 0.02, 0.1][number as usize % 3];
        let at = DVec3::new(0.7, -0.3, 1.1);
        let x: Vec<DVec3> = (0..4).map(|i| at + vector(10 * i, size)).collect();
        let state = State {
            p: x.clone(),
            v: vec![DVec3::ZERO; 4],
            w: vec![1.0; 4],
            cloth: 4,
            x,
        };
        let mut tubes = Tubes::new(&state, 1.0);
        for (i, tube) in tubes.of.iter_mut().enumerate() {
            tube.step = vector(100 + 10 * i as u32, 0.002);
            tube.radius = 1e-3 * draw(200 + i as u32).abs();
        }
        (state, tubes, f64::from(1 + number % 8))
    }

    fn passes(features: Features, reach: f64, state: &State, tubes: &Tubes, substeps: f64) -> bool {
        let mut ways = Ways::default();
        ways.lay(state, tubes, substeps, DVec3::ZERO);
        let count = Cell::new(0);
        let mut sieve = Sieve::new(&ways, features, reach, &count);
        let mut passed = Vec::new();
        let mut found = |vertices| passed.push(vertices);
        sieve.put([0, 1, 2, 3], &mut found);
        sieve.finish(&mut found);
        passed.len() == 1
    }

    #[test]
    fn what_can_come_within_reach_passes() {
        for features in [Features::VertexFace, Features::EdgeEdge] {
            let (mut dropped, mut near) = (0, 0);
            for number in 0..3000 {
                let (state, tubes, substeps) = scene(number);
                let reach = 0.004;
                let passed = passes(features, reach, &state, &tubes, substeps);
                // Everywhere on the way, as near to each other as tubes allow.
                let mut closest = f64::INFINITY;
                for moment in 0..=20 {
                    let t = substeps * f64::from(moment) / 20.0;
                    let on_line = |i: usize| state.x[i] + t * tubes.of[i].step;
                    let mut x: Vec<DVec3> = (0..4).map(on_line).collect();
                    for _ in 0..3 {
                        let d = separation(features, [0, 1, 2, 3], &x).d;
                        closest = closest.min(d.length());
                        let n = d.normalize_or_zero();
                        let first = if features == Features::EdgeEdge { 2 } else { 1 };
                        for i in 0..4 {
                            let away = if i < first { -n } else { n };
                            x[i] = on_line(i) + t * tubes.of[i].radius * away;
                        }
                    }
                }
                near += u32::from(closest <= reach);
                dropped += u32::from(!passed);
                assert!(passed || closest > reach, "{number}: {closest} m");
            }
            assert!(
                near > 500 && dropped > 500,
                "{near} near, {dropped} dropped"
            );
        }
    }

    #[test]
    fn what_rests_apart_is_dropped_and_what_rests_together_passes() {
        for features in [Features::VertexFace, Features::EdgeEdge] {
            for number in 0..3000 {
                let (state, mut tubes, substeps) = scene(number);
                for tube in &mut tubes.of {
                    (tube.step, tube.radius) = (DVec3::ZERO, 0.0);
                }
                let distance = separation(features, [0, 1, 2, 3], &state.x).d.length();
                for (reach, expected) in [(1.001 * distance, true), (0.99 * distance - 1e-5, false)]
                {
                    let passed = passes(features, reach, &state, &tubes, substeps);
                    assert!(
                        passed == expected || distance < 1e-4,
                        "{number}: {distance} m"
                    );
                }
            }
        }
    }

    #[test]
    fn wide_and_plain_transposition_give_the_same_bits() {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            let ways: [Way; EIGHT] = std::array::from_fn(|k| {
                let number = |c: usize| (10 * k + c) as f32;
                Way {
                    place: [number(0), number(1), number(2)],
                    radius: number(3),
                    along: [number(4), number(5), number(6)],
                    _pad: 0.0,
                }
            });
            let of = std::array::from_fn(|k| &ways[k]);
            assert_eq!(transposed::<true>(of), transposed::<false>(of));
        }
    }

    #[test]
    fn many_come_out_in_the_order_they_were_put_in() {
        let (mut state, tubes, substeps) = scene(0);
        // All in one place but for the last vertex, which is far from the others.
        state.x.fill(DVec3::X);
        state.x[3] = DVec3::splat(5.0);
        let mut ways = Ways::default();
        ways.lay(&state, &tubes, substeps, DVec3::ZERO);
        for count in [1, BATCH - 1, BATCH, BATCH + 1, 5 * BATCH + 7] {
            let counted = Cell::new(0);
            let mut sieve = Sieve::new(&ways, Features::EdgeEdge, 0.004, &counted);
            let put: Vec<[u32; 4]> = (0..count)
                .map(|i| {
                    if i % 3 == 0 {
                        [0, 1, 3, 3]
                    } else {
                        [(i % 2) as u32, 1, 2, 2]
                    }
                })
                .collect();
            let mut passed = Vec::new();
            let mut found = |vertices| passed.push(vertices);
            for vertices in &put {
                sieve.put(*vertices, &mut found);
            }
            sieve.finish(&mut found);
            let near: Vec<[u32; 4]> = put.into_iter().filter(|v| v[2] == 2).collect();
            assert_eq!(passed, near);
            assert_eq!(counted.get(), count as u64);
        }
    }
}
