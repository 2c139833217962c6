//! Links that classes bring along: they join the elements of each instance, in every spelling.

use super::LOGIC;
use fam_engineering::files::ModelAt;
use fam_engineering::{BuiltCell, Problems, build};
use fam_proto::model::{FieldPoint, InputSource};
use std::path::Path;

/// An MC by its class, a cell of it and two controllers as a class, and MCs that hear themselves.
const CLASSES: &str = r#"
  <SystemUnitClassLib Name="Units">
    <SystemUnitClass Name="Part" ID="{part}">
      <Attribute Name="worstCaseLoad" Unit="us"><Value>10</Value></Attribute>
      <ExternalInterface Name="logic" ID="part-logic" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface">
        <Attribute Name="refURI"><Value>LOGIC#main-pou</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Start" ID="part-start" RefBaseClassPath="FAMInterfaceClassLib/Input" />
      <ExternalInterface Name="Lamp" ID="part-lamp" RefBaseClassPath="FAMInterfaceClassLib/Output">
        <Attribute Name="failSafe"><Value>false</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Hosting" ID="part-hosting" RefBaseClassPath="FAMInterfaceClassLib/Hosting" />
      <SupportedRoleClass RefRoleClassPath="FAMRoleClassLib/MechatronicComponent" />
    </SystemUnitClass>
    <SystemUnitClass Name="Plc" ID="plc"><SupportedRoleClass RefRoleClassPath="FAMRoleClassLib/Controller" /></SystemUnitClass>
    <SystemUnitClass Name="Unit" ID="unit">
      <InternalElement Name="gate" ID="gate">
        <ExternalInterface Name="Start" ID="gate-start" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint" />
        <ExternalInterface Name="Lamp" ID="gate-lamp" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint" />
        <ExternalInterface Name="Other" ID="gate-other" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint" />
        <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Gateway" />
      </InternalElement>
      <InternalElement Name="first" ID="first" RefBaseSystemUnitPath="Units/Plc">
        <InternalElement Name="M again" ID="m-again" RefBaseSystemUnitPath="{m}" />
      </InternalElement>
      <InternalElement Name="second" ID="second" RefBaseSystemUnitPath="Units/Plc">
        <ExternalInterface Name="Hosting" ID="second-hosting" RefBaseClassPath="FAMInterfaceClassLib/Hosting" />
        <InternalLink Name="hosting" RefPartnerSideA="second-hosting" RefPartnerSideB="{M}:Hosting" />
      </InternalElement>
      <InternalElement Name="M" ID="m" RefBaseSystemUnitPath="Units/Part" />
      <InternalLink Name="start" RefPartnerSideA="{gate}:Start" RefPartnerSideB="m:Start" />
      <InternalLink Name="lamp" RefPartnerSideA="gate-lamp" RefPartnerSideB="{m-again}:Lamp" />
    </SystemUnitClass>
    <SystemUnitClass Name="Ring" ID="ring" RefBaseClassPath="Units/Part">
      <ExternalInterface Name="Lamp" ID="ring-lamp" RefBaseClassPath="FAMInterfaceClassLib/Output">
        <Attribute Name="failSafe"><Value>false</Value></Attribute>
        <Attribute Name="exported"><Value>true</Value></Attribute>
      </ExternalInterface>
      <InternalLink Name="round" RefPartnerSideA="ring:Lamp" RefPartnerSideB="part-start" />
    </SystemUnitClass>
  </SystemUnitClassLib>
"#;

const UNIT: &str = r#"<InternalElement Name="u" ID="u" RefBaseSystemUnitPath="Units/Unit" />"#;

/// Two instances of `Ring`, with all that a cell needs beside them.
const RINGS: &str = r#"
    <InternalElement Name="gate" ID="g"><RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Gateway" /></InternalElement>
    <InternalElement Name="c" ID="c" RefBaseSystemUnitPath="Units/Plc" />
    <InternalElement Name="R1" ID="r1" RefBaseSystemUnitPath="Units/Ring"><Attribute Name="hosts"><Value>all</Value></Attribute></InternalElement>
    <InternalElement Name="R2" ID="r2" RefBaseSystemUnitPath="Units/Ring"><Attribute Name="hosts"><Value>all</Value></Attribute></InternalElement>
"#;

fn file(version: &str, content: &str) -> String {
    let namespace = match version {
        "3.0" => " xmlns=\"http://www.dke.de/CAEX\"",
        _ => "",
    };
    format!("<CAEXFile{namespace} SchemaVersion=\"{version}\" FileName=\"f\">{content}</CAEXFile>")
}

/// Writes a model whose classes stand in its own file (CAEX 2.15) or in a library (CAEX 3.0).
fn write(dir: &Path, version: &str, hierarchy: &str) -> std::path::PathBuf {
    std::fs::write(dir.join("m.xml"), LOGIC).unwrap();
    let classes = CLASSES.replace("LOGIC", "m.xml");
    let hierarchy = format!("<InstanceHierarchy Name=\"h\">{hierarchy}</InstanceHierarchy>");
    let model = match version {
        "3.0" => {
            std::fs::write(dir.join("units.aml"), file(version, &classes)).unwrap();
            let hierarchy = hierarchy.replace("=\"Units/", "=\"Lib@Units/");
            let reference = "<ExternalReference Alias=\"Lib\" Path=\"units.aml\" />";
            file(version, &format!("{reference}{hierarchy}"))
        }
        _ => file(version, &format!("{hierarchy}{classes}")),
    };
    let path = dir.join("model.aml");
    std::fs::write(&path, model).unwrap();
    path
}

fn built(version: &str, hierarchy: &str) -> Result<BuiltCell, Problems> {
    let dir = tempfile::tempdir().unwrap();
    build(&write(dir.path(), version, hierarchy))
}

fn image(name: &str) -> FieldPoint {
    FieldPoint::Image(name.to_owned())
}

#[test]
fn links_of_a_class_join_the_elements_of_its_instance() {
    for version in ["3.0", "2.15"] {
        let cell = built(version, UNIT).unwrap_or_else(|p| panic!("{version}: {p}"));
        let mc = &cell.model.mcs[0];
        assert_eq!(mc.inputs[0].source, InputSource::Field(image("gate.Start")));
        assert_eq!(mc.outputs[0].field, Some(image("gate.Lamp")));
        // By the mirror object in the first controller, and by the link in the second.
        let hosts: Vec<&str> = mc.hosts.iter().map(|h| h.as_str()).collect();
        assert_eq!(hosts, ["first", "second"], "{version}");
    }
}

#[test]
fn an_instance_may_replace_a_link_by_its_name_and_an_element_too() {
    let own_link = UNIT.replace(
        " />",
        "><InternalLink Name=\"lamp\" RefPartnerSideA=\"gate-other\" RefPartnerSideB=\"m:Lamp\" /></InternalElement>",
    );
    let cell = built("2.15", &own_link).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(
        cell.model.mcs[0].outputs[0].field,
        Some(image("gate.Other"))
    );
    // A copy of the class's element, as tools write it.
    let own_element = UNIT.replace(
        " />",
        "><InternalElement Name=\"gate\" ID=\"own\">\
         <ExternalInterface Name=\"Start\" ID=\"own-start\" RefBaseClassPath=\"FAMInterfaceClassLib/FieldPoint\"><Attribute Name=\"point\"><Value>image:Mine</Value></Attribute></ExternalInterface>\
         <ExternalInterface Name=\"Lamp\" ID=\"own-lamp\" RefBaseClassPath=\"FAMInterfaceClassLib/FieldPoint\" />\
         <RoleRequirements RefBaseRoleClassPath=\"FAMRoleClassLib/Gateway\" /></InternalElement></InternalElement>",
    );
    for version in ["3.0", "2.15"] {
        let cell = built(version, &own_element).unwrap_or_else(|p| panic!("{version}: {p}"));
        assert_eq!(
            cell.model.mcs[0].inputs[0].source,
            InputSource::Field(image("Mine"))
        );
    }
}

#[test]
fn each_instance_has_the_links_of_its_class_for_itself() {
    for version in ["3.0", "2.15"] {
        let cell = built(version, RINGS).unwrap_or_else(|p| panic!("{version}: {p}"));
        for mc in &cell.model.mcs {
            let InputSource::Export { mc: from, .. } = &mc.inputs[0].source else {
                panic!("{version}: {:?}", mc.inputs)
            };
            assert_eq!(from, &mc.mc, "{version}");
        }
    }
}

#[test]
fn a_link_that_could_mean_several_instances_is_refused() {
    let link = "<InternalElement Name=\"wires\" ID=\"w\"><InternalLink Name=\"x\" RefPartnerSideA=\"part-start\" RefPartnerSideB=\"r1:Lamp\" /></InternalElement>";
    let problems = built("2.15", &format!("{RINGS}{link}"))
        .unwrap_err()
        .to_string();
    for part in [
        "error[M808]",
        "h/wires/x",
        "`part-start`",
        "has 2 instances (R1, R2)",
        "put the link into the class",
    ] {
        assert!(problems.contains(part), "expected {part} in {problems}");
    }
}

#[test]
fn a_class_without_instance_joins_nothing_and_is_read_all_the_same() {
    let link = "<InternalElement Name=\"wires\" ID=\"w\"><InternalLink Name=\"x\" RefPartnerSideA=\"gate-lamp\" RefPartnerSideB=\"r1:Lamp\" /></InternalElement>";
    let problems = built("2.15", &format!("{RINGS}{link}"))
        .unwrap_err()
        .to_string();
    assert!(
        problems.contains("`gate` stands in the class `Unit`, of which the model has no instance"),
        "{problems}"
    );
}

/// What a model refers to lies within its folder, or within the root that its user names.
#[test]
fn a_root_opens_the_folders_beside_the_model_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    std::fs::create_dir_all(at("plant/models")).unwrap();
    let path = write(&at("plant/models"), "3.0", UNIT);
    // Library and logic stand beside the model's folder.
    std::fs::create_dir_all(at("plant/lib")).unwrap();
    std::fs::rename(at("plant/models/m.xml"), at("plant/lib/m.xml")).unwrap();
    let library = std::fs::read_to_string(at("plant/models/units.aml")).unwrap();
    std::fs::remove_file(at("plant/models/units.aml")).unwrap();
    std::fs::write(
        at("plant/lib/units.aml"),
        library.replace("m.xml#", "../lib/m.xml#"),
    )
    .unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let text = text.replace("\"units.aml\"", "\"../lib/units.aml\"");
    std::fs::write(&path, &text).unwrap();

    let within = |root: Option<&Path>| build(ModelAt { file: &path, root });
    let problems = within(None).unwrap_err().to_string();
    assert!(
        problems.contains("error[M805]") && problems.contains("--root DIR"),
        "{problems}"
    );
    let root = at("plant");
    let cell = within(Some(&root)).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(cell.model.mcs.len(), 1);
    // The root is the end, also for it, for symbolic links, and for a `cell.toml`.
    std::fs::write(&path, text.replace("../lib/units", "../../units")).unwrap();
    std::fs::write(at("units.aml"), library).unwrap();
    let problems = within(Some(&root)).unwrap_err().to_string();
    assert!(problems.contains("error[M805]"), "{problems}");
    std::os::unix::fs::symlink(at("units.aml"), at("plant/lib/link.aml")).unwrap();
    std::fs::write(&path, text.replace("lib/units", "lib/link")).unwrap();
    let problems = within(Some(&root)).unwrap_err().to_string();
    assert!(problems.contains("error[M805]"), "{problems}");
    let (_keep, toml) = super::common::one_mc(
        "PROGRAM M\nVAR x : INT; END_VAR\nx := 1;\nEND_PROGRAM\n",
        "",
    );
    let folder = toml.parent().unwrap();
    let text = std::fs::read_to_string(&toml).unwrap();
    let inside = ModelAt {
        file: &toml,
        root: Some(folder),
    };
    assert!(build(inside).is_ok());
    let other = tempfile::tempdir().unwrap();
    std::fs::copy(folder.join("m.st"), other.path().join("m.st")).unwrap();
    let far = other.path().join("m.st").display().to_string();
    std::fs::write(&toml, text.replace("m.st", &far)).unwrap();
    assert!(build(&toml).is_ok());
    let problems = build(inside).unwrap_err().to_string();
    assert!(
        problems.contains("error[M209]") && problems.contains("leaves"),
        "{problems}"
    );
}
