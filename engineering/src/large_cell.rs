//! A cell of any size, to measure with: MCs with variables of all common types and one critical interval each.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

/// One controller for so many MCs; each MC is hosted on two.
const MCS_OF_A_CONTROLLER: usize = 10;

/// Writes model and logic into a folder. Returns the path of the model.
///
/// # Errors
/// A file that cannot be written.
pub fn write(dir: &Path, mcs: usize, variables: usize) -> io::Result<PathBuf> {
    let controllers = (mcs / MCS_OF_A_CONTROLLER).max(2);
    let mut cell = String::from(
        "format = 1\n[cell]\nname = \"large\"\ntick_ms = 10\n[[gateway]]\nname = \"gateway1\"\ndriver = \"image\"\n",
    );
    for n in 0..controllers {
        let _ = writeln!(cell, "[[controller]]\nname = \"c{n}\"\nmemory_mb = 4096");
    }
    std::fs::create_dir_all(dir.join("logic"))?;
    for n in 0..mcs {
        let (one, two) = (n % controllers, (n + 1) % controllers);
        let _ = writeln!(
            cell,
            "[[mc]]\nname = \"Mc{n}\"\nlogic = [\"logic/mc{n}.st\"]\ngateway = \"gateway1\"\nhosts = [\"c{one}\", \"c{two}\"]\nworst_case_us = 50\n\
             [mc.inputs]\nGo = \"image:Go{n}\"\n[mc.outputs]\nDone = {{ field = \"image:Done{n}\", fail_safe = false }}\n\
             [[mc.critical_interval]]\nname = \"Busy\"\ncondition = \"step >= 10 AND step < 20\"\nkind = \"checkpoint\"\nrecovery = \"Back\"\n\
             [mc.critical_interval.checkpoint_state]\nstep = 0"
        );
        std::fs::write(dir.join(format!("logic/mc{n}.st")), logic(n, variables))?;
    }
    let model = dir.join("cell.toml");
    std::fs::write(&model, cell)?;
    Ok(model)
}

/// A program with variables of all common types, some of which it computes with.
fn logic(n: usize, variables: usize) -> String {
    const TYPES: [&str; 6] = ["BOOL", "INT", "DINT", "REAL", "LREAL", "TIME"];
    let mut text = format!(
        "VAR_GLOBAL\n    Go AT %IX0.0 : BOOL;\n    Done AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM Mc{n}\nVAR_EXTERNAL\n    Go, Done : BOOL;\nEND_VAR\nVAR\n    step : INT;\n"
    );
    for v in 1..variables {
        let _ = writeln!(text, "    v{v} : {};", TYPES[v % TYPES.len()]);
    }
    text.push_str("END_VAR\n    IF Go THEN step := (step + 1) MOD 30; END_IF;\n");
    for v in (1..variables).filter(|v| v % TYPES.len() == 2).take(50) {
        let _ = writeln!(text, "    v{v} := v{v} + step;");
    }
    text.push_str(
        "    Done := step = 0;\nEND_PROGRAM\nFUNCTION_BLOCK Back\nVAR_OUTPUT end : BOOL; END_VAR\n    end := TRUE;\nEND_FUNCTION_BLOCK\n",
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of so many MCs the logic is not kept from stage to stage; each is the same MC as in a small cell.
    #[test]
    fn a_large_cell_is_built_of_the_same_mcs_as_a_small_one() {
        let built = [2, 120].map(|mcs| {
            let dir = tempfile::tempdir().unwrap();
            let model = write(dir.path(), mcs, 7).unwrap();
            crate::build(&model).unwrap_or_else(|p| panic!("{p}"))
        });
        assert_eq!(built[1].mcs.len(), 120);
        assert_eq!(built[0].model.mcs[0].hash, built[1].model.mcs[0].hash);
        assert_eq!(built[0].warnings.len() * 60, built[1].warnings.len());
    }
}
