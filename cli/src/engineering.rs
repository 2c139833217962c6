//! From a model to everything that runs, and between its forms: `fam check`, `generate`, `show`, `diff`, `convert`, `new`, `import`, `export`.

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use fam_engineering::caex::container;
use fam_engineering::convert::{Form, convert as convert_model, write_files};
use fam_engineering::files::{ModelAt, text_of};
use fam_engineering::generate::Target;
use fam_engineering::{BuiltCell, import, new_cell, output, plcopen, reload, show as show_model};
use fam_soft_plc::source::SourceFile;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A model.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// AutomationML (.aml, .amlx) or cell.toml
    #[arg(value_name = "MODEL")]
    pub cell: PathBuf,
    /// Folder within which the model's references may lie; without it an AutomationML model is kept to its own folder
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
}

impl ModelArgs {
    fn at(&self) -> ModelAt<'_> {
        at(&self.cell, self.root.as_deref())
    }
}

/// A model and how far its references may lead.
fn at<'a>(file: &'a Path, root: Option<&'a Path>) -> ModelAt<'a> {
    ModelAt { file, root }
}

/// `fam generate`
#[derive(Debug, Args)]
pub struct GenerateArgs {
    #[command(flatten)]
    pub model: ModelArgs,
    /// Where to
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// For which PLCs Serialize and Deserialize are written
    #[arg(long, value_enum, default_value = "fam")]
    pub target: TargetArg,
}

/// For which PLCs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TargetArg {
    /// FAM's own soft-PLC: one block copy.
    Fam,
    /// Variable by variable, with the standard blocks in ST.
    Portable,
}

/// `fam show`
#[derive(Debug, Args)]
pub struct ShowArgs {
    #[command(flatten)]
    pub model: ModelArgs,
    /// One JSON object
    #[arg(long)]
    pub json: bool,
}

/// `fam diff`
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// The model as it was
    pub old: PathBuf,
    /// The model as it is to be
    pub new: PathBuf,
}

/// `fam convert`
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// AutomationML (.aml, .amlx) or cell.toml
    #[arg(value_name = "MODEL")]
    pub from: PathBuf,
    /// Where to; its ending says which form: .aml, .amlx or .toml
    pub to: PathBuf,
    /// Path of an FAM.aml that is there already, from the new model; otherwise it is written beside it
    #[arg(long, value_name = "FILE")]
    pub library: Option<String>,
    /// Folder within which the model's references may lie; without it an AutomationML model is kept to its own folder
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
}

/// `fam new`
#[derive(Debug, Args)]
pub struct NewArgs {
    /// Folder, which is made
    pub dir: PathBuf,
}

/// `fam import`
#[derive(Debug, Args)]
pub struct ImportArgs {
    /// PLCopen XML or Structured Text
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// The AutomationML model to write, or a folder for it; logic, library and the list of what is to be decided stand beside it
    #[arg(long, value_name = "FILE.aml")]
    pub out: PathBuf,
}

/// `fam export`
#[derive(Debug, Args)]
pub struct ExportArgs {
    #[command(flatten)]
    pub model: ModelArgs,
    /// Write the logic of all MCs as one ordinary PLCopen project
    #[arg(long, value_name = "FILE.xml")]
    pub plcopen: PathBuf,
}

/// Checks a model; prints all problems at once.
pub fn check(path: &Path, root: Option<&Path>) -> Result<bool> {
    match fam_engineering::build(at(path, root)) {
        Ok(built) => {
            warn(&built);
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

fn warn(built: &BuiltCell) {
    for warning in &built.warnings {
        println!("{warning}");
    }
}

/// Writes everything that runs.
pub fn generate(args: &GenerateArgs) -> Result<()> {
    let target = match args.target {
        TargetArg::Fam => Target::Fam,
        TargetArg::Portable => Target::Portable,
    };
    let (files, built) = output::write(args.model.at(), target, &args.out)?;
    warn(&built);
    for file in files {
        println!("{}", file.display());
    }
    println!("\n{}", output::summary(&built));
    Ok(())
}

/// Prints a cell.
pub fn show(args: &ShowArgs) -> Result<()> {
    let built = fam_engineering::build(args.model.at())?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&built.model)?);
    } else {
        print!("{}", show_model::tree(&built));
    }
    Ok(())
}

/// Says what changed. `false` if a state cannot be carried over as a whole.
pub fn diff(args: &DiffArgs) -> Result<bool> {
    let old = fam_engineering::build(&args.old)?;
    let new = fam_engineering::build(&args.new)?;
    let change = reload::compare(&old, &new);
    print!("{change}");
    Ok(change.mcs.values().all(|c| match c {
        reload::McChange::Changed { state, .. } => state.is_complete(),
        _ => true,
    }))
}

fn ending(path: &Path) -> String {
    path.extension()
        .map_or_else(String::new, |e| e.to_string_lossy().to_ascii_lowercase())
}

/// Folder and name of a file to be written.
fn place(path: &Path) -> Result<(&Path, String)> {
    let name = path
        .file_name()
        .with_context(|| format!("{} names no file", path.display()))?;
    Ok((
        path.parent().unwrap_or(Path::new("")),
        name.to_string_lossy().into_owned(),
    ))
}

/// Writes a model in another form.
pub fn convert(args: &ConvertArgs) -> Result<()> {
    let (dir, name) = place(&args.to)?;
    let from = at(&args.from, args.root.as_deref());
    let caex = Form::Caex {
        library: args.library.clone(),
    };
    match ending(&args.to).as_str() {
        "amlx" => {
            let inner = format!("{}.aml", name.trim_end_matches(".amlx"));
            let converted = convert_model(from, &inner, &caex)?;
            let bytes = container::pack(&converted.files, &inner);
            std::fs::write(&args.to, bytes)
                .with_context(|| format!("cannot write {}", args.to.display()))?;
            println!("{}", args.to.display());
            Ok(())
        }
        "aml" => write_new(&convert_model(from, &name, &caex)?.files, dir),
        "toml" => write_new(&convert_model(from, &name, &Form::Toml)?.files, dir),
        _ => bail!(
            "{} has no ending that says its form: expected .aml, .amlx or .toml",
            args.to.display()
        ),
    }
}

/// Writes files that are not there yet, or have just this content.
fn write_new(files: &BTreeMap<String, String>, dir: &Path) -> Result<()> {
    for (name, text) in files {
        let path = dir.join(name);
        if let Ok(there) = std::fs::read(&path)
            && there != text.as_bytes()
        {
            bail!(
                "{} is there already, with other content; give another folder, or move it away",
                path.display()
            );
        }
    }
    for file in write_files(files, dir)? {
        println!("{}", file.display());
    }
    Ok(())
}

/// Writes a small cell to begin with.
pub fn new(args: &NewArgs) -> Result<()> {
    write_new(&new_cell::files(), &args.dir)?;
    println!(
        "\nnext: cd {}; fam check cell.toml; fam up deployment.toml. README.md goes on from there.",
        args.dir.display()
    );
    Ok(())
}

/// Proposes a model of an existing PLC project.
pub fn import(args: &ImportArgs) -> Result<()> {
    let mut sources = Vec::new();
    for file in &args.files {
        let text = text_of(file).with_context(|| format!("cannot read {}", file.display()))?;
        sources.push(SourceFile::new(file.display().to_string(), text));
    }
    let out = match args.files.first().and_then(|f| f.file_stem()) {
        Some(stem) if args.out.extension().is_none() => args.out.join(stem).with_extension("aml"),
        _ => args.out.clone(),
    };
    let (dir, name) = place(&out)?;
    if ending(&out) != "aml" {
        bail!(
            "{} is no AutomationML file: expected an ending .aml, or a folder",
            out.display()
        );
    }
    let files = import::model(&sources, &name)?;
    write_new(&files, dir)?;
    println!("\n{}", files["TODO.md"]);
    Ok(())
}

/// Writes the logic of a model as one project.
pub fn export(args: &ExportArgs) -> Result<()> {
    let built = fam_engineering::build(args.model.at())?;
    std::fs::write(&args.plcopen, plcopen::ordinary_project(&built))
        .with_context(|| format!("cannot write {}", args.plcopen.display()))?;
    println!("{}", args.plcopen.display());
    Ok(())
}
