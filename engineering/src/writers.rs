//! Each point of the field has one writer, whichever gateways lead to it; and points that look like one are named.

use crate::io::{Image, key, registers};
use crate::model::{Cell, InputFrom, points};
use crate::problem::Explain;
use fam_proto::GatewayId;
use fam_proto::model::{FieldDriver, FieldPoint, ModbusTable, Place};
use fam_soft_plc::diag::Diagnostic;
use std::collections::{BTreeMap, BTreeSet};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Each field point has one writer: reports two, with both named.
pub fn two_writers(cell: &Cell, images: &[Option<Image>], problems: &mut Vec<Diagnostic>) {
    // One entry for each bit or register that is written. Two gateways may lead to one device.
    let mut writers: BTreeMap<(String, FieldPoint), String> = BTreeMap::new();
    for (mc, image) in cell.mcs.iter().zip(images) {
        let Some(gateway) = &mc.gateway else { continue };
        let device = device(cell, gateway);
        for output in &mc.outputs {
            let Some(field) = &output.field else { continue };
            let place = image.as_ref().and_then(|i| {
                let found = i
                    .outputs
                    .iter()
                    .find(|(l, ..)| key(&l.name) == key(output.name.get_ref()));
                found.map(|(l, ..)| l.place)
            });
            let own = format!("output {} of MC {}", output.name.get_ref(), mc.mc);
            let mut first: Option<String> = None;
            for point in written(field.get_ref(), place) {
                let other = writers
                    .entry((device.clone(), point))
                    .or_insert_with(|| own.clone());
                if *other != own {
                    first.get_or_insert_with(|| other.clone());
                }
            }
            if let Some(other) = first {
                let message = format!(
                    "`{}` has two writers: {other} and {own}",
                    points::point_text(field.get_ref())
                );
                problems.push(
                    cell.text
                        .error("M317", field.span(), message)
                        .expected("one writer for each output of the field")
                        .hint("let one MC write it, and export to it what the other one wants"),
                );
            }
        }
    }
}

/// Warns of points of one gateway whose names differ in case only: to the gateway they are two.
pub fn names_alike(cell: &Cell, problems: &mut Vec<Diagnostic>) {
    let mut seen: BTreeMap<(&GatewayId, String), &str> = BTreeMap::new();
    let mut told = BTreeSet::new();
    for mc in &cell.mcs {
        let Some(gateway) = &mc.gateway else { continue };
        let inputs = mc.inputs.iter().filter_map(|input| match &input.from {
            Some(InputFrom::Field(point)) => Some((point, input.at.clone())),
            _ => None,
        });
        let outputs = mc.outputs.iter().filter_map(|output| {
            let field = output.field.as_ref()?;
            Some((field.get_ref(), field.span()))
        });
        for (point, at) in inputs.chain(outputs) {
            let FieldPoint::Image(name) = point else {
                continue;
            };
            let other = *seen.entry((gateway, name.to_lowercase())).or_insert(name);
            if other != name && told.insert((gateway, name)) {
                let message = format!("`image:{other}` and `image:{name}` are two points");
                let problem = cell.text.warning("W817", at, message);
                problems.push(problem.hint(
                    "the case of a point's name counts; if they are one, write both the same way",
                ));
            }
        }
    }
}

/// What a gateway drives: the device at its address, or what only this gateway has.
fn device(cell: &Cell, gateway: &GatewayId) -> String {
    let found = cell.gateways.iter().find(|g| g.gateway == *gateway);
    match found.map(|g| &g.driver) {
        Some(FieldDriver::Modbus { address }) => format!("at {}", one_spelling(address)),
        _ => format!("of {gateway}"),
    }
}

/// An address as all its spellings have it: `localhost:502`, `LOCALHOST:0502` and `127.0.0.1:502` are one.
fn one_spelling(address: &str) -> String {
    let (host, port) = address.rsplit_once(':').unwrap_or((address, ""));
    let host = host.trim().trim_end_matches('.').to_ascii_lowercase();
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let host = match bare.parse::<IpAddr>() {
        Ok(ip) if ip == Ipv6Addr::LOCALHOST => Ipv4Addr::LOCALHOST.to_string(),
        Ok(ip) => ip.to_canonical().to_string(),
        Err(_) if bare == "localhost" => Ipv4Addr::LOCALHOST.to_string(),
        Err(_) => bare.to_owned(),
    };
    let port = port.trim().trim_start_matches('0');
    format!("{host}:{port}")
}

/// All points that a write to `point` reaches.
fn written(point: &FieldPoint, place: Option<Place>) -> Vec<FieldPoint> {
    match point {
        FieldPoint::Modbus {
            unit,
            table: ModbusTable::HoldingRegister,
            address,
        } => (0..place.map_or(1, registers))
            .filter_map(|n| {
                Some(FieldPoint::Modbus {
                    unit: *unit,
                    table: ModbusTable::HoldingRegister,
                    address: u16::try_from(u32::from(*address) + n).ok()?,
                })
            })
            .collect(),
        other => vec![other.clone()],
    }
}
