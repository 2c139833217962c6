//! Modbus requests to the cell: the tables of each unit, and its whole image as registers.

use std::future::{Ready, ready};
use std::sync::Arc;

use fam_plant_core::{
    AddressError, COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS, Mechanics, UnitImage,
};
use tokio_modbus::server::Service;
use tokio_modbus::{ExceptionCode, Request, Response, SlaveRequest};

use crate::cell::Cell;

/// First register of the input image of a unit: its discrete inputs packed into words, then its input registers.
pub const IMAGE_INPUTS: u16 = 0x1000;
/// Registers of the input image.
pub const IMAGE_INPUT_WORDS: u16 = DISCRETE_INPUTS / 16 + INPUT_REGISTERS;
/// First register of the output image of a unit: its coils packed into words, then its holding registers.
pub const IMAGE_OUTPUTS: u16 = 0x2000;
/// Registers of the output image.
pub const IMAGE_OUTPUT_WORDS: u16 = COIL_WORDS + HOLDING_REGISTERS;
const COIL_WORDS: u16 = COILS / 16;

/// Answers the requests of one connection.
#[derive(Clone)]
pub(crate) struct CellService {
    pub cell: Arc<Cell>,
}

impl Service for CellService {
    type Request = SlaveRequest<'static>;
    type Response = Response;
    type Exception = ExceptionCode;
    type Future = Ready<Result<Response, ExceptionCode>>;

    fn call(&self, request: Self::Request) -> Self::Future {
        ready(
            self.cell
                .request(|plant| answer(plant, request.slave, &request.request)),
        )
    }
}

fn answer(
    plant: &mut dyn Mechanics,
    unit: u8,
    request: &Request<'_>,
) -> Result<Response, ExceptionCode> {
    let image = plant.image(unit).map_err(exception)?;
    match request {
        Request::ReadDiscreteInputs(address, count) => {
            let range = range(*address, *count, DISCRETE_INPUTS)?;
            Ok(Response::ReadDiscreteInputs(
                range.map(|address| image.discrete_input(address)).collect(),
            ))
        }
        Request::ReadCoils(address, count) => {
            let range = range(*address, *count, COILS)?;
            Ok(Response::ReadCoils(
                range.map(|address| image.coil(address)).collect(),
            ))
        }
        Request::ReadInputRegisters(address, count) => {
            read_registers(image, *address, *count, &image.input_registers)
                .map(Response::ReadInputRegisters)
        }
        Request::ReadHoldingRegisters(address, count) => {
            read_registers(image, *address, *count, &image.holding_registers)
                .map(Response::ReadHoldingRegisters)
        }
        Request::WriteSingleCoil(address, on) => {
            plant.write_coil(unit, *address, *on).map_err(exception)?;
            Ok(Response::WriteSingleCoil(*address, *on))
        }
        Request::WriteMultipleCoils(address, values) => {
            plant
                .write_coils(unit, *address, values)
                .map_err(exception)?;
            Ok(Response::WriteMultipleCoils(*address, values.len() as u16))
        }
        Request::WriteSingleRegister(address, value) => {
            write_registers(plant, unit, *address, &[*value])?;
            Ok(Response::WriteSingleRegister(*address, *value))
        }
        Request::WriteMultipleRegisters(address, values) => {
            write_registers(plant, unit, *address, values)?;
            Ok(Response::WriteMultipleRegisters(
                *address,
                values.len() as u16,
            ))
        }
        // The standard has the write before the read (Modbus application protocol 1.1b3, 6.17).
        Request::ReadWriteMultipleRegisters(read_address, count, write_address, values) => {
            read_registers(image, *read_address, *count, &image.holding_registers)?;
            write_registers(plant, unit, *write_address, values)?;
            let image = plant.image(unit).map_err(exception)?;
            read_registers(image, *read_address, *count, &image.holding_registers)
                .map(Response::ReadWriteMultipleRegisters)
        }
        _ => Err(ExceptionCode::IllegalFunction),
    }
}

fn exception(error: AddressError) -> ExceptionCode {
    match error {
        AddressError::Unit { .. } | AddressError::OneUnit { .. } => {
            ExceptionCode::GatewayTargetDevice
        }
        AddressError::Address { .. } => ExceptionCode::IllegalDataAddress,
    }
}

fn range(address: u16, count: u16, size: u16) -> Result<std::ops::Range<u16>, ExceptionCode> {
    match address.checked_add(count) {
        _ if count == 0 => Err(ExceptionCode::IllegalDataValue),
        Some(end) if end <= size => Ok(address..end),
        _ => Err(ExceptionCode::IllegalDataAddress),
    }
}

/// Registers of the table itself at low addresses, of the packed images above.
fn read_registers(
    image: &UnitImage,
    address: u16,
    count: u16,
    table: &[u16],
) -> Result<Vec<u16>, ExceptionCode> {
    let words = |words: &[u16], first: u16| {
        let range = range(address - first, count, words.len() as u16)?;
        Ok(words[usize::from(range.start)..usize::from(range.end)].to_vec())
    };
    if address >= IMAGE_OUTPUTS {
        let mut output: Vec<u16> = (0..COIL_WORDS)
            .map(|word| (image.coils >> (16 * word)) as u16)
            .collect();
        output.extend(image.holding_registers);
        words(&output, IMAGE_OUTPUTS)
    } else if address >= IMAGE_INPUTS {
        let mut input: Vec<u16> = (0..DISCRETE_INPUTS / 16)
            .map(|word| (image.discrete_inputs >> (16 * word)) as u16)
            .collect();
        input.extend(image.input_registers);
        words(&input, IMAGE_INPUTS)
    } else {
        words(table, 0)
    }
}

fn write_registers(
    plant: &mut dyn Mechanics,
    unit: u8,
    address: u16,
    values: &[u16],
) -> Result<(), ExceptionCode> {
    let Some(first) = address.checked_sub(IMAGE_OUTPUTS) else {
        return plant
            .write_holding_registers(unit, address, values)
            .map_err(exception);
    };
    range(first, values.len() as u16, IMAGE_OUTPUT_WORDS)?;
    for (word, value) in (first..).zip(values) {
        let written = match word.checked_sub(COIL_WORDS) {
            None => {
                let bits: [bool; 16] = std::array::from_fn(|bit| value >> bit & 1 == 1);
                plant.write_coils(unit, word * 16, &bits)
            }
            Some(register) => plant.write_holding_register(unit, register, *value),
        };
        written.map_err(exception)?;
    }
    Ok(())
}
