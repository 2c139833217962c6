//! The case study, as the README's first command runs it.

mod support;

#[test]
fn the_demo_holds_all_that_it_asserts() {
    let dir = tempfile::tempdir().unwrap();
    let report = dir.path().join("report");
    let (code, out, err) = support::run(&[
        "demo",
        "--headless",
        "--json",
        "--report",
        report.to_str().unwrap(),
    ]);
    let result: serde_json::Value =
        serde_json::from_str(&out).unwrap_or_else(|e| panic!("{e}\n{out}\n{err}"));
    let failed: Vec<&serde_json::Value> = result["checks"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|c| c["held"] != true)
        .collect();
    assert!(failed.is_empty(), "{failed:#?}\n{err}");
    assert_eq!(code, 0, "{err}");
    assert_eq!(result["totals"]["double_driven_scans"], 0);
    assert_eq!(result["totals"]["incidents"], 0);
    assert!(result["totals"]["products"].as_u64().unwrap() >= 5);
    assert!(result["totals"]["frames_rejected"].as_u64().unwrap() > 0);
    let html = std::fs::read_to_string(report.join("report.html")).unwrap();
    assert!(
        !html.contains("http://") && !html.contains("https://") || !html.contains("src="),
        "the report opens offline"
    );
    for file in ["workload.svg", "timeline.json", "metrics.csv"] {
        assert!(report.join(file).metadata().unwrap().len() > 200, "{file}");
    }
}
