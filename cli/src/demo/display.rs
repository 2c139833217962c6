//! What people see while the demo runs.

use crate::report::{Check, Step};
use crate::status::colours;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::Duration;

/// Progress on a terminal, one line for each step elsewhere, nothing before a JSON object.
pub struct Display {
    bar: Option<ProgressBar>,
    silent: bool,
}

impl Display {
    /// `steps` is the length of the story.
    pub fn new(steps: u64, headless: bool, json: bool) -> Display {
        let bar = (!headless && !json && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new(steps);
            if let Ok(style) = ProgressStyle::with_template(
                "{spinner} [{elapsed_precise}] {bar:24} {pos}/{len}  {wide_msg}",
            ) {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.enable_steady_tick(Duration::from_millis(120));
            bar
        });
        Display { bar, silent: json }
    }

    fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None if self.silent => {}
            None => println!("{text}"),
        }
    }

    /// A step begins.
    pub fn doing(&self, what: &str) {
        if let Some(bar) = &self.bar {
            bar.set_message(what.to_owned());
        }
    }

    /// A step has ended.
    pub fn done(&self, step: &Step, ended_s: f64) {
        if let Some(bar) = &self.bar {
            bar.inc(1);
        }
        let loads: Vec<String> = step
            .after
            .iter()
            .map(|(c, p)| format!("{c} {p:.0} %"))
            .collect();
        self.line(&format!(
            "{:6.1} s  {}: {}",
            step.at_s, step.name, step.text
        ));
        let gap = step
            .gap_ms
            .map_or(String::new(), |ms| format!(", longest gap {ms:.1} ms"));
        self.line(&format!(
            "          {:.1} s later: {}{gap}, {} finished",
            ended_s - step.at_s,
            loads.join(", "),
            step.products
        ));
    }

    /// An assertion was made.
    pub fn checked(&self, check: &Check) {
        if check.held {
            return;
        }
        let text = format!("          FAILED: {}: {}", check.name, check.seen);
        self.line(&if colours() {
            format!("\x1b[31m{text}\x1b[0m")
        } else {
            text
        });
    }

    /// The story is over.
    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
