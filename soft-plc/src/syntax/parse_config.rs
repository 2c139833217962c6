//! Configurations: resources, tasks, program instances, VAR_CONFIG, VAR_ACCESS (IEC 61131-3, clause 6.8).

use crate::diag::Problem;
use crate::syntax::ast::{
    Configuration, Configured, Connection, ExprKind, Ident, ProgramInstance, Project, Resource,
    Task,
};
use crate::syntax::lexer::{Kw, Tok};
use crate::syntax::parser::{Parsed, Parser};

impl Parser<'_> {
    pub(super) fn configuration(&mut self, project: &mut Project) -> Parsed<()> {
        self.advance();
        let name = self.ident("the name of the configuration")?;
        let mut configuration = Configuration {
            name: name.name,
            ..Configuration::default()
        };
        let mut single = Resource::default();
        while !self.eat_kw(Kw::EndConfiguration) {
            if self.eat_kw(Kw::Resource) {
                let mut resource = Resource {
                    name: self.ident("the name of the resource")?.name,
                    ..Resource::default()
                };
                if self.eat_word("ON") {
                    self.qualified("the type of the resource")?;
                }
                while !self.eat_kw(Kw::EndResource) {
                    self.resource_item(&mut resource, project)?;
                }
                configuration.resources.push(resource);
            } else if self.at_kw(Kw::VarConfig) {
                self.var_config(&mut configuration.configured)?;
            } else if self.at_kw(Kw::VarAccess) {
                let names = self.var_access()?;
                configuration.accesses.extend(names);
            } else {
                self.resource_item(&mut single, project)?;
            }
        }
        if !single.tasks.is_empty() || !single.instances.is_empty() {
            configuration.resources.push(single);
        }
        project.configurations.push(configuration);
        Ok(())
    }

    fn resource_item(&mut self, resource: &mut Resource, project: &mut Project) -> Parsed<()> {
        match self.peek() {
            Tok::Kw(Kw::VarGlobal) => {
                let block = self.var_block()?;
                project.globals.push(block);
            }
            Tok::Kw(Kw::Program) => {
                self.advance();
                if !self.eat_kw(Kw::Retain) {
                    self.eat_kw(Kw::NonRetain);
                }
                let Ident { name, span } = self.ident("the name of the program instance")?;
                let task = if self.eat_word("WITH") {
                    Some(self.ident("the name of a task")?.name)
                } else {
                    None
                };
                self.expect(Tok::Colon, "`:` and the program")?;
                let program = self.qualified("the name of a program")?.name;
                let mut connections = Vec::new();
                if self.at(Tok::LParen) {
                    for arg in self.arguments()? {
                        let (Some(parameter), Some(value)) = (arg.name, arg.value) else {
                            return Err(self.unexpected("named connections: in := x, out => y"));
                        };
                        connections.push(Connection {
                            parameter: parameter.name,
                            output: arg.output,
                            value: self.text_of(value.span).to_owned(),
                        });
                    }
                }
                self.expect_semi("the program instance")?;
                resource.instances.push(ProgramInstance {
                    name,
                    program,
                    task,
                    connections,
                    span,
                });
            }
            Tok::Semi => {
                self.advance();
            }
            _ if self.at_word("TASK") => {
                self.advance();
                let task = self.task()?;
                resource.tasks.push(task);
            }
            _ => {
                return Err(
                    self.unexpected("TASK, PROGRAM, VAR_GLOBAL, or the end of the resource")
                );
            }
        }
        Ok(())
    }

    /// VAR_CONFIG: where variables that were declared `AT %I*` stand, and their initial values.
    fn var_config(&mut self, list: &mut Vec<Configured>) -> Parsed<()> {
        self.advance();
        while !self.eat_kw(Kw::EndVar) {
            let mut path = vec![self.ident("the path of a variable, or END_VAR")?];
            while self.eat(Tok::Dot) {
                path.push(self.ident("the next part of the path")?);
            }
            let location = if self.eat_kw(Kw::At) {
                let span = self.expect(Tok::Direct, "a direct address such as %IX0.0")?;
                Some(Ident {
                    name: self.text_of(span).to_owned(),
                    span,
                })
            } else {
                None
            };
            self.expect(Tok::Colon, "`:` and the type of the variable")?;
            let spec = self.type_spec()?;
            let init = if self.eat(Tok::Assign) {
                Some(self.init()?)
            } else {
                None
            };
            self.expect_semi("the configured variable")?;
            list.push(Configured {
                path,
                location,
                spec,
                init,
            });
        }
        Ok(())
    }

    /// VAR_ACCESS: names under which others may reach variables.
    pub(super) fn var_access(&mut self) -> Parsed<Vec<Ident>> {
        self.advance();
        let mut names = Vec::new();
        while !self.eat_kw(Kw::EndVar) {
            names.push(self.ident("the name of an access path, or END_VAR")?);
            self.expect(Tok::Colon, "`:` and the path of the variable")?;
            self.postfix()?;
            self.expect(Tok::Colon, "`:` and the type of the variable")?;
            self.type_spec()?;
            if !self.eat_word("READ_WRITE") {
                self.eat_word("READ_ONLY");
            }
            self.expect_semi("the access path")?;
        }
        Ok(names)
    }

    fn task(&mut self) -> Parsed<Task> {
        let Ident { name, span } = self.ident("the name of the task")?;
        let mut task = Task {
            name,
            span,
            ..Task::default()
        };
        self.expect(Tok::LParen, "`(` and the settings of the task")?;
        loop {
            let setting = self.ident("INTERVAL, PRIORITY or SINGLE")?;
            self.expect(Tok::Assign, "`:=`")?;
            let value = self.expression()?;
            match (setting.name.to_ascii_uppercase().as_str(), &value.kind) {
                ("INTERVAL", ExprKind::Time(ns)) => task.interval_ns = Some(*ns),
                ("PRIORITY", ExprKind::Int(v)) if (0..=65_535).contains(v) => {
                    task.priority = *v as i32;
                }
                ("SINGLE", ExprKind::Name(_) | ExprKind::Field(..) | ExprKind::Direct(_)) => {
                    task.single = Some(self.text_of(value.span).to_owned());
                }
                _ => {
                    self.report(
                        Problem::error(
                            "E120",
                            setting.span.to(value.span),
                            "this is no setting of a task",
                        )
                        .expected(
                            "INTERVAL := a duration, PRIORITY := 0..65535, or SINGLE := a variable",
                        ),
                    );
                }
            }
            if !self.eat(Tok::Comma) {
                break;
            }
        }
        self.expect(Tok::RParen, "`)` after the settings of the task")?;
        self.expect_semi("the task")?;
        Ok(task)
    }
}
