//! Many random projects in a row: what was compared, and the smallest program that shows a difference.

use std::collections::BTreeMap;

use fam_soft_plc::{Diagnostic, Engine};

use crate::compare::{self, Built, Outcome};
use crate::generate::{self, Generated};
use crate::shrink::{Piece, shrink};

/// Scans of each program.
pub const SCANS: u32 = 6;

#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub programs: u64,
    pub scans: u64,
    pub trapped: u64,
    /// The interpreter's limit of statements was reached.
    pub skipped: u64,
    /// A constant part could not be worked out, and the checker said so.
    pub refused: u64,
    pub features: BTreeMap<&'static str, u64>,
}

impl Tally {
    pub fn add(&mut self, other: &Tally) {
        self.programs += other.programs;
        self.scans += other.scans;
        self.trapped += other.trapped;
        self.skipped += other.skipped;
        self.refused += other.refused;
        for (feature, count) in &other.features {
            *self.features.entry(feature).or_default() += count;
        }
    }
}

/// Codes of errors that random text cannot avoid: in constant parts, and recursion that is only possible by the classes of blocks
/// (an overridden method that calls an instance of its base, whose body calls that method).
const CONSTANT: [&str; 4] = ["E302", "E316", "E318", "E410"];

/// Generates, compiles and compares the project of a seed. `Err` is what went wrong, with the smallest text found.
pub fn project(engine: &Engine, seed: u64, programs: usize) -> Result<Tally, String> {
    let mut generated = generate::project(seed, programs);
    let mut tally = Tally::default();
    let built = loop {
        match compare::build(engine, &generated.tree.render()) {
            Ok(built) => break built,
            Err(problems) => {
                let refused = leave_out(&mut generated, &problems);
                if refused == 0 {
                    return Err(refusal(seed, &problems));
                }
                tally.refused += refused;
                if generated.programs.is_empty() {
                    return Ok(tally);
                }
            }
        }
    };
    for (number, name) in generated.programs.clone().iter().enumerate() {
        let which = number_of(name, number);
        match compare::run(engine, &built, name, which, seed, SCANS) {
            Outcome::Agreed { scans, trapped } => {
                tally.programs += 1;
                tally.scans += u64::from(scans);
                tally.trapped += u64::from(trapped);
            }
            Outcome::Skipped => tally.skipped += 1,
            Outcome::Different(what) => {
                return Err(report(engine, seed, &generated, name, which, &what));
            }
        }
    }
    tally.features = generated.features;
    Ok(tally)
}

fn number_of(name: &str, otherwise: usize) -> i64 {
    name[1..].parse().unwrap_or(otherwise as i64)
}

/// Takes out the POUs whose constants cannot be worked out; answers how many programs that were.
fn leave_out(generated: &mut Generated, problems: &[Diagnostic]) -> u64 {
    let mut count = 0;
    for problem in problems
        .iter()
        .filter(|p| p.severity == fam_soft_plc::Severity::Error)
    {
        if !CONSTANT.contains(&problem.code.as_str()) {
            return 0;
        }
        let pou = problem
            .pou
            .as_ref()
            .filter(|p| generated.programs.contains(*p));
        let Some(pou) = pou else {
            // A function or function block: everything may use it.
            count += generated.programs.len() as u64;
            generated.programs.clear();
            return count;
        };
        count += 1;
        generated.programs.retain(|p| p != pou);
        generated
            .tree
            .inner
            .retain(|piece| piece.open != format!("PROGRAM {pou}"));
        let main = generated.tree.inner.last_mut();
        if let Some(calls) = main.and_then(|m| m.inner.last_mut()) {
            calls
                .inner
                .retain(|line| !line.open.ends_with(&format!(" {pou}();")));
        }
    }
    count
}

fn refusal(seed: u64, problems: &[Diagnostic]) -> String {
    let errors = problems
        .iter()
        .filter(|p| p.severity == fam_soft_plc::Severity::Error);
    let shown: String = errors.take(8).map(ToString::to_string).collect();
    format!("seed {seed}: the checker refuses the project\n{shown}")
}

/// The difference in the smallest project that still shows one.
fn report(
    engine: &Engine,
    seed: u64,
    generated: &Generated,
    name: &str,
    which: i64,
    what: &str,
) -> String {
    eprintln!("seed {seed}: {what}; the project is made smaller");
    let kind = |text: &str| text.contains("the program ran to");
    let wanted = kind(what);
    let again = |built: &Built| match compare::run(engine, built, name, which, seed, SCANS) {
        Outcome::Different(text) => Some(text),
        _ => None,
    };
    // A program that the compiled project no longer calls would differ for that reason alone.
    let call = format!("{name}();");
    let fails = |tree: &Piece| {
        let text = tree.render();
        if !text.contains(&call) {
            return false;
        }
        let built = compare::build(engine, &text);
        built.is_ok_and(|b| again(&b).is_some_and(|text| kind(&text) == wanted))
    };
    // The other programs go first: they cost the most time.
    let mut tree = generated.tree.clone();
    let other = |p: &Piece| p.open.starts_with("PROGRAM P") && p.open != format!("PROGRAM {name}");
    tree.inner.retain(|piece| !other(piece));
    if let Some(calls) = tree.inner.last_mut().and_then(|m| m.inner.last_mut()) {
        calls
            .inner
            .retain(|line| line.open.ends_with(&format!(" {name}();")));
    }
    let small = shrink(if fails(&tree) { &tree } else { &generated.tree }, fails).render();
    let shown = compare::build(engine, &small)
        .ok()
        .and_then(|b| again(&b))
        .unwrap_or_else(|| what.to_owned());
    format!("seed {seed}: {shown}\n{small}")
}
