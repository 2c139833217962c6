//! Real processes of `fam`, with what they print.

#![allow(dead_code)] // each test binary uses a part of this

#[path = "../../cli/src/free_port.rs"]
mod free_port;

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// How long anything may take.
pub const WITHIN: Duration = Duration::from_secs(30);

/// A running `fam`.
pub struct Fam {
    pub child: Child,
    lines: Arc<(Mutex<Vec<String>>, Condvar)>,
}

/// The program under test.
pub fn fam() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fam"));
    command
        .env("NO_COLOR", "1")
        .env_remove("FAM_LOG")
        .stdin(Stdio::null());
    command
}

/// Runs it to its end; gives exit code, standard output and standard error.
pub fn run(args: &[&str]) -> (i32, String, String) {
    let out = fam().args(args).output().expect("fam starts");
    (
        out.status.code().unwrap_or(-1),
        String::from_utf8_lossy(&out.stdout).into_owned(),
        String::from_utf8_lossy(&out.stderr).into_owned(),
    )
}

impl Fam {
    /// Starts it and gathers what it prints.
    pub fn start(args: &[&str]) -> Fam {
        let mut child = fam()
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("fam starts");
        let lines: Arc<(Mutex<Vec<String>>, Condvar)> = Arc::default();
        let streams: [Box<dyn Read + Send>; 2] = [
            Box::new(child.stdout.take().unwrap()),
            Box::new(child.stderr.take().unwrap()),
        ];
        for stream in streams {
            let sink = lines.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    sink.0.lock().unwrap().push(line);
                    sink.1.notify_all();
                }
            });
        }
        Fam { child, lines }
    }

    /// Waits for a line that contains all of these, and returns it.
    pub fn wait_for(&self, parts: &[&str]) -> String {
        let deadline = Instant::now() + WITHIN;
        let mut lines = self.lines.0.lock().unwrap();
        loop {
            if let Some(line) = lines.iter().find(|l| parts.iter().all(|p| l.contains(p))) {
                return line.clone();
            }
            let left = deadline.saturating_duration_since(Instant::now());
            assert!(
                !left.is_zero(),
                "no line with {parts:?} in\n{}",
                lines.join("\n")
            );
            lines = self.lines.1.wait_timeout(lines, left).unwrap().0;
        }
    }

    /// Everything printed so far.
    pub fn text(&self) -> String {
        self.lines.0.lock().unwrap().join("\n")
    }

    /// Whether it still runs.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    pub fn signal(&self, signal: i32) {
        // SAFETY: a signal to our own child.
        assert_eq!(
            unsafe { libc::kill(self.child.id().cast_signed(), signal) },
            0
        );
    }

    /// SIGTERM, and its end.
    pub fn terminate(&mut self) -> ExitStatus {
        self.signal(libc::SIGTERM);
        self.ended()
    }

    /// Waits for its end.
    pub fn ended(&mut self) -> ExitStatus {
        let (ended, end) = std::sync::mpsc::channel::<()>();
        let process = self.child.id().cast_signed();
        // Waiting blocks: a process that does not end is killed by another thread.
        let guard = std::thread::spawn(move || {
            let is_late = end.recv_timeout(WITHIN) == Err(RecvTimeoutError::Timeout);
            if is_late {
                // SAFETY: a signal to our own child, which nobody has waited for yet.
                unsafe { libc::kill(process, libc::SIGKILL) };
            }
            is_late
        });
        let status = self.child.wait().unwrap();
        drop(ended);
        assert!(
            !guard.join().unwrap(),
            "it does not end; it printed\n{}",
            self.text()
        );
        status
    }
}

impl Drop for Fam {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A port that nobody listens on.
pub fn free_port() -> u16 {
    free_port::free_address().unwrap().port()
}

/// Waits until a check gives a value.
pub fn until<T>(what: &str, mut check: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + WITHIN;
    loop {
        if let Some(value) = check() {
            return value;
        }
        assert!(Instant::now() < deadline, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A folder of the project.
pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// A cell on the `image` driver: manager and gateway run, controllers are started by the test.
pub struct ImageCell {
    pub dir: tempfile::TempDir,
    pub cell: String,
    pub manager_endpoint: String,
    pub gateway_endpoint: String,
    pub manager: Option<Fam>,
    pub gateway: Option<Fam>,
    /// Further gateways, and where they listen.
    pub others: Vec<(String, Fam)>,
}

impl ImageCell {
    /// Starts manager and gateway of the two-station cell.
    pub fn start() -> ImageCell {
        let cell = project("engineering/tests/cells/two_stations/cell.toml");
        ImageCell::start_with(cell.display().to_string())
    }

    /// As [`ImageCell::start`], of another cell.
    pub fn start_with(cell: String) -> ImageCell {
        let mut cell = ImageCell {
            dir: tempfile::tempdir().unwrap(),
            cell,
            manager_endpoint: format!("tcp/127.0.0.1:{}", free_port()),
            gateway_endpoint: format!("tcp/127.0.0.1:{}", free_port()),
            manager: None,
            gateway: None,
            others: Vec::new(),
        };
        cell.start_gateway();
        cell.start_manager();
        cell
    }

    pub fn file(&self, name: &str) -> String {
        self.dir.path().join(name).display().to_string()
    }

    pub fn start_manager(&mut self) {
        let repository = self.file("repository.redb");
        self.manager = Some(Fam::start(&[
            "manager",
            "--cell",
            &self.cell,
            "--listen",
            &self.manager_endpoint,
            "--connect",
            &self.gateway_endpoint,
            "--repository",
            &repository,
        ]));
    }

    pub fn start_gateway(&mut self) {
        self.gateway = Some(self.a_gateway("gateway1", &self.gateway_endpoint));
    }

    /// Starts a further gateway of the cell and returns where it listens; nodes that start later know of it.
    pub fn start_second_gateway(&mut self, name: &str) -> String {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port());
        let gateway = self.a_gateway(name, &endpoint);
        self.others.push((endpoint.clone(), gateway));
        endpoint
    }

    fn a_gateway(&self, name: &str, endpoint: &str) -> Fam {
        let records = self.file(&format!("{name}.records"));
        Fam::start(&[
            "gateway",
            name,
            "--cell",
            &self.cell,
            "--listen",
            endpoint,
            "--connect",
            &self.manager_endpoint,
            "--records",
            &records,
        ])
    }

    pub fn node(&self, controller: &str) -> Fam {
        self.node_with(controller, &self.cell)
    }

    /// A node that runs another version of the cell.
    pub fn node_with(&self, controller: &str, cell: &str) -> Fam {
        let cache = self.file("modules");
        let mut args = vec!["node", controller, "--cell", cell, "--cache", &cache];
        let gateways = self.others.iter().map(|(endpoint, _)| endpoint);
        for endpoint in gateways.chain([&self.manager_endpoint, &self.gateway_endpoint]) {
            args.extend(["--connect", endpoint]);
        }
        Fam::start(&args)
    }

    /// An operator's command; panics with its message if it fails.
    pub fn operate(&self, args: &[&str]) -> String {
        let (code, out, err) = self.try_operate(args);
        assert_eq!(code, 0, "fam {args:?}: {out}{err}");
        out
    }

    pub fn try_operate(&self, args: &[&str]) -> (i32, String, String) {
        let mut all = args.to_vec();
        all.extend([
            "--name",
            "two_stations",
            "--manager",
            &self.manager_endpoint,
        ]);
        run(&all)
    }

    pub fn status(&self) -> Option<serde_json::Value> {
        let (code, out, _) = self.try_operate(&["status", "--json"]);
        (code == 0).then(|| serde_json::from_str(&out).unwrap())
    }

    /// Who owns an MC, by the gateway's record, if it runs.
    pub fn runs_on(&self, mc: &str) -> Option<String> {
        let status = self.status()?;
        let mc = status["mcs"]
            .as_array()?
            .iter()
            .find(|m| m["mc"] == mc)?
            .clone();
        (mc["record"] == "open" && mc["scan"].as_u64()? > 0)
            .then(|| mc["owner"].as_str().map(str::to_owned))?
    }

    /// `fam io ...` on its gateway; gives exit code, standard output and standard error.
    pub fn io(&self, args: &[&str]) -> (i32, String, String) {
        let mut all = vec!["io"];
        all.extend(args);
        all.extend(["--name", "two_stations", "--gateway", "gateway1"]);
        all.extend(["--endpoint", &self.gateway_endpoint]);
        run(&all)
    }

    /// Sets points of the field.
    pub fn set(&self, values: &[&str]) {
        let mut args = vec!["set"];
        args.extend(values);
        let (code, _, err) = self.io(&args);
        assert_eq!(code, 0, "{err}");
    }

    /// Value of a point of the field.
    pub fn get(&self, point: &str) -> Option<String> {
        let (code, out, _) = self.io(&["get", point]);
        let row = out.lines().nth(1).filter(|_| code == 0)?;
        row.split(',').nth(3).map(str::to_owned)
    }

    /// Waits until a point has this value.
    pub fn wait_point(&self, point: &str, value: &str) {
        until(&format!("{point} is {value}"), || {
            (self.get(point)? == value).then_some(())
        });
    }

    pub fn wait_runs_on(&self, mc: &str, controller: &str) {
        until(&format!("{mc} runs on {controller}"), || {
            (self.runs_on(mc)? == controller).then_some(())
        });
    }
}
