//! The memory layout that checkpoints rely on.

use fam_soft_plc::memory::SYSTEM_BYTES;
use fam_soft_plc::{Area, CompileSpec, RegionSpec, TypeNode, Value, layout_of};

use crate::common::{Machine, compiled, show, spec, typed};

const TEXT: &str = "
TYPE
  Color : (Red, Green, Blue);
  S : STRUCT a : BOOL; b : LREAL; c : SINT; END_STRUCT;
END_TYPE
VAR_GLOBAL g1 : INT; g2 : LINT; q AT %QX0.0 : BOOL; END_VAR
VAR_GLOBAL RETAIN kept : DINT := 7; END_VAR
VAR_GLOBAL CONSTANT C : INT := 3; TAB : ARRAY[0..2] OF INT := [5, 6, 7]; END_VAR
FUNCTION_BLOCK F
VAR_INPUT x : BOOL; END_VAR VAR_IN_OUT io : INT; END_VAR VAR_TEMP tmp : LREAL; END_VAR
VAR CONSTANT k : INT := 2; END_VAR VAR_OUTPUT y : TIME; END_VAR VAR n : INT; END_VAR
io := io + k + TAB[1];
END_FUNCTION_BLOCK
PROGRAM M1
VAR b : BOOL; i : INT; l : LINT; bits : ARRAY[1..5] OF BOOL; w : WORD; s : ARRAY[0..1] OF S; f : F; c : Color; END_VAR
f(io := i);
END_PROGRAM
PROGRAM M2 VAR n : INT := 9; END_VAR n := n + 1; END_PROGRAM
PROGRAM P M1(); M2(); g1 := DINT_TO_INT(kept); END_PROGRAM
PROGRAM Unused VAR big : ARRAY[1..1000] OF LREAL; END_VAR big[1] := 1.0; END_PROGRAM
";

fn state_spec() -> CompileSpec {
    CompileSpec {
        entry: "P".into(),
        regions: vec![
            RegionSpec {
                name: "state".into(),
                programs: vec!["M1".into(), "m2".into()],
                globals: vec!["g2".into()],
                markers: false,
            },
            RegionSpec {
                name: "retained".into(),
                programs: vec![],
                globals: vec!["kept".into()],
                markers: false,
            },
        ],
        ..CompileSpec::default()
    }
}

#[test]
fn offsets_follow_the_documented_rules() {
    let layout = layout_of(&typed(TEXT), &state_spec()).unwrap_or_else(|d| panic!("{}", show(&d)));
    let names: Vec<(&str, u32)> = layout
        .regions
        .iter()
        .map(|r| (r.name.as_str(), r.len))
        .collect();
    assert_eq!(names, [("state", 128), ("retained", 8), ("work", 8)]);
    assert_eq!(layout.outputs.offset, SYSTEM_BYTES);
    assert_eq!(layout.outputs.len, 8);
    let found: Vec<(&str, usize, u32, u32)> = layout
        .variables
        .iter()
        .filter_map(|v| match v.area {
            Area::Region(r) => Some((v.path.as_str(), r, v.offset, v.len)),
            _ => None,
        })
        .collect();
    assert_eq!(
        found,
        [
            ("M1.b", 0, 0, 4),
            ("M1.i", 0, 4, 4),
            ("M1.l", 0, 8, 8),
            ("M1.bits", 0, 16, 8),
            ("M1.w", 0, 24, 4),
            ("M1.s", 0, 32, 48),
            ("M1.f.x", 0, 80, 4),
            ("M1.f.y", 0, 88, 8),
            ("M1.f.n", 0, 96, 4),
            ("M1.c", 0, 104, 4),
            ("M2.n", 0, 112, 4),
            ("g2", 0, 120, 8),
            ("kept", 1, 0, 4),
            ("g1", 2, 0, 4),
        ]
    );
}

#[test]
fn paths_are_found_without_regard_to_case_and_with_indices() {
    let layout = layout_of(&typed(TEXT), &state_spec()).expect("layout");
    let element = layout.find("m1.S[1].b").expect("element");
    assert_eq!(
        (element.path.as_str(), element.offset, element.len),
        ("M1.s[1].b", 32 + 24 + 8, 8)
    );
    assert_eq!(
        layout.find("M1.bits[5]").map(|v| (v.offset, v.len)),
        Some((20, 1))
    );
    assert!(
        matches!(&*layout.find("M1.c").expect("enum").ty, TypeNode::Enum { name, .. } if name == "Color")
    );
    assert_eq!(
        layout.find("q").map(|v| (v.area, v.bit)),
        Some((Area::Outputs, Some(0)))
    );
    assert!(layout.find("kept").is_some_and(|v| v.retain));
    for wrong in [
        "M1.bits[0]",
        "M1.bits[6]",
        "M1.s[1]b",
        "M1",
        "M1.",
        "M1.f.io",
        "M1.f.k",
        "C",
        "Unused.big",
        "M1.bits[1",
        "M1.bits[x]",
        "M1.s[1,1]",
    ] {
        assert!(layout.find(wrong).is_none(), "{wrong}");
    }
    let leaves: Vec<String> = layout
        .leaves(&layout.find("M1.s").expect("array"))
        .into_iter()
        .map(|v| v.path)
        .collect();
    assert_eq!(
        leaves,
        [
            "M1.s[0].a",
            "M1.s[0].b",
            "M1.s[0].c",
            "M1.s[1].a",
            "M1.s[1].b",
            "M1.s[1].c"
        ]
    );
}

#[test]
fn the_hash_follows_every_change_of_the_layout_and_no_other() {
    let hash = |text: &str| layout_of(&typed(text), &spec("P")).expect("layout").hash();
    let base = "PROGRAM P VAR a : INT; b : DINT; END_VAR a := 1; END_PROGRAM";
    assert_eq!(
        hash(base),
        hash("PROGRAM p (* x *) VAR A : INT; B : DINT; END_VAR a := 2; END_PROGRAM")
    );
    for other in [
        "PROGRAM P VAR b : DINT; a : INT; END_VAR a := 1; END_PROGRAM",
        "PROGRAM P VAR a : UINT; b : DINT; END_VAR a := 1; END_PROGRAM",
        "PROGRAM P VAR a : INT; c : DINT; END_VAR a := 1; END_PROGRAM",
        "PROGRAM P VAR a : INT; b : DINT; c : BOOL; END_VAR a := 1; END_PROGRAM",
        "PROGRAM P VAR a : INT; END_VAR VAR RETAIN b : DINT; END_VAR a := 1; END_PROGRAM",
    ] {
        assert_ne!(hash(base), hash(other), "{other}");
    }
    let logic = |text: &str| compiled(text, &spec("P")).logic_hash;
    assert_eq!(
        logic(base),
        logic(&base.replace("a := 1", "a := 1 (* same *)"))
    );
    assert_ne!(logic(base), logic(&base.replace("a := 1", "a := 2")));
}

/// Writing the extremes of each type leaves the neighbours as they are: in cells, packed arrays, structures and images.
#[test]
fn neighbouring_cells_are_not_harmed() {
    let types = [
        ("BOOL", "TRUE"),
        ("SINT", "-128"),
        ("INT", "-32768"),
        ("DINT", "-2147483648"),
        ("LINT", "-9223372036854775808"),
        ("USINT", "255"),
        ("UINT", "65535"),
        ("UDINT", "4294967295"),
        ("ULINT", "18446744073709551615"),
        ("BYTE", "255"),
        ("WORD", "65535"),
        ("DWORD", "4294967295"),
        ("LWORD", "18446744073709551615"),
        ("REAL", "-1.5"),
        ("LREAL", "-1.5"),
        ("TIME", "T#-1ns"),
    ];
    for (ty, value) in types {
        for (kind, decl, place) in [
            (
                "cell",
                format!("before : {ty}; x : {ty}; after : {ty};"),
                "x",
            ),
            (
                "array",
                format!("before : {ty}; x : ARRAY[0..6] OF {ty}; after : {ty}; i : INT := 3;"),
                "x[i]",
            ),
        ] {
            let text = format!("PROGRAM P VAR {decl} END_VAR {place} := {value}; END_PROGRAM");
            let mut m = Machine::new(&text);
            let region = m.instance.layout().regions.len() - 1;
            let before = m.instance.region(region).to_vec();
            m.scan();
            let info = m
                .instance
                .layout()
                .find(&format!("P.{}", place.replace('i', "3")))
                .expect("variable");
            let after = m.instance.region(region);
            let cell = info.offset as usize..(info.offset + info.len) as usize;
            let changed: Vec<usize> = (0..after.len())
                .filter(|i| before[*i] != after[*i])
                .collect();
            assert!(
                changed.iter().all(|i| cell.contains(i)),
                "{ty} {kind}: {changed:?} outside {cell:?}"
            );
            assert!(!changed.is_empty(), "{ty} {kind}");
            assert_eq!(
                m.instance
                    .read_variable(&info)
                    .map(|v| v.to_string())
                    .as_deref(),
                Some(value),
                "{ty} {kind}"
            );
        }
    }
}

#[test]
fn initial_values_lie_in_the_layout_and_in_a_new_instance() {
    let mc = compiled(TEXT, &state_spec());
    let mut m = Machine::of(&mc);
    for (index, bytes) in mc.layout.initial.iter().enumerate() {
        assert_eq!(m.instance.region(index), bytes.as_slice());
    }
    assert_eq!(m.text("M2.n"), "9");
    m.scan();
    m.scan();
    assert_eq!((m.text("M2.n"), m.text("M1.i")), ("11".into(), "16".into()));
    m.instance.reset();
    assert_eq!(
        (m.text("M2.n"), m.text("M1.i"), m.text("kept")),
        ("9".into(), "0".into(), "7".into())
    );
}

#[test]
fn values_are_written_if_they_fit() {
    let mut m = Machine::new(
        "PROGRAM P VAR a : USINT; b : ARRAY[0..1] OF BOOL; r : REAL; END_VAR r := 1.0; END_PROGRAM",
    );
    m.set("a", Value::Int(200));
    m.set("b[1]", Value::Bool(true));
    assert_eq!(
        (m.text("a"), m.text("b[0]"), m.text("b[1]")),
        ("200".into(), "FALSE".into(), "TRUE".into())
    );
    let fail =
        |m: &mut Machine, path: &str, v| m.instance.write(path, v).expect_err(path).to_string();
    assert_eq!(
        fail(&mut m, "P.a", Value::Int(256)),
        "`P.a` is USINT, and 256 does not fit"
    );
    assert_eq!(
        fail(&mut m, "P.r", Value::Lreal(1.0)),
        "`P.r` is REAL, and 1.0 does not fit"
    );
    assert_eq!(
        fail(&mut m, "P.x", Value::Int(1)),
        "there is no variable `P.x`"
    );
    assert!(fail(&mut m, "P.b", Value::Int(1)).contains("array or structure"));
}

#[test]
fn a_wrong_specification_is_explained() {
    let project = typed(TEXT);
    let region = |name: &str, programs: &[&str], globals: &[&str]| RegionSpec {
        name: name.into(),
        programs: programs.iter().map(|s| (*s).to_owned()).collect(),
        globals: globals.iter().map(|s| (*s).to_owned()).collect(),
        markers: false,
    };
    for (entry, regions, message) in [
        ("X", vec![], "there is no program `X`"),
        ("F", vec![], "there is no program `F`"),
        (
            "P",
            vec![region("a", &["Q"], &[])],
            "there is no program `Q`",
        ),
        (
            "P",
            vec![region("a", &["M1"], &[]), region("b", &["m1"], &[])],
            "`m1` is named in two regions, or twice in one",
        ),
        (
            "P",
            vec![region("a", &[], &[]), region("a", &[], &[])],
            "there are two regions with the name `a`",
        ),
        (
            "P",
            vec![region("a", &[], &["nope"])],
            "there is no global variable `nope` for the region `a`",
        ),
        (
            "P",
            vec![region("a", &[], &["q"])],
            "`q` is part of the process image and cannot lie in the region `a`",
        ),
        (
            "P",
            vec![region("a", &[], &["C"])],
            "`C` is constant and cannot lie in the region `a`",
        ),
    ] {
        let spec = CompileSpec {
            entry: entry.into(),
            regions,
            ..CompileSpec::default()
        };
        let failed = layout_of(&project, &spec).expect_err(message);
        assert!(show(&failed).contains(message), "{}", show(&failed));
    }
}
