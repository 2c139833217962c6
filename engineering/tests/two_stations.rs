//! The two-station cell runs: its generated Control POUs go through the three shapes of an activation.

mod common;

use common::two_stations;
use fam_engineering::{BuiltMc, ControlState, build};
use fam_proto::diagnosis::Recovery;
use fam_proto::model::{InputSource, Place};
use fam_soft_plc::{Engine, EngineOptions, Instance, Value};

const CYCLE_NS: i64 = 5_000_000;
const BUDGET_TICKS: u64 = 1000;

/// An MC in the hands of a host.
struct Host<'a> {
    mc: &'a BuiltMc,
    instance: Instance,
    time_ns: i64,
}

impl<'a> Host<'a> {
    fn new(mc: &'a BuiltMc) -> Host<'a> {
        let engine = Engine::new(EngineOptions::default()).unwrap();
        let module = engine.prepare(&mc.compiled).unwrap();
        Host {
            mc,
            instance: Instance::new(&engine, &module).unwrap(),
            time_ns: 0,
        }
    }

    /// As a node activates it: checkpoint in, control variables set, outputs seeded.
    fn activate(
        &mut self,
        checkpoint: &[u8],
        outputs: &[u8],
        time_ns: i64,
        action: u16,
        go_on: bool,
    ) {
        let mut bytes = checkpoint.to_vec();
        self.mc.control.activate(&mut bytes, action, go_on);
        let region = self.mc.checkpoint_region();
        self.instance.region_mut(region).copy_from_slice(&bytes);
        self.instance.outputs_mut().copy_from_slice(outputs);
        self.time_ns = time_ns;
    }

    fn scan(&mut self) -> ControlState {
        self.time_ns += CYCLE_NS;
        self.instance.scan(self.time_ns, BUDGET_TICKS).unwrap();
        self.control()
    }

    fn control(&self) -> ControlState {
        self.mc.control.read(self.checkpoint())
    }

    fn checkpoint(&self) -> &[u8] {
        self.instance.region(self.mc.checkpoint_region())
    }

    fn read(&self, path: &str) -> Value {
        self.instance
            .read(path)
            .unwrap_or_else(|| panic!("no variable {path}"))
    }

    fn input(&mut self, name: &str, value: impl Into<Input>) {
        let value = match value.into() {
            Input::Bool(b) => Value::Bool(b),
            Input::Int(i) => Value::Int(i),
        };
        self.instance.write(name, value).unwrap();
    }
}

enum Input {
    Bool(bool),
    Int(i64),
}

impl From<bool> for Input {
    fn from(value: bool) -> Input {
        Input::Bool(value)
    }
}

impl From<i64> for Input {
    fn from(value: i64) -> Input {
        Input::Int(value)
    }
}

const RUNNING: ControlState = ControlState {
    is_active: true,
    was_active: true,
    recovery_action: 0,
};

/// A feeder in the middle of its stroke.
fn pushing(mc: &BuiltMc) -> Host<'_> {
    let mut host = Host::new(mc);
    let outputs = vec![0; host.instance.outputs().len()];
    host.activate(&mc.initial_checkpoint, &outputs, 0, 0, false);
    assert_eq!(host.scan(), RUNNING);
    host.input("Start", true);
    host.input("PusherHome", true);
    host.scan();
    host.input("PusherHome", false);
    host.scan();
    assert_eq!(host.read("Feeder.step"), Value::Int(1));
    assert_eq!(host.read("PusherExtend"), Value::Bool(true));
    host
}

#[test]
fn the_model_says_what_the_processes_need() {
    let built = build(&two_stations()).unwrap_or_else(|p| panic!("{p}"));
    assert!(built.warnings.is_empty(), "{:?}", built.warnings);
    let model = &built.model;
    assert_eq!(model.cell.as_str(), "two_stations");
    assert_eq!(model.settings.report_us, 100_000);
    assert_eq!(
        model.settings.bids_us,
        fam_proto::model::Settings::default().bids_us
    );
    let [one, two] = model.controllers.as_slice() else {
        panic!("two controllers expected");
    };
    assert_eq!(
        (
            one.cpu_factor_permille,
            one.memory_kb,
            one.limit_permille,
            one.tick_us
        ),
        (1000, 65_536, 500, 5_000)
    );
    assert_eq!((two.cpu_factor_permille, two.limit_permille), (1000, 600));
    assert_eq!(model.gateways[0].tick_us, 5_000);
    let feeder = &model.mcs[0];
    assert_eq!(feeder.mc.as_str(), "Feeder");
    assert_eq!(
        (feeder.cycle_us, feeder.watchdog_us, feeder.suspect_us),
        (5_000, 500_000, 50_000)
    );
    assert_eq!(feeder.hosts.len(), 2);
    assert_eq!(feeder.inputs_len, 8);
    assert_eq!(feeder.outputs.len(), 4);
    assert_eq!(feeder.fail_safe.len(), 8);
    assert_eq!(feeder.diagnosis.stop_action, Some(2));
    let press = &model.mcs[1];
    assert_eq!(press.diagnosis.stop_action, None);
    let ready = press.inputs.iter().find(|i| i.name == "PartReady").unwrap();
    assert_eq!(
        ready.source,
        InputSource::Export {
            mc: feeder.mc.clone(),
            place: Place::Bit { byte: 0, bit: 1 }
        }
    );
    assert_eq!(
        feeder.diagnosis.checkpoint_len as usize,
        built.mcs[0].initial_checkpoint.len()
    );
}

/// The shape of the paper: what runs in which state is readable from the text.
#[test]
fn control_has_the_three_shapes() {
    let built = build(&two_stations()).unwrap();
    let text = &built.mcs[0].control_st;
    let control = &text[text.find("PROGRAM Feeder_Control").unwrap()
        ..text.find("PROGRAM Feeder_Serialize").unwrap()];
    assert_eq!(
        control.trim_end(),
        "PROGRAM Feeder_Control
VAR
    isActive : BOOL;
    wasActive : BOOL;
    recoveryAction : INT;
    Action_Pushing : Feeder_Retract;
    StopAction : Feeder_Stop;
END_VAR
IF isActive AND wasActive THEN
    Feeder();
    Feeder_Serialize();
ELSIF isActive AND NOT wasActive THEN
    CASE recoveryAction OF
        0: (* direct recovery *)
            Feeder_Deserialize();
            Feeder();
            Feeder_Serialize();
            wasActive := TRUE;
        1: (* checkpoint recovery of Pushing *)
            Action_Pushing();
            IF Action_Pushing.end THEN
                Feeder_Deserialize();
                Feeder();
                Feeder_Serialize();
                wasActive := TRUE;
                recoveryAction := 0;
            END_IF;
        2: (* safe stop *)
            StopAction();
            IF StopAction.end THEN
                recoveryAction := 0;
                isActive := FALSE;
            END_IF;
    ELSE (* no such action: nothing may run *)
        isActive := FALSE;
    END_CASE;
ELSIF NOT isActive AND wasActive THEN
    wasActive := FALSE;
END_IF;
END_PROGRAM"
    );
}

#[test]
fn building_twice_gives_the_same_cell() {
    let (one, two) = (
        build(&two_stations()).unwrap(),
        build(&two_stations()).unwrap(),
    );
    assert_eq!(one.model, two.model);
    for (a, b) in one.mcs.iter().zip(&two.mcs) {
        assert_eq!(a.compiled.wasm, b.compiled.wasm);
        assert_eq!(a.control_st, b.control_st);
    }
}

#[test]
fn the_hash_follows_logic_and_masks() {
    let base = build(&two_stations()).unwrap().model;
    for (changes, changed_mc) in [
        ([("feeder.st", "T#20ms;\nEND_VAR", "T#25ms;\nEND_VAR")], 0),
        (
            [(
                "cell.toml",
                "condition = \"step = 10\"",
                "condition = \"step = 11\"",
            )],
            1,
        ),
        (
            [(
                "cell.toml",
                "PartWeight = { export = true, fail_safe = 0.0 }",
                "PartWeight = { export = true, fail_safe = 1.0 }",
            )],
            0,
        ),
    ] {
        let (_dir, built) = common::changed(&changes);
        let model = built.unwrap_or_else(|p| panic!("{p}")).model;
        for (index, (a, b)) in base.mcs.iter().zip(&model.mcs).enumerate() {
            assert_eq!(
                a.hash == b.hash,
                index != changed_mc,
                "{changes:?}: {}",
                a.mc
            );
        }
    }
}

#[test]
fn an_activation_without_history_starts_from_initial_values() {
    let built = build(&two_stations()).unwrap();
    let mut host = Host::new(&built.mcs[0]);
    assert!(!host.control().is_active);
    // Nothing runs before it is activated.
    host.scan();
    assert_eq!(
        host.control(),
        ControlState {
            is_active: false,
            was_active: false,
            recovery_action: 0
        }
    );
    let host = pushing(&built.mcs[0]);
    assert!(
        matches!(built.mcs[0].diagnosis.recovery(host.checkpoint()), Recovery::Checkpoint(i) if i.name == "Pushing")
    );
}

#[test]
fn a_direct_recovery_continues_with_the_next_scan() {
    let built = build(&two_stations()).unwrap();
    let mc = &built.mcs[0];
    let mut one = pushing(mc);
    one.input("PusherOut", true);
    one.input("Weight", 120);
    one.scan();
    one.scan();
    // The timer has been running for two scans when another controller takes over.
    assert_eq!(mc.diagnosis.recovery(one.checkpoint()), Recovery::Direct);
    let mut two = Host::new(mc);
    two.activate(
        one.checkpoint(),
        one.instance.outputs(),
        one.time_ns,
        0,
        false,
    );
    let inputs = one.instance.inputs().to_vec();
    two.instance.inputs_mut().copy_from_slice(&inputs);
    for _ in 0..6 {
        assert_eq!(one.scan(), two.scan());
        assert_eq!(one.checkpoint(), two.checkpoint());
        assert_eq!(one.instance.outputs(), two.instance.outputs());
    }
    assert_eq!(two.read("Feeder.step"), Value::Int(2));
    assert_eq!(two.read("Feeder.weights[0]"), Value::Int(120));
}

#[test]
fn a_checkpoint_recovery_runs_its_action_and_goes_on_from_the_checkpoint_state() {
    let built = build(&two_stations()).unwrap();
    let mc = &built.mcs[0];
    let one = pushing(mc);
    let mut two = Host::new(mc);
    for round in 0..2 {
        // The second round shows that the action can be used again.
        two.activate(
            one.checkpoint(),
            one.instance.outputs(),
            one.time_ns,
            1,
            false,
        );
        two.input("PusherHome", false);
        let recovering = ControlState {
            is_active: true,
            was_active: false,
            recovery_action: 1,
        };
        assert_eq!(two.scan(), recovering, "round {round}");
        assert_eq!(two.read("PusherExtend"), Value::Bool(false));
        two.input("PusherHome", true);
        for _ in 0..4 {
            assert_eq!(two.scan(), recovering, "round {round}: the dwell of 20 ms");
        }
        assert_eq!(two.scan(), RUNNING, "round {round}");
        assert_eq!(two.read("Feeder.step"), Value::Int(0), "round {round}");
    }
}

#[test]
fn an_interrupted_action_goes_on_where_it_was() {
    let built = build(&two_stations()).unwrap();
    let mc = &built.mcs[0];
    let one = pushing(mc);
    let mut two = Host::new(mc);
    two.activate(
        one.checkpoint(),
        one.instance.outputs(),
        one.time_ns,
        1,
        false,
    );
    two.input("PusherHome", true);
    for _ in 0..3 {
        two.scan();
    }
    let mut three = Host::new(mc);
    three.activate(
        two.checkpoint(),
        two.instance.outputs(),
        two.time_ns,
        1,
        true,
    );
    three.input("PusherHome", true);
    assert!(!three.scan().was_active);
    assert_eq!(three.scan(), RUNNING, "two more of the dwell's scans");
}

#[test]
fn a_safe_stop_ends_the_activation() {
    let built = build(&two_stations()).unwrap();
    // By the interval's action.
    let mc = &built.mcs[1];
    let mut press = Host::new(mc);
    let outputs = vec![0; press.instance.outputs().len()];
    press.activate(&mc.initial_checkpoint, &outputs, 0, 0, false);
    press.input("PartReady", true);
    press.input("RamUp", true);
    press.scan();
    press.scan();
    assert_eq!(press.read("RamDown"), Value::Bool(true));
    assert!(
        matches!(mc.diagnosis.recovery(press.checkpoint()), Recovery::SafeStop(i) if i.action == 1)
    );
    let (checkpoint, outputs) = (
        press.checkpoint().to_vec(),
        press.instance.outputs().to_vec(),
    );
    press.activate(&checkpoint, &outputs, press.time_ns, 1, false);
    press.input("RamUp", false);
    assert!(press.scan().is_active);
    assert_eq!(press.read("RamDown"), Value::Bool(false));
    press.input("RamUp", true);
    let stopped = ControlState {
        is_active: false,
        was_active: false,
        recovery_action: 0,
    };
    assert_eq!(press.scan(), stopped);
    // By the stop POU.
    let mc = &built.mcs[0];
    let one = pushing(mc);
    let mut two = Host::new(mc);
    two.activate(
        one.checkpoint(),
        one.instance.outputs(),
        one.time_ns,
        mc.diagnosis.stop_action.unwrap(),
        false,
    );
    assert_eq!(two.scan(), stopped);
    assert_eq!(two.read("PusherExtend"), Value::Bool(false));
    // An action that does not exist runs nothing.
    two.activate(
        one.checkpoint(),
        one.instance.outputs(),
        one.time_ns,
        77,
        false,
    );
    assert!(!two.scan().is_active);
    assert_eq!(two.read("PusherExtend"), Value::Bool(true));
}

#[test]
fn a_warm_reset_keeps_retained_variables() {
    let built = build(&two_stations()).unwrap();
    let mc = &built.mcs[0];
    let mut host = pushing(mc);
    host.input("PusherOut", true);
    for _ in 0..8 {
        host.scan();
    }
    assert_eq!(host.read("fed"), Value::Uint(1));
    let warm = mc.warm_checkpoint(host.checkpoint());
    host.activate(&warm, &[0; 8], 0, 0, false);
    host.input("Start", false);
    host.input("PusherOut", false);
    host.scan();
    assert_eq!(host.read("fed"), Value::Uint(1));
    assert_eq!(host.read("Feeder.step"), Value::Int(0));
    assert_eq!(host.read("FedParts"), Value::Uint(1));
}
