//! Logic as an ordinary PLCopen project: a whole file, or what one program of it needs.

use super::unit::{self, Renames};
use super::xml::Xml;
use super::{comments, head, identifier};
use fam_soft_plc::source::{SourceFile, Span};
use fam_soft_plc::syntax::ast::{Configuration, Project};
use std::collections::BTreeSet;

/// Which declarations go into a file; names in upper case.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Selection {
    /// POUs.
    pub pous: BTreeSet<String>,
    /// Global variables.
    pub globals: BTreeSet<String>,
}

/// Writes a project. Comments of Structured Text become documentation; `None` takes everything.
#[must_use]
pub fn write(
    name: &str,
    project: &Project,
    sources: &[SourceFile],
    selection: Option<&Selection>,
) -> String {
    let comment_of = |span: Span| comments::of(&project.sources, span);
    let wanted = |list: fn(&Selection) -> &BTreeSet<String>, name: &str| {
        selection.is_none_or(|s| list(s).contains(&name.to_ascii_uppercase()))
    };
    let mut xml = Xml::new();
    let about: Vec<String> = sources
        .iter()
        .filter(|s| !s.text.trim_start().starts_with('<'))
        .filter_map(|s| comments::of_file(&s.text))
        .collect();
    let about = about.join("\n\n");
    head(
        &mut xml,
        "logic of a mechatronic component",
        name,
        (!about.is_empty()).then_some(about.as_str()),
    );
    let items = unit::items_with(project, &Renames::default(), &comment_of);
    xml.open("types", &[]);
    for (element, is_type) in [("dataTypes", true), ("pous", false)] {
        xml.open(element, &[]);
        for item in items.iter().filter(|i| i.is_type == is_type) {
            if is_type || item.is_interface || wanted(|s| &s.pous, &item.original) {
                xml.raw(&item.xml);
            }
        }
        xml.close();
    }
    xml.close();
    xml.open("instances", &[]);
    xml.open("configurations", &[]);
    let of_selection;
    let configurations = match selection {
        None => project.configurations.as_slice(),
        Some(selection) => {
            of_selection = selected(project, selection, name);
            of_selection.as_slice()
        }
    };
    for (index, configuration) in configurations.iter().enumerate() {
        configured(&mut xml, project, configuration, &|n| {
            index == 0 && wanted(|s| &s.globals, n)
        });
    }
    let has_globals = || {
        let mut globals = project.globals.iter().flat_map(|b| &b.decls);
        globals.any(|d| wanted(|s| &s.globals, &d.name.name))
    };
    if configurations.is_empty() && has_globals() {
        let empty = Configuration {
            name: identifier(name),
            ..Configuration::default()
        };
        configured(&mut xml, project, &empty, &|n| wanted(|s| &s.globals, n));
    }
    xml.close();
    xml.close();
    xml.close();
    xml.finish()
}

/// What VAR_CONFIG says about the selected programs, and the instances that it names.
fn selected(project: &Project, selection: &Selection, name: &str) -> Vec<Configuration> {
    let is_wanted = |program: &str| selection.pous.contains(&program.to_ascii_uppercase());
    let mut list = Vec::new();
    for configuration in &project.configurations {
        let mut own = configuration.clone();
        own.name = identifier(name);
        for resource in &mut own.resources {
            resource.tasks.clear();
            resource.instances.retain(|i| is_wanted(&i.program));
            for instance in &mut resource.instances {
                instance.task = None;
            }
        }
        own.resources.retain(|r| !r.instances.is_empty());
        let instances: Vec<&str> = own
            .resources
            .iter()
            .flat_map(|r| &r.instances)
            .map(|i| i.name.as_str())
            .collect();
        own.configured.retain(|c| {
            let mut path = c.path.iter();
            path.any(|part| instances.iter().any(|i| i.eq_ignore_ascii_case(&part.name)))
        });
        if !own.configured.is_empty() {
            list.push(own);
        }
    }
    list
}

/// A configuration with its tasks and instances, the wanted global variables, and what VAR_CONFIG says.
fn configured(
    xml: &mut Xml,
    project: &Project,
    configuration: &Configuration,
    wanted: &dyn Fn(&str) -> bool,
) {
    let comment_of = |span: Span| comments::of(&project.sources, span);
    xml.open("configuration", &[("name", &configuration.name)]);
    for resource in &configuration.resources {
        xml.open("resource", &[("name", &resource.name)]);
        for task in &resource.tasks {
            let interval = task.interval_ns.map(fam_soft_plc::value::format_time);
            let priority = task.priority.to_string();
            let mut attributes = vec![("name", task.name.as_str())];
            if let Some(interval) = &interval {
                attributes.push(("interval", interval));
            }
            if let Some(single) = &task.single {
                attributes.push(("single", single));
            }
            attributes.push(("priority", &priority));
            xml.open("task", &attributes);
            for instance in resource
                .instances
                .iter()
                .filter(|i| i.task.as_ref() == Some(&task.name))
            {
                xml.empty(
                    "pouInstance",
                    &[("name", &instance.name), ("typeName", &instance.program)],
                );
            }
            xml.close();
        }
        for instance in resource.instances.iter().filter(|i| i.task.is_none()) {
            xml.empty(
                "pouInstance",
                &[("name", &instance.name), ("typeName", &instance.program)],
            );
        }
        xml.close();
    }
    unit::globals_with(xml, project, &Renames::default(), &comment_of, wanted);
    let own = Project {
        configurations: vec![configuration.clone()],
        sources: project.sources.clone(),
        ..Project::default()
    };
    unit::config_vars(xml, &[(&own, &Renames::default(), None)]);
    xml.close();
}
