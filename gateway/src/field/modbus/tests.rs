//! The client against a device in memory that can be frozen, ended and started again.

use super::*;
use crate::testing;
use fam_proto::McInputs;
use fam_proto::model::{FieldDriver, FieldPoint, InputSource, Place};
use std::collections::BTreeMap;
use std::future::Future;
use std::net::SocketAddr;
use std::pin::Pin;
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio_modbus::prelude::{ExceptionCode, Request, Response, SlaveRequest};
use tokio_modbus::server::tcp::{Server, accept_tcp_connection};

/// Registers, coils, and the writes that came.
#[derive(Debug, Default)]
struct Memory {
    coils: BTreeMap<u16, bool>,
    registers: BTreeMap<u16, u16>,
    writes: Vec<(u8, u16, usize)>,
}

#[derive(Clone, Default)]
struct Device {
    memory: Arc<Mutex<Memory>>,
    frozen: Arc<AtomicBool>,
    refuses: Arc<AtomicBool>,
}

impl tokio_modbus::server::Service for Device {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Pin<Box<dyn Future<Output = Result<Response, ExceptionCode>> + Send>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        let device = self.clone();
        Box::pin(async move {
            if device.frozen.load(Ordering::Relaxed) {
                std::future::pending::<()>().await;
            }
            if device.refuses.load(Ordering::Relaxed) {
                return Err(ExceptionCode::IllegalDataAddress);
            }
            let mut memory = device.memory.lock().unwrap();
            match request.request {
                Request::ReadInputRegisters(at, count) => Ok(Response::ReadInputRegisters(
                    (at..at + count)
                        .map(|at| memory.registers.get(&at).copied().unwrap_or(0))
                        .collect(),
                )),
                Request::WriteMultipleCoils(at, values) => {
                    memory.writes.push((request.slave, at, values.len()));
                    memory.coils.extend((at..).zip(values.iter().copied()));
                    Ok(Response::WriteMultipleCoils(at, values.len() as u16))
                }
                _ => Err(ExceptionCode::IllegalFunction),
            }
        })
    }
}

impl Device {
    async fn serve(&self, at: SocketAddr) -> (SocketAddr, tokio::task::JoinHandle<()>) {
        let listener = TcpListener::bind(at).await.unwrap();
        let address = listener.local_addr().unwrap();
        let device = self.clone();
        let task = tokio::spawn(async move {
            let server = Server::new(listener);
            let new_service = |_| Ok(Some(device.clone()));
            let on_connected =
                |stream, peer| async move { accept_tcp_connection(stream, peer, new_service) };
            let _ = server.serve(&on_connected, |_| {}).await;
        });
        (address, task)
    }

    fn writes(&self) -> Vec<(u8, u16, usize)> {
        std::mem::take(&mut self.memory.lock().unwrap().writes)
    }
}

fn cell(address: &str) -> CellModel {
    let mut cell = testing::cell();
    cell.gateways[0].driver = FieldDriver::Modbus {
        address: address.to_owned(),
    };
    let point = |table, address| FieldPoint::Modbus {
        unit: 3,
        table,
        address,
    };
    cell.mcs[0].inputs[0].source = InputSource::Field(point(ModbusTable::InputRegister, 10));
    cell.mcs[0].outputs[0].field = Some(point(ModbusTable::Coil, 4));
    let mut second = cell.mcs[0].outputs[0].clone();
    second.place = Place::Bit { byte: 0, bit: 1 };
    second.field = Some(point(ModbusTable::Coil, 5));
    cell.mcs[0].outputs.push(second);
    cell
}

struct Bench {
    device: Device,
    address: SocketAddr,
    server: tokio::task::JoinHandle<()>,
    client: Client,
    locals: UnboundedReceiver<GatewayLocal>,
}

const LONG: Duration = Duration::from_secs(10);

impl Bench {
    async fn start() -> Bench {
        let device = Device::default();
        device.memory.lock().unwrap().registers.insert(10, 0x0201);
        let (address, server) = device.serve("127.0.0.1:0".parse().unwrap()).await;
        let (sender, locals) = unbounded_channel();
        let cell = cell("");
        let client = Client::start(&cell, &testing::gateway_id(), address.to_string(), sender);
        Bench {
            device,
            address,
            server,
            client,
            locals,
        }
    }

    async fn next(&mut self) -> GatewayLocal {
        timeout(LONG, self.locals.recv()).await.unwrap().unwrap()
    }

    async fn read(&mut self) -> McInputs {
        self.client.read();
        loop {
            if let GatewayLocal::Field(mut inputs) = self.next().await {
                return inputs.remove(0);
            }
        }
    }

    /// Reads until the device is lost; returns the words.
    async fn lost(&mut self) -> String {
        loop {
            self.client.read();
            if let GatewayLocal::FieldDeviceLost { why, .. } = self.next().await {
                return why;
            }
        }
    }

    /// Reads until the device is back.
    async fn back(&mut self) {
        self.client.read();
        loop {
            match self.next().await {
                GatewayLocal::FieldDeviceBack { .. } => return,
                GatewayLocal::Field(_) => {
                    tokio::task::yield_now().await;
                    self.client.read();
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn inputs_are_read_and_only_changed_outputs_written() {
    let mut bench = Bench::start().await;
    let mc = testing::mc_id();
    let inputs = bench.read().await;
    assert!(inputs.fresh || bench.read().await.fresh);
    bench.client.apply(&mc, &[0b01, 0]);
    assert!(bench.client.flush(LONG).await);
    assert_eq!(bench.device.writes(), [(3, 4, 2)]);
    bench.client.apply(&mc, &[0b01, 0]);
    bench.client.apply(&mc, &[0b11, 0]);
    assert!(bench.client.flush(LONG).await);
    assert_eq!(bench.device.writes(), [(3, 5, 1)]);
    let inputs = bench.read().await;
    assert_eq!((inputs.fresh, &inputs.bytes[..2]), (true, &[1, 2][..]));
    let coils = bench.device.memory.lock().unwrap().coils.clone();
    assert_eq!(coils, BTreeMap::from([(4, true), (5, true)]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_that_stops_answering_is_reported_once_and_written_anew_when_it_is_back() {
    let mut bench = Bench::start().await;
    let mc = testing::mc_id();
    bench.client.apply(&mc, &[0b01, 0]);
    assert!(bench.client.flush(LONG).await);
    bench.device.writes();
    bench.device.frozen.store(true, Ordering::Relaxed);
    let why = bench.lost().await;
    assert!(
        why.contains("no answer to reading 1 from 3/input/10 within 250 ms"),
        "{why}"
    );
    let inputs = bench.read().await;
    assert!(!inputs.fresh, "its inputs are the last ones, not fresh");
    bench.client.apply(&mc, &[0b10, 0]);
    bench.device.frozen.store(false, Ordering::Relaxed);
    bench.back().await;
    assert!(bench.client.flush(LONG).await);
    let coils = bench.device.memory.lock().unwrap().coils.clone();
    assert_eq!(coils, BTreeMap::from([(4, false), (5, true)]));
    assert!(bench.read().await.fresh);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_that_refuses_is_named_with_the_address() {
    let mut bench = Bench::start().await;
    bench.device.refuses.store(true, Ordering::Relaxed);
    let why = bench.lost().await;
    assert!(
        why.contains("it refuses reading 1 from 3/input/10") && why.contains("cell.toml"),
        "{why}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_that_is_not_there_is_named_and_found_when_it_comes() {
    let device = Device::default();
    let (address, server) = device.serve("127.0.0.1:0".parse().unwrap()).await;
    server.abort();
    let _ = server.await;
    let (sender, locals) = unbounded_channel();
    let cell = cell("");
    let client = Client::start(&cell, &testing::gateway_id(), address.to_string(), sender);
    let mut bench = Bench {
        device: device.clone(),
        address,
        server: tokio::spawn(async {}),
        client,
        locals,
    };
    let why = bench.lost().await;
    assert!(
        why.contains("cannot connect") && why.contains("fam plant"),
        "{why}"
    );
    let (_, server) = device.serve(bench.address).await;
    bench.server = server;
    bench.back().await;
    assert!(bench.read().await.fresh);
    bench.server.abort();
}
