//! How much less garments count that strayed.

use drape_train::losses::stray_factors;

use crate::outfit;

#[test]
fn each_garment_counts_by_its_own_error() {
    // Two garments of 10 and 20 vertices; the first would be 0.2 off, the second 0.4, along one axis.
    let outfit = outfit(10, 20, Vec::new());
    let truth = vec![[0.0; 3]; 30];
    let mut held = truth.clone();
    held[..10].fill([0.2, 0.0, 0.0]);
    held[10..].fill([0.0, 0.0, -0.4]);
    let factors = stray_factors(5.0, 0.04, &outfit, &held, &truth);
    let expected = [0.04 / (0.04 + 5.0 * 0.04), 0.04 / (0.04 + 5.0 * 0.16)];
    assert_eq!(factors.len(), 2);
    for (found, expected) in factors.iter().zip(expected) {
        assert!(
            (found - expected).abs() < 1e-12,
            "{found}, expected {expected}"
        );
    }
    assert_eq!(stray_factors(0.0, 0.04, &outfit, &held, &truth), [1.0, 1.0]);
}
