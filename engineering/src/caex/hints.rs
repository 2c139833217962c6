//! What to do, in the words of AutomationML, where the common checks speak of keys of `cell.toml`.

use fam_soft_plc::diag::Diagnostic;

/// By code.
const HINTS: [(&str, &str); 11] = [
    (
        "M203",
        "give the gateway the attributes `driver` (modbus or image) and, for modbus, `address`",
    ),
    (
        "M204",
        "add an InternalElement with the role FAMRoleClassLib/Gateway",
    ),
    (
        "M208",
        "link its Hosting interface with that of a controller, or put a mirror object of it into one",
    ),
    (
        "M304",
        "link it with a FieldPoint, or set its attribute `exported` to true",
    ),
    (
        "M305",
        "give the Output the attribute `failSafe`: the value that it gets when nobody drives it",
    ),
    (
        "M307",
        "set the attribute `exported` of that Output to true, or link the two",
    ),
    (
        "M312",
        "add an ExternalInterface of that name and of the class FAMInterfaceClassLib/Input or Output to the MC, and link it with a FieldPoint",
    ),
    (
        "M404",
        "make the attribute `suspect` longer, or the cycle shorter",
    ),
    ("M405", "make the attribute `watchdog` longer"),
    (
        "M502",
        "give the interval an ExternalInterface of the class FAMInterfaceClassLib/RecoveryAction, or the MC one of the class StopAction",
    ),
    (
        "M503",
        "remove the attribute `checkpointState`, or make the kind `checkpoint`",
    ),
];

/// Puts the hints of a problem into the words of AutomationML.
pub fn retell(problem: &mut Diagnostic) {
    let Some((code, hint)) = HINTS.iter().find(|(code, _)| *code == problem.code) else {
        return;
    };
    problem.hint = Some((*hint).to_owned());
    if *code == "M304" {
        problem.expected = None;
    }
}
