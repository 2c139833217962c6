//! AutomationML models that know nothing of FAM: controllers by their role, logic by its references to PLCopen XML.
//!
//! What such a model does not say is assumed, and each assumption is a warning: every program is a mechatronic component that
//! every controller may run, its located variables are points of the `image` driver, nothing is critical.

use super::cell::MadeFiles;
use super::library::{Caex, Part};
use super::logic_reference::{LogicFiles, Target};
use super::uri;
use super::values::warning;
use crate::files::{ModelFiles, join};
use crate::import::{Proposal, propose};
use crate::import_tables::{PlacedMc, ProposedController, name_of, tables as proposed_tables};
use crate::model::toml_file::CellFile;
use crate::problem::{Explain, suggestion};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::source::SourceFile;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use toml::Spanned;

/// A file with logic: where the model refers to it, and the PROGRAM that a reference names.
struct Reference {
    at: Range<usize>,
    programs: BTreeSet<String>,
    /// Whether some reference names the file as a whole.
    whole: bool,
}

/// The tables of a model without FAM's roles.
pub fn tables(
    caex: &Caex,
    files: &ModelFiles,
    all: &[Part],
    problems: &mut Vec<Diagnostic>,
) -> Option<(CellFile, MadeFiles)> {
    let controllers = controllers(caex, all);
    let references = references(caex, files, all, problems);
    let start = caex
        .hierarchies
        .first()
        .map_or(0..1, |h| caex.objects[*h].name.at.clone());
    let text = caex.text();
    if controllers.is_empty() {
        problems.push(
            text.error("M814", start.clone(), "the model has no controller")
                .expected("an InternalElement with the role FAMRoleClassLib/Controller, or AutomationMLCSRoleClassLib/ControlEquipment/Controller/PLC")
                .hint("give the role to the elements that are controllers"),
        );
    }
    if references.is_empty() && !problems.iter().any(|p| p.severity == Severity::Error) {
        problems.push(
            text.error("M814", start.clone(), "the model has no logic and no mechatronic component")
                .expected("an element with the role FAMRoleClassLib/MechatronicComponent, or a reference to a PLCopen XML file (PLCopenXMLInterface with `refURI`)")
                .hint("`fam import` proposes a model from a PLCopen project"),
        );
    }
    let (mut mcs, mut made): (Vec<PlacedMc>, MadeFiles) = (Vec::new(), Vec::new());
    for (path, reference) in references {
        let Some(proposal) = proposal(caex, files, &path, &reference, problems) else {
            continue;
        };
        for mc in proposal.mcs {
            let wanted = reference.whole
                || reference.programs.is_empty()
                || reference
                    .programs
                    .iter()
                    .any(|p| p.eq_ignore_ascii_case(&mc.program));
            let known = mcs
                .iter()
                .any(|m: &PlacedMc| m.mc.name.eq_ignore_ascii_case(&mc.name));
            if !wanted || known {
                continue;
            }
            let file = format!("{path} ({})", mc.name);
            made.push((file.clone(), mc.logic.clone()));
            mcs.push(PlacedMc {
                mc,
                at: reference.at.clone(),
                file,
            });
        }
        for sentence in proposal.to_do {
            problems.push(text.warning("W806", reference.at.clone(), sentence));
        }
    }
    if controllers.is_empty() || mcs.is_empty() {
        return None;
    }
    only_from(&mut mcs);
    let names: Vec<&str> = mcs.iter().map(|m| m.mc.name.as_str()).collect();
    let message = format!(
        "the model has no roles of FAM: each program is taken as a mechatronic component ({}) that every controller may run, its located variables as points of the driver `image`",
        names.join(", ")
    );
    problems.push(warning(
        caex,
        "W806",
        start.clone(),
        message,
        "`fam convert` writes the model with the roles of FAM, as a start",
    ));
    if let [only] = controllers.as_slice() {
        let message = format!(
            "{} is the only controller: nothing can take over from it",
            only.name
        );
        problems.push(warning(
            caex,
            "W807",
            only.at.clone(),
            message,
            "add a second one",
        ));
    }
    let name = caex
        .hierarchies
        .first()
        .map_or("cell", |h| caex.objects[*h].name.text.as_str());
    let cell = Spanned::new(start, name_of(name));
    Some((proposed_tables(cell, &controllers, &mcs), made))
}

fn controllers(caex: &Caex, all: &[Part]) -> Vec<ProposedController> {
    let mut list: Vec<ProposedController> = Vec::new();
    for element in all.iter().filter(|e| !caex.is_mirror(e.id)) {
        let roles = caex.roles(element.id);
        let is_one = roles
            .iter()
            .any(|r| r.ends_with("Controller/PLC") || r.ends_with("/Controller"));
        // An inner part of a controller with the same role is not another one.
        if !is_one
            || list
                .iter()
                .any(|c| c.at.start != element.at.start && is_inside(caex, element, &c.at))
        {
            continue;
        }
        let object = &caex.objects[element.id];
        let mut name = name_of(&object.name.text);
        while list.iter().any(|c| c.name == name) {
            name.push_str("_2");
        }
        list.push(ProposedController {
            name,
            description: object.description.clone(),
            at: element.at.clone(),
        });
    }
    list
}

fn is_inside(caex: &Caex, element: &Part, outer: &Range<usize>) -> bool {
    let mut at = caex.objects[element.id].parent;
    while let Some(id) = at {
        if caex.objects[id].file == 0 && caex.objects[id].name.at == *outer {
            return true;
        }
        at = caex.objects[id].parent;
    }
    false
}

fn references(
    caex: &Caex,
    files: &ModelFiles,
    all: &[Part],
    problems: &mut Vec<Diagnostic>,
) -> BTreeMap<String, Reference> {
    let mut logic = LogicFiles::new(files);
    let mut found: BTreeMap<String, Reference> = BTreeMap::new();
    for element in all.iter().filter(|e| !caex.is_mirror(e.id)) {
        for interface in caex.interfaces(element) {
            let is_logic = caex.is_logic(interface.id);
            // Tags are variables without logic of their own.
            let is_variable = caex
                .interface_classes(interface.id)
                .iter()
                .any(|c| c.ends_with("/VariableInterface") || c.ends_with("/Tag"));
            let uri = caex.attribute(&interface, "refURI");
            let found_in = uri.as_ref().map(|found| found.file);
            if !is_logic || (is_variable && uri.is_none()) {
                continue;
            }
            let object = &caex.objects[element.id].name.text;
            let name = &caex.objects[interface.id].name.text;
            let library = uri.as_ref().map(|f| caex.in_library(f.file));
            let library = library.unwrap_or_default();
            let what = format!("the logic interface `{name}` of `{object}`{library}");
            let (at, parsed) = match &uri {
                Some(found) => (found.value.at.clone(), uri::parse(&found.value.text)),
                None => {
                    let problem = caex
                        .text()
                        .error(
                            "M811",
                            interface.at.clone(),
                            format!("{what} has no `refURI`"),
                        )
                        .expected(uri::UriError::EXPECTED);
                    problems.push(problem);
                    continue;
                }
            };
            let uri = match parsed {
                Ok(uri) => uri,
                Err(e) => {
                    let problem = caex.text().error("M811", at, format!("{what}: {e}"));
                    problems.push(problem.expected(uri::UriError::EXPECTED));
                    continue;
                }
            };
            let file = found_in.unwrap_or_default();
            let path = match join(caex.folder(file), &uri.path) {
                Ok(path) => path,
                Err(e) => {
                    let problem = caex.text().error("M805", at, format!("{what}: {e}"));
                    problems.push(problem.hint(e.hint()));
                    continue;
                }
            };
            let entry = found.entry(path.clone()).or_insert_with(|| Reference {
                at: at.clone(),
                programs: BTreeSet::new(),
                whole: false,
            });
            match uri.fragment.map(|f| (logic.target(&path, &f), f)) {
                Some((
                    Ok(Some(Target::Pou {
                        name,
                        program: true,
                    })),
                    _,
                )) => {
                    entry.programs.insert(name);
                }
                Some((Err(names), fragment)) => {
                    let message =
                        format!("{what}: `{path}` has no POU, variable or globalId `{fragment}`");
                    let hint = suggestion(&fragment, names.iter().map(String::as_str));
                    problems.push(caex.text().error("M812", at, message).hint(hint));
                }
                // Something inside the file: its programs come with it.
                Some(_) => {}
                None => entry.whole = true,
            }
        }
    }
    found
}

/// Of programs that are not taken nobody can read anything: such inputs are points of the field.
fn only_from(mcs: &mut [PlacedMc]) {
    let taken: Vec<String> = mcs.iter().map(|m| m.mc.name.clone()).collect();
    for input in mcs.iter_mut().flat_map(|m| &mut m.mc.inputs) {
        let is_taken = |from: &(String, String)| taken.contains(&from.0);
        input.from = input.from.take().filter(is_taken);
    }
}

fn proposal(
    caex: &Caex,
    files: &ModelFiles,
    path: &str,
    reference: &Reference,
    problems: &mut Vec<Diagnostic>,
) -> Option<Proposal> {
    let text = match files.read(path) {
        Ok(text) => text,
        Err(e) => {
            let problem = caex
                .text()
                .error("M209", reference.at.clone(), e.to_string());
            problems.push(problem.hint(e.hint()));
            return None;
        }
    };
    match propose(&[SourceFile::new(path, text)]) {
        Ok(proposal) if proposal.mcs.is_empty() => {
            let message = format!("`{path}` has no PROGRAM");
            problems.push(
                caex.text()
                    .error("M210", reference.at.clone(), message)
                    .hint("only programs can be run; call its function blocks from one"),
            );
            None
        }
        Ok(proposal) => Some(proposal),
        Err(found) => {
            problems.extend(found);
            None
        }
    }
}
