//! A cell with an MC that divides by its input, and loops for ever where that is [`LOOPS_FOR_EVER`]; and one that counts.

/// Low byte of the input that makes the MC loop for ever.
pub const LOOPS_FOR_EVER: u8 = 7;

/// The cell; its folder goes when the value does.
pub fn cell() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write(
        "cell.toml",
        r#"
format = 1
[cell]
name = "faulty"
tick_ms = 5
[[gateway]]
name = "gateway1"
driver = "image"
[[controller]]
name = "controller1"
[[controller]]
name = "controller2"
[[mc]]
name = "Divider"
logic = ["divider.st"]
gateway = "gateway1"
hosts = "all"
worst_case_us = 50
watchdog_ms = 500
stop = "Divider_Stop"
[mc.inputs]
divisor = "image:divisor"
[mc.outputs]
quotient = { field = "image:quotient", fail_safe = 0 }
[[mc]]
name = "Tally"
logic = ["tally.st"]
gateway = "gateway1"
hosts = "all"
worst_case_us = 50
watchdog_ms = 500
[mc.outputs]
count = { field = "image:count", fail_safe = 0 }
"#,
    );
    write(
        "divider.st",
        "VAR_GLOBAL
    divisor AT %IW0 : INT;
    quotient AT %QW0 : INT;
END_VAR
PROGRAM Divider
VAR_EXTERNAL divisor, quotient : INT; END_VAR
VAR scans : DINT; END_VAR
    scans := scans + 1;
    WHILE divisor = 7 DO
        scans := scans + 1;
    END_WHILE;
    quotient := 100 / divisor;
END_PROGRAM
FUNCTION_BLOCK Divider_Stop
VAR_EXTERNAL quotient : INT; END_VAR
VAR_OUTPUT end : BOOL; END_VAR
    quotient := -1;
    end := TRUE;
END_FUNCTION_BLOCK
",
    );
    write(
        "tally.st",
        "VAR_GLOBAL count AT %QW0 : INT; END_VAR
PROGRAM Tally
VAR_EXTERNAL count : INT; END_VAR
VAR n : INT; END_VAR
    n := n + 1;
    count := n;
END_PROGRAM
",
    );
    folder
}
