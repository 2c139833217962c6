//! `deployment.toml`: how a cell is brought up on one machine by `fam up`: files, endpoints, which processes to start.
//!
//! Every key has a default, so that `cell = "cell.toml"` is a whole deployment. Paths are relative to the file.

use crate::problem::{Explain, ModelText, Problems, file_error, suggestion};
use fam_proto::model::{CellModel, FieldDriver};
use fam_proto::{ControllerId, GatewayId};
use fam_soft_plc::diag::Diagnostic;
use serde::Deserialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use toml::Spanned;

/// First port of the processes that others connect to: the manager's, then one for each gateway.
pub const PORT_FIRST: u16 = 7447;

/// The file as read; [`DeploymentFile::resolve`] holds it against its cell.
#[derive(Debug)]
pub struct DeploymentFile {
    text: ModelText,
    folder: PathBuf,
    table: Table,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    cell: Spanned<String>,
    run_dir: Option<String>,
    #[serde(default)]
    manager: ManagerTable,
    #[serde(default)]
    gateway: Vec<GatewayTable>,
    controllers: Option<Spanned<Start>>,
    plant: Option<PlantTable>,
    #[serde(default)]
    real_time: RealTime,
    #[serde(default)]
    log: Log,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ManagerTable {
    listen: Option<Spanned<String>>,
    repository: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GatewayTable {
    name: Spanned<String>,
    listen: Option<Spanned<String>>,
    records: Option<String>,
    address: Option<Spanned<String>>,
}

#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "this is neither \"all\" nor a list of controllers in [ ]"
)]
enum Start {
    Word(String),
    List(Vec<String>),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlantTable {
    modbus: Option<Spanned<String>>,
    status: Option<Spanned<String>>,
    #[serde(default = "one")]
    seed: u64,
    #[serde(default)]
    machine: PlantMachine,
}

/// Which machine the plant process simulates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlantMachine {
    /// The FMS-200 assembly cell.
    #[default]
    Fms200,
    /// The marking machine.
    Marking,
}

impl PlantMachine {
    /// Its name, as in the file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            PlantMachine::Fms200 => "fms200",
            PlantMachine::Marking => "marking",
        }
    }
}

fn one() -> u64 {
    1
}

/// Real-time options of a node's scan thread; each is used where the machine allows it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealTime {
    /// SCHED_FIFO priority, 1 to 99; `None` for normal scheduling.
    pub priority: Option<u8>,
    /// Whether memory is locked against paging.
    #[serde(default)]
    pub lock_memory: bool,
    /// CPUs that scan threads may run on; empty for all.
    #[serde(default)]
    pub cpus: Vec<usize>,
}

/// Form of log lines.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    #[default]
    Plain,
    /// One JSON object a line.
    Json,
}

/// Logging of all processes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// Form of the lines.
    #[serde(default)]
    pub format: LogFormat,
    /// What is logged, as `FAM_LOG` says it, such as `info` or `fam=debug`.
    pub filter: Option<String>,
}

/// A deployment that fits its cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployment {
    /// The cell model.
    pub cell: PathBuf,
    /// Where processes keep their files, logs and sockets.
    pub run_dir: PathBuf,
    /// The manager.
    pub manager: ManagerDeployment,
    /// One for each gateway of the cell, in its order.
    pub gateways: Vec<GatewayDeployment>,
    /// Controllers to start, in this order.
    pub controllers: Vec<ControllerId>,
    /// The simulated plant, if it is to be started.
    pub plant: Option<PlantDeployment>,
    /// Real-time options of the nodes.
    pub real_time: RealTime,
    /// Logging.
    pub log: Log,
}

/// The manager process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ManagerDeployment {
    /// Zenoh endpoint that it listens on, such as `tcp/127.0.0.1:7447`.
    pub listen: String,
    /// File of the System Repository.
    pub repository: PathBuf,
}

/// A gateway process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewayDeployment {
    /// Which one.
    pub gateway: GatewayId,
    /// Zenoh endpoint that it listens on.
    pub listen: String,
    /// File of its records.
    pub records: PathBuf,
    /// Host and port of its field device: what the cell says, unless the deployment says otherwise.
    pub address: Option<String>,
}

/// The plant process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlantDeployment {
    /// Modbus TCP address that it listens on.
    pub modbus: String,
    /// Address on which it tells its state to tools.
    pub status: String,
    /// Seed of the simulation.
    pub seed: u64,
    /// What it simulates.
    pub machine: PlantMachine,
}

impl DeploymentFile {
    /// Reads the file.
    ///
    /// # Errors
    /// [`Problems`] with the place of an unknown or wrong key.
    pub fn read(path: &Path) -> Result<DeploymentFile, Problems> {
        let text = std::fs::read_to_string(path).map_err(|e| {
            let problem = file_error("M103", path, format!("the deployment cannot be read: {e}"));
            Problems::one(problem.hint("give the path of a deployment.toml"))
        })?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Self::parse(&path.display().to_string(), text, folder)
    }

    /// Reads a text whose paths are relative to `folder`.
    ///
    /// # Errors
    /// As [`DeploymentFile::read`].
    pub fn parse(name: &str, text: String, folder: PathBuf) -> Result<DeploymentFile, Problems> {
        let text = ModelText::new(name, text);
        match toml::from_str(&text.text) {
            Ok(table) => Ok(DeploymentFile {
                text,
                folder,
                table,
            }),
            Err(e) => Err(Problems::one(text.unreadable(&e))),
        }
    }

    /// Path of the cell model.
    #[must_use]
    pub fn cell(&self) -> PathBuf {
        self.folder.join(self.table.cell.get_ref())
    }

    /// Holds the deployment against its cell and fills in the defaults.
    ///
    /// # Errors
    /// [`Problems`]: gateways and controllers that the cell does not have, and texts that are no addresses.
    pub fn resolve(&self, cell: &CellModel) -> Result<Deployment, Problems> {
        let mut problems = Vec::new();
        let table = &self.table;
        let run_dir = self.folder.join(table.run_dir.as_deref().unwrap_or("run"));
        let listen =
            |given: &Option<Spanned<String>>, port: u16, problems: &mut Vec<Diagnostic>| {
                let Some(endpoint) = given else {
                    return format!("tcp/127.0.0.1:{port}");
                };
                let text = endpoint.get_ref();
                if text
                    .strip_prefix("tcp/")
                    .is_none_or(|a| !is_host_and_port(a))
                {
                    problems.push(
                        self.text
                            .error("M701", endpoint.span(), format!("`{text}` is no endpoint"))
                            .expected("tcp/<host>:<port>, such as tcp/127.0.0.1:7447"),
                    );
                }
                text.clone()
            };
        let manager = ManagerDeployment {
            listen: listen(&table.manager.listen, PORT_FIRST, &mut problems),
            repository: table
                .manager
                .repository
                .as_ref()
                .map_or_else(|| run_dir.join("repository.redb"), |p| self.folder.join(p)),
        };
        for given in &table.gateway {
            if !cell
                .gateways
                .iter()
                .any(|g| g.gateway.as_str() == given.name.get_ref())
            {
                let known: Vec<&str> = cell.gateways.iter().map(|g| g.gateway.as_str()).collect();
                let message = format!("the cell has no gateway `{}`", given.name.get_ref());
                problems.push(
                    self.text
                        .error("M702", given.name.span(), message)
                        .hint(suggestion(given.name.get_ref(), known)),
                );
            }
        }
        let mut gateways = Vec::new();
        for (index, gateway) in cell.gateways.iter().enumerate() {
            let given = table
                .gateway
                .iter()
                .find(|g| g.name.get_ref() == gateway.gateway.as_str());
            let port = PORT_FIRST
                .saturating_add(1)
                .saturating_add(u16::try_from(index).unwrap_or(u16::MAX));
            let (endpoint, records, address) = match given {
                Some(g) => (
                    listen(&g.listen, port, &mut problems),
                    g.records.as_ref().map(|p| self.folder.join(p)),
                    g.address.as_ref(),
                ),
                None => (listen(&None, port, &mut problems), None, None),
            };
            if let Some(address) = address {
                if gateway.driver == FieldDriver::Image {
                    let message = format!(
                        "gateway {} has the driver `image` and no address",
                        gateway.gateway
                    );
                    problems.push(
                        self.text
                            .error("M703", address.span(), message)
                            .hint("remove the address"),
                    );
                } else {
                    self.host_and_port(address, &mut problems);
                }
            }
            gateways.push(GatewayDeployment {
                gateway: gateway.gateway.clone(),
                listen: endpoint,
                records: records
                    .unwrap_or_else(|| run_dir.join(format!("{}.records", gateway.gateway))),
                address: address
                    .map(|a| a.get_ref().clone())
                    .or(match &gateway.driver {
                        FieldDriver::Modbus { address } => Some(address.clone()),
                        FieldDriver::Image => None,
                    }),
            });
        }
        let controllers = self.controllers(cell, &mut problems);
        let plant = table.plant.as_ref().map(|p| {
            let mut address = |given: &Option<Spanned<String>>, default: &str| match given {
                Some(a) => {
                    self.host_and_port(a, &mut problems);
                    a.get_ref().clone()
                }
                None => default.to_owned(),
            };
            PlantDeployment {
                modbus: address(&p.modbus, "127.0.0.1:1502"),
                status: address(&p.status, "127.0.0.1:1503"),
                seed: p.seed,
                machine: p.machine,
            }
        });
        if problems.is_empty() {
            Ok(Deployment {
                cell: self.cell(),
                run_dir,
                manager,
                gateways,
                controllers,
                plant,
                real_time: table.real_time.clone(),
                log: table.log.clone(),
            })
        } else {
            Err(Problems { list: problems })
        }
    }

    fn host_and_port(&self, text: &Spanned<String>, problems: &mut Vec<Diagnostic>) {
        if !is_host_and_port(text.get_ref()) {
            problems.push(
                self.text
                    .error(
                        "M701",
                        text.span(),
                        format!("`{}` is no address", text.get_ref()),
                    )
                    .expected("<host>:<port>, such as 127.0.0.1:1502"),
            );
        }
    }

    fn controllers(&self, cell: &CellModel, problems: &mut Vec<Diagnostic>) -> Vec<ControllerId> {
        let all = || {
            cell.controllers
                .iter()
                .map(|c| c.controller.clone())
                .collect()
        };
        let Some(start) = &self.table.controllers else {
            return all();
        };
        let names = match start.get_ref() {
            Start::Word(word) if word == "all" => return all(),
            Start::Word(word) => std::slice::from_ref(word),
            Start::List(list) => list.as_slice(),
        };
        let mut found: Vec<ControllerId> = Vec::new();
        for name in names {
            match cell
                .controllers
                .iter()
                .find(|c| c.controller.as_str() == name)
            {
                Some(c) if found.contains(&c.controller) => {
                    let message = format!("controller {name} would be started twice");
                    problems.push(
                        self.text
                            .error("M704", start.span(), message)
                            .hint("a controller registers under its name once; remove one of them"),
                    );
                }
                Some(c) => found.push(c.controller.clone()),
                None => {
                    let known: Vec<&str> = cell
                        .controllers
                        .iter()
                        .map(|c| c.controller.as_str())
                        .collect();
                    let message = format!("the cell has no controller `{name}`");
                    problems.push(
                        self.text
                            .error("M702", start.span(), message)
                            .hint(suggestion(name, known)),
                    );
                }
            }
        }
        found
    }
}

/// A socket address, or a host name with a port.
fn is_host_and_port(text: &str) -> bool {
    text.parse::<SocketAddr>().is_ok()
        || text.rsplit_once(':').is_some_and(|(host, port)| {
            !host.is_empty()
                && host
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || c == '.' || c == '-')
                && port.parse::<u16>().is_ok()
        })
}
