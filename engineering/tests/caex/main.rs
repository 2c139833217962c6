//! AutomationML models: both forms of a cell give the same projects, and real files are read as they are.

mod bad;
#[path = "../common/mod.rs"]
mod common;
mod history;
mod libraries;
mod links;
mod refused;
mod round_trip;
mod variants;

use common::two_stations;
use fam_engineering::caex::container;
use fam_engineering::convert::{Form, convert, write_files};
use fam_engineering::generate::Target;
use fam_engineering::output::{files_of, generate};
use fam_engineering::{BuiltCell, build};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// A schema of the reference folder, if it is there.
fn schema(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("FAM_REFERENCE").map(|f| PathBuf::from(f).join("xsd").join(name));
    if path.is_none() {
        eprintln!("FAM_REFERENCE is not set: not validated against {name}");
    }
    path
}

/// Holds files against a schema, where xmllint and the schema are at hand.
fn validate(files: &[PathBuf], name: &str) {
    let Some(schema) = schema(name) else { return };
    let Ok(output) = Command::new("xmllint")
        .arg("--noout")
        .arg("--schema")
        .arg(schema)
        .args(files)
        .output()
    else {
        return eprintln!("xmllint is not installed: not validated");
    };
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Everything that is generated of a cell.
fn generated(built: &BuiltCell) -> BTreeMap<String, String> {
    files_of(built, Target::Fam)
}

fn assert_same(a: &BuiltCell, b: &BuiltCell) {
    let (one, other) = (generated(a), generated(b));
    assert_eq!(
        one.keys().collect::<Vec<_>>(),
        other.keys().collect::<Vec<_>>()
    );
    for (name, text) in &one {
        if text != &other[name] {
            let line = text
                .lines()
                .zip(other[name].lines())
                .position(|(a, b)| a != b)
                .unwrap_or(0);
            panic!(
                "{name} differs in line {}:\n{:?}\n{:?}",
                line + 1,
                text.lines().nth(line),
                other[name].lines().nth(line)
            );
        }
    }
    assert_eq!(a.model, b.model);
}

fn caex() -> Form {
    Form::Caex { library: None }
}

/// Converts into a folder and builds what is there.
fn converted(from: &Path, name: &str, form: &Form, dir: &Path) -> (PathBuf, BuiltCell) {
    let files = convert(from, name, form).unwrap_or_else(|p| panic!("{p}"));
    write_files(&files.files, dir).unwrap();
    let model = dir.join(name);
    let built = build(&model).unwrap_or_else(|p| panic!("{p}"));
    (model, built)
}

fn there_and_back(cell: &Path) {
    let original = build(cell).unwrap_or_else(|p| panic!("{p}"));
    let dir = tempfile::tempdir().unwrap();
    let (aml, as_caex) = converted(cell, "cell.aml", &caex(), &dir.path().join("caex"));
    assert_same(&original, &as_caex);
    validate(std::slice::from_ref(&aml), "CAEX_ClassModel_V.3.0.xsd");
    let logic: Vec<PathBuf> = files_below(&dir.path().join("caex"))
        .into_iter()
        .filter(|f| f.extension().is_some_and(|e| e == "xml"))
        .collect();
    assert!(!logic.is_empty());
    validate(&logic, "tc6_xml_v201.xsd");

    let (toml, as_toml) = converted(&aml, "cell.toml", &Form::Toml, &dir.path().join("toml"));
    assert_same(&original, &as_toml);
    let (again, as_caex) = converted(&toml, "cell.aml", &caex(), &dir.path().join("again"));
    assert_same(&original, &as_caex);
    // The defaults of the classes have become values; from here on nothing changes any more.
    let (third, _) = converted(&again, "cell.aml", &caex(), &dir.path().join("third"));
    let (first, second) = (
        std::fs::read_to_string(again).unwrap(),
        std::fs::read_to_string(third).unwrap(),
    );
    for (number, (a, b)) in first.lines().zip(second.lines()).enumerate() {
        assert_eq!(a, b, "line {}", number + 1);
    }
    assert_eq!(first.len(), second.len());

    let files = convert(cell, "cell.aml", &caex()).unwrap().files;
    let container_path = dir.path().join("cell.amlx");
    std::fs::write(&container_path, container::pack(&files, "cell.aml")).unwrap();
    assert_same(
        &original,
        &build(&container_path).unwrap_or_else(|p| panic!("{p}")),
    );
}

fn files_below(dir: &Path) -> Vec<PathBuf> {
    let mut list = Vec::new();
    for entry in std::fs::read_dir(dir).unwrap().flatten() {
        if entry.path().is_dir() {
            list.extend(files_below(&entry.path()));
        } else {
            list.push(entry.path());
        }
    }
    list.sort();
    list
}

#[test]
fn the_two_stations_are_the_same_in_each_form() {
    there_and_back(&two_stations());
}

#[test]
fn the_fms200_cell_is_the_same_in_each_form() {
    there_and_back(&project("deploy/fms200/cell.toml"));
}

#[test]
fn the_marking_machine_is_the_same_in_each_form() {
    there_and_back(&project("deploy/marking-machine/cell.toml"));
}

#[test]
fn a_cell_with_every_type_is_the_same_in_each_form() {
    there_and_back(&project("engineering/tests/cells/types/cell.toml"));
}

#[test]
fn the_shipped_automationml_model_is_the_shipped_cell() {
    let aml = project("deploy/fms200/fms200.aml");
    let toml = project("deploy/fms200/cell.toml");
    if std::env::var_os("FAM_UPDATE").is_some() {
        let form = Form::Caex {
            library: Some("../lib/FAM.aml".to_owned()),
        };
        let files = convert(&toml, "fms200.aml", &form).unwrap_or_else(|p| panic!("{p}"));
        write_files(&files.files, &project("deploy/fms200")).unwrap();
    }
    let (a, b) = (build(&aml), build(&toml));
    assert_same(&a.unwrap_or_else(|p| panic!("{p}")), &b.unwrap());
    validate(
        &[aml, project("deploy/lib/FAM.aml")],
        "CAEX_ClassModel_V.3.0.xsd",
    );
    let logic: Vec<PathBuf> = files_below(&project("deploy/fms200/logic"))
        .into_iter()
        .filter(|f| f.extension().is_some_and(|e| e == "xml"))
        .collect();
    validate(&logic, "tc6_xml_v201.xsd");
}

#[test]
fn what_is_generated_runs_again_as_a_model() {
    let (files, built) = generate(&two_stations(), Target::Fam).unwrap();
    let (again, _) = generate(&two_stations(), Target::Fam).unwrap();
    assert_eq!(files, again);
    let dir = tempfile::tempdir().unwrap();
    write_files(&files, dir.path()).unwrap();
    let deployment =
        fam_engineering::DeploymentFile::read(&dir.path().join("deployment.toml")).unwrap();
    let second = build(&deployment.cell()).unwrap();
    assert_same(&built, &second);
    let resolved = deployment.resolve(&second.model).unwrap();
    assert_eq!(resolved.controllers.len(), 2);
    let agents: toml::Table = toml::from_str(&files["agents.toml"]).unwrap();
    assert_eq!(agents["controller_agent"].as_array().unwrap().len(), 2);
    assert_eq!(
        agents["mc_agent"][0]["state_diagnosis"].as_str(),
        Some("Feeder.diagnosis.xml")
    );
}

/// One cell in CAEX 2.15 with everything that is spelled in its own way there and in the wild.
const OLD: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<CAEXFile FileName="old.aml" SchemaVersion="2.15" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="CAEX_ClassModel_V2.15.xsd">
  <AdditionalInformation AutomationMLVersion="2.0" />
  <ExternalReference Path="lib/Own.aml" Alias="Own" />
  <InstanceHierarchy Name="old">
    <InternalElement Name="gate" ID="{00000000-0000-0000-0000-000000000001}">
      <ExternalInterface Name="Start:1" ID="{00000000-0000-0000-0000-000000000101}" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint">
        <Attribute Name="point" AttributeDataType="xs:string"><Value>image:Start</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Lamp" ID="aa000000-0000-0000-0000-000000000102" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint">
        <Attribute Name="point" AttributeDataType="xs:string"><Value> image:Lamp </Value></Attribute>
      </ExternalInterface>
      <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Gateway" />
    </InternalElement>
    <InternalElement Name="first" ID="{00000000-0000-0000-0000-000000000002}" RefBaseSystemUnitPath="Own@OwnUnits/FastController">
      <InternalElement Name="mirror of M" ID="{00000000-0000-0000-0000-000000000003}" RefBaseSystemUnitPath="{00000000-0000-0000-0000-000000000005}" />
    </InternalElement>
    <InternalElement Name="second" ID="{00000000-0000-0000-0000-000000000004}" RefBaseSystemUnitPath="Own@OwnUnits/FastController">
      <Attribute Name="cpuFactor" AttributeDataType="xs:double"><Value>0.5</Value></Attribute>
      <ExternalInterface Name="Hosting" ID="00000000-0000-0000-0000-000000000104" RefBaseClassPath="FAMInterfaceClassLib/Hosting" />
    </InternalElement>
    <InternalElement Name="M" ID="{00000000-0000-0000-0000-000000000005}">
      <Attribute Name="worstCaseLoad" AttributeDataType="xs:double" Unit="ms"><Value>0.02</Value></Attribute>
      <ExternalInterface Name="logic" ID="{00000000-0000-0000-0000-000000000105}" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface/LogicInterface">
        <Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>file:///the%20logic/m.xml#main-pou</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="go" RefBaseClassPath="FAMInterfaceClassLib/Input">
        <Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>file:///the%20logic/m.xml#Start</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Lamp" RefBaseClassPath="FAMInterfaceClassLib/Output">
        <Attribute Name="failSafe" AttributeDataType="xs:boolean"><Value>0</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Hosting" RefBaseClassPath="FAMInterfaceClassLib/Hosting" />
      <InternalElement Name="Lit" ID="{00000000-0000-0000-0000-000000000006}">
        <ExternalInterface Name="recovery" RefBaseClassPath="FAMInterfaceClassLib/RecoveryAction">
          <Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>the%20logic\m.xml#Off</Value></Attribute>
        </ExternalInterface>
        <RoleRequirements RefBaseRoleClassPath="Own@OwnRoles/Danger">
          <Attribute Name="condition" AttributeDataType="xs:string"><Value>count &gt; 3</Value></Attribute>
        </RoleRequirements>
      </InternalElement>
      <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/MechatronicComponent" />
    </InternalElement>
    <InternalElement Name="wires" ID="{00000000-0000-0000-0000-000000000007}">
      <InternalLink Name="a" RefPartnerSideA="{00000000-0000-0000-0000-000000000001}:Start:1" RefPartnerSideB="00000000-0000-0000-0000-000000000005:go" />
      <InternalLink Name="b" RefPartnerSideA="AA000000-0000-0000-0000-000000000102" RefPartnerSideB="{00000000-0000-0000-0000-000000000003}:Lamp" />
      <InternalLink RefPartnerSideA="00000000-0000-0000-0000-000000000104" RefPartnerSideB="{00000000-0000-0000-0000-000000000005}:Hosting" Name="c" />
    </InternalElement>
  </InstanceHierarchy>
</CAEXFile>
"#;

const OWN: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<CAEXFile FileName="Own.aml" SchemaVersion="2.15">
  <ExternalReference Path="../FAM.aml" Alias="F" />
  <RoleClassLib Name="OwnRoles">
    <RoleClass Name="Danger" RefBaseClassPath="F@FAMRoleClassLib/CriticalInterval">
      <Attribute Name="kind" AttributeDataType="xs:string"><DefaultValue>checkpoint</DefaultValue></Attribute>
      <Attribute Name="repeatable" AttributeDataType="xs:boolean"><DefaultValue>true</DefaultValue></Attribute>
    </RoleClass>
  </RoleClassLib>
  <SystemUnitClassLib Name="OwnUnits">
    <SystemUnitClass Name="AnyController">
      <Attribute Name="loadLimit" AttributeDataType="xs:double"><Value>40</Value></Attribute>
      <SupportedRoleClass RefRoleClassPath="F@FAMRoleClassLib/Controller" />
    </SystemUnitClass>
    <SystemUnitClass Name="FastController" RefBaseClassPath="OwnUnits/AnyController">
      <Attribute Name="cpuFactor" AttributeDataType="xs:double"><Value>2</Value></Attribute>
    </SystemUnitClass>
  </SystemUnitClassLib>
</CAEXFile>
"#;

const LOGIC: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
  <fileHeader companyName="c" productName="p" productVersion="1" creationDateTime="2020-01-01T00:00:00" />
  <contentHeader name="m"><coordinateInfo><fbd><scaling x="1" y="1" /></fbd><ld><scaling x="1" y="1" /></ld><sfc><scaling x="1" y="1" /></sfc></coordinateInfo></contentHeader>
  <types><dataTypes /><pous>
    <pou name="Main" pouType="program" globalId="main-pou">
      <interface><externalVars><variable name="Start"><type><BOOL /></type></variable><variable name="Lamp"><type><BOOL /></type></variable></externalVars><localVars><variable name="count"><type><INT /></type></variable></localVars></interface>
      <body><ST><xhtml:p>IF Start THEN count := count + 1; END_IF; Lamp := count &gt; 3;</xhtml:p></ST></body>
    </pou>
    <pou name="Off" pouType="functionBlock">
      <interface><externalVars><variable name="Lamp"><type><BOOL /></type></variable></externalVars><outputVars><variable name="end"><type><BOOL /></type></variable></outputVars></interface>
      <body><ST><xhtml:p>Lamp := FALSE; end := TRUE;</xhtml:p></ST></body>
    </pou>
  </pous></types>
  <instances><configurations><configuration name="c"><globalVars>
    <variable name="Start" address="%IX0.0"><type><BOOL /></type></variable>
    <variable name="Lamp" address="%QX0.0"><type><BOOL /></type></variable>
  </globalVars></configuration></configurations></instances>
</project>
"#;

fn old_model(dir: &Path) -> PathBuf {
    std::fs::create_dir_all(dir.join("lib")).unwrap();
    std::fs::create_dir_all(dir.join("the logic")).unwrap();
    std::fs::write(dir.join("lib/Own.aml"), OWN).unwrap();
    std::fs::write(dir.join("the logic/m.xml"), LOGIC).unwrap();
    let model = dir.join("old.aml");
    std::fs::write(&model, format!("\u{feff}{OLD}")).unwrap();
    model
}

#[test]
fn caex_2_15_with_all_its_spellings_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let built = build(&old_model(dir.path())).unwrap_or_else(|p| panic!("{p}"));
    let model = &built.model;
    assert_eq!(model.cell.as_str(), "old");
    let names: Vec<&str> = model
        .controllers
        .iter()
        .map(|c| c.controller.as_str())
        .collect();
    assert_eq!(names, ["first", "second"]);
    // Inherited twice, and laid over.
    let of: Vec<(u32, u32)> = model
        .controllers
        .iter()
        .map(|c| (c.cpu_factor_permille, c.limit_permille))
        .collect();
    assert_eq!(of, [(2000, 400), (500, 400)]);
    let mc = &model.mcs[0];
    assert_eq!(mc.worst_case_us, 20);
    // One by its mirror object, one by a link.
    assert_eq!(mc.hosts.len(), 2);
    assert_eq!(mc.inputs[0].name, "Start");
    assert_eq!(mc.outputs[0].name, "Lamp");
    assert!(mc.outputs[0].field.is_some());
    let interval = &mc.diagnosis.intervals[0];
    assert_eq!(
        (
            interval.name.as_str(),
            interval.pou.as_str(),
            interval.repeatable
        ),
        ("Lit", "Off", true)
    );
    assert_eq!(built.intervals_of("M")[0], "count > 3");
    validate(
        &[dir.path().join("old.aml"), dir.path().join("lib/Own.aml")],
        "CAEX_ClassModel_V2.15.xsd",
    );
}

trait Intervals {
    fn intervals_of(&self, mc: &str) -> Vec<String>;
}

impl Intervals for BuiltCell {
    fn intervals_of(&self, mc: &str) -> Vec<String> {
        let mc = self.mcs.iter().find(|m| m.mc.as_str() == mc).unwrap();
        mc.intervals.iter().map(|i| i.condition.clone()).collect()
    }
}

/// A model of another tool: a PLC by its role, logic by its reference, nothing of FAM.
#[test]
fn a_third_party_model_runs_on_the_image_driver() {
    let dir = tempfile::tempdir().unwrap();
    old_model(dir.path());
    let foreign = r#"<?xml version="1.0" encoding="utf-8"?>
<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="plant.aml">
  <SourceDocumentInformation OriginName="t" OriginID="t" OriginVersion="1" LastWritingDateTime="2020-01-01T00:00:00" />
  <InstanceHierarchy Name="Small plant">
    <InternalElement Name="CPU 1" ID="1">
      <ExternalInterface Name="program" ID="2" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface">
        <Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>the logic/m.xml</Value></Attribute>
      </ExternalInterface>
      <RoleRequirements RefBaseRoleClassPath="AutomationMLCSRoleClassLib/ControlEquipment/Controller/PLC" />
    </InternalElement>
  </InstanceHierarchy>
</CAEXFile>
"#;
    let path = dir.path().join("plant.aml");
    std::fs::write(&path, foreign).unwrap();
    validate(std::slice::from_ref(&path), "CAEX_ClassModel_V.3.0.xsd");
    let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(built.model.cell.as_str(), "Small_plant");
    assert_eq!(built.model.controllers[0].controller.as_str(), "CPU_1");
    assert_eq!(built.model.mcs[0].mc.as_str(), "Main");
    assert_eq!(built.model.mcs[0].inputs[0].name, "Start");
    let warnings: Vec<String> = built.warnings.iter().map(ToString::to_string).collect();
    let warnings = warnings.join("\n");
    for part in [
        "no roles of FAM",
        "only controller",
        "fail-safe",
        "critical intervals",
        "worst-case",
    ] {
        assert!(warnings.contains(part), "expected {part} in:\n{warnings}");
    }
    // From there on it is a model of FAM.
    there_and_back(&path);

    for (from, to, part) in [
        ("<Value>the logic/m.xml</Value>", "", "has no `refURI`"),
        (
            "<Value>the logic/m.xml</Value>",
            "<Value></Value>",
            "the reference is empty",
        ),
        ("the logic/m.xml", "the logic/x.xml", "cannot be read"),
        ("the logic/m.xml", "the logic/m.xml#None", "globalId `None`"),
        ("Controller/PLC", "Sensor", "the model has no controller"),
    ] {
        assert!(foreign.contains(from));
        std::fs::write(&path, foreign.replace(from, to)).unwrap();
        let problems = build(&path).unwrap_err().to_string();
        assert!(problems.contains(part), "expected {part} in:\n{problems}");
    }
}

#[test]
fn real_models_without_logic_say_so() {
    let Some(reference) = std::env::var_os("FAM_REFERENCE") else {
        return eprintln!("FAM_REFERENCE is not set: the samples are not read");
    };
    let samples = PathBuf::from(reference).join("samples");
    let problems = build(&samples.join("BoosterCompressor.aml"))
        .unwrap_err()
        .to_string();
    for part in [
        "`../PLCOpenXML/BoosterCompressor_codesys.xml` leaves the model's folder",
        "warning[W809]: the library `AutomationMLBaseLibraries`",
    ] {
        assert!(problems.contains(part), "expected {part} in:\n{problems}");
    }
    let problems = build(&samples.join("AR_APC_AllClassLibs_V_1_2_1.aml"))
        .unwrap_err()
        .to_string();
    assert!(
        problems.contains("the model has no controller"),
        "{problems}"
    );
    let problems = build(&samples.join("xor_ld.xml")).unwrap_err().to_string();
    assert!(problems.contains("PLCopen project"), "{problems}");
}
