//! Values of CAEX attributes as the model's tables want them: numbers in their unit, yes and no, values of variables.

use super::document::{Attribute, Text};
use super::library::{Caex, Part};
use crate::problem::Explain;
use fam_soft_plc::diag::Diagnostic;
use toml::Spanned;

/// Reads attributes of parts, and collects what is wrong with them.
pub struct Values<'a> {
    /// The model.
    pub caex: &'a Caex,
    /// What is wrong.
    pub problems: Vec<Diagnostic>,
}

/// A quantity: the unit that the tables use, and what others are worth in it.
#[derive(Debug, Clone, Copy)]
pub struct Quantity {
    units: &'static [(&'static str, f64)],
}

/// Times of the tables in milliseconds.
pub const MILLISECONDS: Quantity = Quantity {
    units: &[
        ("ms", 1.0),
        ("s", 1000.0),
        ("us", 0.001),
        ("µs", 0.001),
        ("min", 60_000.0),
    ],
};
/// Scan times in microseconds.
pub const MICROSECONDS: Quantity = Quantity {
    units: &[("us", 1.0), ("µs", 1.0), ("ms", 1000.0), ("s", 1_000_000.0)],
};
/// Shares in percent.
pub const PERCENT: Quantity = Quantity {
    units: &[("%", 1.0), ("percent", 1.0), ("permille", 0.1)],
};
/// Memory in megabytes.
pub const MEGABYTES: Quantity = Quantity {
    units: &[
        ("MB", 1.0),
        ("MiB", 1.0),
        ("kB", 1.0 / 1024.0),
        ("GB", 1024.0),
        ("GiB", 1024.0),
    ],
};
/// Throughput in megabits per second.
pub const MEGABITS: Quantity = Quantity {
    units: &[("Mbit/s", 1.0), ("kbit/s", 0.001), ("Gbit/s", 1000.0)],
};
/// A number without a unit.
pub const PLAIN: Quantity = Quantity {
    units: &[("", 1.0)],
};

impl Values<'_> {
    /// An error in the main file.
    pub fn error(
        &mut self,
        code: &str,
        at: std::ops::Range<usize>,
        message: impl Into<String>,
    ) -> &mut Diagnostic {
        let problem = self.caex.text().error(code, at, message);
        self.problems.push(problem);
        self.problems.last_mut().expect("one was just added")
    }

    /// A text; empty ones count as missing.
    #[must_use]
    pub fn text(&self, part: &Part, name: &str) -> Option<Spanned<String>> {
        let text = self.caex.attribute(part, name)?.value;
        (!text.text.is_empty()).then(|| Spanned::new(text.at, text.text))
    }

    /// A number in the quantity's first unit.
    pub fn number(&mut self, part: &Part, name: &str, quantity: Quantity) -> Option<Spanned<f64>> {
        let found = self.caex.attribute(part, name)?;
        self.quantity(&found.attribute, found.value, quantity)
    }

    /// The value of a nested attribute as a number.
    pub fn nested_number(
        &mut self,
        attribute: &Attribute,
        quantity: Quantity,
    ) -> Option<Spanned<f64>> {
        let text = attribute.value.clone().or(attribute.default.clone())?;
        self.quantity(attribute, text, quantity)
    }

    fn quantity(
        &mut self,
        attribute: &Attribute,
        text: Text,
        quantity: Quantity,
    ) -> Option<Spanned<f64>> {
        if text.text.is_empty() {
            return None;
        }
        let name = &attribute.name.text;
        let Ok(number) = text.text.parse::<f64>() else {
            self.error(
                "M809",
                text.at,
                format!("`{name}` cannot be `{}`", text.text),
            )
            .expected = Some("a number".to_owned());
            return None;
        };
        let unit = attribute.unit.as_ref().map_or("", |u| u.text.as_str());
        let Some((_, factor)) = quantity
            .units
            .iter()
            .find(|(u, _)| *u == unit || unit.is_empty())
        else {
            let known: Vec<&str> = quantity.units.iter().map(|(u, _)| *u).collect();
            let at = attribute
                .unit
                .as_ref()
                .map_or(text.at.clone(), |u| u.at.clone());
            self.error("M809", at, format!("`{name}` cannot be given in `{unit}`"))
                .expected = Some(match known.as_slice() {
                [""] => "no unit".to_owned(),
                units => units.join(", "),
            });
            return None;
        };
        // A product with 0.001 is not the quotient; what people write in whole numbers stays whole.
        let value = if *factor < 1.0 {
            number / (1.0 / factor).round()
        } else {
            number * factor
        };
        Some(Spanned::new(text.at, value))
    }

    /// A whole number from 0.
    pub fn whole(&mut self, part: &Part, name: &str, quantity: Quantity) -> Option<Spanned<u32>> {
        let number = self.number(part, name, quantity)?;
        let (span, value) = (number.span(), number.into_inner());
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            // by the test above
            return Some(Spanned::new(span, value as u32));
        }
        self.error("M809", span, format!("`{name}` cannot be {value}"))
            .expected = Some("a whole number from 0".to_owned());
        None
    }

    /// Yes or no; no if it is not there.
    pub fn flag(&mut self, part: &Part, name: &str) -> bool {
        let Some(text) = self.text(part, name) else {
            return false;
        };
        match text.get_ref().to_ascii_lowercase().as_str() {
            "true" | "1" => true,
            "false" | "0" => false,
            other => {
                let message = format!("`{name}` cannot be `{other}`");
                self.error("M809", text.span(), message).expected =
                    Some("true or false".to_owned());
                false
            }
        }
    }

    /// The value of a variable, as `fail_safe` of `cell.toml` has it.
    #[must_use]
    pub fn variable_value(&self, part: &Part, name: &str) -> Option<Spanned<toml::Value>> {
        let found = self.caex.attribute(part, name)?;
        value(found.attribute.data_type.as_deref(), found.value)
    }
}

/// A value of a variable after its data type; without one, or with another, after what it looks like.
#[must_use]
pub fn value(data_type: Option<&str>, text: Text) -> Option<Spanned<toml::Value>> {
    if text.text.is_empty() {
        return None;
    }
    let plain = text.text.as_str();
    let string = || toml::Value::String(plain.to_owned());
    // The prefix of the schema's types is whatever the file says: `xs:`, `xsd:`, none.
    let data_type = data_type.map(|t| t.rsplit(':').next().unwrap_or(t));
    let value = match data_type {
        Some("string") => string(),
        Some("double" | "float" | "decimal") => {
            plain.parse().map_or_else(|_| string(), toml::Value::Float)
        }
        _ => match plain.to_ascii_lowercase().as_str() {
            "true" => toml::Value::Boolean(true),
            "false" => toml::Value::Boolean(false),
            "1" if data_type == Some("boolean") => toml::Value::Boolean(true),
            "0" if data_type == Some("boolean") => toml::Value::Boolean(false),
            _ => plain
                .parse()
                .map(toml::Value::Integer)
                .or_else(|_| plain.parse().map(toml::Value::Float))
                .unwrap_or_else(|_| string()),
        },
    };
    Some(Spanned::new(text.at, value))
}

/// Fluent form of a warning at a place of the main file.
#[must_use]
pub fn warning(
    caex: &Caex,
    code: &str,
    at: std::ops::Range<usize>,
    message: String,
    hint: &str,
) -> Diagnostic {
    caex.text().warning(code, at, message).hint(hint)
}
