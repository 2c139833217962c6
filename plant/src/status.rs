//! The status port: what happened in the cell, for tests, reports and people.
//!
//! A request is one line, its answer one line of JSON. `status` gives a [`PlantStatus`], `summary` the same without the lists,
//! `products` and `incidents` one list each. `printf 'summary\n' | nc 127.0.0.1 1503` is enough to look.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use fam_plant_core::{Incident, Ledger, PlantConfig, Product};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tracing::debug;

use crate::cell::Cell;

/// Longest request line.
const REQUEST_BYTES_MAX: u64 = 256;
/// How long [`StatusClient`] waits for an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// What happened in the cell so far.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlantStatus {
    /// Simulated time since power-up.
    pub time_us: u64,
    /// Simulated time that stalls of the plant process have cost.
    pub lag_us: u64,
    pub config: PlantConfig,
    pub modbus_requests: u64,
    /// Sets laid into the rack.
    pub finished: u64,
    pub incidents_total: u64,
    pub ledger: Ledger,
    /// Sets in the order in which they were laid into the rack; empty in a summary.
    pub products: Vec<Product>,
    /// The first 1000 incidents; empty in a summary.
    pub incidents: Vec<Incident>,
}

/// Answers on the status port until dropped.
pub(crate) async fn serve(listener: &TcpListener, cell: &Arc<Cell>) -> io::Result<()> {
    // Connections end with the server, because the set is dropped with it.
    let mut connections = JoinSet::new();
    loop {
        let (stream, peer) = listener.accept().await?;
        let cell = Arc::clone(cell);
        connections.spawn(async move {
            if let Err(error) = converse(stream, &cell).await {
                debug!("status connection of {peer} ended: {error}");
            }
        });
        while connections.try_join_next().is_some() {}
    }
}

async fn converse(stream: TcpStream, cell: &Cell) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (read, mut write) = stream.into_split();
    let mut read = BufReader::new(read);
    let mut line = String::new();
    loop {
        line.clear();
        if (&mut read)
            .take(REQUEST_BYTES_MAX)
            .read_line(&mut line)
            .await?
            == 0
        {
            return Ok(());
        }
        let mut answer = answer(cell, line.trim()).map_err(io::Error::other)?;
        answer.push('\n');
        write.write_all(answer.as_bytes()).await?;
    }
}

fn answer(cell: &Cell, request: &str) -> serde_json::Result<String> {
    match request {
        "status" => serde_json::to_string(&cell.status(true)),
        "summary" => serde_json::to_string(&cell.status(false)),
        "products" => serde_json::to_string(&cell.status(true).products),
        "incidents" => serde_json::to_string(&cell.status(true).incidents),
        other => serde_json::to_string(&Refusal {
            error: format!(
                "unknown request \"{other}\": one of status, summary, products, incidents is expected"
            ),
        }),
    }
}

#[derive(Serialize, Deserialize)]
struct Refusal {
    error: String,
}

/// Asks the status port of a running plant, with one connection for each request.
#[derive(Clone, Copy, Debug)]
pub struct StatusClient {
    address: SocketAddr,
}

impl StatusClient {
    pub fn new(address: SocketAddr) -> Self {
        StatusClient { address }
    }

    /// Everything: figures, products and incidents.
    pub async fn status(&self) -> Result<PlantStatus> {
        self.ask("status").await
    }

    /// The figures without products and incidents one by one.
    pub async fn summary(&self) -> Result<PlantStatus> {
        self.ask("summary").await
    }

    pub async fn products(&self) -> Result<Vec<Product>> {
        self.ask("products").await
    }

    pub async fn incidents(&self) -> Result<Vec<Incident>> {
        self.ask("incidents").await
    }

    async fn ask<T: DeserializeOwned>(&self, request: &str) -> Result<T> {
        let address = self.address;
        let Ok(line) = tokio::time::timeout(ANSWER_TIMEOUT, self.line(request)).await else {
            bail!("the plant at {address} has not answered \"{request}\" in {ANSWER_TIMEOUT:?}");
        };
        let line = line.with_context(|| {
            format!(
                "cannot ask the plant's status port at {address}: is `fam plant` running there?"
            )
        })?;
        if let Ok(Refusal { error }) = serde_json::from_str(&line) {
            bail!("the plant at {address}: {error}");
        }
        serde_json::from_str(&line).with_context(|| {
            format!("the answer of {address} to \"{request}\" is not a plant's: {line:.100}")
        })
    }

    async fn line(&self, request: &str) -> io::Result<String> {
        let mut stream = TcpStream::connect(self.address).await?;
        stream.write_all(format!("{request}\n").as_bytes()).await?;
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).await?;
        Ok(line)
    }
}
