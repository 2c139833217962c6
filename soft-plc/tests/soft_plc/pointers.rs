//! POINTER TO of CODESYS: bytes written at random against a model of its memory, warnings, what a trap says.

use std::sync::{LazyLock, Mutex};

use fam_soft_plc::{CheckOptions, Dialect, TrapKind, TypedProject, Value, compile};
use proptest::prelude::*;

use crate::common::{Machine, show, spec, typed_with};

fn typed(text: &str) -> TypedProject {
    let options = CheckOptions {
        dialect: Dialect::Codesys,
        ..CheckOptions::default()
    };
    typed_with(text, options)
}

fn machine(text: &str) -> Machine {
    let mc = compile(&typed(text), &spec("P")).unwrap_or_else(|d| panic!("{}", show(&d)));
    Machine::of(&mc)
}

/// Characters of the string under test.
const MOST: usize = 13;
/// Bytes of the array under test.
const BYTES: usize = 15;
const TEXTS: [&str; 5] = ["", "a", "hello", "1234567890abc", "longer than it can be"];

/// One step a scan, and then all that can be seen of the string and the array.
static MACHINE: LazyLock<Mutex<Machine>> = LazyLock::new(|| {
    let texts: Vec<String> = TEXTS.iter().map(|t| format!("'{t}'")).collect();
    let text = format!(
        "PROGRAM P
VAR_INPUT op, at_ : DINT; value : LWORD; END_VAR
VAR before : DWORD := 16#A5A5A5A5; s : STRING[{MOST}]; behind : DWORD := 16#5A5A5A5A; a : ARRAY[0..{}] OF BYTE; last : DWORD := 16#77777777;
    pb : POINTER TO BYTE; pd : POINTER TO DWORD; pr : POINTER TO REAL; pl : POINTER TO LWORD; ps : POINTER TO STRING; i : INT; n : INT; whole : BOOL;
    seen : ARRAY[0..{MOST}] OF BYTE; texts : ARRAY[0..4] OF STRING := [{}]; END_VAR
CASE op OF
0: pb := ADR(s) + at_; pb^ := LWORD_TO_BYTE(value);
1: pd := ADR(s) + at_; pd^ := LWORD_TO_DWORD(value);
2: pl := ADR(s) + at_; pl^ := value;
3: s := texts[at_];
4: s := CONCAT(s, 'x');
5: pb := ADR(s); FOR i := 1 TO SIZEOF(s) DO pb^ := 0; pb := pb + 1; END_FOR;
6: ps := ADR(s); ps^ := texts[at_];
7: pb := ADR(a); pb[at_] := LWORD_TO_BYTE(value);
8: pd := ADR(a[at_]); pd^ := LWORD_TO_DWORD(value);
9: pl := ADR(a) + at_; pl^ := value;
END_CASE;
n := LEN(s);
pb := ADR(s);
FOR i := 0 TO {MOST} DO seen[i] := pb^; pb := pb + 1; END_FOR;
whole := (before = 16#A5A5A5A5) AND (behind = 16#5A5A5A5A) AND (last = 16#77777777);
END_PROGRAM",
        BYTES - 1,
        texts.join(", ")
    );
    Mutex::new(machine(&text))
});

/// A string as CODESYS has it: it ends at the first 0. A 0 in it also clears what stands behind.
#[derive(Default)]
struct Model {
    text: [u8; MOST + 1],
    bytes: [u8; BYTES],
}

impl Model {
    fn len(&self) -> usize {
        self.text.iter().position(|b| *b == 0).unwrap_or(MOST)
    }

    fn put(&mut self, at: usize, byte: u8) {
        if byte == 0 && at < self.len() {
            self.text[at..].fill(0);
        }
        self.text[at] = byte;
    }

    fn assign(&mut self, new: &str) {
        let (old, new) = (self.len(), &new.as_bytes()[..new.len().min(MOST)]);
        if new.len() < old {
            self.text[new.len()..old].fill(0);
        }
        self.text[..new.len()].copy_from_slice(new);
        self.text[new.len()] = 0;
    }

    fn step(&mut self, op: i64, at: usize, value: u64) {
        let raw = value.to_le_bytes();
        let width = [1, 4, 8];
        match op {
            0..=2 => {
                for (n, byte) in raw[..width[op as usize]].iter().enumerate() {
                    self.put(at + n, *byte);
                }
            }
            3 | 6 => self.assign(TEXTS[at]),
            4 => {
                let text = String::from_utf8_lossy(&self.text[..self.len()]).into_owned() + "x";
                self.assign(&text);
            }
            5 => (0..=MOST).for_each(|at| self.put(at, 0)),
            _ => {
                let width = width[op as usize - 7];
                self.bytes[at..at + width].copy_from_slice(&raw[..width]);
            }
        }
    }
}

/// What is done, where, with which bytes: characters mostly, and zeros.
fn step() -> impl Strategy<Value = (i64, usize, u64)> {
    let byte = prop_oneof![2 => Just(0u8), 5 => 97u8..123];
    (0i64..10, 0usize..100, prop::array::uniform8(byte)).prop_map(|(op, at, mut raw)| {
        let room = match op {
            0..=2 => MOST + 1 - [1, 4, 8][op as usize],
            3 | 6 => TEXTS.len() - 1,
            7..=9 => BYTES - [1, 4, 8][op as usize - 7],
            _ => 0,
        };
        let at = at % (room + 1);
        // At the very end of a string stands a 0.
        if op <= 2 && at == room {
            raw[[0, 3, 7][op as usize]] = 0;
        }
        (op, at, u64::from_le_bytes(raw))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn bytes_among_the_characters_of_a_string_keep_it_whole(steps in prop::collection::vec(step(), 1..40)) {
        let mut machine = MACHINE.lock().expect("the machine");
        machine.instance.reset();
        let mut model = Model::default();
        for (op, at, value) in steps {
            machine.set("op", Value::Int(op));
            machine.set("at_", Value::Int(at as i64));
            machine.set("value", Value::Uint(value));
            machine.scan();
            model.step(op, at, value);
            prop_assert_eq!(machine.get("whole"), Value::Bool(true));
            prop_assert_eq!(machine.text("n"), model.len().to_string());
            for (index, byte) in model.text.iter().enumerate() {
                prop_assert_eq!(machine.text(&format!("seen[{index}]")), byte.to_string(), "character {}", index);
            }
            for (index, byte) in model.bytes.iter().enumerate() {
                prop_assert_eq!(machine.text(&format!("a[{index}]")), byte.to_string(), "element {}", index);
            }
        }
    }
}

#[test]
fn a_pointer_that_outlives_what_it_leads_to_is_warned_of() {
    let text = "FUNCTION_BLOCK B
VAR_INPUT data : POINTER TO DINT; END_VAR
VAR kept : POINTER TO DINT; n : DINT; raw : DWORD; END_VAR
VAR_TEMP t : DINT; here : POINTER TO DINT; END_VAR
kept := ADR(t);
here := ADR(t);
kept := ADR(n);
raw := ADR(t) + 4;
END_FUNCTION_BLOCK
FUNCTION F : INT
VAR_INPUT x : INT; END_VAR
VAR p : POINTER TO INT; END_VAR
p := ADR(x);
F := p^;
END_FUNCTION
PROGRAM P
VAR b : B; n : DINT; END_VAR
VAR_TEMP t : DINT; END_VAR
b(data := ADR(n));
b(data := ADR(t));
n := F(1);
END_PROGRAM";
    let found: Vec<u32> = typed(text)
        .warnings
        .iter()
        .filter(|w| w.code == "W714")
        .map(|w| w.line)
        .collect();
    assert_eq!(found, [5, 8, 20]);
}

#[test]
fn bytes_that_lie_otherwise_are_warned_of() {
    let text = "TYPE Even : STRUCT a : REAL; b : DWORD; END_STRUCT; Odd : STRUCT a : REAL; b : INT; END_STRUCT; END_TYPE
PROGRAM P
VAR e : Even; o : Odd; p : POINTER TO BYTE; q : POINTER TO Odd; END_VAR
p := ADR(e);
p := ADR(o);
q := ADR(o);
END_PROGRAM";
    let warnings = typed(text).warnings;
    let found: Vec<(&str, u32)> = warnings.iter().map(|w| (w.code.as_str(), w.line)).collect();
    assert_eq!(found, [("W713", 5)], "{}", show(&warnings));
}

#[test]
fn what_is_written_through_a_pointer_counts_as_assigned() {
    let text = "FUNCTION F : DWORD
VAR_OUTPUT y : DWORD; END_VAR
VAR p : POINTER TO DWORD; END_VAR
p := ADR(F); p^ := 1;
p := ADR(y); p^ := 2;
END_FUNCTION
PROGRAM P VAR a, b : DWORD; END_VAR a := F(y => b) + b; IF a > 0 THEN b := a; END_IF; END_PROGRAM";
    let warnings = typed(text).warnings;
    assert!(warnings.is_empty(), "{}", show(&warnings));
}

#[test]
fn a_trap_names_the_line_and_what_is_wrong() {
    let rows = [
        (
            "p := 60;\np^ := 1;",
            "the pointer leads out of the variables",
        ),
        (
            "p := ADR(c);\np^ := 1;",
            "a constant, which cannot be written",
        ),
        ("p := ADR(s);\np[3] := 1;", "behind the last character"),
        (
            "q := ADR(s) + 1;\nq^ := 'a';",
            "no place where a STRING begins",
        ),
    ];
    for (body, expected) in rows {
        let mut machine = machine(&format!(
            "PROGRAM P
VAR p : POINTER TO BYTE; q : POINTER TO STRING; s : STRING[3]; END_VAR
VAR CONSTANT c : ARRAY[0..7] OF BYTE := [1]; END_VAR
{body}
END_PROGRAM"
        ));
        let trap = machine.try_scan().expect_err(body);
        assert_eq!((trap.kind, trap.line), (TrapKind::Address, 5), "{trap}");
        assert!(trap.message.contains(expected), "{trap}");
    }
}

#[test]
fn the_standard_dialect_knows_pointer_as_another_word_for_reference() {
    let refused = |body: &str| {
        let text =
            format!("PROGRAM P VAR p : POINTER TO BYTE; b : BYTE; END_VAR {body} END_PROGRAM");
        let (project, problems) =
            fam_soft_plc::parse_project(&[fam_soft_plc::SourceFile::new("p.st", text)]);
        assert!(problems.is_empty());
        fam_soft_plc::check(&project, CheckOptions::default())
            .err()
            .map(|problems| problems[0].code.clone())
    };
    assert_eq!(refused("p := ADR(b); p^ := 1;"), None);
    assert_eq!(refused("p := p + 1;").as_deref(), Some("E305"));
    assert_eq!(
        refused("IF p < 5 THEN b := 1; END_IF;").as_deref(),
        Some("E305")
    );
    assert_eq!(refused("b := p[1];").as_deref(), Some("E314"));
}
