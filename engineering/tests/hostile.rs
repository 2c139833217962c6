//! Readers under damaged input: whatever is done to a file, what comes is an error or a model, never a panic.

mod common;

use common::two_stations;
use fam_engineering::caex::container;
use fam_engineering::convert::{Form, convert};
use fam_engineering::model::open::open_bytes;
use fam_engineering::model::resolve::resolve;
use fam_engineering::plcopen::{diagnosis_file, mc_source, project_xml};
use fam_engineering::{build, import};
use fam_soft_plc::source::SourceFile;
use proptest::prelude::*;
use proptest::sample::Index;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;

static FILES: LazyLock<BTreeMap<String, String>> = LazyLock::new(|| {
    convert(&two_stations(), "cell.aml", &Form::Caex { library: None })
        .unwrap()
        .files
});

static GENERATED: LazyLock<[String; 2]> = LazyLock::new(|| {
    let built = build(&two_stations()).unwrap();
    [
        project_xml(&built, &built.model.controllers[0].controller),
        diagnosis_file::write(&built.mcs[0]),
    ]
});

/// One way to damage a text.
#[derive(Debug, Clone)]
enum Damage {
    Cut(Index, usize),
    Copy(Index, Index, usize),
    Put(Index, String),
}

fn damage() -> impl Strategy<Value = Vec<Damage>> {
    let words = prop::sample::select(vec![
        "<",
        ">",
        "\"",
        "&lt;",
        "&x;",
        "/>",
        "<Attribute Name=\"a\">",
        "</InternalElement>",
        "ID=\"1\"",
        "#",
        "%zz",
        "../",
        "\u{0}",
        "ä",
        "{",
        "}",
        ":",
        "@",
        "9999999999999999999999",
        "-1",
        "NaN",
        "",
        "Name=\"\"",
        "<!DOCTYPE a>",
        "<![CDATA[",
        "]]>",
    ]);
    let one = prop_oneof![
        (any::<Index>(), 1usize..400).prop_map(|(at, len)| Damage::Cut(at, len)),
        (any::<Index>(), any::<Index>(), 1usize..400)
            .prop_map(|(from, to, len)| Damage::Copy(from, to, len)),
        (any::<Index>(), words).prop_map(|(at, word)| Damage::Put(at, word.to_owned())),
    ];
    prop::collection::vec(one, 1..4)
}

fn damaged(text: &str, how: &[Damage]) -> String {
    let mut chars: Vec<char> = text.chars().collect();
    for damage in how {
        let len = chars.len().max(1);
        let piece = |at: &Index, n: usize| at.index(len)..(at.index(len) + n).min(chars.len());
        match damage {
            Damage::Cut(at, n) => {
                let range = piece(at, *n);
                if range.start <= range.end {
                    chars.drain(range);
                }
            }
            Damage::Copy(from, to, n) => {
                let range = piece(from, *n);
                let copied: Vec<char> = chars.get(range).unwrap_or_default().to_vec();
                let at = to.index(len).min(chars.len());
                chars.splice(at..at, copied);
            }
            Damage::Put(at, word) => {
                let at = at.index(len).min(chars.len());
                chars.splice(at..at, word.chars());
            }
        }
    }
    chars.into_iter().collect()
}

fn read_model(bytes: &[u8]) {
    let opened = open_bytes(Path::new("/nowhere/cell.aml"), bytes);
    for problem in &opened.problems {
        assert!(!problem.to_string().is_empty());
    }
    if let Some(file) = opened.file {
        let (_, problems) = resolve(file, opened.text, opened.problems);
        for problem in problems {
            assert!(!problem.to_string().is_empty());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn caex(how in damage()) {
        read_model(damaged(&FILES["cell.aml"], &how).as_bytes());
    }

    #[test]
    fn containers(how in prop::collection::vec((any::<Index>(), any::<u8>()), 1..4), text in damage()) {
        let mut files = FILES.clone();
        let model = damaged(&files["cell.aml"], &text);
        files.insert("cell.aml".to_owned(), model);
        let mut bytes = container::pack(&files, "cell.aml");
        for (at, value) in how {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        read_model(&bytes);
    }

    #[test]
    fn plcopen(how in damage()) {
        let text = damaged(&FILES["feeder.xml"], &how);
        let _ = import::model(&[SourceFile::new("feeder.xml", text)], "cell.aml");
        let _ = mc_source(&damaged(&GENERATED[0], &how), "Feeder");
    }

    #[test]
    fn diagnosis_files(how in damage()) {
        let _ = diagnosis_file::read(&damaged(&GENERATED[1], &how));
    }

    #[test]
    fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        read_model(&bytes);
    }
}
