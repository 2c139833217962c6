//! The cell on its hosts, what is asked of it, and the verdict after each fault.

use crate::journal::{Journal, monotonic_us};
use crate::net::fabric::Fabric;
use crate::net::{Host, NoHost};
use crate::process::{Log, Process};
use crate::stalls::Stalls;
use fam_driver::Client;
use fam_plant::PlantStatus;
use fam_proto::{CellStatus, CommandKind, ControllerId, Event, EventKind, McId, Query, QueryReply};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

pub const MANAGER: &str = "manager";
pub const GATEWAY: &str = "gateway";
pub const PLANT: &str = "plant";
pub const C1: &str = "controller1";
pub const C2: &str = "controller2";
pub const C3: &str = "controller3";

/// How long anything may take.
pub const WITHIN: Duration = Duration::from_secs(40);
/// The cell is at rest when all is driven and nothing has changed for so long.
const REST: Duration = Duration::from_millis(300);
/// What the manager says to be doing while its disk fails: nothing else then is under way.
const DISK_FAILS: &str = "the repository cannot be written";
/// An MC is driven if its last frame is no older, in microseconds.
const DRIVEN_US: u64 = 150_000;
/// Where this test's own questions come from: always the same host, because Zenoh's threads stay where they were started.
const OPERATOR: Ipv4Addr = Ipv4Addr::new(10, 77, 255, 1);

/// What all cells of this program share; one cell runs at a time, because they would disturb each other's times.
struct Place {
    operator: Option<Host>,
    cells: u8,
}

fn place() -> MutexGuard<'static, Place> {
    static PLACE: OnceLock<Mutex<Place>> = OnceLock::new();
    PLACE
        .get_or_init(|| {
            Mutex::new(Place {
                operator: None,
                cells: 0,
            })
        })
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
}

/// Compiled modules are shared by all cells; so are the numbers of lives, which is right: they only have to grow.
fn cache() -> &'static Path {
    static CACHE: OnceLock<tempfile::TempDir> = OnceLock::new();
    CACHE
        .get_or_init(|| tempfile::tempdir().expect("a temporary folder"))
        .path()
}

/// The running cell.
pub struct Cell {
    pub fabric: Fabric,
    pub journal: Journal,
    pub mcs: BTreeSet<McId>,
    hosts: BTreeMap<String, Host>,
    processes: BTreeMap<String, Process>,
    logs: BTreeMap<String, Arc<Log>>,
    environment: BTreeMap<String, Vec<(String, String)>>,
    /// Folders of manager and gateway in place of the cell's own.
    pub folders: BTreeMap<String, PathBuf>,
    runtime: tokio::runtime::Runtime,
    client: Client,
    commands: Arc<tokio::sync::Mutex<Client>>,
    plant: Option<BufReader<TcpStream>>,
    model: PathBuf,
    dir: tempfile::TempDir,
    began: Instant,
    stalls: Stalls,
    _place: MutexGuard<'static, Place>,
}

impl Cell {
    /// Starts plant, gateway, manager and these controllers; `None`, with the reason printed, where there can be no hosts.
    pub fn start(controllers: &[&str]) -> Option<Cell> {
        let mut cell = Cell::prepare(controllers)?;
        cell.begin();
        Some(cell)
    }

    /// As [`Cell::start`], with nothing running yet.
    pub fn prepare(controllers: &[&str]) -> Option<Cell> {
        let mut place = place();
        place.cells += 1;
        let net = place.cells;
        let operator = match &place.operator {
            Some(operator) => operator.clone(),
            None => match Host::new(OPERATOR) {
                Ok(operator) => place.operator.insert(operator).clone(),
                Err(NoHost::NotAllowed(error)) => {
                    eprintln!("not tested here: no network namespace can be made ({error})");
                    return None;
                }
                Err(NoHost::Broken(what, error)) => {
                    panic!("network namespaces work here, but {what} does not: {error}")
                }
            },
        };
        operator
            .enter()
            .expect("the operator's host can be entered");
        let mut fabric = Fabric::default();
        fabric.connect(&operator);
        let mut hosts = BTreeMap::new();
        for (n, name) in (1..).zip([MANAGER, GATEWAY, PLANT].iter().chain(controllers)) {
            let host = fabric
                .host(Ipv4Addr::new(10, 77, net, n))
                .unwrap_or_else(|why| panic!("host {name}: {why:?}"));
            hosts.insert((*name).to_owned(), host);
        }
        let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/fms200/cell.toml");
        let built = fam_engineering::build_model(&model).expect("the cell builds");
        let runtime = fam_driver::runtime().expect("a runtime");
        let manager = format!("tcp/{}:7447", hosts[MANAGER].address);
        let open = || {
            let client = Client::open(built.cell.clone(), vec![manager.clone()]);
            runtime
                .block_on(client)
                .expect("the endpoint is well formed")
        };
        let (client, commands) = (open(), open());
        Some(Cell {
            fabric,
            journal: Journal::default(),
            mcs: built.mcs.iter().map(|m| m.mc.clone()).collect(),
            hosts,
            processes: BTreeMap::new(),
            logs: BTreeMap::new(),
            environment: BTreeMap::new(),
            folders: BTreeMap::new(),
            runtime,
            client,
            commands: Arc::new(tokio::sync::Mutex::new(commands)),
            plant: None,
            model,
            dir: tempfile::tempdir().expect("a temporary folder"),
            began: Instant::now(),
            stalls: Stalls::watch(),
            _place: place,
        })
    }

    /// Starts all processes and waits until all MCs are driven.
    pub fn begin(&mut self) {
        for name in [PLANT, GATEWAY, MANAGER] {
            self.run(name);
        }
        for name in self.controllers() {
            self.run(&name);
        }
        self.rest("after the start");
    }

    /// Controllers that have a host.
    pub fn controllers(&self) -> Vec<String> {
        let others = [MANAGER, GATEWAY, PLANT];
        self.hosts
            .keys()
            .filter(|name| !others.contains(&name.as_str()))
            .cloned()
            .collect()
    }

    pub fn host(&self, name: &str) -> &Host {
        &self.hosts[name]
    }

    /// What a process finds in its environment from its next start on.
    pub fn environment(&mut self, name: &str, variables: &[(&str, &str)]) {
        let variables = variables
            .iter()
            .map(|(n, v)| ((*n).to_owned(), (*v).to_owned()))
            .collect();
        self.environment.insert(name.to_owned(), variables);
    }

    fn folder(&self, name: &str) -> PathBuf {
        let own = || self.dir.path().to_owned();
        self.folders.get(name).cloned().unwrap_or_else(own)
    }

    fn endpoint(&self, name: &str, port: u16) -> String {
        format!("tcp/{}:{port}", self.hosts[name].address)
    }

    /// Starts a process (again).
    pub fn run(&mut self, name: &str) {
        let model = self.model.display().to_string();
        let manager = self.endpoint(MANAGER, 7447);
        let gateway = self.endpoint(GATEWAY, 7448);
        let plant = self.hosts[PLANT].address;
        let mut args: Vec<String> = Vec::new();
        let mut add = |words: &[&str]| args.extend(words.iter().map(|&w| w.to_owned()));
        match name {
            PLANT => add(&[
                "plant",
                "--modbus",
                &format!("{plant}:1502"),
                "--status",
                &format!("{plant}:1503"),
            ]),
            GATEWAY => {
                let records = self.folder(GATEWAY).join("records.bin");
                let journal = self.journal.next_life(self.dir.path());
                add(&["gateway", "gateway1", "--cell", &model]);
                add(&["--listen", &gateway, "--connect", &manager]);
                add(&["--records", &records.display().to_string()]);
                add(&["--journal", &journal.display().to_string()]);
                add(&["--field", &format!("{plant}:1502")]);
            }
            MANAGER => {
                let repository = self.folder(MANAGER).join("repository.redb");
                add(&["manager", "--cell", &model]);
                add(&["--listen", &manager, "--connect", &gateway]);
                add(&["--repository", &repository.display().to_string()]);
            }
            node => {
                let listen = self.endpoint(node, 7449);
                add(&["node", node, "--cell", &model, "--listen", &listen]);
                add(&["--connect", &manager, "--connect", &gateway]);
                add(&["--cache", &cache().display().to_string()]);
            }
        }
        add(&["--log", "json"]);
        let log = self.logs.entry(name.to_owned()).or_default().clone();
        let environment = self.environment.get(name).cloned().unwrap_or_default();
        let process = Process::start(&self.hosts[name], &args, &environment, log);
        self.processes.insert(name.to_owned(), process);
    }

    pub fn is_running(&self, name: &str) -> bool {
        self.processes.contains_key(name)
    }

    /// SIGKILL, if it runs.
    pub fn kill(&mut self, name: &str) {
        if let Some(process) = self.processes.remove(name) {
            process.kill();
        }
    }

    pub fn signal(&self, name: &str, signal: i32) {
        if let Some(process) = self.processes.get(name) {
            process.signal(signal);
        }
    }

    /// Waits for the end of a process that was told to end, or cannot run.
    pub fn ended(&mut self, name: &str) -> std::process::ExitStatus {
        let mut process = self.processes.remove(name).expect("it was started");
        match process.wait(WITHIN) {
            Some(status) => status,
            None => panic!("{name} does not end\n{}", self.report()),
        }
    }

    /// Whether a process that was asked to end does so in time; it is no longer looked after then.
    pub fn leaves(&mut self, name: &str) -> bool {
        let Some(process) = self.processes.get_mut(name) else {
            return true;
        };
        let left = process.wait(Duration::from_secs(3)).is_some();
        if left {
            self.processes.remove(name);
        }
        left
    }

    /// Starts whatever does not run.
    pub fn run_all(&mut self) {
        let missing: Vec<String> = self
            .hosts
            .keys()
            .filter(|name| !self.is_running(name))
            .cloned()
            .collect();
        for name in missing {
            self.run(&name);
        }
    }

    /// What a process has logged, over all its lives.
    pub fn log(&self, name: &str) -> &Log {
        &self.logs[name]
    }

    /// The manager's word on the cell, if it answers.
    pub fn status(&mut self) -> Option<CellStatus> {
        let asked = self.client.ask(Query::Status, Duration::from_millis(300));
        match self.runtime.block_on(asked) {
            Ok(QueryReply::Status(status)) => Some(status),
            _ => None,
        }
    }

    /// The history.
    pub fn events(&mut self) -> Vec<Event> {
        let mut all = Vec::new();
        loop {
            let after = all.last().map_or(0, |e: &Event| e.seq);
            let asked = self.client.ask(Query::Events { after, limit: 500 }, WITHIN);
            match self.runtime.block_on(asked) {
                Ok(QueryReply::Events { events, more }) => {
                    all.extend(events);
                    if !more {
                        return all;
                    }
                }
                other => panic!("no history: {other:?}\n{}", self.report()),
            }
        }
    }

    /// Gives a command and waits for its end, whatever that is.
    pub fn command(&self, what: CommandKind) {
        let client = self.commands.clone();
        self.runtime.block_on(async move {
            let _ = client.lock().await.command(what, WITHIN, |_| {}).await;
        });
    }

    /// Gives a command and goes on.
    pub fn command_along(&self, what: CommandKind) {
        let client = self.commands.clone();
        self.runtime.spawn(async move {
            // The process that it goes to may be killed meanwhile: what comes of it is seen in the cell.
            let _ = client
                .lock()
                .await
                .command(what, Duration::from_secs(3), |_| {})
                .await;
        });
    }

    /// Orders a move of an MC and goes on.
    pub fn move_along(&self, mc: &McId, to: &str) {
        self.command_along(CommandKind::Move {
            mc: mc.clone(),
            to: ControllerId::new(to).expect("a name"),
            force: false,
        });
    }

    /// Who drives what, by the frames applied last.
    pub fn owners(&mut self) -> BTreeMap<McId, String> {
        self.journal.read();
        let newest = self.journal.newest.values();
        newest
            .map(|a| (a.mc.clone(), a.owner.controller.to_string()))
            .collect()
    }

    /// An MC, and who drives it; of the controller with the most.
    pub fn busiest(&mut self) -> (String, Vec<McId>) {
        let mut by: BTreeMap<String, Vec<McId>> = BTreeMap::new();
        for (mc, controller) in self.owners() {
            by.entry(controller).or_default().push(mc);
        }
        by.into_iter()
            .max_by_key(|(_, mcs)| mcs.len())
            .expect("something is driven")
    }

    /// Waits until the journal shows it.
    pub fn until(&mut self, what: &str, mut enough: impl FnMut(&Journal) -> bool) {
        let deadline = Instant::now() + WITHIN;
        loop {
            self.journal.read();
            if enough(&self.journal) {
                return;
            }
            self.check_alive();
            assert!(
                Instant::now() < deadline,
                "waited {WITHIN:?} in vain: {what}\n{}",
                self.report()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits until every MC is driven, and none by these controllers.
    pub fn until_driven_without(&mut self, what: &str, without: &[&str]) {
        let from_us = monotonic_us();
        let mcs = self.mcs.clone();
        self.until(
            &format!("{what}: all MCs driven, none by {without:?}"),
            |j| {
                mcs.iter().all(|mc| {
                    j.newest.get(mc).is_some_and(|a| {
                        a.at_us > from_us && !without.contains(&a.owner.controller.as_str())
                    })
                })
            },
        );
    }

    /// Waits until all processes know each other, all MCs are driven and no plan is under way.
    pub fn rest(&mut self, when: &str) {
        let deadline = Instant::now() + WITHIN;
        let (mut calm_since, mut owners) = (Instant::now(), BTreeMap::new());
        loop {
            self.check_alive();
            let running: Vec<String> = self
                .controllers()
                .into_iter()
                .filter(|c| self.is_running(c))
                .collect();
            let known = self.status().is_some_and(|s| {
                let at_rest = |doing: &String| doing.starts_with(DISK_FAILS);
                s.in_progress.as_ref().is_none_or(at_rest)
                    && s.gateways.iter().all(|g| g.up)
                    && running.iter().all(|name| {
                        s.controllers
                            .iter()
                            .any(|c| c.controller.as_str() == name && c.up && c.report.is_some())
                    })
            });
            let now_owners = self.owners();
            let now_us = monotonic_us();
            let newest = &self.journal.newest;
            let driven = self.mcs.iter().all(|mc| {
                newest
                    .get(mc)
                    .is_some_and(|a| now_us.saturating_sub(a.at_us) < DRIVEN_US)
            });
            if !known || !driven || now_owners != owners {
                calm_since = Instant::now();
                owners = now_owners;
            }
            if calm_since.elapsed() >= REST {
                return;
            }
            assert!(
                Instant::now() < deadline,
                "the cell does not come to rest {when} (all known: {known}, all driven: {driven})\n{}",
                self.report()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Lets the cell run.
    pub fn run_for(&mut self, how_long: Duration) {
        let end = Instant::now() + how_long;
        while Instant::now() < end {
            self.check_alive();
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn check_alive(&mut self) {
        let dead: Vec<String> = self
            .processes
            .iter_mut()
            .filter_map(|(name, p)| Some((name, p.ended()?)))
            .map(|(name, status)| format!("{name} ended by itself with {status}"))
            .collect();
        assert!(dead.is_empty(), "{}\n{}", dead.join("\n"), self.report());
    }

    /// The plant's own account.
    pub fn plant(&mut self) -> PlantStatus {
        let address = (self.hosts[PLANT].address, 1503);
        if self.plant.is_none() {
            let stream = self.hosts[PLANT].within(move || TcpStream::connect(address));
            self.plant = Some(BufReader::new(stream.expect("the plant answers")));
        }
        let stream = self.plant.as_mut().expect("just connected");
        stream.get_mut().write_all(b"status\n").expect("it takes");
        let mut line = String::new();
        stream.read_line(&mut line).expect("and answers");
        serde_json::from_str(&line).expect("a status")
    }

    /// MCs that were taken from their owners since then although nobody had ordered it, in words. A handover counts as ordered also
    /// when the successor's opening has overtaken the release; what a stall of the machine explains is told, and left out.
    pub fn taken_since(&mut self, since_us: u64) -> Vec<String> {
        self.journal.read();
        let ordered: BTreeSet<(McId, u64)> = self
            .events()
            .into_iter()
            .filter(|e| e.kind == EventKind::McActivated && e.text.contains("handed over"))
            .filter_map(|e| Some((e.mc?, e.epoch?.0)))
            .collect();
        let mut taken = Vec::new();
        for t in self.journal.takeovers_since(since_us) {
            if t.released || ordered.contains(&(t.mc.clone(), t.to.0.0)) {
                continue;
            }
            let text = format!("{} from {} to {}", t.mc, t.from.1, t.to.1);
            if self.stalls.explain(t.last_us, t.first_us) {
                eprintln!("the machine stalled: {text}");
            } else {
                taken.push(text);
            }
        }
        taken
    }

    /// The verdict: nothing driven twice, nothing lost, no incident, and each takeover of the last while stands in the history.
    pub fn judge(&mut self, after: &str, since_us: u64) {
        self.journal.read();
        let mut wrong = self.journal.wrong();
        let plant = self.plant();
        if plant.incidents_total > 0 {
            wrong.push(format!(
                "{} incidents: {:?}",
                plant.incidents_total, plant.incidents
            ));
        }
        let activated: BTreeSet<(McId, u64)> = self
            .events()
            .into_iter()
            .filter(|e| e.kind == EventKind::McActivated)
            .filter_map(|e| Some((e.mc?, e.epoch?.0)))
            .collect();
        for t in self.journal.takeovers_since(since_us) {
            if !activated.contains(&(t.mc.clone(), t.to.0.0)) {
                wrong.push(format!(
                    "the history does not tell that {} was activated with epoch {} on {}",
                    t.mc, t.to.0, t.to.1
                ));
            }
        }
        assert!(
            wrong.is_empty(),
            "after {after}:\n{}\n{}",
            wrong.join("\n"),
            self.report()
        );
    }

    /// That the history has such an entry since then.
    pub fn told(&mut self, after: &str, from_seq: u64, kinds: &[EventKind]) {
        let events = self.events();
        let told = events
            .iter()
            .any(|e| e.seq > from_seq && kinds.contains(&e.kind));
        assert!(
            told,
            "after {after} the history has none of {kinds:?}\n{}",
            self.report()
        );
    }

    /// Position in the history.
    pub fn last_event(&mut self) -> u64 {
        self.events().last().map_or(0, |e| e.seq)
    }

    /// How long the cell has been running, for the test's own account.
    pub fn seconds(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// What all processes have logged last.
    pub fn report(&self) -> String {
        let newest: Vec<String> = self
            .journal
            .newest
            .values()
            .map(|a| {
                format!(
                    "{}: {} epoch {} scan {}, {} ms ago",
                    a.mc,
                    a.owner,
                    a.epoch,
                    a.scan,
                    monotonic_us().saturating_sub(a.at_us) / 1_000
                )
            })
            .collect();
        let logs: Vec<String> = self
            .logs
            .iter()
            .map(|(name, log)| format!("-- {name}\n{}", log.tail(25)))
            .collect();
        format!("{}\n{}", newest.join("\n"), logs.join("\n"))
    }
}
