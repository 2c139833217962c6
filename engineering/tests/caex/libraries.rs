//! What stands in libraries: references are relative to the file in which they stand, and values of classes hold with their places.

use super::LOGIC;
use fam_engineering::files::ModelAt;
use fam_engineering::{BuiltCell, Problems, build};
use std::path::Path;

/// A class with logic beside it.
const PARTS: &str = r#"<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="parts.aml">
  <RoleClassLib Name="Roles">
    <RoleClass Name="Lit" RefBaseClassPath="FAMRoleClassLib/CriticalInterval">
      <Attribute Name="condition"><DefaultValue>count > 3</DefaultValue></Attribute>
      <Attribute Name="kind"><DefaultValue>checkpoint</DefaultValue></Attribute>
      <Attribute Name="checkpointState"><Attribute Name="count"><Value>2</Value></Attribute></Attribute>
    </RoleClass>
  </RoleClassLib>
  <SystemUnitClassLib Name="Parts">
    <SystemUnitClass Name="Part">
      <Attribute Name="worstCaseLoad" Unit="us"><Value>10</Value></Attribute>
      <ExternalInterface Name="logic" ID="logic" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface">
        <Attribute Name="refURI"><Value>logic/m.xml#main-pou</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Start" ID="start" RefBaseClassPath="FAMInterfaceClassLib/Input"><Attribute Name="point"><Value>image:Start</Value></Attribute></ExternalInterface>
      <ExternalInterface Name="Lamp" ID="lamp" RefBaseClassPath="FAMInterfaceClassLib/Output"><Attribute Name="point"><Value>image:Lamp</Value></Attribute><Attribute Name="failSafe"><Value>false</Value></Attribute></ExternalInterface>
      <SupportedRoleClass RefRoleClassPath="FAMRoleClassLib/MechatronicComponent" />
    </SystemUnitClass>
  </SystemUnitClassLib>
</CAEXFile>
"#;

/// A library in another folder, whose class derives from that one and has logic of its own.
const UNITS: &str = r#"<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="units.aml">
  <ExternalReference Alias="P" Path="../parts/parts.aml" />
  <SystemUnitClassLib Name="Units">
    <SystemUnitClass Name="Unit" RefBaseClassPath="P@Parts/Part">
      <InternalElement Name="Lit" ID="lit">
        <ExternalInterface Name="recovery" ID="recovery" RefBaseClassPath="FAMInterfaceClassLib/RecoveryAction">
          <Attribute Name="refURI"><Value>logic/stop.st#Off</Value></Attribute>
        </ExternalInterface>
        <RoleRequirements RefBaseRoleClassPath="P@Roles/Lit" />
      </InternalElement>
    </SystemUnitClass>
  </SystemUnitClassLib>
</CAEXFile>
"#;

const MODEL: &str = r#"<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="plant.aml">
  <ExternalReference Alias="U" Path="../lib/units/units.aml" />
  <InstanceHierarchy Name="plant">
    <InternalElement Name="gate" ID="g"><RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Gateway" /></InternalElement>
    <InternalElement Name="a" ID="a"><RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Controller" /></InternalElement>
    <InternalElement Name="b" ID="b"><RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Controller" /></InternalElement>
    <InternalElement Name="M" ID="m" RefBaseSystemUnitPath="U@Units/Unit"><Attribute Name="hosts"><Value>all</Value></Attribute></InternalElement>
  </InstanceHierarchy>
</CAEXFile>
"#;

const STOP: &str = "FUNCTION_BLOCK Off\nVAR_EXTERNAL Lamp : BOOL; END_VAR\nVAR_OUTPUT end : BOOL; END_VAR\n Lamp := FALSE; end := TRUE;\nEND_FUNCTION_BLOCK\n";

/// The model in `models/`, two libraries in folders of their own, logic beside each; with texts replaced.
fn built(changes: &[(&str, &str, &str)], root: Option<&str>) -> Result<BuiltCell, Problems> {
    let logic = LOGIC.replacen(
        &LOGIC[LOGIC.find("<pou name=\"Off\"").unwrap()..LOGIC.rfind("</pous>").unwrap()],
        "",
        1,
    );
    let dir = tempfile::tempdir().unwrap();
    for (path, text) in [
        ("all/models/plant.aml", MODEL),
        ("all/lib/units/units.aml", UNITS),
        ("all/lib/units/logic/stop.st", STOP),
        ("all/lib/parts/parts.aml", PARTS),
        ("all/lib/parts/logic/m.xml", &logic),
        ("all/other/m.xml", &logic),
        ("outside.xml", &logic),
    ] {
        let path = dir.path().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut text = text.to_owned();
        for (file, from, to) in changes {
            if path.ends_with(file) {
                assert!(text.contains(from), "{file} has no {from}");
                text = text.replacen(from, to, 1);
            }
        }
        std::fs::write(path, text).unwrap();
    }
    let root = root.map(|r| dir.path().join(r));
    build(ModelAt {
        file: &dir.path().join("all/models/plant.aml"),
        root: root.as_deref().map(Path::new),
    })
}

#[test]
fn references_are_relative_to_the_library_in_which_they_stand() {
    let cell = built(&[], Some("all")).unwrap_or_else(|p| panic!("{p}"));
    let mc = &cell.mcs[0];
    let files: Vec<&str> = mc.sources.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(
        files[..2],
        ["lib/parts/logic/m.xml", "lib/units/logic/stop.st"]
    );
    // The role's checkpoint state came along from the library of the library.
    let states = &mc.intervals[0].checkpoint_state;
    assert_eq!(states[0].1, "2", "{states:?}");
}

#[test]
fn libraries_lead_nowhere_else_than_models_do() {
    let reference = "logic/m.xml#main-pou";
    for (to, root, parts) in [
        // Up, and within the root still.
        ("../../other/m.xml#main-pou", "all", &[][..]),
        (
            "../../../outside.xml#main-pou",
            "all",
            &[
                "error[M805]",
                "logic of MC M in the library `lib/parts/parts.aml`",
                "leaves the model's folder",
                "plant.aml:7",
                "plant/M",
                "--root",
            ],
        ),
        ("../../../outside.xml#main-pou", ".", &[]),
        (
            "logic/n.xml#main-pou",
            "all",
            &["error[M209]", "`lib/parts/logic/n.xml` cannot be read"],
        ),
        (
            "logic/m.xml#nobody",
            "all",
            &[
                "error[M812]",
                "`lib/parts/logic/m.xml` has no POU, variable or globalId `nobody`",
            ],
        ),
    ] {
        match built(&[("parts.aml", reference, to)], Some(root)) {
            Ok(_) => assert!(parts.is_empty(), "{to} was built"),
            Err(problems) => {
                let text = problems.to_string();
                assert!(!parts.is_empty(), "{to}: {text}");
                for part in parts {
                    assert!(text.contains(part), "{to}: expected {part} in {text}");
                }
            }
        }
    }
    // Without a root the libraries themselves lie outside.
    let problems = built(&[], None).err().map(|p| p.to_string());
    let text = problems.unwrap_or_default();
    assert!(
        text.contains("error[M805]") && text.contains("--root"),
        "{text}"
    );
}

/// A place in a library's file is no place in the model's.
#[test]
fn what_is_wrong_in_a_library_shows_at_the_element_that_it_comes_to() {
    for (from, to, parts) in [
        (
            "Unit=\"us\"",
            "Unit=\"h\"",
            &[
                "error[M809]",
                "cannot be given in `h`",
                "plant.aml:7",
                "plant/M",
            ][..],
        ),
        (
            "<Value>2</Value>",
            "<Value>TRUE</Value>",
            &["error[M509]", "plant.aml:7"],
        ),
        (
            "Name=\"count\"><Value>2</Value>",
            "Name=\"count\">",
            &["error[M810]", "gives `count` no value", "plant.aml:7"],
        ),
    ] {
        let text = match built(&[("parts.aml", from, to)], Some("all")) {
            Ok(_) => panic!("{to} was built"),
            Err(problems) => problems.to_string(),
        };
        for part in parts {
            assert!(text.contains(part), "{to}: expected {part} in {text}");
        }
    }
}

/// The limit of the second controller of the old model, whose class says 40 %.
fn limit_permille(own: &str) -> u32 {
    let dir = tempfile::tempdir().unwrap();
    let model = super::old_model(dir.path());
    let cpu = "<Attribute Name=\"cpuFactor\" AttributeDataType=\"xs:double\"><Value>0.5";
    let text = super::OLD.replacen(cpu, &format!("{own}{cpu}"), 1);
    std::fs::write(&model, text).unwrap();
    let built = fam_engineering::build(&model).unwrap_or_else(|p| panic!("{p}"));
    built.model.controllers[1].limit_permille
}

#[test]
fn an_own_attribute_goes_before_its_class_as_far_as_it_says_something() {
    for (own, expected) in [
        ("", 400),
        (
            "<Attribute Name=\"loadLimit\"><Value>30</Value></Attribute>",
            300,
        ),
        // A default is what holds where nobody says more.
        (
            "<Attribute Name=\"loadLimit\"><DefaultValue>30</DefaultValue></Attribute>",
            400,
        ),
        // The own unit, and the value of the class.
        ("<Attribute Name=\"loadLimit\" Unit=\"permille\" />", 40),
    ] {
        assert_eq!(limit_permille(own), expected, "{own}");
    }
}
