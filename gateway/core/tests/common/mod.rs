//! A small cell, a driver that carries out a gateway's outputs in order, and controllers that make frames.
#![allow(dead_code)] // each test file uses its own part

use fam_gateway_core::*;
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::*;
use fam_proto::*;
use std::sync::Arc;

pub const TICK_US: u64 = 5_000;
pub const WATCHDOG_US: u64 = 1_000_000;
pub const SUSPECT_US: u64 = 50_000;
pub const LAYOUT: LayoutHash = LayoutHash(7);
pub const STATE_LEN: usize = 200;

pub fn mc_id() -> McId {
    McId::new("Station1").unwrap()
}
pub fn importer_id() -> McId {
    McId::new("Transport").unwrap()
}
pub fn gateway_id() -> GatewayId {
    GatewayId::new("gateway1").unwrap()
}
pub fn owner(n: u64) -> Owner {
    Owner {
        controller: ControllerId::new(&format!("controller{n}")).unwrap(),
        boot: BootId(100 + n),
    }
}

fn mc(name: McId, inputs: Vec<InputPoint>) -> McModel {
    McModel {
        mc: name,
        gateway: gateway_id(),
        hosts: vec![owner(1).controller, owner(2).controller],
        criticality: 1,
        cycle_us: TICK_US as u32,
        worst_case_us: 100,
        memory_kb: 1,
        watchdog_us: WATCHDOG_US,
        suspect_us: SUSPECT_US,
        hash: 1,
        layout: LAYOUT,
        diagnosis: Diagnosis {
            state_offset: 8,
            checkpoint_len: STATE_LEN as u32,
            intervals: vec![],
            stop_action: Some(1),
        },
        inputs,
        inputs_len: 4,
        outputs: vec![OutputPoint {
            name: "Q".to_owned(),
            number: fam_proto::model::Number::Unsigned,
            place: Place::Bit { byte: 0, bit: 0 },
            field: Some(FieldPoint::Image("Q".to_owned())),
        }],
        fail_safe: vec![0xF0, 0],
    }
}

pub fn cell() -> CellModel {
    CellModel {
        cell: CellId::new("test").unwrap(),
        controllers: vec![],
        mcs: vec![
            mc(
                mc_id(),
                vec![InputPoint {
                    name: "I".to_owned(),
                    number: fam_proto::model::Number::Unsigned,
                    place: Place::Bytes { byte: 0, width: 2 },
                    source: InputSource::Field(FieldPoint::Image("I".to_owned())),
                }],
            ),
            mc(
                importer_id(),
                vec![InputPoint {
                    name: "FromStation1".to_owned(),
                    number: fam_proto::model::Number::Unsigned,
                    place: Place::Bit { byte: 3, bit: 2 },
                    source: InputSource::Export {
                        mc: mc_id(),
                        place: Place::Bit { byte: 0, bit: 0 },
                    },
                }],
            ),
        ],
        gateways: vec![GatewayModel {
            gateway: gateway_id(),
            tick_us: TICK_US as u32,
            driver: FieldDriver::Image,
        }],
        settings: Settings::default(),
    }
}

/// What the disk does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disk {
    Works,
    /// Syncs fail, as on a full or failing disk under a mapped file.
    NoSync,
    Fails,
}

pub const DISK_FULL: &str = "No space left on device";

/// A gateway with its disk and field, and everything it said.
pub struct Bench {
    pub cell: CellModel,
    pub gateway: Gateway,
    pub records: MemoryRecords,
    pub disk: Disk,
    pub field_answers: bool,
    pub now: Now,
    pub run: u32,
    pub left: bool,
    pub images: Vec<Arc<InputImage>>,
    pub applied: Vec<Applied>,
    pub outputs: Vec<(McId, Vec<u8>, bool)>,
    pub sent: Vec<Message>,
    pub events: Vec<Event>,
    pub writes: Vec<RecordWrite>,
}

impl Bench {
    pub fn new() -> Bench {
        let cell = cell();
        let now = Now(1_000_000);
        let gateway = Gateway::new(&cell, &gateway_id(), BootId(1), 1, vec![], now).unwrap();
        let mut bench = Bench {
            cell,
            gateway,
            records: MemoryRecords::default(),
            disk: Disk::Works,
            field_answers: true,
            now,
            run: 1,
            left: false,
            images: vec![],
            applied: vec![],
            outputs: vec![],
            sent: vec![],
            events: vec![],
            writes: vec![],
        };
        bench.drain();
        for n in 1..=2 {
            bench.token(n, true);
        }
        bench.gateway.handle_timeout(now);
        bench.drain();
        bench
    }

    /// Kills the gateway and starts it again on its records.
    pub fn restart(&mut self) {
        self.run += 1;
        self.gateway = Gateway::new(
            &self.cell,
            &gateway_id(),
            BootId(u64::from(self.run)),
            self.run,
            self.records.after_kill(),
            self.now,
        )
        .unwrap();
        self.drain();
        for n in 1..=2 {
            self.token(n, true);
        }
        self.gateway.handle_timeout(self.now);
        self.drain();
    }

    pub fn drain(&mut self) {
        while let Some(output) = self.gateway.poll_output() {
            match output {
                Output::Persist { ticket, write } => {
                    let result = self.write(write);
                    self.gateway
                        .handle(Input::Persisted { ticket, result }, self.now);
                }
                Output::Send(envelope) => self.sent.push(envelope.body),
                Output::Event(event) => self.events.push(event),
                Output::Act(GatewayAct::PublishImage(image)) => self.images.push(image),
                Output::Act(GatewayAct::ApplyOutputs { mc, outputs, why }) => {
                    self.outputs
                        .push((mc, outputs.to_vec(), why == Why::FailSafe));
                    if let Why::Frame(applied) = why {
                        self.applied.push(applied);
                    }
                }
                Output::Act(GatewayAct::ReadField) if self.field_answers => {
                    let inputs = vec![McInputs {
                        mc: mc_id(),
                        bytes: vec![1, 2, 0, 0],
                        fresh: true,
                    }];
                    self.gateway
                        .handle(Input::Local(GatewayLocal::Field(inputs)), self.now);
                }
                Output::Act(GatewayAct::ReadField) => {}
                Output::Act(GatewayAct::Left) => self.left = true,
            }
        }
    }

    fn write(&mut self, write: RecordWrite) -> Result<(), String> {
        let fails = match self.disk {
            Disk::Works => false,
            Disk::NoSync => write.is_synced(),
            Disk::Fails => true,
        };
        let kept =
            !fails || (self.disk == Disk::NoSync && matches!(write, RecordWrite::Changed { .. }));
        if kept {
            self.records.write(write.clone());
            self.writes.push(write);
        }
        if fails {
            Err(DISK_FULL.to_owned())
        } else {
            Ok(())
        }
    }

    pub fn input(&mut self, input: GatewayInput) {
        self.gateway.handle(input, self.now);
        self.drain();
    }

    pub fn token(&mut self, n: u64, alive: bool) {
        let owner = owner(n);
        self.input(Input::Peer {
            process: ProcessId::Node(owner.controller),
            boot: owner.boot,
            alive,
        });
    }

    /// Lets time pass, deadline by deadline.
    pub fn pass(&mut self, us: u64) {
        let end = self.now.plus_us(us);
        while let Some((at, _)) = self.gateway.poll_timeout()
            && at <= end
        {
            self.now = self.now.max(at);
            self.gateway.handle_timeout(self.now);
            self.drain();
        }
        self.now = end;
    }

    pub fn frame(&mut self, bytes: Vec<u8>) {
        self.input(Input::Local(GatewayLocal::Frame(bytes.into())));
    }

    pub fn open(&mut self, open: Open) -> Message {
        let before = self.sent.len();
        let from = AgentId::Component(open.owner.controller.clone(), open.mc.clone());
        self.input(Input::Message(Envelope {
            from,
            boot: open.owner.boot,
            to: AgentId::Gateway(gateway_id()),
            body: Message::Open(open),
        }));
        assert_eq!(self.sent.len(), before + 1, "one answer to an open");
        self.sent[before].clone()
    }

    pub fn opened(&mut self, open: Open) -> Opened {
        match self.open(open) {
            Message::Opened(opened) => opened,
            other => panic!("not opened: {other:?}"),
        }
    }

    pub fn record(&self) -> RecordSummary {
        self.gateway.gate(&mc_id()).unwrap().summary(self.now)
    }

    pub fn rejected(&self, why: Rejection) -> u64 {
        let gate = self.gateway.gate(&mc_id()).unwrap();
        gate.counters().rejected.get(&why).copied().unwrap_or(0)
            + self.gateway.stray().get(&why).copied().unwrap_or(0)
    }

    pub fn newest_image(&self) -> ImageNumber {
        self.images.last().map_or(ImageNumber(0), |i| i.number)
    }

    /// Opens `epoch` for controller `n` and returns a driver of it.
    pub fn driver(&mut self, n: u64, epoch: u64) -> Driver {
        let opened = self.opened(ask(n, epoch));
        Driver::of(n, &opened)
    }

    /// One scan of a driver, its frame delivered.
    pub fn scan(&mut self, driver: &mut Driver) {
        let bytes = driver.frame(self.newest_image());
        self.frame(bytes);
    }
}

pub fn ask(n: u64, epoch: u64) -> Open {
    Open {
        mc: mc_id(),
        epoch: Epoch(epoch),
        owner: owner(n),
        layout: LAYOUT,
        held: None,
        force: false,
        reset: None,
    }
}

/// A controller that drives the MC: its state counts scans.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Driver {
    pub header: FrameHeader,
    pub state: Vec<u8>,
    pub outputs: Vec<u8>,
}

impl Driver {
    pub fn of(n: u64, opened: &Opened) -> Driver {
        let state = opened
            .checkpoint
            .as_ref()
            .map_or_else(|| vec![0; STATE_LEN], |c| c.state.clone());
        Driver {
            header: FrameHeader {
                mc: opened.mc.clone(),
                owner: owner(n),
                epoch: opened.epoch,
                scan: Scan(opened.next_scan.0 - 1),
                image: ImageNumber(0),
                base: opened.base,
                mc_time_us: opened.checkpoint.as_ref().map_or(0, |c| c.mc_time_us),
                layout: LAYOUT,
                digest: Digest::default(),
                phase: Phase::Running,
                released_to: None,
                scan_us: 10,
                content: Content::Full,
                outputs_len: 2,
                state_len: STATE_LEN as u32,
            },
            state,
            outputs: vec![1, 0],
        }
    }

    /// Runs a scan.
    pub fn step(&mut self, image: ImageNumber) {
        self.header.scan = self.header.scan.next();
        self.header.image = image;
        self.header.mc_time_us += TICK_US;
        let at = self.header.scan.0 as usize % (STATE_LEN - 8);
        self.state[..8].copy_from_slice(&self.header.scan.0.to_le_bytes());
        self.state[8 + at] ^= self.header.owner.boot.0 as u8;
        self.outputs[1] = self.header.scan.0 as u8;
        self.header.digest = Digest::of(self.header.mc_time_us, &self.state);
    }

    /// The frame of the scan that was run last.
    pub fn encode(&self) -> Vec<u8> {
        encode_frame(&self.header, &self.outputs, &self.state).unwrap()
    }

    pub fn frame(&mut self, image: ImageNumber) -> Vec<u8> {
        self.step(image);
        self.encode()
    }
}
