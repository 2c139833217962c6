//! The command line of `fam`.

use crate::engineering::{
    ConvertArgs, DiffArgs, ExportArgs, GenerateArgs, ImportArgs, NewArgs, ShowArgs,
};
use clap::{Args, Parser, Subcommand, ValueEnum};
use fam_proto::{ControllerId, GatewayId, McId};
use std::net::SocketAddr;
use std::path::PathBuf;

/// Flexible Automation Middleware: controllers that share their work and survive each other's failure.
#[derive(Debug, Parser)]
#[command(
    name = "fam",
    version,
    propagate_version = true,
    max_term_width = 110,
    after_help = "\
Examples:
  fam demo                                the FMS-200 cell through joins, crashes, a freeze and a drain, in about 55 s
  fam up deploy/fms200/deployment.toml    start a cell and keep it running
  fam status --watch                      who runs what, and with which workload
  fam drain controller1                   take a controller out for maintenance
  fam bench failover --kind kill          measure the failover on this machine"
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the case study of the FMS-200 cell with real processes, and write a report
    Demo(DemoArgs),
    /// Start all processes of a deployment and keep them running until Ctrl-C
    Up(UpArgs),
    /// Run the manager: Middleware Manager, QoS Monitors, Diagnosis & Decision, repository
    Manager(ManagerArgs),
    /// Run a controller node: soft-PLC, Controller Agent, MC Agents
    Node(NodeArgs),
    /// Run an I/O gateway: records, fence, fail-safe values, field driver
    Gateway(GatewayArgs),
    /// Run a simulated plant, the FMS-200 cell or the marking machine, behind Modbus TCP
    Plant(PlantArgs),
    /// Show controllers, MCs, workloads and what is going on
    Status(StatusArgs),
    /// Show the event history
    Events(EventsArgs),
    /// Move an MC to a controller, at its next non-critical state
    Move(MoveArgs),
    /// Move all MCs off a controller and give it no more
    Drain(ControllerArgs),
    /// End a drain
    Undrain(ControllerArgs),
    /// Keep an MC where it is, or on a given controller, while that controller lives
    Pin(PinArgs),
    /// End a pin
    Unpin(McArgs),
    /// Run an MC's stop POU and leave it stopped
    Stop(McArgs),
    /// Bring a stopped or faulted MC back
    Reset(ResetArgs),
    /// Acknowledge alarms
    Ack(AckArgs),
    /// Bring changed logic into the running cell: says what changes, asks, and exchanges it MC by MC
    Reload(ReloadArgs),
    /// Read and write the points of a gateway with the `image` driver
    Io(IoArgs),
    /// Show live values of running MCs
    Watch(WatchArgs),
    /// Run the programs of a project alone, in simulated time
    Run(RunArgs),
    /// Check cells and logic and say everything that is wrong with them
    Check(CheckArgs),
    /// Run Structured Text test programs and count what holds
    Test(TestArgs),
    /// Write everything that runs: projects, diagnosis files, agents, deployment
    Generate(GenerateArgs),
    /// Show a model as a tree
    Show(ShowArgs),
    /// Say what changed between two versions of a model, and what becomes of the state
    Diff(DiffArgs),
    /// Write a model in another form: AutomationML or cell.toml
    Convert(ConvertArgs),
    /// Write a small cell to begin with
    New(NewArgs),
    /// Propose a model from the logic of an existing PLC project
    Import(ImportArgs),
    /// Write the logic of a model as one ordinary PLC project
    Export(ExportArgs),
    /// Measure this machine and this build
    Bench(crate::bench::BenchArgs),
    /// Run seeded schedules of faults against a whole simulated cell
    Simulate(crate::simulate::SimulateArgs),
    /// Run the cell for hours with a random fault every few seconds, and keep a ledger
    Soak(crate::soak::SoakArgs),
}

/// How to reach the cell.
#[derive(Debug, Clone, Args)]
pub struct CellArgs {
    /// Name of the cell; needed only where several answer at the endpoint
    #[arg(long, env = "FAM_CELL_NAME")]
    pub name: Option<String>,
    /// Zenoh endpoint of the manager
    #[arg(long, default_value = DEFAULT_MANAGER, env = "FAM_MANAGER")]
    pub manager: String,
}

/// Endpoint of the manager unless told otherwise.
pub const DEFAULT_MANAGER: &str = "tcp/127.0.0.1:7447";
/// Endpoint of the gateway unless told otherwise.
pub const DEFAULT_GATEWAY: &str = "tcp/127.0.0.1:7448";

/// How a process writes its log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogArg {
    /// Lines for people.
    Plain,
    /// One JSON object a line.
    Json,
}

/// `fam demo`
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// No progress display: one line for each step
    #[arg(long)]
    pub headless: bool,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "fam-report")]
    pub report: PathBuf,
    /// Print the result as one JSON object
    #[arg(long)]
    pub json: bool,
    /// Seed of the plant: which parts come out of the feeders, in which order
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Cell to run
    #[arg(long, value_name = "FILE", hide = true)]
    pub cell: Option<PathBuf>,
}

/// `fam up`
#[derive(Debug, Args)]
pub struct UpArgs {
    /// Deployment file
    pub deployment: PathBuf,
}

/// `fam manager`
#[derive(Debug, Args)]
pub struct ManagerArgs {
    /// Cell model
    #[arg(long, value_name = "FILE")]
    pub cell: PathBuf,
    /// Endpoint to listen on
    #[arg(long, default_value = DEFAULT_MANAGER)]
    pub listen: String,
    /// Endpoints of the gateways
    #[arg(long, default_value = DEFAULT_GATEWAY)]
    pub connect: Vec<String>,
    /// File of the System Repository
    #[arg(long, value_name = "FILE", default_value = "fam-repository.redb")]
    pub repository: PathBuf,
    /// SCHED_FIFO priority of the process, used where the machine allows it; 0 for normal scheduling
    #[arg(long, value_name = "N", default_value_t = 6)]
    pub priority: u8,
    /// Form of the log
    #[arg(long, value_enum, default_value = "plain")]
    pub log: LogArg,
}

/// `fam node`
#[derive(Debug, Args)]
pub struct NodeArgs {
    /// Which controller of the cell this is
    pub controller: ControllerId,
    /// Cell model
    #[arg(long, value_name = "FILE")]
    pub cell: PathBuf,
    /// Endpoints of manager and gateways
    #[arg(long, default_values_t = [DEFAULT_MANAGER.to_owned(), DEFAULT_GATEWAY.to_owned()])]
    pub connect: Vec<String>,
    /// Endpoint to listen on; port 0 takes a free one, the others learn it through gossip
    #[arg(long, default_value = "tcp/127.0.0.1:0")]
    pub listen: String,
    /// Neither listen nor let others find this node: it reaches the cell through the given endpoints alone
    #[arg(long, hide = true)]
    pub isolated: bool,
    /// Publish measuring points of scans and checkpoints, for benchmarks
    #[arg(long, hide = true)]
    pub trace: bool,
    /// Folder for compiled modules
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// SCHED_FIFO priority of the scan thread, used where the machine allows it; 0 for normal scheduling
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub priority: u8,
    /// SCHED_FIFO priority of the threads that send and receive, not above the scan thread's
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub link_priority: u8,
    /// Lock memory against paging, where allowed
    #[arg(long)]
    pub lock_memory: bool,
    /// Pin the scan thread to this CPU; may be given several times
    #[arg(long, value_name = "N")]
    pub cpu: Vec<usize>,
    /// Form of the log
    #[arg(long, value_enum, default_value = "plain")]
    pub log: LogArg,
}

/// `fam gateway`
#[derive(Debug, Args)]
pub struct GatewayArgs {
    /// Which gateway of the cell this is
    pub gateway: GatewayId,
    /// Cell model
    #[arg(long, value_name = "FILE")]
    pub cell: PathBuf,
    /// Endpoint to listen on
    #[arg(long, default_value = DEFAULT_GATEWAY)]
    pub listen: String,
    /// Endpoints of the manager and of other gateways
    #[arg(long, default_value = DEFAULT_MANAGER)]
    pub connect: Vec<String>,
    /// File of the records
    #[arg(long, value_name = "FILE", default_value = "fam-records.bin")]
    pub records: PathBuf,
    /// Address of the field device, in place of the model's
    #[arg(long, value_name = "HOST:PORT")]
    pub field: Option<String>,
    /// SCHED_FIFO priority of the process, used where the machine allows it; 0 for normal scheduling
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub priority: u8,
    /// Publish what is applied behind the fence, for benchmarks and reports
    #[arg(long)]
    pub recorder: bool,
    /// File that gets the journal of what is applied behind the fence
    #[arg(long, value_name = "FILE", hide = true)]
    pub journal: Option<PathBuf>,
    /// Apply every frame, whoever sends it: drives no plant safely
    #[cfg(feature = "fence-off")]
    #[arg(long)]
    pub fence_off: bool,
    /// Form of the log
    #[arg(long, value_enum, default_value = "plain")]
    pub log: LogArg,
}

/// What the plant process simulates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MachineArg {
    /// The FMS-200 assembly cell, as deploy/fms200 drives it.
    Fms200,
    /// The marking machine, as deploy/marking-machine drives it.
    Marking,
}

/// `fam plant`
#[derive(Debug, Args)]
pub struct PlantArgs {
    /// Modbus TCP address
    #[arg(long, default_value = "127.0.0.1:1502")]
    pub modbus: SocketAddr,
    /// Address of the status port (a request a line, an answer in JSON a line)
    #[arg(long, default_value = "127.0.0.1:1503")]
    pub status: SocketAddr,
    /// SCHED_FIFO priority of the process, used where the machine allows it; 0 for normal scheduling
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub priority: u8,
    /// Seed: which parts come out of the feeders, in which order
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// What is simulated
    #[arg(long, value_enum, default_value = "fms200")]
    pub machine: MachineArg,
    /// Form of the log
    #[arg(long, value_enum, default_value = "plain")]
    pub log: LogArg,
}

/// `fam status`
#[derive(Debug, Args)]
pub struct StatusArgs {
    #[command(flatten)]
    pub cell: CellArgs,
    /// Show it again every half second
    #[arg(long)]
    pub watch: bool,
    /// One JSON object
    #[arg(long)]
    pub json: bool,
}

/// `fam events`
#[derive(Debug, Args)]
pub struct EventsArgs {
    #[command(flatten)]
    pub cell: CellArgs,
    /// Go on with new events
    #[arg(long)]
    pub follow: bool,
    /// One JSON object a line
    #[arg(long)]
    pub json: bool,
}

/// `fam move`
#[derive(Debug, Args)]
pub struct MoveArgs {
    /// The MC
    pub mc: McId,
    /// Where to
    #[arg(long)]
    pub to: ControllerId,
    /// Even over a healthy owner that does not release
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// A controller.
#[derive(Debug, Args)]
pub struct ControllerArgs {
    /// The controller
    pub controller: ControllerId,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// An MC.
#[derive(Debug, Args)]
pub struct McArgs {
    /// The MC
    pub mc: McId,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// `fam pin`
#[derive(Debug, Args)]
pub struct PinArgs {
    /// The MC
    pub mc: McId,
    /// To which controller; where it is if left out
    #[arg(long)]
    pub to: Option<ControllerId>,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// `fam reset`
#[derive(Debug, Args)]
pub struct ResetArgs {
    /// The MC
    pub mc: McId,
    /// All variables take their initial values
    #[arg(long, conflicts_with = "warm")]
    pub cold: bool,
    /// Retained variables keep their values
    #[arg(long)]
    pub warm: bool,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// `fam ack`
#[derive(Debug, Args)]
pub struct AckArgs {
    /// Number of the event, as `fam events` shows it; all alarms if left out
    pub event: Option<u64>,
    #[command(flatten)]
    pub cell: CellArgs,
}

/// `fam io`
#[derive(Debug, Args)]
pub struct IoArgs {
    /// What to do
    #[command(subcommand)]
    pub what: IoCommand,
    /// Which gateway
    #[arg(long, default_value = "gateway1", global = true)]
    pub gateway: GatewayId,
    /// Name of the cell; needed only where several answer at the endpoint
    #[arg(long, env = "FAM_CELL_NAME", global = true)]
    pub name: Option<String>,
    /// Zenoh endpoint of the gateway
    #[arg(long, default_value = DEFAULT_GATEWAY, env = "FAM_GATEWAY", global = true)]
    pub endpoint: String,
}

/// Subcommands of `fam io`.
#[derive(Debug, Subcommand)]
pub enum IoCommand {
    /// Print points, inputs and outputs as CSV; all if none is named
    Get {
        /// Points
        points: Vec<String>,
    },
    /// Set input points: `point=value`, or CSV (`name,value`) on standard input where none is given
    Set {
        /// Values
        values: Vec<String>,
    },
}

/// `fam watch`
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  fam watch Station1.step Station1.axis.position          a table that follows the cell
  fam watch Station2.step Transport.pallets --csv         a line for each sample in which something was applied
  fam watch Feeder.count --cell cell.toml --samples 1     one look, for scripts

Values are those behind the outputs applied last, one consistent scan for each MC. They come from the gateway: the
controllers notice nothing. Paths are those of the program: `timer.ET`, `table[3].height`, `Station1_Control.wasActive`.")]
pub struct WatchArgs {
    /// `<MC>.<variable>`: a scalar, a text, an array, a structure or an instance
    #[arg(required = true, value_name = "MC.VARIABLE")]
    pub variables: Vec<String>,
    /// The model that the cell runs: it knows where each variable lies
    #[arg(
        long,
        value_name = "FILE",
        default_value = "deploy/fms200/fms200.aml",
        env = "FAM_CELL"
    )]
    pub cell: PathBuf,
    /// Zenoh endpoints of the gateways
    #[arg(long = "gateway", value_name = "ENDPOINT", default_value = DEFAULT_GATEWAY, env = "FAM_GATEWAY")]
    pub endpoints: Vec<String>,
    /// Time between two looks, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 200)]
    pub every_ms: u64,
    /// End after so many samples
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Comma-separated values: the gateway's time in ms, each MC's scan, the values
    #[arg(long)]
    pub csv: bool,
}

/// `fam reload`
#[derive(Debug, Args)]
#[command(after_help = "\
Every process reads the cell again from where it was started with. MCs whose logic, state and critical intervals are the same
run on untouched. A changed one is released at a non-critical state, its state is carried over by name and type, and its new
version runs the next scan. Examples:
  fam check cell.toml && fam reload       look at what would change, then decide
  fam reload --yes                        for scripts
  fam reload --dry-run                    only look")]
pub struct ReloadArgs {
    #[command(flatten)]
    pub cell: CellArgs,
    /// Do not ask
    #[arg(long, conflicts_with = "dry_run")]
    pub yes: bool,
    /// Say what would change, and change nothing
    #[arg(long)]
    pub dry_run: bool,
}

/// `fam check`
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Cell models, Structured Text and PLCopen XML; the kind is recognised from the content
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Folder within which a model's references may lie; without it an AutomationML model is kept to its own folder
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
    /// Print the result in the Static Analysis Results Interchange Format
    #[arg(long, conflicts_with = "json")]
    pub sarif: bool,
    /// Whose liberties are taken with the standard
    #[arg(long, value_enum, default_value = "standard")]
    pub dialect: DialectArg,
}

/// Whose liberties are taken with the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DialectArg {
    /// None.
    Standard,
    /// Those of CODESYS: numbers become narrower ones with a warning.
    Codesys,
}

/// `fam run`
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Structured Text or PLCopen XML
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Only this program, or an instance of this function block; else all, as their tasks say
    #[arg(long, value_name = "NAME")]
    pub program: Option<String>,
    /// How many scans; 1 unless in real time
    #[arg(long)]
    pub scans: Option<u64>,
    /// Time from one scan to the next; else the shortest interval of the tasks, or 10
    #[arg(long, value_name = "MS")]
    pub cycle_ms: Option<f64>,
    /// Table of values to set before scans: a column `scan` (from 1 as `--trace` counts; from 0 if it has a row 0) or `time_ms`, then one for each variable
    #[arg(long, value_name = "FILE")]
    pub inputs: Option<PathBuf>,
    /// Table of values after each scan
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Show these variables after each scan
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    pub watch: Vec<String>,
    /// Wait for the time of each scan
    #[arg(long)]
    pub realtime: bool,
    /// End with one JSON object that holds all variables
    #[arg(long)]
    pub json: bool,
    /// Whose liberties are taken with the standard
    #[arg(long, value_enum, default_value = "standard")]
    pub dialect: DialectArg,
}

/// `fam test`
#[derive(Debug, Args)]
pub struct TestArgs {
    /// Folder with Structured Text: programs whose names begin with TEST are the tests, all else supports them
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Scans of each test, unless its variable `done` becomes TRUE before
    #[arg(long, default_value_t = 1_000)]
    pub scans: u64,
    /// Time from one scan to the next
    #[arg(long, default_value_t = 10.0)]
    pub cycle_ms: f64,
}
