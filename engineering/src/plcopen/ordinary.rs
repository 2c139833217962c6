//! The logic of all MCs as one ordinary project for one PLC, as its engineers would write it: no generated POU, one resource, a
//! task for each MC.
//!
//! In FAM each MC has its own process image and its own global variables. In one PLC they share both: images lie one behind the
//! other, an input that another MC exports is that MC's variable, and where two MCs mean different things by one name, the later
//! one's is written as `<MC>_<name>`.

use super::unit::{self, Item, Renames};
use super::xml::Xml;
use super::{Unit, comments, configuration, head, new_name, settled, task, types};
use crate::build::{BuiltCell, BuiltMc};
use fam_proto::model::{InputSource, McModel, Place};
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::Span;
use fam_soft_plc::syntax::ast::{Project, VarBlock, VarDecl};
use std::collections::BTreeMap;

/// Writes it.
#[must_use]
pub fn ordinary_project(built: &BuiltCell) -> String {
    let mut parts: Vec<Part<'_>> = built.mcs.iter().filter_map(|mc| part(built, mc)).collect();
    let mut globals = Globals::default();
    globals.images(&mut parts);
    globals.own(&mut parts);
    globals.exchanged(&mut parts);
    let mut shared = globals.items();
    let mut units = Vec::new();
    for part in parts {
        let Part {
            mc,
            project,
            renames,
            ..
        } = part;
        let comment_of = |span: Span| comments::of(&project.sources, span);
        let items = |renames: &Renames| unit::items_with(&project, renames, &comment_of);
        let (renames, items) = settled(mc, &items, renames, &mut shared);
        units.push(Unit {
            mc,
            entry: mc.program.clone(),
            project,
            renames,
            items,
        });
    }
    let name = built.model.cell.as_str();
    let mut xml = Xml::new();
    head(&mut xml, "logic of a cell", name, None);
    types(&mut xml, &units);
    configuration(&mut xml, name, |xml| {
        xml.open("resource", &[("name", "PLC")]);
        for unit in &units {
            task(xml, unit.mc, &unit.renames.of(&unit.entry));
        }
        xml.close();
        for unit in &units {
            let comment_of = |span: Span| comments::of(&unit.project.sources, span);
            unit::globals_with(xml, &unit.project, &unit.renames, &comment_of, &|_| true);
        }
        let lines: Vec<_> = units
            .iter()
            .map(|u| (&u.project, &u.renames, Some("PLC")))
            .collect();
        unit::config_vars(xml, &lines);
    });
    xml.close();
    xml.finish()
}

/// An MC's share of the project.
struct Part<'a> {
    mc: &'a BuiltMc,
    model: &'a McModel,
    /// Its logic; of the global variables in the end only those that it brings into the project.
    project: Project,
    renames: Renames,
}

fn part<'a>(built: &'a BuiltCell, mc: &'a BuiltMc) -> Option<Part<'a>> {
    // The generated source is the last one.
    let (_, written) = mc.sources.split_last()?;
    let (project, _) = parse_project(written);
    Some(Part {
        mc,
        model: built.model.mc(&mc.mc)?,
        project,
        renames: Renames::default(),
    })
}

/// The other MC and its variable that an input of this name shows.
fn exported<'a>(part: &'a Part<'_>, input: &str) -> Option<(&'a str, Place)> {
    let named = |name: &str| name.eq_ignore_ascii_case(input);
    let input = part.model.inputs.iter().find(|i| named(&i.name))?;
    match &input.source {
        InputSource::Export { mc, place } => Some((mc.as_str(), *place)),
        InputSource::Field(_) => None,
    }
}

/// The global variables of the project, by their name in upper case: the MC that brings each, and a constant as its text.
#[derive(Default)]
struct Globals(BTreeMap<String, (String, Option<String>)>);

impl Globals {
    /// Puts the process images one behind the other.
    fn images(&mut self, parts: &mut [Part<'_>]) {
        let mut next = [0u32; 3];
        for part in parts {
            part.renames.image = next;
            let lens = [
                part.model.inputs_len as usize,
                part.model.fail_safe.len(),
                part.model.diagnosis.checkpoint_len as usize,
            ];
            for (next, len) in next.iter_mut().zip(lens) {
                let len = u32::try_from(len.next_multiple_of(8)).unwrap_or(u32::MAX);
                *next = next.saturating_add(len);
            }
        }
    }

    /// Names the variables that each MC brings, and leaves out constants that are there already.
    fn own(&mut self, parts: &mut [Part<'_>]) {
        for part in parts {
            let mut blocks = std::mem::take(&mut part.project.globals);
            for block in &mut blocks {
                let constant = block.constant;
                block.decls.retain(|decl| self.takes(part, constant, decl));
                for decl in &mut block.decls {
                    let goes_out = part.model.outputs.iter().find(|o| o.name == decl.name.name);
                    if goes_out.is_some_and(|o| o.field.is_none()) {
                        decl.location = None;
                    }
                }
            }
            part.project.globals = blocks;
        }
    }

    /// Whether the MC brings this variable into the project, under whatever name.
    fn takes(&mut self, part: &mut Part<'_>, constant: bool, decl: &VarDecl) -> bool {
        let name = &decl.name.name;
        if exported(part, name).is_some() {
            return true;
        }
        let text = constant.then(|| unit::variable(&part.project, decl));
        let upper = name.to_ascii_uppercase();
        let there = self.0.get(&upper);
        if text.is_some() && there.is_some_and(|(_, other)| *other == text) {
            return false;
        }
        let new = if there.is_none() {
            name.clone()
        } else {
            new_name(part.mc, name, |name| self.0.contains_key(name))
        };
        let owner = part.mc.mc.to_string();
        self.0.insert(new.to_ascii_uppercase(), (owner, text));
        part.renames.names.insert(upper, new);
        true
    }

    /// An input that another MC exports is that MC's variable. One that shows a part of a larger variable stays an input.
    fn exchanged(&mut self, parts: &mut [Part<'_>]) {
        let names: BTreeMap<(String, Place), String> = parts
            .iter()
            .flat_map(|p| {
                p.model.outputs.iter().filter_map(|o| {
                    let new = p.renames.names.get(&o.name.to_ascii_uppercase())?;
                    Some(((p.mc.mc.to_string(), o.place), new.clone()))
                })
            })
            .collect();
        for part in parts {
            let mut blocks: Vec<VarBlock> = std::mem::take(&mut part.project.globals);
            for block in &mut blocks {
                block.decls.retain(|decl| {
                    let name = &decl.name.name;
                    let Some((mc, place)) = exported(part, name) else {
                        return true;
                    };
                    let shown = names.get(&(mc.to_owned(), place)).cloned();
                    let stays = shown.is_none();
                    let new = shown.unwrap_or_else(|| {
                        let is_free = !self.0.contains_key(&name.to_ascii_uppercase());
                        if is_free {
                            name.clone()
                        } else {
                            new_name(part.mc, name, |name| self.0.contains_key(name))
                        }
                    });
                    if stays {
                        let owner = part.mc.mc.to_string();
                        self.0.insert(new.to_ascii_uppercase(), (owner, None));
                    }
                    part.renames.names.insert(name.to_ascii_uppercase(), new);
                    stays
                });
            }
            part.project.globals = blocks;
        }
    }

    /// As items that no type and no POU may share a name with.
    fn items(self) -> BTreeMap<(bool, String), Item> {
        let item = |name: String| Item {
            original: name.clone(),
            name,
            is_type: false,
            is_interface: false,
            xml: String::new(),
        };
        let names = self.0.into_keys();
        names.map(|n| ((false, n.clone()), item(n))).collect()
    }
}
