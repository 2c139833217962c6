//! The agents of node and manager, and the gateway, under any messages that read: none of them panics, and the gateway's
//! record goes only forward.

use crate::cell::{cell, gateway_id, mc_id, owner};
use crate::pieces::Pieces;
use fam_agents::manager::{ManagerAgents, ManagerLocal};
use fam_agents::node::{NodeAgents, NodeConfig};
use fam_gateway_core::{Gateway, GatewayLocal};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::codec::{Wire, decode};
use fam_proto::{BootId, Envelope, InputImage, Now, ProcessId, RepoState};
use std::sync::Arc;

/// Deadlines that are due at one moment, at most: more is a loop that does not end.
const TIMEOUTS_AT_ONCE_MAX: u32 = 1_000;
/// Outputs of one input, at most.
const OUTPUTS_MAX: u32 = 10_000;

fn node() -> NodeAgents {
    let cell = cell();
    NodeAgents::new(
        NodeConfig {
            owner: owner(2),
            model: cell.controllers[1].clone(),
            mcs: cell.mcs.iter().map(|m| Arc::new(m.clone())).collect(),
            settings: cell.settings.clone(),
            real_time: Vec::new(),
            criteria: Vec::new(),
        },
        Now(0),
    )
}

/// A manager that starts from this repository.
pub(crate) fn start_manager(restored: RepoState) -> ManagerAgents {
    let mut manager = ManagerAgents::new(Arc::new(cell()), restored, BootId(7), Now(0));
    manager.handle(Input::Local(ManagerLocal::Wall { unix_us: 1 }), Now(0));
    drain(&mut manager, Now(0));
    manager
}

fn gateway() -> Gateway {
    Gateway::new(&cell(), &gateway_id(), BootId(9), 1, Vec::new(), Now(0)).expect("the cell fits")
}

/// Drains an agent as its driver does, every write answered at once.
fn drain<A, P, X, L>(agent: &mut A, now: Now)
where
    A: Agent<Input = Input<L>, Output = Output<P, X>>,
{
    for _ in 0..OUTPUTS_MAX {
        match agent.poll_output() {
            None => return,
            Some(Output::Persist { ticket, .. }) => {
                let result = Ok(());
                agent.handle(Input::Persisted { ticket, result }, now);
            }
            Some(_) => {}
        }
    }
    panic!("one input makes outputs without end");
}

/// Lets time pass; deadlines come when they are due.
fn pass<A, P, X, L>(agent: &mut A, now: Now)
where
    A: Agent<Input = Input<L>, Output = Output<P, X>>,
{
    for _ in 0..TIMEOUTS_AT_ONCE_MAX {
        if agent.poll_timeout().is_none_or(|(at, _)| at > now) {
            return;
        }
        agent.handle_timeout(now);
        drain(agent, now);
    }
    panic!("a deadline that is always due");
}

/// An image at the agents of a node and at the manager.
pub(crate) fn see_image(image: &InputImage) {
    let image = Arc::new(image.clone());
    let (mut node, mut manager) = (node(), start_manager(RepoState::default()));
    for now in [Now(5_000), Now(400_000)] {
        node.handle(Input::Image(Arc::clone(&image)), now);
        drain(&mut node, now);
        pass(&mut node, now);
        manager.handle(Input::Image(Arc::clone(&image)), now);
        drain(&mut manager, now);
        pass(&mut manager, now);
    }
}

/// A run of messages, images, tokens and time at a node, a manager and a gateway.
pub fn agents(bytes: &[u8]) {
    let mut pieces = Pieces(bytes);
    let (mut node, mut manager, mut gateway) =
        (node(), start_manager(RepoState::default()), gateway());
    let mut now = Now(0);
    for _ in 0..32 {
        if pieces.is_empty() {
            break;
        }
        let how = pieces.byte();
        match how & 7 {
            0..=3 => {
                let mut message = vec![b'F', 1, Envelope::KIND, 0];
                message.extend_from_slice(pieces.piece());
                if let Ok(envelope) = decode::<Envelope>(&message) {
                    // Each of them gets it: a message may come under any key.
                    node.handle(Input::Message(envelope.clone()), now);
                    manager.handle(Input::Message(envelope.clone()), now);
                    gateway.handle(Input::Message(envelope), now);
                }
            }
            4 => {
                let mut message = vec![b'F', 1, InputImage::KIND, 0];
                message.extend_from_slice(pieces.piece());
                if let Ok(image) = decode::<InputImage>(&message) {
                    let image = Arc::new(image);
                    node.handle(Input::Image(Arc::clone(&image)), now);
                    manager.handle(Input::Image(image), now);
                }
            }
            5 => {
                let process = match how >> 4 & 3 {
                    0 => ProcessId::Manager,
                    1 => ProcessId::Node(owner(1).controller),
                    2 => ProcessId::Node(owner(2).controller),
                    _ => ProcessId::Gateway(gateway_id()),
                };
                let (boot, alive) = (BootId(u64::from(pieces.word())), how & 8 == 0);
                node.handle(
                    Input::Peer {
                        process: process.clone(),
                        boot,
                        alive,
                    },
                    now,
                );
                manager.handle(
                    Input::Peer {
                        process: process.clone(),
                        boot,
                        alive,
                    },
                    now,
                );
                gateway.handle(
                    Input::Peer {
                        process,
                        boot,
                        alive,
                    },
                    now,
                );
            }
            6 => {
                let frame = Arc::from(pieces.piece());
                gateway.handle(Input::Local(GatewayLocal::Frame(frame)), now);
            }
            _ => now = now.plus_us(u64::from(pieces.word()) * 100),
        }
        let before = gateway.gate(&mc_id()).map(|g| g.ledger().epoch);
        drain(&mut node, now);
        drain(&mut manager, now);
        drain(&mut gateway, now);
        pass(&mut node, now);
        pass(&mut manager, now);
        pass(&mut gateway, now);
        assert!(gateway.gate(&mc_id()).map(|g| g.ledger().epoch) >= before);
    }
}
