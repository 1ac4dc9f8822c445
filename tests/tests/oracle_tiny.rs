//! The port gives the published program's numbers on the tiny case: forward,
//! losses, gradients, one Adam step, a rollout, and training steps after a
//! rollout. Bars are those the project promises.

use std::path::Path;

use serde_json::Value;

fn worst(value: &Value) -> f64 {
    match value {
        Value::Array(all) => all.iter().map(worst).fold(0.0, f64::max),
        one => one.as_f64().expect("a number"),
    }
}

#[test]
fn numbers_equal_the_published_programs() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("oracle");
    let report = drape_tests::oracle::compare(&dir, "tiny").unwrap();
    for (key, bar) in [
        ("prediction", 1e-5),
        ("blocks", 1e-4),
        ("losses", 1e-4),
        ("gradients", 1e-3),
        ("adam", 1e-3),
        ("rollout", 1e-5),
        ("multistep", 1e-3),
    ] {
        let found = worst(&report[key]);
        assert!(found <= bar, "{key}: {found} > {bar} in {report}");
    }
    assert_eq!(report["blocks"].as_array().unwrap().len(), 4);
    assert_eq!(report["rollout"].as_array().unwrap().len(), 10);
}

#[test]
fn a_missing_file_is_named() {
    let error = drape_tests::oracle::compare(Path::new("nowhere"), "tiny").unwrap_err();
    assert!(
        format!("{error:#}").contains("nowhere/weights.safetensors"),
        "{error:#}"
    );
}
