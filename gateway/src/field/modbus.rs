//! Modbus TCP client of one device: the only one that reads and writes it.
//!
//! One task owns the connection. Outputs go before inputs, also between the requests of one read. A device that does not
//! answer is reported once, its inputs are not fresh, and it is tried again with growing pauses; when it is back, all
//! outputs are written anew.

use fam_gateway_core::GatewayLocal;
use fam_gateway_core::modbus::{Range, ReadPlan, Write, WritePlan};
use fam_proto::model::{CellModel, ModbusTable};
use fam_proto::{GatewayId, McId};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::mpsc::UnboundedSender;
use tokio::sync::{Notify, watch};
use tokio::time::timeout;
use tokio_modbus::client::{Context, Reader, Writer};
use tokio_modbus::slave::{Slave, SlaveContext};

/// A device that has not answered a request for this long is lost.
pub const ANSWER_MAX: Duration = Duration::from_millis(250);
/// First and longest pause between two attempts to connect.
pub const RETRY: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(1));

/// Handle of the task.
#[derive(Debug)]
pub struct Client {
    shared: Arc<Shared>,
    task: tokio::task::JoinHandle<()>,
}

#[derive(Debug)]
struct Shared {
    address: String,
    writes: Mutex<WritePlan>,
    read_wanted: AtomicBool,
    wake: Notify,
    /// Whether the device holds all that is wanted.
    settled: watch::Sender<bool>,
    locals: UnboundedSender<GatewayLocal>,
}

impl Drop for Client {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// What went wrong with the device, in words.
type Lost = String;

impl Client {
    /// Starts the task; connects in the background, for ever. `address` is `host:port`.
    #[must_use]
    pub fn start(
        cell: &CellModel,
        gateway: &GatewayId,
        address: String,
        locals: UnboundedSender<GatewayLocal>,
    ) -> Client {
        let shared = Arc::new(Shared {
            address,
            writes: Mutex::new(WritePlan::new(cell, gateway)),
            read_wanted: AtomicBool::new(false),
            wake: Notify::new(),
            settled: watch::channel(true).0,
            locals,
        });
        let reads = ReadPlan::new(cell, gateway);
        Client {
            task: tokio::spawn(Arc::clone(&shared).run(reads)),
            shared,
        }
    }

    /// Asks for a read.
    pub fn read(&self) {
        self.shared.read_wanted.store(true, Ordering::Release);
        self.shared.wake.notify_one();
    }

    /// Sets an MC's outputs.
    pub fn apply(&self, mc: &McId, outputs: &[u8]) {
        let mut writes = self.shared.writes();
        writes.set(mc, outputs);
        if writes.is_due() {
            self.shared.settled.send_replace(false);
            drop(writes);
            self.shared.wake.notify_one();
        }
    }

    /// Waits until the device holds all that is wanted.
    pub async fn flush(&self, within: Duration) -> bool {
        let mut settled = self.shared.settled.subscribe();
        let settled = settled.wait_for(|settled| *settled);
        matches!(timeout(within, settled).await, Ok(Ok(_)))
    }
}

impl Shared {
    fn writes(&self) -> MutexGuard<'_, WritePlan> {
        self.writes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, local: GatewayLocal) {
        let _ = self.locals.send(local);
    }

    async fn run(self: Arc<Self>, mut reads: ReadPlan) {
        let mut pause = RETRY.0;
        let mut lost_reported = false;
        loop {
            let mut connected = false;
            let why = match self.connect().await {
                Ok(mut device) => {
                    self.serve(&mut device, &mut reads, || {
                        connected = true;
                        if lost_reported {
                            lost_reported = false;
                            self.tell(GatewayLocal::FieldDeviceBack {
                                device: self.address.clone(),
                            });
                        }
                    })
                    .await
                }
                Err(why) => why,
            };
            if connected {
                pause = RETRY.0;
            }
            if !lost_reported {
                lost_reported = true;
                self.tell(GatewayLocal::FieldDeviceLost {
                    device: self.address.clone(),
                    why,
                });
            }
            // The core goes on in the meantime: with inputs that are not fresh.
            let again = tokio::time::sleep(pause);
            tokio::pin!(again);
            loop {
                if self.read_wanted.swap(false, Ordering::AcqRel) {
                    self.tell(GatewayLocal::Field(reads.take(&[])));
                }
                tokio::select! {
                    () = &mut again => break,
                    () = self.wake.notified() => {}
                }
            }
            pause = (pause * 2).min(RETRY.1);
        }
    }

    async fn connect(&self) -> Result<Context, Lost> {
        let failed = |error: &dyn std::fmt::Display| {
            format!(
                "cannot connect: {error}; start the device (`fam plant` for the simulated cell), or correct the address in cell.toml or the deployment"
            )
        };
        let stream = timeout(ANSWER_MAX, TcpStream::connect(&self.address))
            .await
            .map_err(|_| failed(&format!("no answer within {} ms", ANSWER_MAX.as_millis())))?
            .map_err(|error| failed(&error))?;
        stream.set_nodelay(true).map_err(|error| failed(&error))?;
        self.writes().forget();
        Ok(tokio_modbus::client::tcp::attach_slave(
            stream,
            Slave::tcp_device(),
        ))
    }

    /// Reads and writes until the device is lost; `works` is called after each success.
    async fn serve(
        &self,
        device: &mut Context,
        reads: &mut ReadPlan,
        mut works: impl FnMut(),
    ) -> Lost {
        let ranges = reads.ranges().to_vec();
        loop {
            if let Err(why) = self.write_all(device, &mut works).await {
                return why;
            }
            if self.read_wanted.swap(false, Ordering::AcqRel) {
                let mut answers = Vec::with_capacity(ranges.len());
                for range in &ranges {
                    match read(device, range).await {
                        Ok(values) => answers.push(Some(values)),
                        Err(why) => {
                            self.tell(GatewayLocal::Field(reads.take(&answers)));
                            return why;
                        }
                    }
                    works();
                    if let Err(why) = self.write_all(device, &mut works).await {
                        self.tell(GatewayLocal::Field(reads.take(&answers)));
                        return why;
                    }
                }
                self.tell(GatewayLocal::Field(reads.take(&answers)));
                continue;
            }
            self.wake.notified().await;
        }
    }

    async fn write_all(&self, device: &mut Context, works: &mut impl FnMut()) -> Result<(), Lost> {
        loop {
            let next = {
                let writes = self.writes();
                let next = writes.next();
                if next.is_none() {
                    // Under the lock of the plan, as in `apply`: the two never contradict each other.
                    self.settled
                        .send_if_modified(|settled| !std::mem::replace(settled, true));
                }
                next
            };
            let Some(next) = next else {
                return Ok(());
            };
            write(device, &next).await?;
            self.writes().written(&next);
            works();
        }
    }
}

fn table_word(table: ModbusTable) -> &'static str {
    match table {
        ModbusTable::DiscreteInput => "discrete",
        ModbusTable::Coil => "coil",
        ModbusTable::InputRegister => "input",
        ModbusTable::HoldingRegister => "holding",
    }
}

/// Makes one of three failures words: silence, a broken connection, a refusal by the device.
fn explain<T>(
    what: impl Fn() -> String,
    result: Result<tokio_modbus::Result<T>, tokio::time::error::Elapsed>,
) -> Result<T, Lost> {
    match result {
        Err(_) => Err(format!(
            "no answer to {} within {} ms",
            what(),
            ANSWER_MAX.as_millis()
        )),
        Ok(Err(error)) => Err(format!("the connection broke at {}: {error}", what())),
        Ok(Ok(Err(refusal))) => Err(format!(
            "it refuses {}: {refusal}; compare the addresses in cell.toml with the device's register map",
            what()
        )),
        Ok(Ok(Ok(values))) => Ok(values),
    }
}

async fn read(device: &mut Context, range: &Range) -> Result<Vec<u16>, Lost> {
    let (address, count) = (range.address, range.count);
    let what = || {
        format!(
            "reading {count} from {}/{}/{address}",
            range.table.unit,
            table_word(range.table.table)
        )
    };
    device.set_slave(Slave(range.table.unit));
    let bits = |bits: Vec<bool>| bits.into_iter().map(u16::from).collect::<Vec<_>>();
    let values = match range.table.table {
        ModbusTable::DiscreteInput => explain(
            what,
            timeout(ANSWER_MAX, device.read_discrete_inputs(address, count)).await,
        )
        .map(bits),
        ModbusTable::Coil => explain(
            what,
            timeout(ANSWER_MAX, device.read_coils(address, count)).await,
        )
        .map(bits),
        ModbusTable::InputRegister => explain(
            what,
            timeout(ANSWER_MAX, device.read_input_registers(address, count)).await,
        ),
        ModbusTable::HoldingRegister => explain(
            what,
            timeout(ANSWER_MAX, device.read_holding_registers(address, count)).await,
        ),
    }?;
    if values.len() < usize::from(count) {
        return Err(format!("{}: {} values came", what(), values.len()));
    }
    Ok(values)
}

async fn write(device: &mut Context, write: &Write) -> Result<(), Lost> {
    let what = || {
        format!(
            "writing {} to {}/{}/{}",
            write.values.len(),
            write.table.unit,
            table_word(write.table.table),
            write.address
        )
    };
    device.set_slave(Slave(write.table.unit));
    match write.table.table {
        ModbusTable::Coil => {
            let coils: Vec<bool> = write.values.iter().map(|value| *value != 0).collect();
            explain(
                what,
                timeout(
                    ANSWER_MAX,
                    device.write_multiple_coils(write.address, &coils),
                )
                .await,
            )
        }
        ModbusTable::HoldingRegister => explain(
            what,
            timeout(
                ANSWER_MAX,
                device.write_multiple_registers(write.address, &write.values),
            )
            .await,
        ),
        ModbusTable::DiscreteInput | ModbusTable::InputRegister => Err(format!(
            "{}: this table cannot be written; correct cell.toml",
            what()
        )),
    }
}

#[cfg(test)]
mod tests;
