//! Names and numbers that identify things in a cell.

use crate::mark::{Mark, hash_marked};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Longest name of a controller, MC, gateway or cell, in bytes.
pub const NAME_BYTES_MAX: usize = 64;

/// Why a text is not a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is not a valid name of a {kind}: expected 1 to {NAME_BYTES_MAX} letters, digits, `_` or `-`, beginning with a letter"
)]
pub struct NameError {
    /// What was to be named: `controller`, `MC`, ...
    pub kind: &'static str,
    /// The text that was given.
    pub text: String,
}

fn check_name(kind: &'static str, text: &str) -> Result<(), NameError> {
    let good = !text.is_empty()
        && text.len() <= NAME_BYTES_MAX
        && text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if good {
        Ok(())
    } else {
        Err(NameError {
            kind,
            text: text.chars().take(80).collect(),
        })
    }
}

macro_rules! name_type {
    ($(#[$doc:meta])* $name:ident, $kind:literal) => {
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(Arc<str>);

        impl $name {
            /// Checks the text and makes it a name.
            ///
            /// # Errors
            /// [`NameError`] if the text is empty, too long or has other characters than letters, digits, `_` and `-`.
            pub fn new(text: &str) -> Result<Self, NameError> {
                check_name($kind, text)?;
                Ok(Self(text.into()))
            }
            /// The name as text.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }
        impl TryFrom<String> for $name {
            type Error = NameError;
            fn try_from(text: String) -> Result<Self, NameError> {
                Self::new(&text)
            }
        }
        impl std::str::FromStr for $name {
            type Err = NameError;
            fn from_str(text: &str) -> Result<Self, NameError> {
                Self::new(text)
            }
        }
        impl From<$name> for String {
            fn from(name: $name) -> String {
                name.0.to_string()
            }
        }
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }
        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
    };
}

name_type!(
    /// A cell: everything that one manager looks after. First part of all key expressions.
    CellId, "cell"
);
name_type!(
    /// A controller node, by its name in the cell model.
    ControllerId, "controller"
);
name_type!(
    /// A mechatronic component, by its name in the cell model.
    McId, "mechatronic component"
);
name_type!(
    /// An I/O gateway, by its name in the cell model.
    GatewayId, "gateway"
);

macro_rules! number_type {
    ($(#[$doc:meta])* $name:ident, $mark:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
        pub struct $name(pub u64);
        impl std::hash::Hash for $name {
            fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
                hash_marked(Mark::$mark, self.0, state);
            }
        }
        impl $name {
            /// The next higher number. At the end of all numbers it stays: nothing then counts as newer.
            #[must_use]
            pub fn next(self) -> Self {
                Self(self.0.saturating_add(1))
            }
        }
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

number_type!(
    /// Grows with each activation of an MC: the fencing token that its frames carry. 0 is before the first.
    Epoch, Epoch
);
number_type!(
    /// Number of a scan of an MC, counted over its whole life: epochs do not restart it.
    Scan, Scan
);
number_type!(
    /// Tells two runs of one process apart; a later run has a higher number.
    BootId, Boot
);
number_type!(
    /// Number of an input image of one gateway; grows across restarts of the gateway too.
    ImageNumber, Image
);
number_type!(
    /// Number of an order of the Middleware Manager: a repeated order keeps its number.
    OrderId, Order
);
number_type!(
    /// Number of a plan, and so the generation of the assignment that it leads to.
    PlanId, Plan
);

/// Who drives an MC: a controller in one of its lives. A controller that comes back has a new boot id and owns nothing.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Owner {
    /// The controller.
    pub controller: ControllerId,
    /// The life of its node.
    pub boot: BootId,
}

impl fmt::Display for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (boot {})", self.controller, self.boot)
    }
}

/// A process of the cell, as messages and liveliness tokens are addressed.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum ProcessId {
    /// The manager (Middleware Manager, QoS Monitors, Diagnosis & Decision).
    Manager,
    /// A controller node (Controller Agent, MC Agents).
    Node(ControllerId),
    /// An I/O gateway.
    Gateway(GatewayId),
    /// A command that asks the manager something, by a number of its own choice.
    Client(u64),
}

impl fmt::Display for ProcessId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ProcessId::Manager => f.write_str("manager"),
            ProcessId::Node(c) => write!(f, "controller {c}"),
            ProcessId::Gateway(g) => write!(f, "gateway {g}"),
            ProcessId::Client(n) => write!(f, "client {n}"),
        }
    }
}

/// An agent, as it signs and receives messages.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum AgentId {
    /// Middleware Manager.
    Manager,
    /// Diagnosis & Decision.
    Decision,
    /// The QoS Monitors.
    Monitors,
    /// Controller Agent of a controller.
    Controller(ControllerId),
    /// MC Agent of one MC on one controller.
    Component(ControllerId, McId),
    /// The fence of a gateway.
    Gateway(GatewayId),
    /// An operator's command.
    Client(u64),
}

impl AgentId {
    /// The process in which the agent lives.
    #[must_use]
    pub fn process(&self) -> ProcessId {
        match self {
            AgentId::Manager | AgentId::Decision | AgentId::Monitors => ProcessId::Manager,
            AgentId::Controller(c) | AgentId::Component(c, _) => ProcessId::Node(c.clone()),
            AgentId::Gateway(g) => ProcessId::Gateway(g.clone()),
            AgentId::Client(n) => ProcessId::Client(*n),
        }
    }
}

impl fmt::Display for AgentId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            AgentId::Manager => f.write_str("Middleware Manager"),
            AgentId::Decision => f.write_str("Diagnosis & Decision"),
            AgentId::Monitors => f.write_str("QoS Monitors"),
            AgentId::Controller(c) => write!(f, "Controller Agent of {c}"),
            AgentId::Component(c, m) => write!(f, "MC Agent of {m} on {c}"),
            AgentId::Gateway(g) => write!(f, "gateway {g}"),
            AgentId::Client(n) => write!(f, "client {n}"),
        }
    }
}
