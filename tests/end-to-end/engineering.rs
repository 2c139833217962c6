//! From a model to a running cell with the commands that people use: a third party's AutomationML model, and a new cell of one's own.

mod support;

use std::path::Path;
use support::{Fam, free_port, run, until};

/// A plant of another tool: a PLC by its role, logic by its reference.
const PLANT: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="plant.aml">
  <SourceDocumentInformation OriginName="t" OriginID="t" OriginVersion="1" LastWritingDateTime="2020-01-01T00:00:00" />
  <InstanceHierarchy Name="tank">
    <InternalElement Name="cpu" ID="1">
      <ExternalInterface Name="program" ID="2" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface">
        <Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>file:///plc/tank.xml#Filling</Value></Attribute>
      </ExternalInterface>
      <RoleRequirements RefBaseRoleClassPath="AutomationMLCSRoleClassLib/ControlEquipment/Controller/PLC" />
    </InternalElement>
  </InstanceHierarchy>
</CAEXFile>
"#;

const LOGIC: &str = r#"<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0200" xmlns:xhtml="http://www.w3.org/1999/xhtml">
  <fileHeader companyName="c" productName="p" productVersion="1" creationDateTime="2020-01-01T00:00:00" />
  <contentHeader name="tank"><coordinateInfo><fbd><scaling x="1" y="1" /></fbd><ld><scaling x="1" y="1" /></ld><sfc><scaling x="1" y="1" /></sfc></coordinateInfo></contentHeader>
  <types><dataTypes /><pous>
    <pou name="Filling" pouType="program">
      <interface><externalVars>
        <variable name="Low"><type><BOOL /></type></variable>
        <variable name="Valve"><type><BOOL /></type></variable>
      </externalVars></interface>
      <body><ST><xhtml:p><![CDATA[Valve := Low;]]></xhtml:p></ST></body>
    </pou>
  </pous></types>
  <instances><configurations><configuration name="c"><resource name="r">
    <task name="cyclic" interval="PT0.02S" priority="1"><pouInstance name="Tank1" typeName="Filling" /></task>
    <globalVars>
      <variable name="Low" address="%IX0.0"><type><BOOL /></type></variable>
      <variable name="Valve" address="%QX0.0"><type><BOOL /></type></variable>
    </globalVars>
  </resource></configuration></configurations></instances>
</project>
"#;

/// Ports that are free, so that cells of several tests do not meet. Returns the gateway's endpoint.
fn with_free_ports(deployment: &Path, gateway: &str) -> String {
    let text = std::fs::read_to_string(deployment).unwrap();
    let kept: Vec<&str> = text.lines().take_while(|l| !l.starts_with('[')).collect();
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let text = format!(
        "{}\n[manager]\nlisten = \"tcp/127.0.0.1:{}\"\n[[gateway]]\nname = \"{gateway}\"\nlisten = \"{endpoint}\"\n",
        kept.join("\n"),
        free_port()
    );
    std::fs::write(deployment, text).unwrap();
    endpoint
}

/// Sets points until another one has a value (`name,value`).
fn sets_and_sees(endpoint: &str, set: &[&str], seen: &str) {
    let common = ["--endpoint", endpoint];
    until(&format!("{seen} after {set:?}"), || {
        let set: Vec<&str> = [&["io", "set"], set, &common].concat();
        let (code, ..) = run(&set);
        if code != 0 {
            return None;
        }
        let get: Vec<&str> = [&["io", "get"][..], &common].concat();
        let (_, out, _) = run(&get);
        let (name, value) = seen.split_once(',')?;
        let shown = out.lines().find_map(|l| {
            let columns: Vec<&str> = l.split(',').collect();
            let driven = format!("image:{name}");
            (columns.first() == Some(&name) || columns.last() == Some(&driven.as_str()))
                .then(|| columns.get(3).copied())?
        })?;
        let shown = match shown {
            "true" => "1",
            "false" => "0",
            number => number,
        };
        (shown == value).then_some(())
    });
}

#[test]
fn a_third_party_model_goes_from_check_over_generate_to_running() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("plc")).unwrap();
    std::fs::write(dir.path().join("plc/tank.xml"), LOGIC).unwrap();
    let model = dir.path().join("plant.aml");
    std::fs::write(&model, PLANT).unwrap();
    let model = model.display().to_string();
    let (code, out, err) = run(&["check", &model]);
    assert_eq!(code, 0, "{out}{err}");
    assert!(
        out.contains("no roles of FAM") && out.contains("1 MCs, no errors"),
        "{out}"
    );

    let generated = dir.path().join("out");
    let (code, out, err) = run(&[
        "generate",
        &model,
        "--out",
        &generated.display().to_string(),
    ]);
    assert_eq!(code, 0, "{out}{err}");
    for file in [
        "cpu.xml",
        "Tank1.diagnosis.xml",
        "agents.toml",
        "deployment.toml",
        "summary.txt",
        "model/cell.toml",
    ] {
        assert!(generated.join(file).exists(), "{file}");
    }
    let deployment = generated.join("deployment.toml");
    let endpoint = with_free_ports(&deployment, "gateway1");
    let mut up = Fam::start(&["up", &deployment.display().to_string()]);
    up.wait_for(&["is up"]);
    sets_and_sees(&endpoint, &["Low=1"], "Valve,1");
    sets_and_sees(&endpoint, &["Low=0"], "Valve,0");
    assert!(up.terminate().success(), "{}", up.text());
}

#[test]
fn a_new_cell_runs_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let cell = dir.path().join("mine");
    let (code, out, err) = run(&["new", &cell.display().to_string()]);
    assert_eq!(code, 0, "{out}{err}");
    let deployment = cell.join("deployment.toml");
    let endpoint = with_free_ports(&deployment, "gateway1");
    let mut up = Fam::start(&["up", &deployment.display().to_string()]);
    up.wait_for(&["is up"]);
    // What its README shows.
    sets_and_sees(&endpoint, &["Start=1", "ArmAtPart=1"], "ArmForward,1");
    sets_and_sees(&endpoint, &["ArmAtPart=0", "ArmAtStamper=1"], "Stamped,1");
    sets_and_sees(
        &endpoint,
        &["Start=0", "ArmAtStamper=0", "ArmAtPart=1"],
        "ArmForward,0",
    );
    assert!(up.terminate().success(), "{}", up.text());

    // And it goes into the other forms.
    let model = cell.join("cell.toml").display().to_string();
    for form in ["cell.aml", "cell.amlx", "back/cell.toml"] {
        let to = dir.path().join(form).display().to_string();
        let (code, out, err) = run(&["convert", &model, &to]);
        assert_eq!(code, 0, "{out}{err}");
        let (code, out, err) = run(&["diff", &model, &to]);
        assert_eq!(code, 0, "{out}{err}");
        assert!(
            out.lines().all(|l| l.ends_with("runs on untouched")),
            "{out}"
        );
        let (_, shown, _) = run(&["show", &to]);
        assert!(
            shown.starts_with("cell my_cell") && shown.contains("Carrying: step = 20"),
            "{shown}"
        );
    }
}

#[test]
fn a_killed_controller_comes_back_and_one_that_was_told_to_end_stays_away() {
    let dir = tempfile::tempdir().unwrap();
    let cell = dir.path().join("mine");
    let (code, out, err) = run(&["new", &cell.display().to_string()]);
    assert_eq!(code, 0, "{out}{err}");
    let deployment = cell.join("deployment.toml");
    let endpoint = with_free_ports(&deployment, "gateway1");
    let mut up = Fam::start(&["up", &deployment.display().to_string()]);
    let said = up.wait_for(&["processes: "]);
    let signal = |controller: &str, signal: &str| {
        let said = up.text();
        let (_, after) = said.rsplit_once(&format!("{controller} ")).unwrap();
        let pid: String = after.chars().take_while(char::is_ascii_digit).collect();
        let sent = std::process::Command::new("kill")
            .args([signal, &pid])
            .status();
        assert!(
            sent.unwrap().success(),
            "{controller} is process {pid}: {said}"
        );
    };
    let arm = |at_part: &str, set: &[&str], seen: &str| {
        sets_and_sees(&endpoint, &[&[at_part], set].concat(), seen);
    };
    arm("ArmAtPart=1", &["Start=1"], "ArmForward,1");

    signal("controller1", "-KILL");
    up.wait_for(&["controller1 ended by itself", "SIGKILL"]);
    up.wait_for(&["controller1 is started again, as process"]);
    arm("ArmAtPart=0", &["ArmAtStamper=1"], "Stamped,1");

    // For maintenance: the other one has come back, and takes over.
    signal("controller2", "-TERM");
    up.wait_for(&[
        "controller2 has ended in order and stays away",
        "fam node controller2",
    ]);
    arm(
        "ArmAtPart=1",
        &["Start=0", "ArmAtStamper=0"],
        "ArmForward,0",
    );
    assert!(
        !up.text().contains("controller2 is started again"),
        "{said}"
    );
    assert!(up.terminate().success(), "{}", up.text());
}

#[test]
fn an_existing_project_becomes_a_model() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).display().to_string();
    std::fs::write(at("tank.xml"), LOGIC).unwrap();
    let import = |out: &str| run(&["import", &at("tank.xml"), "--out", &at(out)]);
    // A folder, and the model by its name.
    for (out, model) in [("there", "there/tank.aml"), ("plant.aml", "plant.aml")] {
        let (code, said, err) = import(out);
        assert_eq!(code, 0, "{said}{err}");
        assert!(said.contains(model), "{said}");
        let (code, said, err) = run(&["check", &at(model)]);
        assert_eq!(code, 0, "{said}{err}");
    }
    let todo = std::fs::read_to_string(at("there/TODO.md")).unwrap();
    assert!(todo.contains("Tank1"), "{todo}");
    let (code, _, err) = import("plant.xml");
    assert_ne!(code, 0);
    assert!(
        err.contains("expected an ending .aml, or a folder"),
        "{err}"
    );
    // What somebody has written meanwhile is not lost.
    std::fs::write(at("there/TODO.md"), "mine").unwrap();
    let (code, _, err) = import("there");
    assert_ne!(code, 0);
    assert!(
        err.contains("is there already, with other content"),
        "{err}"
    );
    assert_eq!(
        std::fs::read_to_string(at("there/TODO.md")).unwrap(),
        "mine"
    );
    std::fs::write(at("none.xml"), "").unwrap();
    let (code, _, err) = run(&["import", &at("none.xml"), "--out", &at("other")]);
    assert_ne!(code, 0);
    assert!(err.contains("none.xml"), "{err}");
}
