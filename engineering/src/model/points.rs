//! Field points and sources as text: `modbus:1/coil/0`, `image:X`, `mc:Transport.T_AtStation1`.

use super::InputFrom;
use fam_proto::McId;
use fam_proto::model::{FieldPoint, ModbusTable};

const POINT_FORMS: &str =
    "`modbus:<unit>/<discrete|coil|input|holding>/<address>` or `image:<name>`";

/// Why a text is no point: what is wrong, and what was expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PointError {
    /// What is wrong.
    pub message: String,
    /// What was expected.
    pub expected: String,
}

fn error(message: impl Into<String>, expected: impl Into<String>) -> PointError {
    PointError {
        message: message.into(),
        expected: expected.into(),
    }
}

/// Reads a field point.
///
/// # Errors
/// [`PointError`] that says which part is wrong.
pub fn field_point(text: &str) -> Result<FieldPoint, PointError> {
    match text.split_once(':') {
        Some(("modbus", rest)) => modbus(text, rest),
        Some(("image", "")) => Err(error(
            format!("`{text}` names no point"),
            "a name after `image:`",
        )),
        Some(("image", name)) => Ok(FieldPoint::Image(name.to_owned())),
        _ => Err(error(format!("`{text}` is no field point"), POINT_FORMS)),
    }
}

fn modbus(text: &str, rest: &str) -> Result<FieldPoint, PointError> {
    let parts: Vec<&str> = rest.split('/').collect();
    let [unit, table, address] = parts.as_slice() else {
        return Err(error(
            format!("`{text}` does not have the three parts of a Modbus point"),
            "`modbus:<unit>/<table>/<address>`, such as `modbus:1/coil/0`",
        ));
    };
    let unit = unit.parse().map_err(|_| {
        error(
            format!("`{unit}` is no Modbus unit"),
            "a number from 0 to 255",
        )
    })?;
    let table = match *table {
        "discrete" => ModbusTable::DiscreteInput,
        "coil" => ModbusTable::Coil,
        "input" => ModbusTable::InputRegister,
        "holding" => ModbusTable::HoldingRegister,
        other => {
            return Err(error(
                format!("`{other}` is no Modbus table"),
                "discrete, coil, input or holding",
            ));
        }
    };
    let address = address.parse().map_err(|_| {
        error(
            format!("`{address}` is no Modbus address"),
            "a number from 0 to 65535",
        )
    })?;
    Ok(FieldPoint::Modbus {
        unit,
        table,
        address,
    })
}

/// Reads the source of an input.
///
/// # Errors
/// [`PointError`] that says which part is wrong.
pub fn input_source(text: &str) -> Result<InputFrom, PointError> {
    let Some(rest) = text.strip_prefix("mc:") else {
        return field_point(text).map(InputFrom::Field).map_err(|mut e| {
            if e.expected == POINT_FORMS {
                e.expected = format!("{POINT_FORMS}, or `mc:<MC>.<exported variable>`");
            }
            e
        });
    };
    let Some((mc, variable)) = rest.split_once('.').filter(|(_, v)| !v.is_empty()) else {
        return Err(error(
            format!("`{text}` does not name an exported variable"),
            "`mc:<MC>.<variable>`",
        ));
    };
    let mc = McId::new(mc).map_err(|e| error(e.to_string(), "the name of an MC"))?;
    Ok(InputFrom::Export {
        mc,
        variable: variable.to_owned(),
    })
}

/// A field point as it is written.
#[must_use]
pub fn point_text(point: &FieldPoint) -> String {
    match point {
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
        FieldPoint::Image(name) => format!("image:{name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_and_written_alike() {
        for text in [
            "modbus:1/coil/0",
            "modbus:255/discrete/65535",
            "modbus:0/input/7",
            "modbus:9/holding/40",
            "image:X",
            "image:a b:c",
        ] {
            assert_eq!(point_text(&field_point(text).unwrap()), text);
        }
        assert_eq!(
            input_source("mc:A.b.c"),
            Ok(InputFrom::Export {
                mc: McId::new("A").unwrap(),
                variable: "b.c".into()
            })
        );
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, message) in [
            ("coil/0", "`coil/0` is no field point"),
            ("image:", "`image:` names no point"),
            (
                "modbus:1/coil",
                "`modbus:1/coil` does not have the three parts of a Modbus point",
            ),
            ("modbus:256/coil/0", "`256` is no Modbus unit"),
            ("modbus:1/coils/0", "`coils` is no Modbus table"),
            ("modbus:1/coil/-1", "`-1` is no Modbus address"),
            (
                "mc:Transport",
                "`mc:Transport` does not name an exported variable",
            ),
            ("mc:.x", "`` is not a valid name"),
        ] {
            let e = input_source(text).unwrap_err();
            assert!(e.message.starts_with(message), "{text}: {}", e.message);
            assert!(!e.expected.is_empty());
        }
        assert!(
            input_source("x")
                .unwrap_err()
                .expected
                .contains("`mc:<MC>.<exported variable>`")
        );
    }
}
