//! Every decoder under random and under mutated bytes, on the stable toolchain: what the fuzz targets do at length.

use fam_hostile::{MODEL_TARGETS, TARGETS, Target, seeds};
use proptest::prelude::*;
use std::path::Path;

fn targets() -> impl Iterator<Item = Target> {
    TARGETS.into_iter().chain(MODEL_TARGETS)
}

#[test]
fn every_seed_is_stood() {
    for (name, target) in targets() {
        let seeds = seeds::of(name);
        assert!(seeds.len() > 1, "{name} has no seeds");
        for seed in seeds {
            target(&seed);
        }
        target(&[]);
    }
}

/// What a fuzzer has once found, and the inputs that it starts from.
#[test]
fn everything_in_the_corpus_is_stood() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus");
    let mut inputs = 0;
    for (name, target) in targets() {
        let folder = corpus.join(name);
        for entry in
            std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        {
            target(&std::fs::read(entry.unwrap().path()).unwrap());
            inputs += 1;
        }
    }
    assert!(inputs > 50, "{inputs}");
}

fn stands(name: &str, random: bool) {
    let (_, target) = targets().find(|(n, _)| *n == name).unwrap();
    let seeds = seeds::of(name);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig {
        cases: 1_500,
        failure_persistence: None,
        ..ProptestConfig::default()
    });
    let flips = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8);
    let mutated = (0..seeds.len(), flips, any::<prop::sample::Index>(), 0..4u8);
    let words = |error: String| panic!("{name}: {error}");
    if random {
        let bytes = prop::collection::vec(any::<u8>(), 0..400);
        let result = runner.run(&bytes, |bytes| {
            target(&bytes);
            Ok(())
        });
        return result.unwrap_or_else(|error| words(error.to_string()));
    }
    let result = runner.run(&mutated, |(seed, flips, cut, how)| {
        let mut bytes = seeds[seed].clone();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        match how {
            0 => bytes.truncate(cut.index(bytes.len()) + 1),
            1 => bytes.extend_from_within(cut.index(bytes.len())..),
            _ => {}
        }
        target(&bytes);
        Ok(())
    });
    result.unwrap_or_else(|error| words(error.to_string()));
}

macro_rules! stands {
    ($($name:ident),*) => {$(
        #[test]
        fn $name() {
            stands(stringify!($name), true);
            stands(stringify!($name), false);
        }
    )*};
}

stands!(
    message,
    frame,
    checkpoint,
    image,
    piece,
    records,
    repository,
    diagnosis,
    agents,
    caex,
    amlx,
    plcopen,
    diagnosis_file
);
