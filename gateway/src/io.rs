//! Inputs and outputs for people: what each MC reads and sets, and the points of the image driver, as JSON over the link
//! and as CSV in files.

use crate::field::image::Points;
use fam_driver::{Link, LinkError, RequestError, Server};
use fam_gateway_core::place;
use fam_gateway_core::stored::StoredHead;
use fam_proto::model::{CellModel, FieldPoint, InputSource, McModel, ModbusTable, Number};
use fam_proto::{CellId, GatewayId, Head, InputImage, McId, Record, Watched, codec, keys};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most values that one request sets.
pub const SET_VALUES_MAX: usize = 10_000;

/// What can be asked of a gateway.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum IoRequest {
    /// All points whose name is one of these, or begins with one of these and a dot; all points if none is given.
    Get(Vec<String>),
    /// Sets points of the image driver: name to value as text (`TRUE`, `-5`, `16#FF`, `2.5`).
    Set(BTreeMap<String, String>),
}

/// Which way a value goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Into an MC.
    Input,
    /// Out of an MC.
    Output,
    /// A point of the image driver that can be set.
    Point,
}

/// One value.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IoPoint {
    /// `<MC>.<variable>`, or the name of a point of the image driver.
    pub name: String,
    /// Which way.
    pub direction: Direction,
    /// Width in bits.
    pub bits: u32,
    /// Its value: the bits, zero-extended.
    pub value: u64,
    /// How the bits are read.
    #[serde(default)]
    pub number: Number,
    /// Whether it was read in the newest cycle.
    pub fresh: bool,
    /// Where it comes from or goes to: `modbus:1/coil/0`, `image:X`, `mc:Transport.Y`; empty for a point itself.
    pub place: String,
}

/// What stands at the gateway now.
#[derive(Debug, Default)]
struct Now {
    image: Option<Arc<InputImage>>,
    outputs: BTreeMap<McId, Arc<[u8]>>,
    heads: BTreeMap<McId, StoredHead>,
}

/// The values of a gateway, kept up to date by its process.
#[derive(Debug)]
pub struct IoView {
    mcs: Vec<McModel>,
    points: Option<Arc<Points>>,
    now: Mutex<Now>,
}

impl IoView {
    /// A view of a gateway's MCs, and of its points if it has the image driver.
    #[must_use]
    pub fn new(cell: &CellModel, gateway: &GatewayId, points: Option<Arc<Points>>) -> IoView {
        let mcs = cell.mcs.iter().filter(|mc| &mc.gateway == gateway);
        IoView {
            mcs: mcs.cloned().collect(),
            points,
            now: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Now> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the newest image.
    pub fn image(&self, image: Arc<InputImage>) {
        self.lock().image = Some(image);
    }

    /// Takes an MC's newest outputs.
    pub fn outputs(&self, mc: McId, outputs: Arc<[u8]>) {
        self.lock().outputs.insert(mc, outputs);
    }

    /// Takes an MC's newest head.
    pub fn head(&self, mc: McId, head: StoredHead) {
        self.lock().heads.insert(mc, head);
    }

    /// Shows MCs to whoever watches them, for as long as the server is kept.
    ///
    /// # Errors
    /// If the link is closed.
    pub fn serve_watched(
        self: &Arc<Self>,
        link: &Link,
        gateway: &GatewayId,
    ) -> Result<Server, LinkError> {
        let view = Arc::clone(self);
        link.serve(&keys::watch(link.cell(), gateway), move |bytes| {
            let mc = std::str::from_utf8(bytes).ok();
            let mc = mc.and_then(|name| McId::new(name).ok());
            let mc = mc.ok_or("expected the name of an MC")?;
            codec::encode(&view.watched(&mc)?).map_err(|error| error.to_string())
        })
    }

    /// An MC as it stands here.
    ///
    /// # Errors
    /// Words for the asker: no such MC, or nothing is known of it yet.
    pub fn watched(&self, mc: &McId) -> Result<Watched, String> {
        let now = self.lock();
        if !self.mcs.iter().any(|model| &model.mc == mc) {
            let names: Vec<&str> = self.mcs.iter().map(|model| model.mc.as_str()).collect();
            return Err(format!(
                "this gateway does not serve {mc}; it has {}",
                names.join(", ")
            ));
        }
        let image = now.image.as_ref().ok_or("no image has been sent yet")?;
        let record = image.record_of(mc).ok_or("it has no record yet")?;
        let head = now.heads.get(mc).filter(|_| record.head.is_some());
        Ok(Watched {
            record: Record {
                mc: mc.clone(),
                epoch: record.epoch,
                owner: record.owner.clone(),
                state: record.state.clone(),
                head: head.map(|head| Head {
                    checkpoint: head.checkpoint(),
                    outputs: head.outputs.to_vec(),
                }),
            },
            inputs: image.inputs_of(mc).map_or(Vec::new(), |i| i.bytes.clone()),
            at_us: image.sent_at_us,
        })
    }

    /// Answers requests under the gateway's key for as long as the server is kept.
    ///
    /// # Errors
    /// If the link is closed.
    pub fn serve(self: &Arc<Self>, link: &Link, gateway: &GatewayId) -> Result<Server, LinkError> {
        let view = Arc::clone(self);
        link.serve(&keys::io(link.cell(), gateway), move |bytes| {
            let request = serde_json::from_slice(bytes).map_err(|error| {
                format!("this gateway does not understand the request: {error}")
            })?;
            let points = view.answer(&request)?;
            serde_json::to_vec(&points).map_err(|error| error.to_string())
        })
    }

    /// Answers a request: the points asked for, or those that were set.
    ///
    /// # Errors
    /// Words for the asker.
    pub fn answer(&self, request: &IoRequest) -> Result<Vec<IoPoint>, String> {
        match request {
            IoRequest::Get(names) => {
                let points = self.all();
                if let Some(unknown) = names
                    .iter()
                    .find(|name| !points.iter().any(|point| is_asked(point, name)))
                {
                    return Err(format!(
                        "there is no MC, variable or point `{unknown}`; `fam io get` lists all"
                    ));
                }
                let asked =
                    |point: &IoPoint| names.is_empty() || names.iter().any(|n| is_asked(point, n));
                Ok(points.into_iter().filter(asked).collect())
            }
            IoRequest::Set(values) => self.set(values),
        }
    }

    fn set(&self, values: &BTreeMap<String, String>) -> Result<Vec<IoPoint>, String> {
        let Some(points) = &self.points else {
            return Err(
                "this gateway reads a field device; only points of the `image` driver can be set"
                    .to_owned(),
            );
        };
        if values.len() > SET_VALUES_MAX {
            return Err(format!("at most {SET_VALUES_MAX} values at once"));
        }
        let known = points.all();
        let mut parsed = Vec::new();
        for (name, text) in values {
            let (bits, number) = known
                .get(name)
                .map_or((64, Number::Unsigned), |point| (point.bits, point.number));
            let value =
                parse_value(text, bits, number).map_err(|why| format!("`{name}`: {why}"))?;
            parsed.push((name.clone(), value));
        }
        points.set(&parsed).map_err(|error| error.to_string())?;
        let names: Vec<String> = values.keys().cloned().collect();
        self.answer(&IoRequest::Get(names))
    }

    fn all(&self) -> Vec<IoPoint> {
        let mut all: Vec<IoPoint> = Vec::new();
        for (name, point) in self.points.iter().flat_map(|points| points.all()) {
            if !point.driven {
                all.push(IoPoint {
                    name,
                    direction: Direction::Point,
                    bits: point.bits,
                    value: point.value,
                    number: point.number,
                    fresh: true,
                    place: String::new(),
                });
            }
        }
        let now = self.lock();
        for mc in &self.mcs {
            let inputs = now.image.as_ref().and_then(|image| image.inputs_of(&mc.mc));
            for input in &mc.inputs {
                all.push(IoPoint {
                    name: format!("{}.{}", mc.mc, input.name),
                    direction: Direction::Input,
                    bits: place::width_bits(input.place),
                    number: input.number,
                    value: inputs
                        .and_then(|inputs| place::get(&inputs.bytes, input.place))
                        .unwrap_or(0),
                    fresh: inputs.is_some_and(|inputs| inputs.fresh),
                    place: match &input.source {
                        InputSource::Field(point) => point_text(point),
                        InputSource::Export { mc, .. } => format!("mc:{mc}"),
                    },
                });
            }
            let outputs = now.outputs.get(&mc.mc);
            for output in &mc.outputs {
                all.push(IoPoint {
                    name: format!("{}.{}", mc.mc, output.name),
                    direction: Direction::Output,
                    bits: place::width_bits(output.place),
                    number: output.number,
                    value: place::get(
                        outputs.map_or(&mc.fail_safe[..], |outputs| outputs),
                        output.place,
                    )
                    .unwrap_or(0),
                    fresh: true,
                    place: output
                        .field
                        .as_ref()
                        .map_or_else(|| "export".to_owned(), point_text),
                });
            }
        }
        all
    }
}

fn is_asked(point: &IoPoint, name: &str) -> bool {
    point.name == name
        || (point.direction == Direction::Output
            && point.place.strip_prefix("image:") == Some(name))
        || point
            .name
            .strip_prefix(name)
            .is_some_and(|rest| rest.starts_with('.'))
}

fn point_text(point: &FieldPoint) -> String {
    match point {
        FieldPoint::Image(name) => format!("image:{name}"),
        FieldPoint::Modbus {
            unit,
            table,
            address,
        } => {
            let table = match table {
                ModbusTable::DiscreteInput => "discrete",
                ModbusTable::Coil => "coil",
                ModbusTable::InputRegister => "input",
                ModbusTable::HoldingRegister => "holding",
            };
            format!("modbus:{unit}/{table}/{address}")
        }
    }
}

/// Reads a value as an engineer writes it: `TRUE`, `FALSE`, decimal with sign, `16#FF`, `8#17`, `2#1010`, `0xFF`. A point
/// that holds a real number takes decimals with or without point and exponent; only a value with a base gives its bits.
///
/// # Errors
/// What was expected, if it does not fit `bits`.
pub fn parse_value(text: &str, bits: u32, number: Number) -> Result<u64, String> {
    let plain = text.trim().replace('_', "");
    let lower = plain.to_ascii_lowercase();
    let max = if bits >= 64 {
        u64::MAX
    } else {
        (1 << bits) - 1
    };
    let expected = || {
        let kind = match (bits, number) {
            (1, _) => "TRUE, FALSE, 0 or 1".to_owned(),
            (_, Number::Real) => "a real number (`2.5`, `-3`, `1e3`)".to_owned(),
            _ => format!("a number of {bits} bits (`12`, `-3` or `16#FF`)"),
        };
        format!("`{text}` does not fit: expected {kind}")
    };
    let radix = [("16#", 16), ("0x", 16), ("8#", 8), ("2#", 2)]
        .into_iter()
        .find_map(|(prefix, radix)| Some((lower.strip_prefix(prefix)?, radix)));
    let value = if let Some((digits, radix)) = radix {
        u64::from_str_radix(digits, radix).ok()
    } else if number == Number::Real {
        match bits {
            32 => plain.parse::<f32>().ok().map(|v| u64::from(v.to_bits())),
            _ => plain.parse::<f64>().ok().map(f64::to_bits),
        }
    } else if lower == "true" {
        Some(1)
    } else if lower == "false" {
        Some(0)
    } else if let Ok(value) = plain.parse::<u64>() {
        // Positive numbers up to the width are taken for signed points too: some devices count past the sign.
        Some(value)
    } else if let Ok(value) = plain.parse::<i64>() {
        // A negative number has to fit as a signed one of this width.
        let fits = bits > 1 && (bits >= 64 || value >= -(1 << (bits - 1)));
        fits.then_some(value.cast_unsigned() & max)
    } else {
        None
    };
    value.filter(|value| *value <= max).ok_or_else(expected)
}

/// The value as [`parse_value`] reads it.
fn value_text(point: &IoPoint) -> String {
    match (point.number, point.bits) {
        (Number::Real, 32) => f32::from_bits(point.value as u32).to_string(),
        (Number::Real, _) => f64::from_bits(point.value).to_string(),
        (Number::Signed, 1..=63) => {
            let unused = 64 - point.bits;
            ((point.value << unused).cast_signed() >> unused).to_string()
        }
        (Number::Signed, _) => point.value.cast_signed().to_string(),
        (Number::Unsigned, _) => point.value.to_string(),
    }
}

/// Points as CSV: `name,direction,bits,value,fresh,place`.
#[must_use]
pub fn to_csv(points: &[IoPoint]) -> String {
    let mut csv = "name,direction,bits,value,fresh,place\n".to_owned();
    for point in points {
        let direction = match point.direction {
            Direction::Input => "input",
            Direction::Output => "output",
            Direction::Point => "point",
        };
        csv.push_str(&format!(
            "{},{direction},{},{},{},{}\n",
            quote(&point.name),
            point.bits,
            value_text(point),
            point.fresh,
            quote(&point.place)
        ));
    }
    csv
}

fn quote(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// Values to set, from CSV with the columns `name` and `value` (others are ignored, so that what [`to_csv`] wrote can be edited and
/// given back: rows whose `direction` is not `point` are left out). Empty lines and lines that begin with `#` do not count.
///
/// # Errors
/// The line, and what was expected.
pub fn from_csv(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(n, line)| (n + 1, line.trim_end_matches('\r')))
        .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    let Some((_, head)) = lines.next() else {
        return Err("the file is empty: expected a first line `name,value`".to_owned());
    };
    let columns = split(head);
    let column = |name: &str| columns.iter().position(|column| column.trim() == name);
    let (Some(name_at), Some(value_at)) = (column("name"), column("value")) else {
        return Err(format!(
            "line 1: expected the columns `name` and `value`, found `{head}`"
        ));
    };
    let direction_at = column("direction");
    let mut values = BTreeMap::new();
    for (n, line) in lines {
        let cells = split(line);
        let (Some(name), Some(value)) = (cells.get(name_at), cells.get(value_at)) else {
            return Err(format!(
                "line {n}: expected {} columns, found {}",
                columns.len(),
                cells.len()
            ));
        };
        if direction_at.is_some_and(|at| cells.get(at).is_some_and(|cell| cell != "point")) {
            continue;
        }
        if values
            .insert(name.trim().to_owned(), value.trim().to_owned())
            .is_some()
        {
            return Err(format!("line {n}: `{}` stands there twice", name.trim()));
        }
    }
    Ok(values)
}

/// Splits one line of CSV; quoted cells may hold commas and doubled quotes.
fn split(line: &str) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut quoted = false;
    let mut characters = line.chars().peekable();
    while let Some(character) = characters.next() {
        match character {
            '"' if quoted && characters.peek() == Some(&'"') => {
                characters.next();
                push(&mut cells, '"');
            }
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            other => push(&mut cells, other),
        }
    }
    cells
}

fn push(cells: &mut [String], character: char) {
    if let Some(cell) = cells.last_mut() {
        cell.push(character);
    }
}

/// Asks a gateway.
///
/// # Errors
/// [`RequestError`]: nobody answers, or the gateway's words.
pub async fn request(
    link: &Link,
    cell: &CellId,
    gateway: &GatewayId,
    request: &IoRequest,
    within: Duration,
) -> Result<Vec<IoPoint>, RequestError> {
    let refused = |error: serde_json::Error| RequestError::Refused(error.to_string());
    let bytes = serde_json::to_vec(request).map_err(refused)?;
    let answer = link
        .request(&keys::io(cell, gateway), bytes, within)
        .await?;
    serde_json::from_slice(&answer).map_err(refused)
}

#[cfg(test)]
mod tests;
