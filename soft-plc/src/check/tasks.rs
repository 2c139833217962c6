//! Tasks and program instances of a configuration (IEC 61131-3, clause 6.8.2): each name once, and nothing that is not there.

use crate::check::Checker;
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{PouKind, Resource, Task};

/// The places of names that stand a second time.
fn doubled<'a>(names: impl Iterator<Item = (&'a str, Span)>) -> Vec<(&'a str, Span)> {
    let mut seen: Vec<&str> = Vec::new();
    let mut again = Vec::new();
    for (name, span) in names {
        if seen.iter().any(|s| s.eq_ignore_ascii_case(name)) {
            again.push((name, span));
        } else {
            seen.push(name);
        }
    }
    again
}

impl Checker<'_> {
    pub(super) fn check_tasks(&mut self) {
        let project = self.project;
        let resources = || project.configurations.iter().flat_map(|c| &c.resources);
        let cyclic = |task: &&Task| task.single.is_none();
        let fastest = resources()
            .flat_map(|r| &r.tasks)
            .filter(cyclic)
            .filter_map(|t| t.interval_ns.filter(|ns| *ns > 0))
            .min();
        for resource in resources() {
            self.check_resource(resource);
            for task in resource.tasks.iter().filter(cyclic) {
                self.check_interval(task, fastest);
            }
        }
    }

    fn check_resource(&mut self, resource: &Resource) {
        let tasks = resource.tasks.iter().map(|t| (t.name.as_str(), t.span));
        for (name, span) in doubled(tasks) {
            let message = format!("the task `{name}` is declared twice");
            self.report(Problem::error("E236", span, message).hint("give each task its own name"));
        }
        let instances = || resource.instances.iter();
        for (name, span) in doubled(instances().map(|i| (i.name.as_str(), i.span))) {
            let message = format!("the program instance `{name}` is declared twice");
            let problem = Problem::error("E236", span, message);
            self.report(problem.hint("give each instance its own name"));
        }
        for instance in instances() {
            let known = |name: &str| {
                let mut tasks = resource.tasks.iter();
                tasks.any(|t| t.name.eq_ignore_ascii_case(name))
            };
            if let Some(task) = instance.task.as_ref().filter(|name| !known(name)) {
                let message = format!("there is no task `{task}` in this resource");
                let tasks: Vec<&str> = resource.tasks.iter().map(|t| t.name.as_str()).collect();
                let problem = Problem::error("E237", instance.span, message);
                self.report(match tasks.as_slice() {
                    [] => problem.hint(format!(
                        "declare it: TASK {task}(INTERVAL := T#10ms, PRIORITY := 1);"
                    )),
                    _ => problem.expected(format!("one of {}", tasks.join(", "))),
                });
            }
            let program = self
                .find_declared_pou(&instance.program)
                .filter(|pou| self.pou(*pou).kind == PouKind::Program);
            if program.is_none() {
                let message = format!("there is no PROGRAM `{}`", instance.program);
                self.report(Problem::error("E237", instance.span, message));
            }
        }
    }

    /// How often a task runs is counted in scans of the fastest one.
    fn check_interval(&mut self, task: &Task, fastest: Option<i64>) {
        let (Some(interval), Some(fastest)) = (task.interval_ns, fastest) else {
            return;
        };
        let ms = |ns: i64| format!("{} ms", ns as f64 / 1e6);
        if interval <= 0 {
            let message = format!(
                "the task `{}` has no interval: it runs in every scan",
                task.name
            );
            let problem = Problem::warning("W715", task.span, message);
            self.report(problem.hint("give it an interval above zero"));
        } else if interval % fastest != 0 {
            let runs = (interval + fastest / 2) / fastest * fastest;
            let message = format!(
                "the task `{}` runs every {} and not every {}: scans are {} apart",
                task.name,
                ms(runs),
                ms(interval),
                ms(fastest)
            );
            let problem = Problem::warning("W715", task.span, message);
            self.report(problem.hint("make it a multiple of the shortest interval"));
        }
    }
}
