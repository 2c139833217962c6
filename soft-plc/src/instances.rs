//! Program instances. Where a configuration runs one PROGRAM several times, each instance becomes a program of its own: it has its
//! own variables, and VAR_CONFIG gives them places and values of their own (IEC 61131-3, clause 6.8.1).

use crate::syntax::ast::{PouKind, Project};

fn same(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

/// Gives each instance of a PROGRAM that has several a copy of it with the instance's name.
pub fn own_programs(project: &mut Project) {
    let mut configurations = std::mem::take(&mut project.configurations);
    let instances = || configurations.iter().flat_map(|c| &c.resources);
    let of: Vec<String> = instances()
        .flat_map(|r| &r.instances)
        .map(|i| i.program.to_ascii_uppercase())
        .collect();
    let repeated = |program: &str| of.iter().filter(|p| same(p, program)).count() > 1;
    let resources = configurations.iter_mut().flat_map(|c| &mut c.resources);
    for instance in resources.flat_map(|r| &mut r.instances) {
        if !repeated(&instance.program) || same(&instance.name, &instance.program) {
            continue;
        }
        let found = project
            .pous
            .iter()
            .find(|p| p.kind == PouKind::Program && same(&p.name.name, &instance.program));
        let Some(mut own) = found.cloned() else {
            continue;
        };
        own.name.name.clone_from(&instance.name);
        while is_taken(project, &own.name.name) {
            own.name.name.push('_');
        }
        instance.program.clone_from(&own.name.name);
        project.pous.push(own);
    }
    project.configurations = configurations;
}

fn is_taken(project: &Project, name: &str) -> bool {
    let globals = project.globals.iter().flat_map(|b| &b.decls);
    project.pous.iter().any(|p| same(&p.name.name, name))
        || project.types.iter().any(|t| same(&t.name.name, name))
        || globals.into_iter().any(|d| same(&d.name.name, name))
}
