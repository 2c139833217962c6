//! What a peer can make a process keep is bounded, and one damaged number makes nobody deaf. How much a process keeps is
//! measured by how much it has to say of itself.

use fam_agents::manager::{ManagerAgents, ManagerLocal};
use fam_agents::node::{NodeAgents, NodeConfig};
use fam_gateway_core::Gateway;
use fam_hostile::{cell, gateway_id, owner, seeds};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{
    AgentId, BootId, Command, CommandKind, ControllerId, Envelope, Event, EventKind, GatewayId,
    McId, McOutcome, Message, Now, ProcessId, Registered, RepoState, Severity,
};
use std::sync::Arc;

fn node() -> NodeAgents {
    let cell = cell();
    let config = NodeConfig {
        owner: owner(2),
        model: cell.controllers[1].clone(),
        mcs: cell.mcs.iter().map(|m| Arc::new(m.clone())).collect(),
        settings: cell.settings.clone(),
        real_time: Vec::new(),
        criteria: Vec::new(),
    };
    NodeAgents::new(config, Now(0))
}

fn manager() -> ManagerAgents {
    let cell = Arc::new(cell());
    let mut manager = ManagerAgents::new(cell, RepoState::default(), BootId(7), Now(0));
    manager.handle(Input::Local(ManagerLocal::Wall { unix_us: 1 }), Now(0));
    history(&mut manager);
    manager
}

/// Carries out what the manager wants, and counts its entries in the history.
fn history(manager: &mut ManagerAgents) -> usize {
    let mut entries = 0;
    while let Some(output) = manager.poll_output() {
        match output {
            Output::Persist { ticket, .. } => {
                let result = Ok(());
                manager.handle(Input::Persisted { ticket, result }, Now(0));
            }
            Output::Event(_) => entries += 1,
            _ => {}
        }
    }
    entries
}

fn from_manager(boot: u64, body: Message) -> Input<fam_agents::node::NodeLocal> {
    Input::Message(Envelope {
        from: AgentId::Manager,
        boot: BootId(boot),
        to: AgentId::Controller(owner(2).controller),
        body,
    })
}

fn registered() -> Message {
    Message::Registered(Registered {
        assigned: Vec::new(),
        ineligible: Vec::new(),
    })
}

fn token(boot: u64) -> Input<fam_agents::node::NodeLocal> {
    Input::Peer {
        process: ProcessId::Manager,
        boot: BootId(boot),
        alive: true,
    }
}

#[test]
fn a_damaged_boot_id_makes_no_node_deaf() {
    let refused = || Message::RegistrationRefused("nonsense".to_owned());
    // While the manager's token stands, a word of a later life is not believed.
    let mut node_a = node();
    node_a.handle(token(7), Now(0));
    node_a.handle(from_manager(u64::MAX, refused()), Now(1));
    node_a.handle(from_manager(7, registered()), Now(2));
    assert!(node_a.controller().is_registered());
    // Without a token it is, until a token shows who is there.
    let mut node_b = node();
    node_b.handle(from_manager(u64::MAX, refused()), Now(1));
    node_b.handle(from_manager(7, registered()), Now(2));
    assert!(!node_b.controller().is_registered());
    node_b.handle(token(7), Now(3));
    node_b.handle(from_manager(7, registered()), Now(4));
    assert!(node_b.controller().is_registered());
    // A later manager with its token takes over, and the earlier one is heard no more.
    node_b.handle(token(8), Now(5));
    assert!(!node_b.controller().is_registered());
    node_b.handle(from_manager(7, registered()), Now(6));
    assert!(!node_b.controller().is_registered());
}

#[test]
fn a_damaged_image_number_makes_no_manager_deaf() {
    let mut manager = manager();
    let mut show = |boot: u64, number: u64, us: u64| {
        let mut image = seeds::input_image(number, true);
        image.boot = BootId(boot);
        manager.handle(Input::Image(Arc::new(image)), Now(us));
        history(&mut manager);
        manager.view().gateways[&gateway_id()].image.0
    };
    assert_eq!(show(9, 100, 0), 100);
    assert_eq!(show(9, u64::MAX, 5_000), 100);
    assert_eq!(show(9, 101, 5_000), 101);
    // After a long silence many are missing.
    assert_eq!(show(9, 2_101, 10_005_000), 2_101);
}

#[test]
fn a_flood_of_events_does_not_fill_the_history() {
    let mut manager = manager();
    let mut entries = 0;
    for n in 0..5_000u64 {
        let from = match n % 3 {
            0 => AgentId::Controller(owner(1).controller),
            1 => AgentId::Gateway(gateway_id()),
            _ => AgentId::Controller(ControllerId::new(&format!("nobody{n}")).unwrap()),
        };
        let text = "x".repeat(10_000);
        let mut event = Event::new(Severity::Alarm, EventKind::McFailSafe, text);
        if n % 2 == 0 {
            event = event.mc(&McId::new(&format!("Made{n}")).unwrap());
        }
        let body = Message::Event(event);
        let (boot, to) = (BootId(n), AgentId::Manager);
        manager.handle(
            Input::Message(Envelope {
                from,
                boot,
                to,
                body,
            }),
            Now(n),
        );
        entries += history(&mut manager);
    }
    assert!((100..=400).contains(&entries), "{entries}");
    assert!(format!("{manager:?}").len() < 1_500_000);
}

#[test]
fn made_up_names_commands_and_reports_leave_no_trace_that_grows() {
    let mut manager = manager();
    let mut entries = 0;
    let envelopes = seeds::envelopes();
    let find =
        |kind: fn(&Message) -> bool| envelopes.iter().find(|e| kind(&e.body)).cloned().unwrap();
    let register = find(|m| matches!(m, Message::Register(_)));
    let report =
        find(|m| matches!(m, Message::McReport(r) if matches!(r.outcome, McOutcome::NotOpened(_))));
    let mut size = 0;
    for n in 0..6_000u64 {
        let mut strange = register.clone();
        let name = ControllerId::new(&format!("nobody{n}")).unwrap();
        strange.from = AgentId::Controller(name.clone());
        if let Message::Register(registration) = &mut strange.body {
            registration.owner.controller = name;
        }
        let mut told = report.clone();
        if let Message::McReport(report) = &mut told.body {
            report.outcome = McOutcome::Deposed("y".repeat(50));
            report.owner.boot = BootId(n);
            told.boot = BootId(n);
        }
        let command = Envelope {
            from: AgentId::Client(n),
            boot: BootId(n),
            to: AgentId::Manager,
            body: Message::Command(Command {
                id: n,
                what: CommandKind::Unpin(McId::new(&format!("Made{n}")).unwrap()),
            }),
        };
        for envelope in [strange, told, command] {
            manager.handle(Input::Message(envelope), Now(n));
            entries += history(&mut manager);
        }
        let process = ProcessId::Node(owner(1).controller);
        let (boot, alive) = (BootId(n), true);
        manager.handle(
            Input::Peer {
                process,
                boot,
                alive,
            },
            Now(n),
        );
        history(&mut manager);
        if n == 3_000 {
            size = format!("{manager:?}").len();
        }
    }
    assert!(entries < 1_000, "{entries}");
    let grown = format!("{manager:?}").len();
    assert!(grown < size + size / 5, "{size} grew to {grown}");
}

#[test]
fn an_oversized_registration_is_not_kept() {
    let mut manager = manager();
    let mut register = seeds::envelopes()
        .into_iter()
        .find(|e| matches!(e.body, Message::Register(_)))
        .unwrap();
    if let Message::Register(registration) = &mut register.body {
        registration.description = "x".repeat(100_000);
    }
    manager.handle(Input::Message(register), Now(0));
    history(&mut manager);
    assert!(!manager.view().controllers[&owner(2).controller].is_up());
}

#[test]
fn made_up_tokens_and_images_fill_neither_gateway_nor_node() {
    let mut gateway =
        Gateway::new(&cell(), &gateway_id(), BootId(9), 1, Vec::new(), Now(0)).unwrap();
    let mut node = node();
    let sizes = |gateway: &Gateway, node: &NodeAgents| {
        (format!("{gateway:?}").len(), format!("{node:?}").len())
    };
    let (mut gateway_size, mut node_size) = (0, 0);
    for n in 0..4_000u64 {
        let name = match n % 2 {
            0 => owner(1).controller,
            _ => ControllerId::new(&format!("nobody{n}")).unwrap(),
        };
        let (process, boot, alive) = (ProcessId::Node(name), BootId(n), true);
        gateway.handle(
            Input::Peer {
                process,
                boot,
                alive,
            },
            Now(n),
        );
        while gateway.poll_output().is_some() {}
        let mut image = seeds::input_image(n, true);
        image.gateway = GatewayId::new(&format!("nobody{n}")).unwrap();
        node.handle(Input::Image(Arc::new(image)), Now(n));
        while node.poll_output().is_some() {}
        if n == 100 {
            (gateway_size, node_size) = sizes(&gateway, &node);
        }
    }
    let (gateway_grown, node_grown) = sizes(&gateway, &node);
    assert!(
        gateway_grown < gateway_size + 500,
        "{gateway_size} grew to {gateway_grown}"
    );
    assert!(
        node_grown < node_size + 500,
        "{node_size} grew to {node_grown}"
    );
}
