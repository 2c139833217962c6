//! Regions as the generated POUs use them: block copies, access to internals, checkpoints that agree in both forms.

use fam_soft_plc::{CheckOptions, CompileSpec, CompiledMc, RegionSpec, Value, compile, layout_of};

use crate::common::{Machine, show, typed, typed_with};

const MC: &str = "
PROGRAM MC1
VAR n : INT; t : TON; list : ARRAY[0..2] OF SINT; edge : R_TRIG; END_VAR
n := n + 1;
t(IN := TRUE, PT := T#1s);
list[n MOD 3] := list[n MOD 3] - 1;
edge(CLK := n > 2);
END_PROGRAM
";

fn spec() -> CompileSpec {
    CompileSpec {
        entry: "MC1_Control".into(),
        regions: vec![RegionSpec {
            name: "state".into(),
            programs: vec!["MC1".into()],
            globals: vec![],
            markers: false,
        }],
        ..CompileSpec::default()
    }
}

fn state_len() -> u32 {
    let text = format!("{MC} PROGRAM MC1_Control MC1(); END_PROGRAM");
    let layout = layout_of(&typed(&text), &spec()).expect("layout");
    layout.region("state").expect("region").len
}

fn build(body: &str, len: u32) -> Result<CompiledMc, String> {
    let text = format!(
        "{MC} VAR_GLOBAL save, load : BOOL; image : ARRAY[0..{}] OF BYTE; END_VAR\nPROGRAM MC1_Control\nVAR c : Copy; END_VAR\nMC1();\nc();\nEND_PROGRAM\nFUNCTION_BLOCK Copy\nVAR i : INT; END_VAR\n{body}\nEND_FUNCTION_BLOCK",
        len - 1
    );
    let options = CheckOptions {
        allow_internal_access: true,
        ..CheckOptions::default()
    };
    compile(&typed_with(&text, options), &spec()).map_err(|d| show(&d))
}

const BLOCK_COPY: &str = "
IF save THEN __REGION_TO_BYTES('state', image); END_IF;
IF load THEN __BYTES_TO_REGION('state', image); END_IF;";

#[test]
fn a_region_goes_to_bytes_and_back() {
    let mut m = Machine::of(&build(BLOCK_COPY, state_len()).expect("compiles"));
    for _ in 0..4 {
        m.scan();
    }
    m.set("save", Value::Bool(true));
    m.scan();
    m.set("save", Value::Bool(false));
    let kept = m.instance.region(0).to_vec();
    let at = m.instance.layout().find("image").expect("image").offset as usize;
    let image = m.instance.region(1)[at..at + kept.len()].to_vec();
    assert_eq!(image, kept);
    m.scan();
    m.set("load", Value::Bool(true));
    m.scan();
    assert_eq!(m.instance.region(0), kept.as_slice());
    assert_eq!(m.text("MC1.n"), "5");
}

#[test]
fn an_array_of_another_length_is_refused_with_both_lengths() {
    let len = state_len();
    let failed = build(BLOCK_COPY, len + 8).expect_err("length");
    assert!(
        failed.contains(&format!(
            "the region `state` has {len} bytes and the array has {}",
            len + 8
        )),
        "{failed}"
    );
    assert!(
        failed.contains(&format!("ARRAY[0..{}] OF BYTE", len - 1)),
        "{failed}"
    );
    let failed = build("__REGION_TO_BYTES('nowhere', image);", len).expect_err("name");
    assert!(
        failed.contains("there is no region `nowhere`") && failed.contains("one of state, work"),
        "{failed}"
    );
}

/// The same bytes, written variable by variable as for a foreign PLC.
#[test]
fn internals_are_reachable_and_give_the_same_bytes() {
    let len = state_len();
    let layout = layout_of(
        &typed(&format!("{MC} PROGRAM MC1_Control MC1(); END_PROGRAM")),
        &spec(),
    )
    .expect("layout");
    let mut body = String::from("IF save THEN\n");
    for root in &layout.roots {
        for leaf in layout.leaves(root) {
            let elem = leaf.ty.elem().expect("scalar");
            let raw = match elem.name() {
                "TIME" => format!("LINT_TO_LWORD(TIME_TO_LINT({}))", leaf.path),
                "BOOL" => format!("BOOL_TO_LWORD({})", leaf.path),
                name => format!("{name}_TO_LWORD({})", leaf.path),
            };
            for byte in 0..leaf.len {
                body.push_str(&format!(
                    "image[{}] := LWORD_TO_BYTE(SHR({raw}, {}));\n",
                    leaf.offset + byte,
                    byte * 8
                ));
            }
        }
    }
    body.push_str("END_IF;");
    let mut m = Machine::of(&build(&body, len).expect("compiles"));
    m.set("save", Value::Bool(true));
    for _ in 0..5 {
        m.scan();
        let kept = m.instance.region(0).to_vec();
        let at = m.instance.layout().find("image").expect("image").offset as usize;
        assert_eq!(m.instance.region(1)[at..at + kept.len()], kept);
    }
    assert_eq!(m.text("MC1.t.running"), "TRUE");
}

#[test]
fn internals_are_closed_without_the_option() {
    let (project, _) = fam_soft_plc::parse_project(&[fam_soft_plc::SourceFile::new(
        "t.st",
        "PROGRAM P VAR t : TON; x : TIME; END_VAR x := t.start; t.Q := TRUE; END_PROGRAM",
    )]);
    let failed = fam_soft_plc::check(&project, CheckOptions::default()).expect_err("closed");
    let text = show(&failed);
    assert!(text.contains("`start` is internal to TON (VAR)"), "{text}");
    assert!(
        text.contains("`t` is an output of TON") || text.contains("`Q` is an output of TON"),
        "{text}"
    );
}
