//! Operators' commands: ask the manager, print what it says.

use crate::args::{CellArgs, EventsArgs, ReloadArgs, StatusArgs};
use crate::status;
use anyhow::{Context, Result, bail};
use fam_driver::Client;
use fam_proto::{CellId, CellStatus, CommandKind, Query, QueryReply};
use std::io::{IsTerminal, Write};
use std::time::Duration;

/// How long the manager may take to answer.
const ASK_WITHIN: Duration = Duration::from_secs(5);
/// How long a command may take to its end.
const COMMAND_WITHIN: Duration = Duration::from_secs(30);
/// How long all controllers may take to make a new version ready, and to bring it in.
const STAGE_WITHIN: Duration = Duration::from_secs(150);
/// Most events in one answer.
const EVENTS_LIMIT: u32 = 500;

async fn connect(cell: &CellArgs) -> Result<Client> {
    let name = cell_name(cell.name.as_deref(), &cell.manager, "--manager").await?;
    Ok(Client::open(name, vec![cell.manager.clone()]).await?)
}

/// The cell that is meant: the one named, or else the only one that answers at the endpoint, which `option` gives.
///
/// # Errors
/// If none answers, or several do.
pub async fn cell_name(name: Option<&str>, endpoint: &str, option: &str) -> Result<CellId> {
    if let Some(name) = name {
        return CellId::new(name).context("--name");
    }
    let cells = fam_driver::cells_at(endpoint, ASK_WITHIN).await?;
    let mut cells = cells.into_iter();
    match (cells.next(), cells.next()) {
        (Some(only), None) => Ok(only),
        (None, _) => bail!(
            "no cell answers at {endpoint} (waited {} ms): start one with `fam up`, or give its endpoint with `{option}`",
            ASK_WITHIN.as_millis()
        ),
        (Some(a), Some(b)) => bail!(
            "several cells answer at {endpoint}, {a} and {b} among them: say which with `--name`"
        ),
    }
}

/// Gives one command and prints its end.
///
/// # Errors
/// If the manager refuses or cannot be reached.
pub async fn command(cell: &CellArgs, what: CommandKind) -> Result<()> {
    let mut client = connect(cell).await?;
    let words = client
        .command(what, COMMAND_WITHIN, |begun| eprintln!("{begun} ..."))
        .await?;
    println!("{words}");
    client.close().await;
    Ok(())
}

/// `fam reload`. `Ok(false)`: the person at the terminal does not want it.
///
/// # Errors
/// If the new version cannot be taken, or the manager cannot be reached.
pub async fn reload(args: &ReloadArgs) -> Result<bool> {
    let mut client = connect(&args.cell).await?;
    let tell = |begun: &str| eprintln!("{begun} ...");
    let changes = client
        .command(CommandKind::Reload(None), STAGE_WITHIN, tell)
        .await?;
    println!("{}", changes.trim_end());
    if args.dry_run {
        client.close().await;
        return Ok(true);
    }
    if !args.yes {
        if !std::io::stdin().is_terminal() {
            bail!(
                "nothing was changed: give --yes where nobody can be asked, or --dry-run to only look"
            );
        }
        print!("Bring this into the running cell? [y/N] ");
        std::io::stdout().flush()?;
        let mut answer = String::new();
        std::io::stdin().read_line(&mut answer)?;
        if !matches!(answer.trim(), "y" | "Y" | "yes") {
            println!("nothing was changed");
            client.close().await;
            return Ok(false);
        }
    }
    let look = client.last_command();
    let words = client
        .command(CommandKind::Reload(Some(look)), STAGE_WITHIN, tell)
        .await?;
    println!("{words}");
    client.close().await;
    Ok(true)
}

async fn ask_status(client: &mut Client) -> Result<CellStatus> {
    loop {
        if let QueryReply::Status(status) = client.ask(Query::Status, ASK_WITHIN).await? {
            return Ok(status);
        }
    }
}

/// `fam status`
///
/// # Errors
/// If the manager cannot be reached.
pub async fn show_status(args: &StatusArgs) -> Result<()> {
    let mut client = connect(&args.cell).await?;
    loop {
        let seen = ask_status(&mut client).await;
        if !args.watch {
            let seen = seen?;
            if args.json {
                println!("{}", serde_json::to_string(&status::status_json(&seen)?)?);
            } else {
                println!("{}", status::render(&seen));
            }
            client.close().await;
            return Ok(());
        }
        match seen {
            Ok(seen) if args.json => {
                println!("{}", serde_json::to_string(&status::status_json(&seen)?)?)
            }
            // Home, then clear what an earlier, longer screen has left.
            Ok(seen) => print!("\x1b[H\x1b[2J{}\nCtrl-C ends", status::render(&seen)),
            Err(error) => println!("\x1b[H\x1b[2J{error:#}"),
        }
        std::io::stdout().flush()?;
        tokio::time::sleep(Duration::from_millis(500)).await;
    }
}

/// `fam events`
///
/// # Errors
/// If the manager cannot be reached.
pub async fn show_events(args: &EventsArgs) -> Result<()> {
    let mut client = connect(&args.cell).await?;
    let mut after = 0;
    loop {
        let QueryReply::Events { events, more } = client
            .ask(
                Query::Events {
                    after,
                    limit: EVENTS_LIMIT,
                },
                ASK_WITHIN,
            )
            .await?
        else {
            continue;
        };
        for event in &events {
            after = event.seq;
            if args.json {
                println!("{}", status::event_json(event));
            } else {
                println!("{}", status::event_line(event));
            }
        }
        std::io::stdout().flush()?;
        if more {
            continue;
        }
        if !args.follow {
            client.close().await;
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}
