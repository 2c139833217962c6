//! The two small models that all cases change: a `cell.toml` and an AutomationML file.

/// Name and content of the files of a small cell: A lights its lamp, B sees it.
pub const TOML: &[(&str, &str)] = &[
    (
        "cell.toml",
        r#"format = 1
[cell]
name = "small"
[[gateway]]
name = "gate"
driver = "image"
[[controller]]
name = "c1"
[[controller]]
name = "c2"
[[mc]]
name = "A"
logic = ["a.st"]
gateway = "gate"
hosts = ["c1", "c2"]
worst_case_us = 10
[mc.inputs]
Go = "image:Go"
[mc.outputs]
Lamp = { field = "image:Lamp", export = true, fail_safe = false }
[[mc.critical_interval]]
name = "Lit"
condition = "step = 5"
kind = "checkpoint"
recovery = "Off"
[mc.critical_interval.checkpoint_state]
step = 0
[[mc]]
name = "B"
logic = ["b.st"]
gateway = "gate"
hosts = "all"
worst_case_us = 10
[mc.inputs]
Seen = "mc:A.Lamp"
"#,
    ),
    (
        "a.st",
        r#"VAR_GLOBAL
    Go AT %IX0.0 : BOOL;
    Lamp AT %QX0.0 : BOOL;
END_VAR
PROGRAM A
VAR_EXTERNAL Go, Lamp : BOOL; END_VAR
VAR step : INT; END_VAR
    IF Go THEN step := step + 1; END_IF;
    Lamp := step = 5;
END_PROGRAM
FUNCTION_BLOCK Off
VAR_EXTERNAL Lamp : BOOL; END_VAR
VAR_OUTPUT end : BOOL; END_VAR
    Lamp := FALSE;
    end := TRUE;
END_FUNCTION_BLOCK
"#,
    ),
    (
        "b.st",
        r#"VAR_GLOBAL
    Seen AT %IX0.0 : BOOL;
END_VAR
PROGRAM B
VAR_EXTERNAL Seen : BOOL; END_VAR
VAR count : UDINT; END_VAR
    IF Seen THEN count := count + 1; END_IF;
END_PROGRAM
"#,
    ),
];

/// The same MC A in CAEX, with a library of its own and its logic in PLCopen XML.
pub const CAEX: &[(&str, &str)] = &[
    (
        "cell.aml",
        r#"<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="cell.aml">
  <ExternalReference Alias="Own" Path="own.aml" />
  <InstanceHierarchy Name="small">
    <InternalElement Name="gate" ID="gate">
      <ExternalInterface Name="Go" ID="gate-go" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint" />
      <ExternalInterface Name="Lamp" ID="gate-lamp" RefBaseClassPath="FAMInterfaceClassLib/FieldPoint" />
      <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/Gateway" />
    </InternalElement>
    <InternalElement Name="c1" ID="c1" RefBaseSystemUnitPath="Own@Units/Plc" />
    <InternalElement Name="A" ID="a">
      <Attribute Name="worstCaseLoad" Unit="us"><Value>10</Value></Attribute>
      <Attribute Name="hosts"><Value>all</Value></Attribute>
      <ExternalInterface Name="logic" ID="a-logic" RefBaseClassPath="AutomationMLInterfaceClassLib/AutomationMLBaseInterface/ExternalDataConnector/PLCopenXMLInterface">
        <Attribute Name="refURI"><Value>a.xml#A</Value></Attribute>
      </ExternalInterface>
      <ExternalInterface Name="Go" ID="a-go" RefBaseClassPath="FAMInterfaceClassLib/Input" />
      <ExternalInterface Name="Lamp" ID="a-lamp" RefBaseClassPath="FAMInterfaceClassLib/Output">
        <Attribute Name="failSafe"><Value>false</Value></Attribute>
      </ExternalInterface>
      <InternalElement Name="Lit" ID="lit">
        <Attribute Name="condition"><Value>step = 5</Value></Attribute>
        <Attribute Name="kind"><Value>checkpoint</Value></Attribute>
        <ExternalInterface Name="recovery" ID="lit-off" RefBaseClassPath="FAMInterfaceClassLib/RecoveryAction">
          <Attribute Name="refURI"><Value>a.xml#Off</Value></Attribute>
        </ExternalInterface>
        <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/CriticalInterval" />
      </InternalElement>
      <InternalLink Name="go" RefPartnerSideA="gate-go" RefPartnerSideB="a-go" />
      <InternalLink Name="lamp" RefPartnerSideA="gate-lamp" RefPartnerSideB="a-lamp" />
      <RoleRequirements RefBaseRoleClassPath="FAMRoleClassLib/MechatronicComponent" />
    </InternalElement>
  </InstanceHierarchy>
</CAEXFile>
"#,
    ),
    (
        "own.aml",
        r#"<CAEXFile xmlns="http://www.dke.de/CAEX" SchemaVersion="3.0" FileName="own.aml">
  <SystemUnitClassLib Name="Units">
    <SystemUnitClass Name="Plc">
      <SupportedRoleClass RefRoleClassPath="FAMRoleClassLib/Controller" />
    </SystemUnitClass>
  </SystemUnitClassLib>
</CAEXFile>
"#,
    ),
    (
        "a.xml",
        r#"<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
  <types><pous>
    <pou name="A" pouType="program">
      <interface>
        <externalVars><variable name="Go"><type><BOOL /></type></variable><variable name="Lamp"><type><BOOL /></type></variable></externalVars>
        <localVars><variable name="step"><type><INT /></type></variable></localVars>
      </interface>
      <body><ST><xhtml:p>IF Go THEN step := step + 1; END_IF; Lamp := step = 5;</xhtml:p></ST></body>
    </pou>
    <pou name="Off" pouType="functionBlock">
      <interface>
        <externalVars><variable name="Lamp"><type><BOOL /></type></variable></externalVars>
        <outputVars><variable name="end"><type><BOOL /></type></variable></outputVars>
      </interface>
      <body><ST><xhtml:p>Lamp := FALSE; end := TRUE;</xhtml:p></ST></body>
    </pou>
  </pous></types>
  <instances><configurations><configuration name="c"><globalVars>
    <variable name="Go" address="%IX0.0"><type><BOOL /></type></variable>
    <variable name="Lamp" address="%QX0.0"><type><BOOL /></type></variable>
  </globalVars></configuration></configurations></instances>
</project>
"#,
    ),
];

/// A deployment of the first one.
pub const DEPLOYMENT: &str = "cell = \"cell.toml\"\ncontrollers = [\"c1\", \"c2\"]\n[manager]\nlisten = \"tcp/127.0.0.1:7447\"\n[[gateway]]\nname = \"gate\"\n";
