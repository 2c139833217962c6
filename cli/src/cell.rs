//! `fam check` and `fam generate`.

use anyhow::Result;
use std::path::Path;

/// Checks a cell; prints all problems at once.
pub fn check(path: &Path) -> Result<bool> {
    match fam_engineering::build(path) {
        Ok(built) => {
            for warning in &built.warnings {
                println!("{warning}");
            }
            println!(
                "{}: {} controllers, {} MCs, no errors",
                path.display(),
                built.model.controllers.len(),
                built.model.mcs.len()
            );
            Ok(true)
        }
        Err(problems) => {
            println!("{problems}");
            Ok(false)
        }
    }
}

/// Writes the Flexible Automation Projects and the diagnosis files.
pub fn generate(path: &Path, out: &Path) -> Result<()> {
    let built = fam_engineering::build(path)?;
    for file in fam_engineering::write_projects(&built, out)? {
        println!("{}", file.display());
    }
    Ok(())
}
