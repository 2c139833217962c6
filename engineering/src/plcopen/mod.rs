//! Flexible Automation Projects: PLCopen TC6 XML, version 2.01, one project for each controller.
//!
//! Each MC is a RESOURCE of its own in the controller's CONFIGURATION: with its global variables (its process image and
//! its plain globals), its task, and its programs. So names and addresses of different MCs do not meet, as in FAM itself.
//! Types and POUs of all MCs share one list; where two MCs mean different things by one name, the later one's is
//! written as `<MC>_<name>`, and read back under its own. Which items belong to an MC, and in what order, stands in the resource's `addData`.

mod body;
mod comments;
pub mod diagnosis_file;
pub mod logic_file;
mod ordinary;
pub mod read;
mod unit;
pub mod xml;

pub use ordinary::ordinary_project;

use crate::build::{BuiltCell, BuiltMc};
use crate::convert::not_written;
use crate::generate::Names;
use crate::problem::Problems;
use fam_proto::ControllerId;
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::syntax::ast::Project;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use unit::{Item, Renames};
use xml::Xml;

/// Namespace of version 2.01.
pub const NAMESPACE: &str = "http://www.plcopen.org/xml/tc6_0201";
/// Name of the additional data that lists an MC's items.
pub const MC_DATA: &str = "urn:fam:mc:1";

/// Writes, into a folder that is made if needed: `<controller>.xml` for each controller, `<MC>.diagnosis.xml` for each MC.
/// The same cell gives the same bytes. Returns the files.
///
/// # Errors
/// [`Problems`] if a file cannot be written.
pub fn write_projects(built: &BuiltCell, dir: &Path) -> Result<Vec<PathBuf>, Problems> {
    let write = |name: String, text: String| {
        let path = dir.join(name);
        match std::fs::write(&path, text) {
            Ok(()) => Ok(path),
            Err(e) => Err(Problems::one(not_written(&path, &e))),
        }
    };
    std::fs::create_dir_all(dir).map_err(|e| Problems::one(not_written(dir, &e)))?;
    let mut files = Vec::new();
    for controller in &built.model.controllers {
        let text = project_xml(built, &controller.controller);
        files.push(write(format!("{}.xml", controller.controller), text)?);
    }
    for mc in &built.mcs {
        files.push(write(
            format!("{}.diagnosis.xml", mc.mc),
            diagnosis_file::write(mc),
        )?);
    }
    Ok(files)
}

struct Unit<'a> {
    mc: &'a BuiltMc,
    /// The PROGRAM that the task runs.
    entry: String,
    project: Project,
    renames: Renames,
    items: Vec<Item>,
}

/// The Flexible Automation Project of a controller: all MCs that it hosts.
#[must_use]
pub fn project_xml(built: &BuiltCell, controller: &ControllerId) -> String {
    let hosted = built.mcs.iter().filter(|mc| {
        built
            .model
            .mc(&mc.mc)
            .is_some_and(|m| m.hosts.contains(controller))
    });
    let mut shared: BTreeMap<(bool, String), Item> = BTreeMap::new();
    let mut units: Vec<Unit<'_>> = Vec::new();
    for mc in hosted {
        let (project, _) = parse_project(&mc.sources);
        let items: ItemsOf<'_> = &|renames| unit::items(&project, renames);
        let (renames, items) = settled(mc, items, Renames::default(), &mut shared);
        units.push(Unit {
            mc,
            entry: Names::of(mc.mc.as_str()).control,
            project,
            renames,
            items,
        });
    }
    let mut xml = Xml::new();
    head(
        &mut xml,
        "Flexible Automation Project",
        controller.as_str(),
        None,
    );
    types(&mut xml, &units);
    configuration(&mut xml, controller.as_str(), |xml| {
        for unit in &units {
            resource(xml, unit);
        }
        let lines: Vec<_> = units
            .iter()
            .map(|u| (&u.project, &u.renames, Some(u.mc.mc.as_str())))
            .collect();
        unit::config_vars(xml, &lines);
    });
    xml.close();
    xml.finish()
}

/// The one configuration of a project.
fn configuration(xml: &mut Xml, name: &str, content: impl FnOnce(&mut Xml)) {
    xml.open("instances", &[]);
    xml.open("configurations", &[]);
    xml.open("configuration", &[("name", &identifier(name))]);
    content(xml);
    xml.close();
    xml.close();
    xml.close();
}

/// Opens a project, up to its types.
fn head(xml: &mut Xml, description: &str, name: &str, comment: Option<&str>) {
    xml.open(
        "project",
        &[
            ("xmlns", NAMESPACE),
            ("xmlns:xhtml", "http://www.w3.org/1999/xhtml"),
        ],
    );
    xml.empty(
        "fileHeader",
        &[
            ("companyName", "FAM"),
            ("productName", "fam"),
            ("productVersion", env!("CARGO_PKG_VERSION")),
            // The schema asks for a time; the same cell has to give the same bytes.
            ("creationDateTime", "2020-01-01T00:00:00"),
            ("contentDescription", description),
        ],
    );
    xml.open("contentHeader", &[("name", name)]);
    if let Some(comment) = comment {
        xml.text("Comment", comment);
    }
    xml.open("coordinateInfo", &[]);
    for language in ["fbd", "ld", "sfc"] {
        xml.open(language, &[]);
        xml.empty("scaling", &[("x", "1"), ("y", "1")]);
        xml.close();
    }
    xml.close();
    xml.close();
}

/// The items of an MC, written with these names.
type ItemsOf<'a> = &'a dyn Fn(&Renames) -> Vec<Item>;

/// Settles an MC's names: an item that another MC has with the same content is shared, one with other content is renamed.
fn settled(
    mc: &BuiltMc,
    items: ItemsOf<'_>,
    mut renames: Renames,
    shared: &mut BTreeMap<(bool, String), Item>,
) -> (Renames, Vec<Item>) {
    loop {
        let items = items(&renames);
        let clash = items.iter().find(|item| {
            let upper = item.name.to_ascii_uppercase();
            [true, false].into_iter().any(|is_type| {
                shared
                    .get(&(is_type, upper.clone()))
                    .is_some_and(|other| other.xml != item.xml || other.is_type != item.is_type)
            })
        });
        let Some(clash) = clash else {
            for item in &items {
                shared
                    .entry((item.is_type, item.name.to_ascii_uppercase()))
                    .or_insert_with(|| item.clone());
            }
            return (renames, items);
        };
        let is_shared = |name: &str| {
            shared.keys().any(|(_, n)| *n == name)
                || renames.names.values().any(|n| n.eq_ignore_ascii_case(name))
        };
        let name = new_name(mc, &clash.original, is_shared);
        let old = clash.original.to_ascii_uppercase();
        renames.names.insert(old, name);
    }
}

/// A name for what another MC has under the same one. It stands nowhere in the MC's logic: so whoever reads the project back
/// knows where it stands for the old one.
fn new_name(mc: &BuiltMc, name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut new = format!("{}_{name}", identifier(mc.mc.as_str()));
    let is_said = |upper: &str| {
        let mut sources = mc.sources.iter();
        sources.any(|s| s.text.to_ascii_uppercase().contains(upper))
    };
    loop {
        let upper = new.to_ascii_uppercase();
        if !is_taken(&upper) && !is_said(&upper) {
            return new;
        }
        new.push_str("_2");
    }
}

/// The items of all MCs, each once.
fn types(xml: &mut Xml, units: &[Unit<'_>]) {
    xml.open("types", &[]);
    for (element, is_type) in [("dataTypes", true), ("pous", false)] {
        xml.open(element, &[]);
        let mut written: Vec<&str> = Vec::new();
        for item in units.iter().flat_map(|u| &u.items) {
            if item.is_type == is_type && !written.contains(&item.name.as_str()) {
                xml.raw(&item.xml);
                written.push(&item.name);
            }
        }
        xml.close();
    }
    xml.close();
}

fn resource(xml: &mut Xml, unit: &Unit<'_>) {
    let mc = unit.mc;
    let control = unit.renames.of(&unit.entry);
    xml.open("resource", &[("name", mc.mc.as_str())]);
    task(xml, mc, &control);
    unit::globals(xml, &unit.project, &unit.renames);
    for pou in &unit.project.pous {
        let name = unit.renames.of(&pou.name.name);
        if pou.kind == fam_soft_plc::syntax::ast::PouKind::Program && name != control {
            xml.empty("pouInstance", &[("name", &name), ("typeName", &name)]);
        }
    }
    xml.open("addData", &[]);
    xml.open("data", &[("name", MC_DATA), ("handleUnknown", "preserve")]);
    xml.open(
        "mc",
        &[
            ("xmlns", MC_DATA),
            ("name", mc.mc.as_str()),
            ("control", &control),
        ],
    );
    for item in &unit.items {
        let element = if item.is_type { "type" } else { "pou" };
        if item.name == item.original {
            xml.empty(element, &[("name", &item.name)]);
        } else {
            xml.empty(
                element,
                &[("name", &item.name), ("original", &item.original)],
            );
        }
    }
    xml.close();
    xml.close();
    xml.close();
    xml.close();
}

/// An MC's task, which runs this program.
fn task(xml: &mut Xml, mc: &BuiltMc, program: &str) {
    let interval = fam_soft_plc::value::format_time(i64::from(mc.cycle_us) * 1000);
    xml.open(
        "task",
        &[
            ("name", &format!("{}_Task", mc.mc)),
            ("interval", &interval),
            ("priority", "1"),
        ],
    );
    xml.empty("pouInstance", &[("name", program), ("typeName", program)]);
    xml.close();
}

/// A name of FAM as an IEC identifier.
fn identifier(name: &str) -> String {
    name.replace('-', "_")
}

/// The part of a written project that belongs to one MC, as a source that the compiler takes.
///
/// # Errors
/// [`read::ReadError`] if the text is no Flexible Automation Project, or has no such MC.
pub fn mc_source(project: &str, mc: &str) -> Result<SourceFile, read::ReadError> {
    read::mc_source(project, mc)
}
