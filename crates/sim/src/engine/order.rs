//! An order of constraints in which none waits for the one before it.
//!
//! Passes over springs, hinges and faces are Gauss–Seidel: each constraint sees
//! what those before it did. Along a mesh's own numbering nearly every one
//! shares a vertex with the last, and the processor computes them one by one.
//! But constraints that share no vertex can change places without changing a
//! bit. So they are sorted into rounds: each comes in the round after the last
//! of those that share a vertex with it and stand before it. Within a round all
//! are independent, and the processor overlaps them; whoever shares vertices
//! keeps the old order, so the result is that of the old order bit for bit,
//! forwards as well as backwards.

/// Numbers of constraints on vertices below `vertices`, by rounds.
pub(super) fn by_rounds<const N: usize>(vertices: usize, constraints: &[[u32; N]]) -> Vec<u32> {
    let mut busy_until = vec![0u32; vertices];
    let round = |constraint: &[u32; N]| {
        let corners = constraint.iter().map(|&v| v as usize);
        let round = corners.clone().map(|v| busy_until[v]).max().unwrap_or(0);
        corners.for_each(|v| busy_until[v] = round + 1);
        round
    };
    let rounds: Vec<u32> = constraints.iter().map(round).collect();
    let mut order: Vec<u32> = (0..constraints.len() as u32).collect();
    order.sort_by_key(|&number| rounds[number as usize]);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Constraints between vertices that are drawn without any order.
    fn tangle(vertices: u32, count: u32) -> Vec<[u32; 3]> {
        let draw = |i: u32, salt: u32| (i * 7919 + salt * 104_729) % 65_521 % vertices;
        (0..count)
            .map(|i| [draw(i, 1), draw(i, 2), draw(i, 3)])
            .collect()
    }

    fn share(a: &[u32; 3], b: &[u32; 3]) -> bool {
        a.iter().any(|v| b.contains(v))
    }

    #[test]
    fn whoever_shares_a_vertex_keeps_the_order_and_nobody_is_lost() {
        for (vertices, count) in [(5, 40), (60, 400), (1000, 1)] {
            let constraints = tangle(vertices, count);
            let order = by_rounds(vertices as usize, &constraints);
            let mut place = vec![usize::MAX; constraints.len()];
            for (at, &number) in order.iter().enumerate() {
                place[number as usize] = at;
            }
            assert_eq!(order.len(), constraints.len());
            assert!(place.iter().all(|&at| at < order.len()));
            for (b, of_b) in constraints.iter().enumerate() {
                for (a, of_a) in constraints[..b].iter().enumerate() {
                    assert!(!share(of_a, of_b) || place[a] < place[b], "{a} and {b}");
                }
            }
        }
    }

    #[test]
    fn neighbours_in_the_order_rarely_wait_for_each_other() {
        // Eight chains, one after the other: in this order everybody waits for the one before.
        let many: Vec<[u32; 3]> = (0..8u32)
            .flat_map(|k| (0..30).map(move |i| [100 * k + i, 100 * k + i + 1, 100 * k + i + 2]))
            .collect();
        let order = by_rounds(800, &many);
        let waits = order.windows(2).filter(|two| {
            let of = |number: u32| &many[number as usize];
            share(of(two[0]), of(two[1]))
        });
        assert_eq!(waits.count(), 0);
    }
}
