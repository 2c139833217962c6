//! `cargo run -p fam-soft-plc --example scan -- [NAME]...`: the measurement of `fam bench scan` without the rest of the command,
//! for all programs or those named. With `--dump FOLDER` the Wasm and the machine code (an ELF file) of each go there.

#![allow(clippy::disallowed_methods)]

#[path = "../../cli/src/bench/scan.rs"]
mod scan;

fn main() -> anyhow::Result<()> {
    let mut names = Vec::new();
    let mut dump = None;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        if arg == "--dump" {
            dump = args.next();
        } else {
            names.push(arg);
        }
    }
    let only = |name: &str| names.is_empty() || names.iter().any(|n| n == name);
    let pairs = scan::pairs(10_000, &only);
    if let Some(folder) = dump {
        for pair in &pairs {
            let (_, module) = scan::compile(pair)?;
            let path = |end: &str| format!("{folder}/{}.{end}", pair.name);
            std::fs::write(path("wasm"), &module.mc().wasm)?;
            // The ELF file stands behind a header.
            let code = module.serialize()?;
            let start = code.windows(4).position(|w| w == b"\x7fELF").unwrap_or(0);
            std::fs::write(path("elf"), &code[start..])?;
        }
        return Ok(());
    }
    let figures = scan::run(&pairs)?;
    for program in figures["programs"].as_array().into_iter().flatten() {
        let number = |key: &str| program[key].as_f64().unwrap_or_default();
        println!(
            "{:16} {:10.1} ns {:10.1} ns in C  {:6.2}",
            program["name"].as_str().unwrap_or_default(),
            number("ns"),
            number("c_ns"),
            number("ratio")
        );
    }
    println!("geometric mean {}", figures["ratio_geomean"]);
    Ok(())
}
