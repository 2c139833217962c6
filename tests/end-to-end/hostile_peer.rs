//! A peer gone wild among real processes: it sends random, replayed and mutated bytes under every key of the cell. The cell
//! goes on working, nothing is driven twice, and what did not read is counted.

mod support;

use fam_driver::{Link, LinkOptions};
use fam_gateway::recording;
use fam_gateway_core::recorder::{check_chain, double_driven_scans};
use fam_proto::{CellId, ControllerId, GatewayId, ProcessId};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use support::{ImageCell, until};

/// Rounds of the attack; each sends something under every key.
const ROUNDS: u64 = 4_000;
/// What the peer has heard and can send again.
const HEARD_MAX: usize = 2_000;

/// A small generator: the same attack in each run, as far as what it hears is the same.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
    fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next() % end.max(1) as u64).unwrap()
    }
}

fn keys() -> Vec<String> {
    let mut keys: Vec<String> = [
        "to/manager",
        "to/node/controller1",
        "to/node/controller2",
        "to/gateway/gateway1",
        "to/client/1",
        "image/gateway1",
        "image/nobody",
        "frame/Feeder",
        "frame/Press",
        "frame/Nobody",
        "event",
        "applied/gateway1",
        "io/gateway1",
        "alive/manager/1",
        "alive/node/controller1/1",
    ]
    .map(|key| format!("fam/two_stations/{key}"))
    .to_vec();
    keys.sort();
    keys
}

/// Scans applied of an MC.
fn scan(cell: &ImageCell, mc: &str) -> Option<u64> {
    let status = cell.status()?;
    let mcs = status["mcs"].as_array()?;
    mcs.iter().find(|m| m["mc"] == mc)?["scan"].as_u64()
}

fn wait_scanning(cell: &ImageCell, mc: &str) {
    let from = until("the manager answers", || scan(cell, mc));
    until(&format!("{mc} is driven"), || {
        (scan(cell, mc)? > from + 20).then_some(())
    });
}

/// A key, and what came under it.
type Heard = (String, Vec<u8>);

#[test]
fn a_peer_gone_wild_stops_nothing() {
    let mut cell = ImageCell::start();
    let mut nodes = [cell.node("controller1"), cell.node("controller2")];
    for mc in ["Feeder", "Press"] {
        wait_scanning(&cell, mc);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    let applied = runtime.block_on(attack(&cell));
    assert!(
        applied.len() > 100,
        "the journal has {} entries",
        applied.len()
    );
    assert_eq!(double_driven_scans(&applied), 0);
    check_chain(&applied, false).unwrap();

    // Everybody lives, and drives.
    for process in nodes.iter_mut().chain([
        cell.manager.as_mut().unwrap(),
        cell.gateway.as_mut().unwrap(),
    ]) {
        assert!(process.runs(), "{}", process.text());
    }
    for mc in ["Feeder", "Press"] {
        wait_scanning(&cell, mc);
    }
    // An operator can still move things, and sees what came.
    let on = until("Feeder has an owner", || cell.runs_on("Feeder"));
    let other = if on == "controller1" {
        "controller2"
    } else {
        "controller1"
    };
    until("Feeder can be moved", || {
        let (code, _, err) = cell.try_operate(&["move", "Feeder", "--to", other]);
        if code != 0 {
            eprintln!("{err}");
        }
        (code == 0).then_some(())
    });
    cell.wait_runs_on("Feeder", other);
    until("everybody has counted what did not read", || {
        let status = cell.status()?;
        let many = |count: &serde_json::Value| count.as_u64().is_some_and(|n| n > 100);
        let nodes = status["controllers"].as_array()?;
        let all = nodes.iter().all(|n| many(&n["report"]["bad_messages"]));
        let gateway = &status["gateways"][0]["bad_messages"];
        (many(&status["bad_messages"]) && many(gateway) && all).then_some(())
    });
}

/// Sends its worst, and returns what the gateway has applied meanwhile.
async fn attack(cell: &ImageCell) -> Vec<fam_proto::Applied> {
    let name = CellId::new("two_stations").unwrap();
    let gateway = GatewayId::new("gateway1").unwrap();
    // As a node it is introduced to all others; a command would reach only whom it calls.
    let intruder = ControllerId::new("intruder").unwrap();
    let options = LinkOptions {
        connect: vec![cell.manager_endpoint.clone(), cell.gateway_endpoint.clone()],
        ..LinkOptions::new(name.clone(), ProcessId::Node(intruder))
    };
    let (link, _events) = Link::open(options).await.unwrap();
    let heard: Arc<Mutex<Vec<Heard>>> = Arc::default();
    let news = Arc::new(tokio::sync::Notify::new());
    let (sink, tell) = (Arc::clone(&heard), Arc::clone(&news));
    let _ears = link
        .subscribe("fam/two_stations/**", move |key, bytes| {
            let mut heard = sink.lock().unwrap();
            if heard.len() < HEARD_MAX {
                heard.push((key.to_owned(), bytes.into_owned()));
                tell.notify_one();
            }
        })
        .unwrap();
    let within = Duration::from_secs(10);
    let end = recording::fetch(&link, &name, &gateway, u64::MAX, within);
    let from = end.await.unwrap().first;
    let hearing = async {
        while heard.lock().unwrap().len() < 200 {
            news.notified().await;
        }
    };
    tokio::time::timeout(within, hearing)
        .await
        .expect("the peer hears nothing");
    let keys = keys();
    let mut dice = Dice(0x9E37_79B9_7F4A_7C15);
    // As fast as a cycle: the cell is to be attacked, not only its machine.
    let mut pace = tokio::time::interval(Duration::from_millis(1));
    for round in 0..ROUNDS {
        for key in &keys {
            let bytes = missile(&mut dice, &heard.lock().unwrap(), key);
            link.put_raw(key, bytes);
        }
        if round % 4 == 0 {
            pace.tick().await;
        }
    }
    let mut applied = Vec::new();
    let mut position = from;
    loop {
        let batch = recording::fetch(&link, &name, &gateway, position, within)
            .await
            .unwrap();
        if batch.entries.is_empty() || applied.len() > 20_000 {
            break;
        }
        position = batch.first + batch.entries.len() as u64;
        applied.extend(batch.entries);
    }
    link.close().await;
    applied
}

/// Random bytes, something heard under this key or another, or that with some bytes changed.
fn missile(dice: &mut Dice, heard: &[(String, Vec<u8>)], key: &str) -> Vec<u8> {
    let how = dice.below(8);
    if how == 0 || heard.is_empty() {
        let len = dice.below(300);
        return (0..len).map(|_| dice.next() as u8).collect();
    }
    let fitting: Vec<&Vec<u8>> = heard
        .iter()
        .filter(|(from, _)| how == 1 || from == key)
        .map(|(_, bytes)| bytes)
        .collect();
    let Some(original) = fitting.get(dice.below(fitting.len())) else {
        return vec![b'F', 1, dice.next() as u8, 0, dice.next() as u8];
    };
    let mut bytes = (*original).clone();
    if how > 3 && !bytes.is_empty() {
        for _ in 0..=dice.below(3) {
            let at = dice.below(bytes.len());
            bytes[at] = dice.next() as u8;
        }
    }
    if how == 7 {
        bytes.truncate(dice.below(bytes.len() + 1));
    }
    bytes
}
