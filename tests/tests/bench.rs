//! `drape-bench` as a person runs it.

use drape_tests::programs::{printed, run};
use serde_json::Value;

#[test]
fn a_result_holds_sizes_and_times_and_is_compared_with_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--case", "small", "--runs", "9", "--json", "one.json"];
    let output = run("drape-bench", folder.path(), &arguments);
    assert!(output.status.success(), "{}", printed(&output));
    let text = std::fs::read_to_string(folder.path().join("one.json")).unwrap();
    let result: Value = serde_json::from_str(&text).unwrap();
    assert!(result["threads"].as_u64().unwrap() > 0);
    assert!(result["matmul_2048_ms"].as_f64().unwrap() > 0.0);
    let case = &result["cases"]["small"];
    for name in ["vertices", "body_vertices", "patches", "train_step_ms"] {
        assert!(case[name].as_f64().unwrap() > 0.0, "{name}");
    }
    let part = |name: &str| case["stages"][name].as_f64().unwrap();
    let forward: f64 = [
        "neighbours, normals, frames",
        "encoders",
        "blocks",
        "decoder",
    ]
    .iter()
    .map(|stage| part(&format!("inference: {stage}")))
    .sum();
    let inference = case["inference_ms"].as_f64().unwrap();
    // Medians of parts do not add up to the median of the whole, but they are most of it.
    assert!(forward > 0.3 * inference && forward < 3.0 * inference);
    assert!(case["peak_mib"].as_f64().unwrap() >= case["inference_peak_mib"].as_f64().unwrap());

    let arguments = ["--case", "small", "--runs", "9", "--previous", "one.json"];
    let output = run("drape-bench", folder.path(), &arguments);
    assert!(
        printed(&output).contains("before: inference"),
        "{}",
        printed(&output)
    );
}

#[test]
fn too_few_runs_and_a_file_that_is_no_result_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(
        "drape-bench",
        folder.path(),
        &["--case", "small", "--runs", "3"],
    );
    assert!(!output.status.success());
    assert!(
        printed(&output).contains("at least 9"),
        "{}",
        printed(&output)
    );
    std::fs::write(folder.path().join("bad.json"), "{\"threads\": 2").unwrap();
    let arguments = ["--case", "small", "--previous", "bad.json"];
    let output = run("drape-bench", folder.path(), &arguments);
    assert!(!output.status.success());
    let text = printed(&output);
    assert!(text.contains("bad.json is not a result"), "{text}");
}
