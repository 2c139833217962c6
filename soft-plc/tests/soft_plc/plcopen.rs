//! PLCopen XML: the same project as its Structured Text, errors at the lines of the file.

use fam_soft_plc::source::Span;
use fam_soft_plc::{CheckOptions, SourceFile, check, compile, parse_project};

use crate::common::{Machine, show, spec};

const ST: &str = "
TYPE
  Color : (Red, Green := 5, Blue) := Green;
  Percent : INT (0..100);
  Point : STRUCT x : REAL := 1.5; y : REAL; END_STRUCT;
  Row : ARRAY[1..3, 0..1] OF Point;
END_TYPE
VAR_GLOBAL CONSTANT N : INT := 3; END_VAR
VAR_GLOBAL lamp AT %QX0.1 : BOOL; END_VAR
VAR_GLOBAL RETAIN total : DINT := 10; END_VAR
FUNCTION Twice : INT VAR_INPUT v : INT; END_VAR Twice := v * 2; END_FUNCTION
FUNCTION_BLOCK Acc VAR_INPUT step : INT := 1; END_VAR VAR_OUTPUT sum : INT; END_VAR VAR_IN_OUT all : DINT; END_VAR
VAR_TEMP t : INT; END_VAR
t := Twice(step); sum := sum + t; all := all + t; END_FUNCTION_BLOCK
PROGRAM P
VAR c : Color; p : Percent := 50; row : Row; a : Acc := (step := 4); list : ARRAY[0..4] OF INT := [1, 3(2), 9]; pt : Point := (y := 2.5); t : TON; END_VAR
VAR_EXTERNAL total : DINT; END_VAR
IF c = Green & list[4] > 1 THEN a(all := total); c := Blue; END_IF;
row[N, 1].x := pt.y; lamp := a.sum < 100; t(IN := TRUE, PT := T#1s);
END_PROGRAM
";

const XML: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
  <fileHeader companyName="x" productName="x" productVersion="1" creationDateTime="2020-01-01T00:00:00"/>
  <contentHeader name="test"><coordinateInfo/></contentHeader>
  <types>
    <dataTypes>
      <dataType name="Color">
        <baseType><enum><values><value name="Red"/><value name="Green" value="5"/><value name="Blue"/></values></enum></baseType>
        <initialValue><simpleValue value="Green"/></initialValue>
      </dataType>
      <dataType name="Percent"><baseType><subrangeSigned><range lower="0" upper="100"/><baseType><INT/></baseType></subrangeSigned></baseType></dataType>
      <dataType name="Point"><baseType><struct>
        <variable name="x"><type><REAL/></type><initialValue><simpleValue value="1.5"/></initialValue></variable>
        <variable name="y"><type><REAL/></type></variable>
      </struct></baseType></dataType>
      <dataType name="Row"><baseType><array><dimension lower="1" upper="3"/><dimension lower="0" upper="1"/><baseType><derived name="Point"/></baseType></array></baseType></dataType>
    </dataTypes>
    <pous>
      <pou name="Twice" pouType="function">
        <interface><returnType><INT/></returnType><inputVars><variable name="v"><type><INT/></type></variable></inputVars></interface>
        <body><ST><xhtml:p>Twice := v * 2;</xhtml:p></ST></body>
      </pou>
      <pou name="Acc" pouType="functionBlock">
        <interface>
          <inputVars><variable name="step"><type><INT/></type><initialValue><simpleValue value="1"/></initialValue></variable></inputVars>
          <outputVars><variable name="sum"><type><INT/></type></variable></outputVars>
          <inOutVars><variable name="all"><type><DINT/></type></variable></inOutVars>
          <tempVars><variable name="t"><type><INT/></type></variable></tempVars>
        </interface>
        <body><ST><xhtml:p><![CDATA[t := Twice(step); sum := sum + t; all := all + t;]]></xhtml:p></ST></body>
      </pou>
      <pou name="P" pouType="program">
        <interface>
          <localVars>
            <variable name="c"><type><derived name="Color"/></type></variable>
            <variable name="p"><type><derived name="Percent"/></type><initialValue><simpleValue value="50"/></initialValue></variable>
            <variable name="row"><type><derived name="Row"/></type></variable>
            <variable name="a"><type><derived name="Acc"/></type><initialValue><structValue><value member="step"><simpleValue value="4"/></value></structValue></initialValue></variable>
            <variable name="list"><type><array><dimension lower="0" upper="4"/><baseType><INT/></baseType></array></type>
              <initialValue><arrayValue><value><simpleValue value="1"/></value><value repetitionValue="3"><simpleValue value="2"/></value><value><simpleValue value="9"/></value></arrayValue></initialValue></variable>
            <variable name="pt"><type><derived name="Point"/></type><initialValue><structValue><value member="y"><simpleValue value="2.5"/></value></structValue></initialValue></variable>
            <variable name="t"><type><derived name="TON"/></type></variable>
          </localVars>
          <externalVars><variable name="total"><type><DINT/></type></variable></externalVars>
        </interface>
        <body><ST><xhtml:p>
IF c = Green &amp; list[4] &gt; 1 THEN a(all := total); c := Blue; END_IF;
row[N, 1].x := pt.y; lamp := a.sum &lt; 100; t(IN := TRUE, PT := T#1s);
</xhtml:p></ST></body>
      </pou>
    </pous>
  </types>
  <instances><configurations><configuration name="Config"><resource name="Res">
    <task name="Main" interval="PT0.02S" priority="1"><pouInstance name="Inst" typeName="P"/></task>
    <globalVars constant="true"><variable name="N"><type><INT/></type><initialValue><simpleValue value="3"/></initialValue></variable></globalVars>
    <globalVars><variable name="lamp" address="%QX0.1"><type><BOOL/></type></variable></globalVars>
    <globalVars retain="true"><variable name="total"><type><DINT/></type><initialValue><simpleValue value="10"/></initialValue></variable></globalVars>
  </resource></configuration></configurations></instances>
</project>
"#;

fn build(name: &str, text: &str) -> Result<fam_soft_plc::CompiledMc, String> {
    let (project, diagnostics) = parse_project(&[SourceFile::new(name, text)]);
    if !diagnostics.is_empty() {
        return Err(show(&diagnostics));
    }
    let typed = check(&project, CheckOptions::default()).map_err(|d| show(&d))?;
    compile(&typed, &spec("P")).map_err(|d| show(&d))
}

#[test]
fn xml_and_text_are_the_same_program() {
    let st = build("p.st", ST).unwrap_or_else(|e| panic!("{e}"));
    let xml = build("p.xml", XML).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(st.layout, xml.layout);
    assert_eq!(st.wasm, xml.wasm);
    assert_eq!(st.logic_hash, xml.logic_hash);
    let mut m = Machine::of(&xml);
    m.scan();
    m.scan();
    assert_eq!(
        (
            m.text("total"),
            m.text("row[3,1].x"),
            m.text("lamp"),
            m.text("c")
        ),
        ("18".into(), "2.5".into(), "TRUE".into(), "6".into())
    );
    let old = XML.replace("tc6_0201", "tc6_0200");
    assert_eq!(
        build("p.xml", &old).map(|m| m.logic_hash),
        Ok(st.logic_hash)
    );
}

#[test]
fn tasks_and_instances_are_kept() {
    let (project, _) = parse_project(&[SourceFile::new("p.xml", XML)]);
    let resource = &project.configurations[0].resources[0];
    assert_eq!(
        (
            resource.tasks[0].name.as_str(),
            resource.tasks[0].interval_ns,
            resource.tasks[0].priority
        ),
        ("Main", Some(20_000_000), 1)
    );
    assert_eq!(
        (
            resource.instances[0].program.as_str(),
            resource.instances[0].task.as_deref()
        ),
        ("P", Some("Main"))
    );
    let st = "PROGRAM P ; END_PROGRAM CONFIGURATION Config RESOURCE Res ON PLC TASK Main(INTERVAL := T#20ms, PRIORITY := 1); PROGRAM Inst WITH Main : P; END_RESOURCE END_CONFIGURATION";
    let (other, problems) = parse_project(&[SourceFile::new("p.st", st)]);
    assert!(problems.is_empty(), "{}", show(&problems));
    // The same but for where they stand.
    let (mut here, mut there) = (
        resource.clone(),
        other.configurations[0].resources[0].clone(),
    );
    for resource in [&mut here, &mut there] {
        resource.tasks[0].span = Span::default();
        resource.instances[0].span = Span::default();
    }
    assert_eq!(there.tasks, here.tasks);
    assert_eq!(there.instances, here.instances);
}

#[test]
fn errors_stand_at_the_line_of_the_xml_file() {
    let line_of = |needle: &str| {
        XML.lines()
            .position(|l| l.contains(needle))
            .map(|i| i as u32 + 1)
    };
    let (cdata, entity) = (line_of("sum := sum + t"), line_of("c := Blue"));
    for (from, to, line, message) in [
        // Exact text, CDATA.
        (
            "sum := sum + t;",
            "sum := summ + t;",
            cdata,
            "`summ` is not declared",
        ),
        (
            "sum := sum + t;",
            "sum := sum + ;",
            cdata,
            "`;` cannot stand here",
        ),
        // Decoded entities: another text, the same line.
        ("c := Blue;", "c := Blau;", entity, "`Blau` is not declared"),
        // Declarations.
        (
            "<derived name=\"Acc\"/>",
            "<derived name=\"Akk\"/>",
            line_of("name=\"Acc\"/>"),
            "the type `Akk` is not declared",
        ),
        (
            "value=\"50\"",
            "value=\"500\"",
            line_of("value=\"50\""),
            "500 is outside 0..100",
        ),
    ] {
        let text = XML.replace(from, to);
        assert_ne!(text, XML);
        let (project, mut diagnostics) = parse_project(&[SourceFile::new("p.xml", &text)]);
        diagnostics.extend(
            check(&project, CheckOptions::default())
                .err()
                .unwrap_or_default(),
        );
        let first = diagnostics.first().expect(to);
        assert!(first.message.contains(message), "{first}");
        assert_eq!(
            (first.file.as_str(), Some(first.line)),
            ("p.xml", line),
            "{first}"
        );
    }
}

#[test]
fn what_cannot_be_read_is_named() {
    let body = "<ST><xhtml:p>Twice := v * 2;</xhtml:p></ST>";
    for (from, to, message) in [
        (body, "<CFC/>", "the body of Twice is written in CFC"),
        (
            body,
            "<SFC/>",
            "a FUNCTION cannot be a sequential function chart",
        ),
        (
            "http://www.plcopen.org/xml/tc6_0201",
            "http://www.plcopen.org/xml/tc6.xsd",
            "PLCopen XML 1.0 (tc6.xsd) is not supported",
        ),
        (
            "http://www.plcopen.org/xml/tc6_0201",
            "https://www.iec.ch/public/TC65SC65BWG7TF10",
            "IEC 61131-10 XML is not supported",
        ),
        (
            "http://www.plcopen.org/xml/tc6_0201",
            "urn:x",
            "is no PLCopen project",
        ),
        ("</project>", "", "this is no well-formed XML"),
        (
            "<INT/></returnType>",
            "<array/></returnType>",
            "<array> has no <baseType>",
        ),
        (
            "pouType=\"function\"",
            "pouType=\"class\"",
            "`class` is no kind of POU",
        ),
    ] {
        let text = XML.replacen(from, to, 1);
        assert_ne!(text, XML, "{from}");
        let failed = build("p.xml", &text).expect_err(message);
        assert!(failed.contains(message), "{message}: {failed}");
        assert!(failed.contains("p.xml:"), "{failed}");
    }
}

/// Real files, where the reference folder exists.
#[test]
fn public_samples_are_read() {
    let Ok(folder) = std::env::var("FAM_REFERENCE") else {
        eprintln!("FAM_REFERENCE is not set; the public samples are passed over");
        return;
    };
    let read = |name: &str| {
        let path = std::path::Path::new(&folder).join("samples").join(name);
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        parse_project(&[SourceFile::new(name, text)])
    };
    let (project, diagnostics) = read("xor_ld.xml");
    assert!(!project.pous.is_empty());
    assert!(diagnostics.is_empty(), "{}", show(&diagnostics));
    assert!(!project.pous[0].body.is_empty());
    let (project, diagnostics) = read("codesys_enip_diag_0200.xml");
    let program = project
        .pous
        .iter()
        .find(|p| p.name.name == "PLC_PRG")
        .expect("PLC_PRG");
    assert!(!program.vars[0].decls.is_empty());
    assert!(!program.body.is_empty() || !diagnostics.is_empty());
    assert_eq!(
        project.configurations[0].resources[0].tasks[0].interval_ns,
        Some(20_000_000)
    );
}
