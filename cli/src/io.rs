//! `fam io`: points of a gateway, in and out as CSV.

use crate::args::{IoArgs, IoCommand};
use crate::operate::cell_name;
use anyhow::{Context, Result, anyhow};
use fam_driver::Client;
use fam_gateway::io::{IoRequest, from_csv, request, to_csv};
use std::io::Read;
use std::time::Duration;

/// How long the gateway may take to answer.
const WITHIN: Duration = Duration::from_secs(3);

/// Asks the gateway and prints what stands there now.
///
/// # Errors
/// If the gateway cannot be reached, or refuses a value.
pub async fn run(args: &IoArgs) -> Result<()> {
    let what = match &args.what {
        IoCommand::Get { points } => IoRequest::Get(points.clone()),
        IoCommand::Set { values } if values.is_empty() => {
            let mut text = String::new();
            std::io::stdin()
                .read_to_string(&mut text)
                .context("cannot read standard input")?;
            IoRequest::Set(from_csv(&text).map_err(|why| anyhow!("standard input: {why}"))?)
        }
        IoCommand::Set { values } => IoRequest::Set(
            values
                .iter()
                .map(|v| {
                    let (name, value) = v
                        .split_once('=')
                        .ok_or_else(|| anyhow!("`{v}`: expected point=value, such as Start=1"))?;
                    Ok((name.to_owned(), value.to_owned()))
                })
                .collect::<Result<_>>()?,
        ),
    };
    let cell = cell_name(args.name.as_deref(), &args.endpoint, "--endpoint").await?;
    let client = Client::open(cell.clone(), vec![args.endpoint.clone()]).await?;
    let points = request(client.link(), &cell, &args.gateway, &what, WITHIN).await?;
    print!("{}", to_csv(&points));
    client.close().await;
    Ok(())
}
