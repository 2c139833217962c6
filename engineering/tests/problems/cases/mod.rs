//! What is wrong with each model: file, what stands there, what stands there instead. One file for each family of problems.

mod caex;
mod foreign;
mod intervals;
mod tables;

/// A change: file, text, new text; a file that is not there is made.
pub type Change = (&'static str, &'static str, &'static str);
/// Name and changes.
pub type Case = (&'static str, &'static [Change]);

const CELL: &str = "cell.toml";
const AML: &str = "cell.aml";

/// Of the `cell.toml`.
pub const TOML: &[&[Case]] = &[tables::CASES, intervals::CASES];
/// Of the `cell.toml`, for `--target portable`.
pub const PORTABLE: &[&[Case]] = &[intervals::PORTABLE];
/// Of the AutomationML model.
pub const CAEX: &[&[Case]] = &[caex::CASES, foreign::CASES];

/// Of the deployment.
pub const DEPLOYMENT: &[(&str, &str, &str)] = &[
    ("no endpoint", "tcp/127.0.0.1:7447", "127.0.0.1:7447"),
    (
        "no address",
        "name = \"gate\"",
        "name = \"gate\"\n[plant]\nmodbus = \"1502\"",
    ),
    ("unknown gateway", "\"gate\"", "\"gat\""),
    ("unknown controller", "\"c2\"", "\"c3\""),
    (
        "address of the driver image",
        "name = \"gate\"",
        "name = \"gate\"\naddress = \"127.0.0.1:1502\"",
    ),
    ("a controller twice", "\"c2\"", "\"c1\""),
];
