//! The plant process seen by its clients: Modbus TCP and the status port.

use std::net::{Ipv4Addr, SocketAddr};

use fam_plant::{
    IMAGE_INPUT_WORDS, IMAGE_INPUTS, IMAGE_OUTPUT_WORDS, IMAGE_OUTPUTS, IncidentKind, PlantConfig,
    PlantOptions, PlantServer, StatusClient, run,
};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_modbus::prelude::*;

fn options() -> PlantOptions {
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    PlantOptions {
        modbus: any,
        status: any,
        config: PlantConfig {
            seed: 4,
            ..PlantConfig::default()
        },
        time_scale: 20.0,
    }
}

struct Running {
    modbus: SocketAddr,
    client: StatusClient,
    status: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<anyhow::Result<()>>,
}

async fn start() -> Running {
    let server = PlantServer::bind(options()).await.expect("free ports");
    let modbus = server.modbus_address().expect("address");
    let status = server.status_address().expect("address");
    let (stop, stopped) = oneshot::channel::<()>();
    let task = tokio::spawn(server.serve(async move {
        let _ = stopped.await;
    }));
    Running {
        modbus,
        client: StatusClient::new(status),
        status,
        stop,
        task,
    }
}

impl Running {
    async fn unit(&self, unit: u8) -> client::Context {
        tcp::connect_slave(self.modbus, Slave(unit))
            .await
            .expect("connected")
    }

    async fn end(self) {
        self.stop.send(()).expect("still running");
        self.task.await.expect("no panic").expect("a clean end");
    }
}

/// Waits for a discrete input by reading it.
async fn until(context: &mut client::Context, address: u16) {
    for _ in 0..20_000 {
        if context
            .read_discrete_inputs(address, 1)
            .await
            .expect("link")
            .expect("answer")
            == [true]
        {
            return;
        }
    }
    panic!("discrete input {address} has not come on");
}

#[tokio::test]
async fn a_controller_drives_a_station_over_modbus() {
    let plant = start().await;
    let mut station = plant.unit(1).await;
    until(&mut station, 0).await; // S1_MagazinePart
    station
        .write_single_coil(0, true)
        .await
        .expect("link")
        .expect("written"); // S1_PusherExtend
    until(&mut station, 2).await; // S1_PusherExtended
    until(&mut station, 3).await; // S1_CheckPart
    station
        .write_multiple_coils(0, &[false, true])
        .await
        .expect("link")
        .expect("written"); // pusher back, S1_GaugeLower
    until(&mut station, 5).await; // S1_GaugeContact
    let depth = station
        .read_input_registers(0, 1)
        .await
        .expect("link")
        .expect("answer")[0];
    assert!([3000, 1800].contains(&depth), "depth {depth}");
    assert_eq!(
        station
            .read_coils(0, 2)
            .await
            .expect("link")
            .expect("answer"),
        [false, true]
    );
    let status = plant.client.status().await.expect("status");
    assert_eq!(status.incidents_total, 0);
    assert!(
        status.ledger.balanced() && status.ledger.fed >= 9,
        "{}",
        status.ledger
    );
    plant.end().await;
}

#[tokio::test]
async fn one_request_moves_the_whole_image_of_a_station() {
    let plant = start().await;
    let mut transport = plant.unit(5).await;
    let outputs = [0_u16, 1, 41, 0, 0, 0]; // T_BeltRun is coil 16; T_OrderTaken is the first holding register
    let inputs = transport
        .read_write_multiple_registers(IMAGE_INPUTS, IMAGE_INPUT_WORDS, IMAGE_OUTPUTS, &outputs)
        .await
        .expect("link")
        .expect("answer");
    assert_eq!(inputs.len(), 11);
    assert_eq!(
        inputs[3 + 4],
        42,
        "T_OrderNumber follows T_OrderTaken at once"
    );
    assert_eq!(
        transport
            .read_coils(16, 1)
            .await
            .expect("link")
            .expect("answer"),
        [true]
    );
    assert_eq!(
        transport
            .read_holding_registers(0, 1)
            .await
            .expect("link")
            .expect("answer"),
        [41]
    );
    assert_eq!(
        transport
            .read_holding_registers(IMAGE_OUTPUTS, IMAGE_OUTPUT_WORDS)
            .await
            .expect("link")
            .expect("answer"),
        outputs
    );
    until(&mut transport, 32).await; // T_BeltRunning
    let packed = transport
        .read_input_registers(IMAGE_INPUTS, 3)
        .await
        .expect("link")
        .expect("answer");
    let bits = transport
        .read_discrete_inputs(0, 48)
        .await
        .expect("link")
        .expect("answer");
    assert_eq!(packed[2] & 1 == 1, bits[32]);
    plant.end().await;
}

#[tokio::test]
async fn what_the_cell_has_not_is_answered_by_an_exception() {
    let plant = start().await;
    let mut station = plant.unit(1).await;
    let beyond = Err(ExceptionCode::IllegalDataAddress);
    assert_eq!(
        station.read_discrete_inputs(40, 9).await.expect("link"),
        beyond
    );
    assert_eq!(
        station
            .read_input_registers(8, 1)
            .await
            .expect("link")
            .map(|_| ()),
        Err(ExceptionCode::IllegalDataAddress)
    );
    assert_eq!(
        station
            .read_holding_registers(IMAGE_INPUTS, 12)
            .await
            .expect("link")
            .map(|_| ()),
        Err(ExceptionCode::IllegalDataAddress)
    );
    assert_eq!(
        station
            .write_multiple_coils(31, &[true, true])
            .await
            .expect("link"),
        Err(ExceptionCode::IllegalDataAddress)
    );
    assert_eq!(
        station
            .write_multiple_registers(IMAGE_OUTPUTS + 5, &[1, 2])
            .await
            .expect("link"),
        Err(ExceptionCode::IllegalDataAddress)
    );
    assert_eq!(
        station.masked_write_register(0, 0, 0).await.expect("link"),
        Err(ExceptionCode::IllegalFunction)
    );
    let mut nobody = plant.unit(6).await;
    assert_eq!(
        nobody.read_coils(0, 1).await.expect("link"),
        Err(ExceptionCode::GatewayTargetDevice)
    );
    plant.end().await;
}

#[tokio::test]
async fn incidents_are_told_with_time_place_and_cause() {
    let plant = start().await;
    let mut station = plant.unit(3).await;
    station
        .write_multiple_coils(3, &[true, true])
        .await
        .expect("link")
        .expect("written"); // both coils of the arm
    until(&mut station, 13).await; // any sensor: the outputs have had a tick
    let incidents = loop {
        let incidents = plant.client.incidents().await.expect("incidents");
        if !incidents.is_empty() {
            break incidents;
        }
    };
    assert_eq!(
        (incidents[0].unit, incidents[0].kind),
        (3, IncidentKind::DrivenAgainstStop)
    );
    let summary = plant.client.summary().await.expect("summary");
    assert_eq!((summary.incidents_total, summary.incidents.len()), (1, 0));
    assert!(plant.client.products().await.expect("products").is_empty());
    plant.end().await;
}

#[tokio::test]
async fn an_unknown_request_on_the_status_port_is_answered_with_what_is_expected() {
    use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
    let plant = start().await;
    let mut stream = BufReader::new(
        tokio::net::TcpStream::connect(plant.status)
            .await
            .expect("connected"),
    );
    for (request, expected) in [
        ("hello\n", "{\"error\":\"unknown request \\\"hello\\\""),
        ("summary\n", "{\"time_us\":"),
    ] {
        stream.write_all(request.as_bytes()).await.expect("sent");
        let mut line = String::new();
        stream.read_line(&mut line).await.expect("answered");
        assert!(line.starts_with(expected), "{line}");
    }
    plant.end().await;
}

#[tokio::test]
async fn a_port_in_use_is_named_with_what_to_do() {
    let taken = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
        .await
        .expect("a free port");
    let address = taken.local_addr().expect("address");
    let error = run(
        PlantOptions {
            modbus: address,
            ..options()
        },
        std::future::pending(),
    )
    .await
    .expect_err("in use");
    assert_eq!(
        error.to_string(),
        format!(
            "cannot listen for Modbus TCP on {address}: port {} is in use. Is another plant running? Stop it, or give another address with --modbus",
            address.port()
        )
    );
    let error = run(
        PlantOptions {
            status: address,
            ..options()
        },
        std::future::pending(),
    )
    .await
    .expect_err("in use");
    assert!(
        error
            .to_string()
            .ends_with("give another address with --status"),
        "{error}"
    );
}

#[tokio::test]
async fn options_that_cannot_be_are_refused() {
    let error = run(
        PlantOptions {
            time_scale: 0.0,
            ..options()
        },
        std::future::pending(),
    )
    .await
    .expect_err("refused");
    assert_eq!(
        error.to_string(),
        "the plant's time scale is 0, expected above 0 and at most 1000 (1 is real time)"
    );
    let config = PlantConfig {
        pallets: 12,
        ..PlantConfig::default()
    };
    let error = run(
        PlantOptions {
            config,
            ..options()
        },
        std::future::pending(),
    )
    .await
    .expect_err("refused");
    assert_eq!(
        error.to_string(),
        "the plant has pallets = 12, but the loop takes 1 to 8"
    );
}

#[tokio::test]
async fn a_plant_that_is_not_there_is_named() {
    let nobody = {
        let listener = tokio::net::TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .await
            .expect("a free port");
        listener.local_addr().expect("address")
    };
    let error = StatusClient::new(nobody)
        .status()
        .await
        .expect_err("nobody there");
    assert_eq!(
        error.to_string(),
        format!("cannot ask the plant's status port at {nobody}: is `fam plant` running there?")
    );
}
