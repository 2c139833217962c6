//! A small cell in every form that is read.

use super::DIAGNOSIS;
use fam_engineering::caex::container;
use fam_engineering::convert::{Form, convert, write_files};
use fam_engineering::plcopen::{diagnosis_file, ordinary_project, project_xml};
use fam_engineering::{build, new_cell};
use std::collections::BTreeMap;

/// A third party's model in the older version: another root, other links, a reference that leads nowhere.
const FOREIGN: &str = r#"<CAEXFile SchemaVersion="2.15" FileName="p.aml"><InstanceHierarchy Name="h">
<InternalElement Name="cpu" ID="{1}"><ExternalInterface Name="l" ID="{2}" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface"><Attribute Name="refURI" AttributeDataType="xs:anyURI"><Value>file:///plc.xml#P%20a</Value></Attribute></ExternalInterface>
<RoleRequirements RefBaseRoleClassPath="AutomationMLCSRoleClassLib/ControlEquipment/Controller/PLC"/><InternalLink Name="k" RefPartnerSideA="{1}:l" RefPartnerSideB="1:l"/></InternalElement></InstanceHierarchy></CAEXFile>"#;

/// One POU in each language.
const LANGUAGES: &str = r#"<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml"><fileHeader companyName="c" productName="p" productVersion="1" creationDateTime="2020-01-01T00:00:00"/><contentHeader name="n"><coordinateInfo><fbd><scaling x="1" y="1"/></fbd><ld><scaling x="1" y="1"/></ld><sfc><scaling x="1" y="1"/></sfc></coordinateInfo></contentHeader><types><dataTypes><dataType name="E"><baseType><enum><values><value name="A"/><value name="B"/></values></enum></baseType></dataType></dataTypes><pous>
<pou name="L" pouType="program"><interface><localVars><variable name="a"><type><BOOL/></type></variable></localVars></interface><body><LD><leftPowerRail localId="1"><position x="0" y="0"/><connectionPointOut formalParameter=""/></leftPowerRail><contact localId="2"><position x="1" y="0"/><connectionPointIn><connection refLocalId="1"/></connectionPointIn><connectionPointOut/><variable>a</variable></contact><coil localId="3"><position x="2" y="0"/><connectionPointIn><connection refLocalId="2"/></connectionPointIn><connectionPointOut/><variable>a</variable></coil></LD></body></pou>
<pou name="S" pouType="program"><interface/><body><SFC><step localId="1" name="s" initialStep="true"><position x="0" y="0"/><connectionPointIn><connection refLocalId="2"/></connectionPointIn><connectionPointOut formalParameter="o"/></step><transition localId="2"><position x="0" y="0"/><connectionPointIn><connection refLocalId="1"/></connectionPointIn><condition><inline name=""><ST><xhtml:p>TRUE</xhtml:p></ST></inline></condition></transition></SFC></body></pou>
<pou name="I" pouType="program"><interface/><body><IL><xhtml:p>LD TRUE</xhtml:p></IL></body></pou></pous></types><instances><configurations/></instances></project>"#;

pub(super) fn of(target: &str) -> Vec<Vec<u8>> {
    let Some((files, project, ordinary, diagnosis)) = cell() else {
        return Vec::new();
    };
    let model = &files["cell.aml"];
    let loader = files.iter().find(|(name, _)| name.ends_with("loader.xml"));
    let loader = loader.map_or("", |(_, text)| text);
    match target {
        "caex" => vec![
            model.clone().into_bytes(),
            FOREIGN.into(),
            br#"<CAEXFile SchemaVersion="3.0" FileName="a"/>"#.to_vec(),
        ],
        "amlx" => {
            let packed = container::pack(&files, "cell.aml");
            vec![
                [&[0][..], &packed].concat(),
                [&[1][..], FOREIGN.as_bytes(), &[0], loader.as_bytes()].concat(),
            ]
        }
        "plcopen" => vec![
            loader.into(),
            project.into_bytes(),
            ordinary.into_bytes(),
            LANGUAGES.into(),
        ],
        _ => vec![diagnosis.into_bytes(), DIAGNOSIS.into()],
    }
}

/// Files of the model, a generated project, an ordinary one, a diagnosis file.
fn cell() -> Option<(BTreeMap<String, String>, String, String, String)> {
    let dir = tempfile::tempdir().ok()?;
    write_files(&new_cell::files(), dir.path()).ok()?;
    let path = dir.path().join("cell.toml");
    let model = convert(&path, "cell.aml", &Form::Caex { library: None }).ok()?;
    let built = build(&path).ok()?;
    let project = project_xml(&built, &built.model.controllers.first()?.controller);
    let diagnosis = diagnosis_file::write(built.mcs.first()?);
    Some((model.files, project, ordinary_project(&built), diagnosis))
}
