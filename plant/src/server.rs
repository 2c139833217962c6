//! The process: both ports, and the ticking of the cell.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, ensure};
use fam_plant_core::PlantConfig;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::MissedTickBehavior;
use tokio_modbus::server::tcp::Server;
use tracing::{debug, info};

use crate::cell::Cell;
use crate::modbus::CellService;
use crate::status;

/// The cell advances at least this often, even if nobody asks.
const TICK: Duration = Duration::from_millis(5);
/// Time scales beyond this leave no time for the mechanics.
const TIME_SCALE_MAX: f64 = 1000.0;

/// How a plant process is started.
#[derive(Clone, Copy, Debug)]
pub struct PlantOptions {
    /// Address of the Modbus TCP server; port 0 takes a free one.
    pub modbus: SocketAddr,
    /// Address of the status port; port 0 takes a free one.
    pub status: SocketAddr,
    pub config: PlantConfig,
    /// Simulated time by real time; 1.0 is real time.
    pub time_scale: f64,
}

/// Runs the plant until `shutdown` is ready.
///
/// # Errors
/// If the configuration cannot be, a port cannot be had, or listening fails later.
pub async fn run(options: PlantOptions, shutdown: impl Future<Output = ()>) -> Result<()> {
    PlantServer::bind(options).await?.serve(shutdown).await
}

/// A plant whose ports are open, but whose time stands until it is served.
pub struct PlantServer {
    options: PlantOptions,
    modbus: TcpListener,
    status: TcpListener,
}

impl PlantServer {
    /// Opens both ports.
    ///
    /// # Errors
    /// If the time scale is out of range or a port cannot be had; the message names the port and what to do.
    pub async fn bind(options: PlantOptions) -> Result<Self> {
        ensure!(
            options.time_scale > 0.0 && options.time_scale <= TIME_SCALE_MAX,
            "the plant's time scale is {}, expected above 0 and at most {TIME_SCALE_MAX} (1 is real time)",
            options.time_scale
        );
        let modbus = listen(options.modbus, "Modbus TCP", "--modbus").await?;
        let status = listen(options.status, "the plant's status port", "--status").await?;
        Ok(PlantServer {
            options,
            modbus,
            status,
        })
    }

    /// Where the Modbus TCP server listens.
    pub fn modbus_address(&self) -> io::Result<SocketAddr> {
        self.modbus.local_addr()
    }

    /// Where the status port listens.
    pub fn status_address(&self) -> io::Result<SocketAddr> {
        self.status.local_addr()
    }

    /// Lets time run and answers until `shutdown` is ready.
    ///
    /// # Errors
    /// If the configuration cannot be, or listening fails.
    pub async fn serve(self, shutdown: impl Future<Output = ()>) -> Result<()> {
        let cell = Arc::new(Cell::new(self.options.config, self.options.time_scale)?);
        info!(
            "the plant ({}) runs: Modbus TCP on {}, status on {}, seed {}",
            self.options.config.machine.name(),
            self.modbus_address()?,
            self.status_address()?,
            self.options.config.seed
        );
        let server = Server::new(self.modbus);
        let service = CellService {
            cell: Arc::clone(&cell),
        };
        let connected = |stream: TcpStream, peer: SocketAddr| {
            let service = service.clone();
            async move {
                debug!("Modbus connection from {peer}");
                // A failing socket ends its own connection, not the server.
                Ok(stream
                    .set_nodelay(true)
                    .is_ok()
                    .then_some((service, stream)))
            }
        };
        let modbus = server.serve(&connected, |error| {
            debug!("Modbus connection ended: {error}")
        });
        tokio::select! {
            result = modbus => result.context("the Modbus TCP server failed"),
            result = status::serve(&self.status, &cell) => result.context("the plant's status port failed"),
            never = tick(&cell) => match never {},
            () = shutdown => {
                info!("the plant stops");
                Ok(())
            }
        }
    }
}

async fn tick(cell: &Cell) -> std::convert::Infallible {
    let mut interval = tokio::time::interval(TICK);
    interval.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        interval.tick().await;
        cell.advance();
    }
}

async fn listen(address: SocketAddr, what: &str, option: &str) -> Result<TcpListener> {
    TcpListener::bind(address).await.map_err(|error| {
        let advice = match error.kind() {
            io::ErrorKind::AddrInUse => {
                format!("port {} is in use. Is another plant running? Stop it, or give another address with {option}", address.port())
            }
            io::ErrorKind::PermissionDenied => {
                format!("port {} needs rights that this user has not. Give a port from 1024 on with {option}", address.port())
            }
            io::ErrorKind::AddrNotAvailable => {
                format!("this machine has no address {}. Give one that it has with {option}", address.ip())
            }
            _ => error.to_string(),
        };
        anyhow!("cannot listen for {what} on {address}: {advice}")
    })
}
