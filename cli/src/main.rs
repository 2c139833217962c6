//! The `fam` command: starts and embeds every part of FAM.

mod args;
mod bench;
mod chain;
mod demo;
mod engineering;
mod free_port;
mod io;
mod logic;
mod observe;
mod operate;
mod processes;
mod report;
mod run;
mod running;
mod serve;
mod simulate;
mod soak;
mod status;
mod supervised;
mod tests_of_logic;
mod up;
mod watch;

use anyhow::Result;
use args::{Cli, Command};
use clap::Parser;
use fam_proto::{CommandKind, Reset};
use std::process::ExitCode;

/// What a shell says of a program that was ended by SIGPIPE.
const NOBODY_READS: i32 = 128 + 13;

/// Whoever reads along may have seen enough (`fam check ... | head`): that is no fault of the program, and ends it without a word.
/// The signal itself stays ignored, as sockets would end the program by it too.
fn end_when_nobody_reads() {
    let otherwise = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let text = panic.payload().downcast_ref::<String>();
        if text.is_some_and(|t| t.starts_with("failed printing to std")) {
            std::process::exit(NOBODY_READS);
        }
        otherwise(panic);
    }));
}

fn main() -> ExitCode {
    end_when_nobody_reads();
    match dispatch(Cli::parse().command) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            let word = if status::colours_on_stderr() {
                "\x1b[31merror\x1b[0m"
            } else {
                "error"
            };
            let text = format!("{error:#}");
            // Problems with files carry their own word and code.
            match text.strip_prefix("error") {
                Some(rest) => eprintln!("{word}{rest}"),
                None => eprintln!("{word}: {text}"),
            }
            ExitCode::from(2)
        }
    }
}

/// `Ok(false)`: it was carried out, and something did not hold.
fn dispatch(command: Command) -> Result<bool> {
    match command {
        // These watch real processes from plain threads and bring their own runtime.
        Command::Demo(args) => return demo::run(&args),
        Command::Bench(args) => return bench::run(&args).map(|()| true),
        Command::Simulate(args) => return simulate::run_schedules(&args),
        Command::Soak(args) => return soak::run(&args),
        Command::Run(args) => return run::run(&args),
        Command::Test(args) => return tests_of_logic::run(&args),
        Command::Check(args) => return logic::check(&args),
        Command::Generate(args) => return engineering::generate(&args).map(|()| true),
        Command::Show(args) => return engineering::show(&args).map(|()| true),
        Command::Diff(args) => return engineering::diff(&args),
        Command::Convert(args) => return engineering::convert(&args).map(|()| true),
        Command::New(args) => return engineering::new(&args).map(|()| true),
        Command::Import(args) => return engineering::import(&args).map(|()| true),
        Command::Export(args) => return engineering::export(&args).map(|()| true),
        _ => {}
    }
    serve::prefer_this_process(match &command {
        Command::Gateway(args) => args.priority,
        Command::Manager(args) => args.priority,
        Command::Plant(args) => args.priority,
        Command::Node(args) => args.link_priority.min(args.priority),
        _ => 0,
    });
    fam_driver::runtime()?.block_on(async {
        match command {
            Command::Demo(_)
            | Command::Bench(_)
            | Command::Simulate(_)
            | Command::Soak(_)
            | Command::Run(_)
            | Command::Test(_)
            | Command::Check(_)
            | Command::Generate(_)
            | Command::Show(_)
            | Command::Diff(_)
            | Command::Convert(_)
            | Command::New(_)
            | Command::Import(_)
            | Command::Export(_) => {}
            Command::Up(args) => up::run(&args).await?,
            Command::Manager(args) => serve::manager(args).await?,
            Command::Node(args) => serve::node(args).await?,
            Command::Gateway(args) => serve::gateway(args).await?,
            Command::Plant(args) => serve::plant(args).await?,
            Command::Status(args) => operate::show_status(&args).await?,
            Command::Events(args) => operate::show_events(&args).await?,
            Command::Move(a) => {
                operate::command(
                    &a.cell,
                    CommandKind::Move {
                        mc: a.mc,
                        to: a.to,
                        force: a.force,
                    },
                )
                .await?
            }
            Command::Drain(a) => {
                operate::command(&a.cell, CommandKind::Drain(a.controller)).await?
            }
            Command::Undrain(a) => {
                operate::command(&a.cell, CommandKind::Undrain(a.controller)).await?
            }
            Command::Pin(a) => {
                operate::command(&a.cell, CommandKind::Pin { mc: a.mc, to: a.to }).await?
            }
            Command::Unpin(a) => operate::command(&a.cell, CommandKind::Unpin(a.mc)).await?,
            Command::Stop(a) => operate::command(&a.cell, CommandKind::Stop(a.mc)).await?,
            Command::Reset(a) => {
                let how = match (a.cold, a.warm) {
                    (true, _) => Reset::Cold,
                    (_, true) => Reset::Warm,
                    _ => Reset::Resume,
                };
                operate::command(&a.cell, CommandKind::Reset { mc: a.mc, how }).await?;
            }
            Command::Ack(a) => operate::command(&a.cell, CommandKind::Acknowledge(a.event)).await?,
            Command::Reload(args) => return operate::reload(&args).await,
            Command::Io(args) => io::run(&args).await?,
            Command::Watch(args) => watch::run(&args).await?,
        }
        Ok(true)
    })
}
