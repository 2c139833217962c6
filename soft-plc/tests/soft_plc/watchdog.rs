//! Loops that the watchdog has to see, whatever the compilers have made of them.

use std::sync::atomic::{AtomicBool, Ordering};

use fam_soft_plc::{Engine, EngineOptions, Instance, TrapKind, Value};

use crate::common::{compiled, spec};

#[test]
fn every_kind_of_endless_loop_is_stopped_at_its_line_and_the_instance_goes_on() {
    for (body, line) in [
        ("WHILE run DO\n;\nEND_WHILE;", 3),
        // Nothing is stored in either: what the outer one has read must not pass for what the inner one sees.
        ("WHILE run DO\nWHILE run DO\n;\nEND_WHILE;\nEND_WHILE;", 4),
        ("REPEAT\n;\nUNTIL NOT run END_REPEAT;", 3),
        (
            "FOR i := 1 TO 10 DO\nIF run THEN i := i - 1; END_IF;\nEND_FOR;",
            3,
        ),
        ("FOR i := 1 TO 10 BY n DO\nn := n;\nEND_FOR;", 3),
        (
            "FOR i := 1 TO 5 DO\nWHILE run DO\nn := n + 0;\nEND_WHILE;\nEND_FOR;",
            4,
        ),
        // Short enough to go without a look, in a loop that is not.
        (
            "WHILE run DO\nFOR i := 1 TO 5 DO\nn := n + 0;\nEND_FOR;\nEND_WHILE;",
            3,
        ),
        ("WHILE run DO\nleaf(x := i);\nEND_WHILE;", 3),
    ] {
        let text = format!(
            "FUNCTION_BLOCK Leaf VAR_INPUT x : INT; END_VAR VAR y : INT; END_VAR y := y + x; END_FUNCTION_BLOCK PROGRAM P VAR run : BOOL; i, n, scans : INT; leaf : Leaf; END_VAR\nscans := scans + 1; IF run THEN\n{body}\nEND_IF; END_PROGRAM"
        );
        let engine = Engine::new(EngineOptions::default()).expect("engine");
        let module = engine
            .prepare(&compiled(&text, &spec("P")))
            .expect("module");
        let mut instance = Instance::new(&engine, &module).expect("instance");
        instance.scan(0, 2).expect("no loop yet");
        instance.write("P.run", Value::Bool(true)).expect("write");
        let done = AtomicBool::new(false);
        let result = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    engine.interrupt_tick();
                    std::thread::yield_now();
                }
            });
            let result = instance.scan(0, 2);
            done.store(true, Ordering::Relaxed);
            result
        });
        let trap = result.expect_err(body);
        assert_eq!(
            (trap.kind, trap.line),
            (TrapKind::EndlessLoop, line),
            "{body}"
        );
        instance.write("P.run", Value::Bool(false)).expect("write");
        instance.scan(0, 2).expect(body);
        assert_eq!(instance.read("P.scans"), Some(Value::Int(3)), "{body}");
    }
}

#[test]
fn short_loops_that_call_each_other_are_not_short_together() {
    let mut text = String::from(
        "FUNCTION_BLOCK L0 VAR n : DINT; END_VAR n := n * 3 + 1; END_FUNCTION_BLOCK\n",
    );
    // 250 * 250 * 250 * 250 calls: far more than the ticks of the scan.
    for level in 1..=4 {
        text.push_str(&format!(
            "FUNCTION_BLOCK L{level} VAR i : INT; below : L{}; END_VAR FOR i := 1 TO 250 DO below(); END_FOR; END_FUNCTION_BLOCK\n",
            level - 1
        ));
    }
    text.push_str("PROGRAM P VAR top : L4; END_VAR top(); END_PROGRAM");
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine
        .prepare(&compiled(&text, &spec("P")))
        .expect("module");
    let mut instance = Instance::new(&engine, &module).expect("instance");
    let done = AtomicBool::new(false);
    let result = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                engine.interrupt_tick();
                std::thread::yield_now();
            }
        });
        let result = instance.scan(0, 2);
        done.store(true, Ordering::Relaxed);
        result
    });
    let trap = result.expect_err("stopped");
    assert_eq!(trap.kind, TrapKind::EndlessLoop);
}

#[test]
fn ticks_between_scans_stop_nothing_and_an_instance_may_go_at_any_time() {
    let text =
        "PROGRAM P VAR i, n : INT; END_VAR FOR i := 1 TO 1000 DO n := i; END_FOR; END_PROGRAM";
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine.prepare(&compiled(text, &spec("P"))).expect("module");
    let mut kept = Instance::new(&engine, &module).expect("instance");
    for _ in 0..10 {
        let mut other = Instance::new(&engine, &module).expect("instance");
        for _ in 0..5 {
            engine.interrupt_tick();
            kept.scan(0, 1_000_000).expect("time enough");
            other.scan(0, 2).expect("time enough");
        }
    }
    assert_eq!(kept.read("P.n"), Some(Value::Int(1000)));
}
