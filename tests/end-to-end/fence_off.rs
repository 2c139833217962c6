//! What the fence is for: the same cuts with and without it. Needs the test build (`--features fam-cli/fence-off`).

mod support;

fn double_driven(fence: &[&str]) -> u64 {
    let mut args = vec![
        "bench", "failover", "--kind", "cut", "--trials", "2", "--json",
    ];
    args.extend(fence);
    let (code, out, err) = support::run(&args);
    assert_eq!(code, 0, "{err}");
    let figures: serde_json::Value =
        serde_json::from_str(&out).unwrap_or_else(|e| panic!("{e}\n{out}\n{err}"));
    figures["double_driven_scans"].as_u64().unwrap()
}

#[test]
fn without_the_fence_a_cut_controller_drives_beside_its_successor_and_with_it_never() {
    assert!(double_driven(&["--fence-off"]) > 0);
    assert_eq!(double_driven(&[]), 0);
}
