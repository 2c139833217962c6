//! Operators' commands: the same plans and orders as everything else, with an answer at once and another one at the end.

use super::MiddlewareManager;
use super::desk::Ticket;
use super::reload::{RENEW_US, STAGE_US};
use crate::cell_view::{CellView, UnderWay};
use crate::decision::Wish;
use crate::monitor::News;
use fam_proto::{
    AgentId, Command, CommandKind, CommandReply, ControllerId, Envelope, Event, EventKind, McId,
    Message, Now, RecordState, RepoWrite, Reset, Severity,
};
use std::collections::BTreeMap;

/// So many commands are remembered, to answer repetitions.
const KEPT: usize = 256;
/// An operator hears after this long that it takes longer, in microseconds.
const MOVE_US: u64 = 20_000_000;
const DRAIN_US: u64 = 60_000_000;
const STOP_US: u64 = 35_000_000;
const RESET_US: u64 = 10_000_000;

/// What has to be true for a command to be done.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Goal {
    /// The MC runs there.
    On(McId, ControllerId),
    /// Nothing runs there.
    Empty(ControllerId),
    /// The MC runs no more.
    Stopped(McId),
    /// The MC runs.
    Runs(McId),
    /// All controllers have made the new version of this command ready.
    Staged(u64),
    /// These versions are in force.
    Renewed(BTreeMap<McId, u64>),
    /// The repository has written it down; the text is the answer.
    Written(String),
}

impl Goal {
    fn is_reached(&self, view: &CellView) -> bool {
        let runs = |mc: &McId| {
            view.mcs.get(mc).is_some_and(|m| {
                m.under_way.is_none() && m.record.as_ref().is_some_and(|r| r.driven)
            })
        };
        match self {
            Goal::On(mc, to) => runs(mc) && view.runs_on(mc) == Some(to),
            Goal::Runs(mc) => runs(mc) && view.runs_on(mc).is_some(),
            Goal::Empty(controller) => view.mcs.iter().all(|(mc, m)| {
                let drives = view.driver(mc).is_some_and(|o| &o.controller == controller);
                !drives && m.under_way != Some(UnderWay::To(controller.clone()))
            }),
            Goal::Stopped(mc) => view.mcs.get(mc).is_some_and(|m| {
                m.under_way.is_none()
                    && m.record.as_ref().is_some_and(|r| {
                        !matches!(r.state, RecordState::Open | RecordState::Released(_))
                    })
            }),
            Goal::Renewed(versions) => versions.iter().all(|(mc, version)| {
                view.version_of(mc).map(|v| v.0) == Some(*version)
                    && view.mcs[mc].under_way.is_none()
            }),
            // Told by the controllers' answers, and by the repository.
            Goal::Staged(_) | Goal::Written(_) => false,
        }
    }

    fn done(&self) -> String {
        match self {
            Goal::On(mc, to) => format!("{mc} runs on {to}"),
            Goal::Runs(mc) => format!("{mc} runs"),
            Goal::Empty(controller) => format!("nothing is active on {controller} any more"),
            Goal::Stopped(mc) => format!("{mc} is stopped; `fam reset {mc}` brings it back"),
            Goal::Written(text) => text.clone(),
            Goal::Staged(_) => "the new version is ready".to_owned(),
            Goal::Renewed(versions) if versions.is_empty() => {
                "all MCs run this version already".to_owned()
            }
            Goal::Renewed(versions) => {
                let names: Vec<&str> = versions.keys().map(McId::as_str).collect();
                format!("the new version is in force: {}", names.join(", "))
            }
        }
    }

    /// What is said when something about an MC has failed on the way there.
    fn failed(&self, mc: &McId, why: &str, view: &CellView) -> String {
        let why = if why.contains(mc.as_str()) {
            why.to_owned()
        } else {
            format!("{mc}: {why}")
        };
        let Goal::Renewed(versions) = self else {
            return why;
        };
        let is_new = |(mc, version): &(&McId, &u64)| {
            view.version_of(mc).map(|in_force| in_force.0) == Some(**version)
        };
        let renewed: Vec<&str> = versions
            .iter()
            .filter(is_new)
            .map(|(mc, _)| mc.as_str())
            .collect();
        let rest = if renewed.is_empty() {
            "No MC has its new version yet".to_owned()
        } else {
            format!("The new version is in force for {}", renewed.join(", "))
        };
        format!("{why}; it goes on with the version that it has. {rest}; `fam reload` tries again")
    }

    fn is_about(&self, mc: &McId, view: &CellView) -> bool {
        match self {
            Goal::On(other, _) | Goal::Stopped(other) => other == mc,
            Goal::Renewed(versions) => versions.contains_key(mc),
            Goal::Empty(controller) => {
                view.driver(mc).is_some_and(|o| &o.controller == controller)
                    && view.need(mc).is_none()
                    && view.mcs[mc].under_way.is_none()
            }
            // Brought back by availability, which goes on trying.
            Goal::Runs(_) | Goal::Staged(_) | Goal::Written(_) => false,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Entry {
    order: u64,
    reply: CommandReply,
    goal: Option<(Goal, Now)>,
}

// What was answered is repeated and not acted on.
impl std::hash::Hash for Entry {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.goal.hash(state);
    }
}

/// Commands that came, with what was answered.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub(super) struct Commands {
    entries: BTreeMap<(u64, u64), Entry>,
    count: u64,
}

impl Commands {
    pub(super) fn deadline(&self) -> Option<(Now, &'static str)> {
        let until = |e: &Entry| e.goal.as_ref().map(|(_, at)| *at);
        let at = self.entries.values().filter_map(until).min()?;
        Some((at, "an operator waits"))
    }
}

/// What a command comes to at once.
enum Begun {
    Done(String),
    Refused(String),
    Until(String, Goal, u64),
}

impl MiddlewareManager {
    pub(super) fn command(&mut self, envelope: &Envelope, command: &Command, now: Now) -> bool {
        let AgentId::Client(client) = envelope.from else {
            return false;
        };
        let key = (client, command.id);
        if let Some(entry) = self.commands.entries.get(&key) {
            let reply = entry.reply.clone();
            self.desk
                .send(AgentId::Client(client), Message::CommandReply(reply));
            return true;
        }
        if !self.tellers.admit(&envelope.from, None, &self.view, now) {
            return false;
        }
        self.commands.count += 1;
        let order = self.commands.count;
        let begun = self.begin_command(client, command, now);
        let (result, goal) = match begun {
            Begun::Done(text) => (Ok(text), None),
            Begun::Refused(why) => (Err(why), None),
            Begun::Until(text, goal, within_us) => (Ok(text), Some((goal, now.plus_us(within_us)))),
        };
        let text = match &result {
            Ok(text) => format!("{}: {text}", describe(&command.what)),
            Err(why) => format!("{} refused: {why}", describe(&command.what)),
        };
        self.event(
            Event::new(Severity::Info, EventKind::OperatorCommand, text),
            now,
        );
        let reply = CommandReply {
            id: command.id,
            done: goal.is_none(),
            result,
        };
        self.desk.send(
            AgentId::Client(client),
            Message::CommandReply(reply.clone()),
        );
        self.commands
            .entries
            .insert(key, Entry { order, reply, goal });
        if self.commands.entries.len() > KEPT {
            let oldest = self
                .commands
                .entries
                .iter()
                .min_by_key(|(_, e)| (e.goal.is_some(), e.order))
                .map(|(key, _)| *key);
            if let Some(oldest) = oldest {
                self.commands.entries.remove(&oldest);
            }
        }
        true
    }

    fn begin_command(&mut self, client: u64, command: &Command, now: Now) -> Begun {
        let id = command.id;
        match &command.what {
            CommandKind::Move { mc, to, force } => match self.may_move(mc, to, *force, now) {
                Ok(None) => {
                    self.wish_move(mc, to, *force);
                    let goal = Goal::On(mc.clone(), to.clone());
                    Begun::Until(format!("{mc} goes to {to}"), goal, MOVE_US)
                }
                Ok(Some(already)) => Begun::Done(already),
                Err(why) => Begun::Refused(why),
            },
            CommandKind::Drain(controller) => self.drain(controller),
            CommandKind::Undrain(controller) => self.undrain(controller, client, id),
            CommandKind::Pin { mc, to } => self.pin(mc, to.as_ref(), client, id, now),
            CommandKind::Unpin(mc) => match self.view.mcs.get_mut(mc) {
                None => Begun::Refused(self.unknown_mc(mc)),
                Some(view) if view.pinned.is_none() => Begun::Done(format!("{mc} was not pinned")),
                Some(view) => {
                    view.pinned = None;
                    self.view.version += 1;
                    self.keep_pins(client, id);
                    written(format!("{mc} is no longer pinned"))
                }
            },
            CommandKind::Stop(mc) => self.stop(mc, now),
            CommandKind::Reset { mc, how } => self.reset(mc, *how),
            CommandKind::Reload(None) => {
                // Numbers of commands are the client's own; with its own number they are everybody's.
                let staged = client.wrapping_add(id);
                match self.stage(staged, now) {
                    Ok(text) => Begun::Until(text, Goal::Staged(staged), STAGE_US),
                    Err(why) => Begun::Refused(why),
                }
            }
            CommandKind::Reload(Some(look)) => {
                match self.renew_all(client.wrapping_add(*look), now) {
                    Ok(versions) => {
                        let text = format!("{} MCs take their new version", versions.len());
                        Begun::Until(text, Goal::Renewed(versions), RENEW_US)
                    }
                    Err(why) => Begun::Refused(why),
                }
            }
            CommandKind::Acknowledge(seq) => {
                let count = self.desk.acknowledge(*seq);
                match (count, seq) {
                    (0, Some(seq)) => Begun::Refused(format!(
                        "there is no open alarm at position {seq}; `fam events` lists them"
                    )),
                    _ => Begun::Done(format!("{count} alarms acknowledged")),
                }
            }
        }
    }

    /// `Ok(Some)`: it is so already.
    fn may_move(
        &self,
        mc: &McId,
        to: &ControllerId,
        force: bool,
        now: Now,
    ) -> Result<Option<String>, String> {
        let Some((_, view)) = self.view.mc(mc) else {
            return Err(self.unknown_mc(mc));
        };
        if !self.view.controllers.contains_key(to) {
            return Err(self.unknown_controller(to));
        }
        let Some(record) = &view.record else {
            return Err(format!(
                "the gateway of {mc} has not been heard yet; try again when it is up"
            ));
        };
        if record.state.needs_reset() || view.stopped {
            return Err(format!("{mc} is stopped; `fam reset {mc}` brings it back"));
        }
        if let Some(on) = self.view.runs_on(mc)
            && on == to
            && view.under_way.is_none()
        {
            return Ok(Some(format!("{mc} runs on {to} already")));
        }
        if view.under_way.is_some() {
            return Err(format!(
                "{mc} is on its way already; try again when it has arrived (`fam status`)"
            ));
        }
        if let Some(pinned) = &view.pinned
            && pinned != to
            && !force
        {
            return Err(format!(
                "{mc} is pinned to {pinned}; `fam unpin {mc}` first"
            ));
        }
        self.view
            .may_take(to, mc, now)
            .map_err(|why| format!("{to} cannot take {mc}: it {why}"))?;
        Ok(None)
    }

    fn wish_move(&mut self, mc: &McId, to: &ControllerId, force: bool) {
        let wish = Wish::Move {
            mc: mc.clone(),
            to: to.clone(),
            force,
        };
        self.wishes
            .push((wish, format!("an operator moves {mc} to {to}")));
    }

    fn drain(&mut self, controller: &ControllerId) -> Begun {
        let Some(there) = self.view.controllers.get_mut(controller) else {
            return Begun::Refused(self.unknown_controller(controller));
        };
        there.drained = true;
        self.keep_drained(Ticket::Kept);
        self.emptying.remove(controller);
        Begun::Until(
            format!("{controller} is drained and gets no more MCs"),
            Goal::Empty(controller.clone()),
            DRAIN_US,
        )
    }

    fn undrain(&mut self, controller: &ControllerId, client: u64, id: u64) -> Begun {
        let Some(there) = self.view.controllers.get_mut(controller) else {
            return Begun::Refused(self.unknown_controller(controller));
        };
        if !there.drained {
            return Begun::Done(format!("{controller} was not drained"));
        }
        there.drained = false;
        let up = there.is_up();
        self.view.version += 1;
        if up {
            self.news.push(News::Joined(controller.clone()));
        }
        // A drain that still waits has come to nothing.
        self.end_goals(
            |goal| matches!(goal, Goal::Empty(c) if c == controller),
            "undrained",
        );
        self.keep_drained(Ticket::Command(client, id));
        written(format!("{controller} takes MCs again"))
    }

    fn pin(
        &mut self,
        mc: &McId,
        to: Option<&ControllerId>,
        client: u64,
        id: u64,
        now: Now,
    ) -> Begun {
        let Some((model, _)) = self.view.mc(mc) else {
            return Begun::Refused(self.unknown_mc(mc));
        };
        let on = self.view.runs_on(mc).cloned();
        let Some(to) = to.cloned().or(on.clone()) else {
            return Begun::Refused(format!(
                "{mc} runs nowhere; say where to pin it: `fam pin {mc} --to <controller>`"
            ));
        };
        if !model.hosts.contains(&to) {
            return Begun::Refused(format!("{to} does not host {mc}"));
        }
        let moves = on.as_ref() != Some(&to);
        if moves && let Err(why) = self.may_move(mc, &to, true, now) {
            return Begun::Refused(why);
        }
        if let Some(view) = self.view.mcs.get_mut(mc) {
            view.pinned = Some(to.clone());
        }
        self.view.version += 1;
        if moves {
            self.keep_pins_later();
            self.wish_move(mc, &to, false);
            let goal = Goal::On(mc.clone(), to.clone());
            Begun::Until(format!("{mc} is pinned and goes to {to}"), goal, MOVE_US)
        } else {
            self.keep_pins(client, id);
            written(format!("{mc} is pinned to {to}"))
        }
    }

    fn stop(&mut self, mc: &McId, now: Now) -> Begun {
        let Some((_, view)) = self.view.mc(mc) else {
            return Begun::Refused(self.unknown_mc(mc));
        };
        if view.under_way == Some(UnderWay::Stop) {
            return Begun::Until(
                format!("{mc} is being stopped"),
                Goal::Stopped(mc.clone()),
                STOP_US,
            );
        }
        if view.under_way.is_some() {
            return Begun::Refused(format!(
                "{mc} is on its way; stop it when it has arrived (`fam status`)"
            ));
        }
        let Some(record) = &view.record else {
            return Begun::Refused(format!("the gateway of {mc} has not been heard yet"));
        };
        let open = matches!(record.state, RecordState::Open);
        let runs = self.view.runs_on(mc).is_some();
        if open && !runs {
            return Begun::Refused(format!(
                "{mc} is being taken over; stop it when it runs again (`fam status`)"
            ));
        }
        self.mark_stopped(mc, true);
        if runs {
            self.begin_stop(None, mc, now);
            let goal = Goal::Stopped(mc.clone());
            Begun::Until(format!("{mc} runs its stop POU"), goal, STOP_US)
        } else {
            Begun::Done(format!(
                "{mc} does not run, and is not started until it is reset"
            ))
        }
    }

    fn reset(&mut self, mc: &McId, how: Reset) -> Begun {
        let Some((_, view)) = self.view.mc(mc) else {
            return Begun::Refused(self.unknown_mc(mc));
        };
        if view.record.is_none() {
            return Begun::Refused(format!("the gateway of {mc} has not been heard yet"));
        }
        if let Some(on) = self.view.driver(mc) {
            return Begun::Refused(format!(
                "{mc} runs on {}; `fam stop {mc}` first",
                on.controller
            ));
        }
        if view.under_way.is_some() {
            return Begun::Refused(format!("{mc} is on its way already (`fam status`)"));
        }
        self.mark_stopped(mc, false);
        if let Some(view) = self.view.mcs.get_mut(mc) {
            view.reset = Some(how);
            view.left_out.clear();
        }
        self.view.version += 1;
        Begun::Until(
            format!("{mc} is brought back"),
            Goal::Runs(mc.clone()),
            RESET_US,
        )
    }

    /// What an operator stopped is stopped again if it is found running after a restart of the manager.
    pub(super) fn stop_again(&mut self, now: Now) {
        let running: Vec<McId> = self
            .view
            .mcs
            .iter()
            .filter(|(mc, m)| m.stopped && m.under_way.is_none() && self.view.runs_on(mc).is_some())
            .map(|(mc, _)| mc.clone())
            .collect();
        for mc in running {
            self.begin_stop(None, &mc, now);
        }
    }

    fn mark_stopped(&mut self, mc: &McId, stopped: bool) {
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        view.shed = false;
        view.reset = None;
        if view.stopped == stopped {
            return;
        }
        view.stopped = stopped;
        let all = self.view.mcs.iter().filter(|(_, m)| m.stopped);
        let write = RepoWrite::Stopped(all.map(|(mc, _)| mc.clone()).collect());
        self.desk.persist(write, Ticket::Kept);
    }

    fn keep_drained(&mut self, ticket: Ticket) {
        let all = self.view.controllers.iter().filter(|(_, c)| c.drained);
        let write = RepoWrite::Drained(all.map(|(c, _)| c.clone()).collect());
        self.desk.persist(write, ticket);
    }

    fn pins(&self) -> RepoWrite {
        let pinned =
            |(mc, m): (&McId, &crate::cell_view::McView)| Some((mc.clone(), m.pinned.clone()?));
        RepoWrite::Pins(self.view.mcs.iter().filter_map(pinned).collect())
    }

    fn keep_pins(&mut self, client: u64, id: u64) {
        let write = self.pins();
        self.keep_for(write, client, id);
    }

    fn keep_pins_later(&mut self) {
        let write = self.pins();
        self.desk.persist(write, Ticket::Kept);
    }

    /// The repository has written down what a command set, or not.
    pub(super) fn command_written(&mut self, client: u64, id: u64, result: &Result<(), String>) {
        let key = (client, id);
        let Some(Entry {
            goal: Some((Goal::Written(text), _)),
            ..
        }) = self.commands.entries.get(&key)
        else {
            return;
        };
        let end = match result {
            Ok(()) => Ok(text.clone()),
            Err(why) => Err(format!(
                "{text}, but that could not be kept and is forgotten when the manager ends: {why}"
            )),
        };
        self.end_command(key, end);
    }

    pub(super) fn review_commands(&mut self, now: Now) {
        let mut ended = Vec::new();
        for (key, entry) in &self.commands.entries {
            let Some((goal, until)) = &entry.goal else {
                continue;
            };
            if let Goal::Staged(id) = goal {
                if let Some(end) = self.staged_text(*id) {
                    ended.push((*key, end));
                }
            } else if goal.is_reached(&self.view) {
                ended.push((*key, Ok(goal.done())));
            } else if now >= *until {
                let text = "not done in time; it is still being tried, see `fam status`";
                ended.push((*key, Err(text.to_owned())));
            }
        }
        for (key, end) in ended {
            self.end_command(key, end);
        }
    }

    /// What was to be done about an MC has failed; `nobody`: because no controller can take it.
    pub(super) fn command_failed(&mut self, mc: &McId, why: &str, nobody: bool) {
        let view = &self.view;
        let keys: Vec<(u64, u64)> = self
            .commands
            .entries
            .iter()
            .filter(|(_, e)| e.goal.as_ref().is_some_and(|(g, _)| g.is_about(mc, view)))
            .filter(|(_, e)| {
                // A drain goes on as long as somebody may yet take the MC.
                let drains = matches!(e.goal, Some((Goal::Empty(_), _)));
                !drains || nobody
            })
            .map(|(key, _)| *key)
            .collect();
        for key in keys {
            let goal = self.commands.entries[&key].goal.as_ref();
            let text = goal.map_or(why.to_owned(), |(g, _)| g.failed(mc, why, &self.view));
            self.end_command(key, Err(text));
        }
    }

    fn end_goals(&mut self, which: impl Fn(&Goal) -> bool, why: &str) {
        let keys: Vec<(u64, u64)> = self
            .commands
            .entries
            .iter()
            .filter(|(_, e)| e.goal.as_ref().is_some_and(|(g, _)| which(g)))
            .map(|(key, _)| *key)
            .collect();
        for key in keys {
            self.end_command(key, Err(why.to_owned()));
        }
    }

    fn end_command(&mut self, key: (u64, u64), result: Result<String, String>) {
        let Some(entry) = self.commands.entries.get_mut(&key) else {
            return;
        };
        entry.goal = None;
        entry.reply = CommandReply {
            id: key.1,
            result,
            done: true,
        };
        let reply = entry.reply.clone();
        self.desk
            .send(AgentId::Client(key.0), Message::CommandReply(reply));
    }

    fn unknown_mc(&self, mc: &McId) -> String {
        let names: Vec<&str> = self.view.mcs.keys().map(McId::as_str).collect();
        format!("there is no MC {mc}; the cell has {}", names.join(", "))
    }

    fn unknown_controller(&self, controller: &ControllerId) -> String {
        let names: Vec<&str> = self
            .view
            .controllers
            .keys()
            .map(ControllerId::as_str)
            .collect();
        format!(
            "there is no controller {controller}; the cell has {}",
            names.join(", ")
        )
    }
}

/// Ends when the repository has answered, which the driver sees to at once.
fn written(text: String) -> Begun {
    Begun::Until(text.clone(), Goal::Written(text), MOVE_US)
}

fn describe(what: &CommandKind) -> String {
    match what {
        CommandKind::Move { mc, to, force } => {
            format!("move {mc} to {to}{}", if *force { " by force" } else { "" })
        }
        CommandKind::Drain(controller) => format!("drain {controller}"),
        CommandKind::Undrain(controller) => format!("undrain {controller}"),
        CommandKind::Pin { mc, to: Some(to) } => format!("pin {mc} to {to}"),
        CommandKind::Pin { mc, to: None } => format!("pin {mc}"),
        CommandKind::Unpin(mc) => format!("unpin {mc}"),
        CommandKind::Stop(mc) => format!("stop {mc}"),
        CommandKind::Reset { mc, how } => format!(
            "reset {mc} ({})",
            match how {
                Reset::Cold => "cold",
                Reset::Warm => "warm",
                Reset::Resume => "resume",
            }
        ),
        CommandKind::Acknowledge(Some(seq)) => format!("acknowledge {seq}"),
        CommandKind::Reload(None) => "reload (look)".to_owned(),
        CommandKind::Reload(Some(_)) => "reload".to_owned(),
        CommandKind::Acknowledge(None) => "acknowledge all alarms".to_owned(),
    }
}
