//! What differs between two versions of the parts of a cell, in words.

use crate::build::{BuiltMc, IntervalText};
use crate::model::resolve::ms;
use fam_proto::diagnosis::IntervalKind;
use fam_proto::model::{ControllerModel, FieldDriver, GatewayModel, McModel, OutputPoint, Place};
use std::fmt;

/// One thing that differs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// What it is: `logic`, `inputs`, `watchdog`.
    pub of: &'static str,
    /// How it differs; may be empty.
    pub how: String,
}

impl Difference {
    /// A difference that is said without more.
    #[must_use]
    pub fn plain(of: &'static str) -> Difference {
        Difference {
            of,
            how: String::new(),
        }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.how.as_str() {
            "" => write!(f, "{}", self.of),
            how => write!(f, "{}: {how}", self.of),
        }
    }
}

/// All of them in one line.
#[must_use]
pub fn line<'a>(list: impl IntoIterator<Item = &'a Difference>) -> String {
    let words: Vec<String> = list.into_iter().map(ToString::to_string).collect();
    words.join("; ")
}

/// Values by name, of the old and of the new version; those that are the same are left out.
fn values(facts: impl IntoIterator<Item = (&'static str, String, String)>) -> Vec<Difference> {
    let differ = facts.into_iter().filter(|(_, old, new)| old != new);
    differ
        .map(|(of, old, new)| Difference {
            of,
            how: format!("{new} instead of {old}"),
        })
        .collect()
}

/// Of a controller.
pub fn controller(old: &ControllerModel, new: &ControllerModel) -> Vec<Difference> {
    let permille = |value: u32, per: f64| (f64::from(value) / per).to_string();
    let facts = |c: &ControllerModel| {
        [
            ("description", format!("\"{}\"", c.description)),
            ("CPU factor", permille(c.cpu_factor_permille, 1000.0)),
            ("limit", format!("{} %", permille(c.limit_permille, 10.0))),
            ("memory", format!("{} kB", c.memory_kb)),
            ("tick", ms(c.tick_us.into())),
        ]
    };
    both(facts(old), facts(new))
}

/// Of a gateway.
pub fn gateway(old: &GatewayModel, new: &GatewayModel) -> Vec<Difference> {
    let facts = |g: &GatewayModel| {
        let driver = match &g.driver {
            FieldDriver::Modbus { address } => format!("modbus at {address}"),
            FieldDriver::Image => "image".to_owned(),
        };
        [("driver", driver), ("tick", ms(g.tick_us.into()))]
    };
    both(facts(old), facts(new))
}

fn both<const N: usize>(
    old: [(&'static str, String); N],
    new: [(&'static str, String); N],
) -> Vec<Difference> {
    values(old.into_iter().zip(new).map(|((of, a), (_, b))| (of, a, b)))
}

/// What of an MC can only change with a new version of it.
pub fn mc(old: (&McModel, &BuiltMc), new: (&McModel, &BuiltMc)) -> Vec<Difference> {
    let ((old, old_built), (new, new_built)) = (old, new);
    let mut list = Vec::new();
    if old_built.compiled.logic_hash != new_built.compiled.logic_hash {
        list.push(Difference::plain("logic"));
    }
    if old.layout != new.layout {
        list.push(Difference::plain("state layout"));
    }
    if old.diagnosis != new.diagnosis || old_built.intervals != new_built.intervals {
        list.push(Difference {
            of: "critical intervals",
            how: named(
                &intervals(old_built),
                &intervals(new_built),
                |i| i.0,
                PartialEq::eq,
            ),
        });
    }
    if old.inputs != new.inputs {
        list.push(Difference {
            of: "inputs",
            how: named(&old.inputs, &new.inputs, |p| &p.name, PartialEq::eq),
        });
    }
    if old.outputs != new.outputs || old.fail_safe != new.fail_safe {
        list.push(Difference {
            of: "outputs",
            how: named(&outputs(old), &outputs(new), |o| o.0, PartialEq::eq),
        });
    }
    list.extend(values([
        ("cycle", ms(old.cycle_us.into()), ms(new.cycle_us.into())),
        ("gateway", old.gateway.to_string(), new.gateway.to_string()),
    ]));
    list
}

/// What of an MC says where it may run and how it is watched.
pub fn mc_settings(old: &McModel, new: &McModel) -> Vec<Difference> {
    let facts = |m: &McModel| {
        let hosts: Vec<&str> = m.hosts.iter().map(|h| h.as_str()).collect();
        [
            ("hosts", hosts.join(", ")),
            ("criticality", m.criticality.to_string()),
            ("worst-case load", format!("{} us", m.worst_case_us)),
            ("watchdog", ms(m.watchdog_us)),
            ("suspect time", ms(m.suspect_us)),
        ]
    };
    both(facts(old), facts(new))
}

/// An interval's name, and all that a person said of it.
type IntervalSaid<'a> = (&'a str, &'a IntervalText, IntervalKind, &'a str, bool);

fn intervals(of: &BuiltMc) -> Vec<IntervalSaid<'_>> {
    let compiled = of.diagnosis.intervals.iter();
    compiled
        .zip(&of.intervals)
        .map(|(i, text)| (i.name.as_str(), text, i.kind, i.pou.as_str(), i.repeatable))
        .collect()
}

/// An output's name, where it goes, and its part of the fail-safe values.
type OutputSaid<'a> = (&'a str, &'a OutputPoint, Vec<u8>);

fn outputs(of: &McModel) -> Vec<OutputSaid<'_>> {
    let safe = |place: Place| -> Vec<u8> {
        let at = |byte: u32, width: usize| {
            let rest = of.fail_safe.iter().skip(byte as usize);
            rest.take(width).copied().collect::<Vec<u8>>()
        };
        match place {
            Place::Bit { byte, bit } => at(byte, 1).iter().map(|b| b >> bit & 1).collect(),
            Place::Bytes { byte, width } => at(byte, width.into()),
        }
    };
    let points = of.outputs.iter();
    points
        .map(|o| (o.name.as_str(), o, safe(o.place)))
        .collect()
}

/// Which of these are new, gone or others.
fn named<T>(
    old: &[T],
    new: &[T],
    name: impl Fn(&T) -> &str,
    is_same: impl Fn(&T, &T) -> bool,
) -> String {
    let find = |list: &[T], of: &T| list.iter().position(|other| name(other) == name(of));
    let mut words = Vec::new();
    for there in new {
        match find(old, there) {
            None => words.push(format!("{} is new", name(there))),
            Some(at) if !is_same(&old[at], there) => {
                words.push(format!("{} is another", name(there)))
            }
            Some(_) => {}
        }
    }
    for there in old {
        if find(new, there).is_none() {
            words.push(format!("{} is gone", name(there)));
        }
    }
    words.join(", ")
}
