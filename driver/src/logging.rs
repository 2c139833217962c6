//! Logs through `tracing`: plain lines on a terminal, JSON objects on request, to standard error.
//!
//! Levels: ERROR: somebody has to act. WARN: something is not as it should be, FAM goes on. INFO: the life of the cell.
//! DEBUG: single messages and decisions. The environment variable `FAM_LOG` filters (`debug`, `fam_gateway=debug,info`, ...).

use fam_proto::{Event, Severity};
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people; coloured on a terminal.
    #[default]
    Plain,
    /// One JSON object a line.
    Json,
}

impl std::str::FromStr for LogFormat {
    type Err = String;
    fn from_str(text: &str) -> Result<LogFormat, String> {
        match text {
            "plain" => Ok(LogFormat::Plain),
            "json" => Ok(LogFormat::Json),
            other => Err(format!(
                "`{other}` is not a log format: expected `plain` or `json`"
            )),
        }
    }
}

/// Sets logging up for this process; `default_filter` (`info`, say) holds unless `FAM_LOG` is set. A second call changes nothing.
pub fn init_logging(format: LogFormat, default_filter: &str) {
    // What Zenoh warns about (an endpoint that cannot be reached, say) the link says in the cell's own words.
    let wanted = std::env::var("FAM_LOG").unwrap_or_else(|_| default_filter.to_owned());
    let filter = EnvFilter::try_new(format!("zenoh=error,{wanted}"))
        .unwrap_or_else(|_| EnvFilter::new(format!("zenoh=error,{default_filter}")));
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr);
    // An error means that logging has been set up before.
    let _ = match format {
        LogFormat::Plain => builder
            .with_ansi(std::io::stderr().is_terminal())
            .with_target(false)
            .try_init(),
        LogFormat::Json => builder.json().flatten_event(true).try_init(),
    };
}

/// Logs an event of the history at the level of its severity.
pub fn log_event(event: &Event) {
    let kind = serde_json::to_value(event.kind).unwrap_or_default();
    let kind = kind.as_str().unwrap_or_default();
    let mc = event.mc.as_ref().map(tracing::field::display);
    let controller = event.controller.as_ref().map(tracing::field::display);
    let plan = event.plan.map(|p| p.0);
    let epoch = event.epoch.map(|e| e.0);
    let scan = event.scan.map(|s| s.0);
    let text = &event.text;
    match event.severity {
        Severity::Info => tracing::info!(kind, mc, controller, plan, epoch, scan, "{text}"),
        Severity::Warning => tracing::warn!(kind, mc, controller, plan, epoch, scan, "{text}"),
        Severity::Alarm => tracing::error!(kind, mc, controller, plan, epoch, scan, "{text}"),
    }
}
