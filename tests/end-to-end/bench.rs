//! Every command of `fam bench` runs and answers, in its smallest form: whoever doubts a figure repeats it. Times are
//! those of the machine and not looked at; what must hold on any machine is.

mod support;

use serde_json::Value;

/// What a figure has to be.
enum Is {
    /// This number.
    Number(f64),
    /// Less than this.
    Below(f64),
    /// A list of so many.
    List(usize),
}

/// Runs the command with `--json`; its figures.
fn bench(args: &str) -> Value {
    let mut words = vec!["bench", "--json"];
    words.extend(args.split(' '));
    let (code, out, err) = support::run(&words);
    assert_eq!(code, 0, "fam bench {args}: {out}{err}");
    serde_json::from_str(&out).unwrap_or_else(|e| panic!("fam bench {args}: {e} in {out}"))
}

#[test]
fn every_bench_answers() {
    use Is::{Below, List, Number};
    let table: [(&str, &[(&str, Is)]); 13] = [
        ("scan --statements 200", &[("programs", List(15))]),
        (
            "plan --controllers 20 --mcs 200",
            &[("gap_percent", Below(3.0)), ("mcs", Number(200.0))],
        ),
        ("checkpoint --trials 20", &[("n", Below(30.0))]),
        ("state --trials 2", &[("bytes", Below(801_000.0))]),
        ("frame --scans 5", &[("scans", Number(5.0))]),
        (
            "generate --mcs 5 --variables 20",
            &[("mcs", Number(5.0)), ("peak_mb", Below(200.0))],
        ),
        (
            "footprint --starts 1 --seconds 1",
            &[("active_mcs", Below(15.0))],
        ),
        (
            "failover --kind kill --trials 1",
            &[
                ("double_driven_scans", Number(0.0)),
                ("scans_behind_max", Number(0.0)),
            ],
        ),
        (
            "failover --kind freeze --trials 1",
            &[
                ("double_driven_scans", Number(0.0)),
                ("scans_behind_max", Number(0.0)),
            ],
        ),
        (
            "failover --kind cut --trials 1",
            &[
                ("double_driven_scans", Number(0.0)),
                ("scans_behind_max", Number(0.0)),
            ],
        ),
        ("move --trials 1", &[("scans_behind_max", Number(0.0))]),
        (
            "loss --kind controller --trials 1",
            &[
                ("n", Number(1.0)),
                ("double_driven_scans", Number(0.0)),
                ("states_unequal", Number(0.0)),
            ],
        ),
        (
            "loss --kind gateway --trials 1",
            &[
                ("n", Number(1.0)),
                ("double_driven_scans", Number(0.0)),
                ("states_unequal", Number(0.0)),
            ],
        ),
    ];
    for (args, expected) in table {
        let figures = bench(args);
        for (name, is) in expected {
            let value = &figures[name];
            let holds = match is {
                Number(n) => value.as_f64() == Some(*n),
                Below(n) => value.as_f64().is_some_and(|v| v < *n),
                List(n) => value.as_array().is_some_and(|l| l.len() == *n),
            };
            assert!(holds, "fam bench {args}: {name} in {figures}");
        }
    }
}
