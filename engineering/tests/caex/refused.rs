//! Files that nobody should send, in every place where a model takes a file: what is said of each, and that it is said soon.

use super::{LOGIC, OLD, OWN, old_model};
use fam_engineering::build;
use fam_engineering::caex::zip;
use flate2::write::DeflateEncoder;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::Path;

/// Where a model takes files: the path, and how messages name it.
const PLACES: [(&str, &[&str]); 3] = [
    ("old.aml", &["error[M103]", "old.aml", "AutomationML model"]),
    (
        "lib/Own.aml",
        &[
            "error[M804]",
            "old.aml:4",
            "the library `Own`: `lib/Own.aml`",
        ],
    ),
    (
        "the logic/m.xml",
        &[
            "error[M209]",
            "old.aml:",
            "old/M/logic",
            "`the logic/m.xml`",
        ],
    ),
];

/// Problems of the model after a change of its folder.
fn after(change: impl FnOnce(&Path)) -> String {
    let dir = tempfile::tempdir().unwrap();
    let model = old_model(dir.path());
    change(dir.path());
    match build(&model) {
        Ok(_) => "it was built".to_owned(),
        Err(problems) => problems.to_string(),
    }
}

fn told(what: &str, problems: &str, parts: &[&str]) {
    for part in parts {
        assert!(
            problems.contains(part),
            "{what}: expected `{part}` in:\n{problems}"
        );
    }
}

#[test]
fn what_cannot_be_read_is_named_with_its_place() {
    for (path, parts) in PLACES {
        let problems = after(|dir| {
            std::fs::remove_file(dir.join(path)).unwrap();
            std::fs::create_dir(dir.join(path)).unwrap();
        });
        told("a directory", &problems, parts);
        told("a directory", &problems, &["directory"]);

        let problems = after(|dir| std::fs::remove_file(dir.join(path)).unwrap());
        told("nothing", &problems, parts);

        let problems = after(|dir| {
            let file = std::fs::File::create(dir.join(path)).unwrap();
            file.set_len(300 << 20).unwrap();
        });
        told("300 MB", &problems, parts.get(..2).unwrap_or(parts));
        told(
            "300 MB",
            &problems,
            &["300 MB, more than the 64 MB that are read", "divide"],
        );

        let mut readable = false;
        let problems = after(|dir| {
            let file = dir.join(path);
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o000)).unwrap();
            readable = std::fs::read(&file).is_ok();
        });
        if readable {
            eprintln!("passed over: this user may read everything");
        } else {
            told("no permission", &problems, parts);
            told("no permission", &problems, &["denied"]);
        }
    }
}

#[test]
fn links_out_of_the_folder_are_not_followed() {
    let outside = tempfile::tempdir().unwrap();
    for (name, text) in [("m.xml", LOGIC), ("Own.aml", OWN)] {
        std::fs::write(outside.path().join(name), text).unwrap();
    }
    for (path, name) in [("the logic/m.xml", "m.xml"), ("lib/Own.aml", "Own.aml")] {
        let problems = after(|dir| {
            std::fs::remove_file(dir.join(path)).unwrap();
            symlink(outside.path().join(name), dir.join(path)).unwrap();
        });
        told(
            path,
            &problems,
            &[" leaves the model's folder", path, "--root DIR"],
        );
        // The folder may be the link as well.
        let problems = after(|dir| {
            let folder = dir.join(path).parent().unwrap().to_owned();
            std::fs::remove_dir_all(&folder).unwrap();
            symlink(outside.path(), &folder).unwrap();
        });
        told(path, &problems, &[" leaves the model's folder", path]);
    }
    // Links in a circle.
    let problems = after(|dir| {
        std::fs::remove_file(dir.join("lib/Own.aml")).unwrap();
        symlink("Own.aml", dir.join("lib/Own.aml")).unwrap();
    });
    told("a circle", &problems, &["error[M804]", "cannot be read"]);
}

/// Entities that double ten times over.
fn expanding(text: &str) -> String {
    let mut entities = String::from("<!ENTITY e0 \"ha\">");
    for n in 1..40 {
        entities += &format!("<!ENTITY e{n} \"&e{0};&e{0};\">", n - 1);
    }
    let (declaration, rest) = text.split_once("?>").unwrap();
    format!(
        "{declaration}?><!DOCTYPE x [{entities}]>{}",
        rest.replacen("</", "&e39;</", 1)
    )
}

fn files() -> BTreeMap<String, String> {
    let named = [
        ("old.aml", OLD),
        ("lib/Own.aml", OWN),
        ("the logic/m.xml", LOGIC),
    ];
    named.map(|(n, t)| (n.to_owned(), t.to_owned())).into()
}

/// A container with these parts, whose model is `old.aml`.
fn container(files: &BTreeMap<String, String>, more: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let whole = fam_engineering::caex::container::pack(files, "old.aml");
    let limits = zip::Limits {
        parts: 100,
        part_bytes: 1 << 27,
        all_bytes: 1 << 28,
    };
    let mut parts = zip::unpack(&whole, limits).unwrap();
    parts.extend(more.iter().map(|(n, b)| ((*n).to_owned(), b.clone())));
    zip::pack(&parts)
}

/// A small container with so many parts that unpack to so many MB each.
fn bomb(mb: usize, parts: usize) -> Vec<u8> {
    let content = vec![b' '; mb << 20];
    let mut sum = flate2::Crc::new();
    sum.update(&content);
    let mut encoder = DeflateEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(&content).unwrap();
    let packed = encoder.finish().unwrap();
    let names: Vec<String> = (0..parts).map(|n| format!("big{n}")).collect();
    let more: Vec<(&str, Vec<u8>)> = names.iter().map(|n| (n.as_str(), packed.clone())).collect();
    let mut bytes = container(&files(), &more);
    assert!(bytes.len() < 1 << 20);
    // Entries of the directory with their method and checksum as of deflated parts.
    for at in 0..bytes.len() - 46 {
        if bytes[at..].starts_with(b"PK\x01\x02") && bytes[at + 46..].starts_with(b"big") {
            bytes[at + 10] = 8;
            bytes[at + 16..at + 20].copy_from_slice(&sum.sum().to_le_bytes());
        }
    }
    bytes
}

fn in_container(bytes: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cell.amlx");
    std::fs::write(&path, bytes).unwrap();
    match build(&path) {
        Ok(_) => "it was built".to_owned(),
        Err(problems) => problems.to_string(),
    }
}

#[test]
fn entities_expand_nowhere() {
    for (path, text) in files() {
        let code = if path.ends_with(".aml") {
            "error[M801]"
        } else {
            "error[E601]"
        };
        let problems = after(|dir| std::fs::write(dir.join(&path), expanding(&text)).unwrap());
        told(
            &path,
            &problems,
            &[code, &path, "document type", "<!DOCTYPE"],
        );
        let mut parts = files();
        parts.insert(path.clone(), expanding(&text));
        let problems = in_container(&container(&parts, &[]));
        told(&path, &problems, &[code, "document type"]);
    }
    let relationships = expanding("<?xml version=\"1.0\"?><Relationships></Relationships>");
    let problems = in_container(&container(
        &files(),
        &[("_rels/.rels", relationships.into_bytes())],
    ));
    told(
        "relationships",
        &problems,
        &["error[M813]", "`_rels/.rels`", "DTD"],
    );
}

#[test]
fn containers_keep_to_themselves_and_to_their_size() {
    assert_eq!(in_container(&container(&files(), &[])), "it was built");
    for name in [
        "../x",
        "a/../../x",
        "/etc/x",
        "C:\\x",
        "..\\x",
        "\\\\host\\x",
    ] {
        let problems = in_container(&container(&files(), &[(name, vec![b'x'])]));
        told(
            name,
            &problems,
            &["error[M813]", "cell.amlx", "outside of it", "leaves"],
        );
    }
    for (one, other) in [("a/x", "a//x"), ("a/x", "a\\x")] {
        let problems = in_container(&container(&files(), &[(one, vec![1]), (other, vec![2])]));
        told(other, &problems, &["error[M813]", "two parts of one path"]);
    }
    // 65 MB in one part, and 260 MB in several.
    let problems = in_container(&bomb(65, 1));
    told(
        "one part",
        &problems,
        &["error[M813]", "`big0` unpacks to more than 64 MB"],
    );
    let problems = in_container(&bomb(52, 5));
    told("many parts", &problems, &["error[M813]", "it is too large"]);
    // Cut off anywhere.
    let whole = container(&files(), &[]);
    for cut in [5, 100, whole.len() / 2, whole.len() - 30, whole.len() - 1] {
        let problems = in_container(&whole[..cut]);
        told(
            "cut",
            &problems,
            &["error[M813]", "cell.amlx", "expected: an .amlx file"],
        );
    }
}

#[test]
fn what_is_no_model_says_what_it_should_be() {
    for (bytes, parts) in [
        (
            &b""[..],
            &["error[M801]", "this is no XML", "begins with `<`"][..],
        ),
        (b"\xef\xbb\xbf", &["error[M801]", "this is no XML"]),
        (b"\x00\x00\x00\x00", &["error[M801]", "this is no XML"]),
        (
            b"\xff\xfe<\x00\x00",
            &["error[M103]", "no text in UTF-8 or UTF-16"],
        ),
        (
            b"<CAEXFile",
            &["error[M801]", "no well-formed XML", "old.aml:1"],
        ),
        (b"<a/><b/>", &["error[M801]", "no well-formed XML"]),
        (b"\x7fELF\x02\x01\xff", &["error[M103]", "no text"]),
    ] {
        let problems = after(|dir| std::fs::write(dir.join("old.aml"), bytes).unwrap());
        told(&format!("{bytes:?}"), &problems, parts);
    }
}
