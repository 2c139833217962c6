//! Values as people write them, CSV both ways, and what can be set.

use super::*;
use crate::testing;
use proptest::prelude::*;

#[test]
fn values_are_read_as_engineers_write_them() {
    for (text, bits, want) in [
        ("TRUE", 1, Some(1)),
        ("false", 1, Some(0)),
        ("2", 1, None),
        ("-1", 1, None),
        ("255", 8, Some(255)),
        ("256", 8, None),
        ("-1", 8, Some(255)),
        ("-128", 8, Some(128)),
        ("-129", 8, None),
        ("16#FF", 8, Some(255)),
        ("0xfF", 16, Some(255)),
        ("2#1010", 8, Some(10)),
        ("1_000", 16, Some(1000)),
        ("2.5", 16, None),
        ("2.5", 32, None),
        ("18446744073709551615", 64, Some(u64::MAX)),
        ("-9223372036854775808", 64, Some(1 << 63)),
        ("", 8, None),
        ("no", 8, None),
    ] {
        let found = parse_value(text, bits, Number::Unsigned);
        assert_eq!(found.clone().ok(), want, "{text} in {bits} bits: {found:?}");
        if let Err(words) = found {
            assert!(words.contains("expected"), "{words}");
        }
    }
}

#[test]
fn real_and_signed_points_are_read_and_written_as_what_they_are() {
    for (text, bits, number, want, back) in [
        ("2.5", 32, Number::Real, u64::from(2.5_f32.to_bits()), "2.5"),
        ("20", 32, Number::Real, u64::from(20_f32.to_bits()), "20"),
        ("-1e3", 64, Number::Real, (-1e3_f64).to_bits(), "-1000"),
        ("16#3F800000", 32, Number::Real, 0x3F80_0000, "1"),
        ("-5", 16, Number::Signed, 0xFFFB, "-5"),
        ("-1", 64, Number::Signed, u64::MAX, "-1"),
        ("65531", 16, Number::Unsigned, 0xFFFB, "65531"),
    ] {
        let value = parse_value(text, bits, number).unwrap();
        assert_eq!(value, want, "{text}");
        let point = IoPoint {
            name: "P".to_owned(),
            direction: Direction::Point,
            bits,
            value,
            number,
            fresh: true,
            place: String::new(),
        };
        assert_eq!(value_text(&point), back);
        assert_eq!(parse_value(&value_text(&point), bits, number), Ok(value));
    }
    let words = parse_value("warm", 32, Number::Real).unwrap_err();
    assert!(words.contains("expected a real number"), "{words}");
}

proptest! {
    #[test]
    fn csv_comes_back(points in prop::collection::btree_map("[A-Za-z_.,\" ]{1,12}", any::<u64>(), 0..6)) {
        let points: Vec<IoPoint> = points.iter().filter(|(name, _)| name.trim() == name.as_str()).map(|(name, value)| IoPoint {
            name: name.clone(), direction: Direction::Point, bits: 64, value: *value, number: Number::Unsigned, fresh: true, place: String::new(),
        }).collect();
        let want: BTreeMap<String, String> = points.iter().map(|p| (p.name.clone(), p.value.to_string())).collect();
        prop_assert_eq!(from_csv(&to_csv(&points)), Ok(want));
    }

    #[test]
    fn no_text_is_read_with_a_panic(text in ".{0,200}", bits in prop::sample::select(vec![1_u32, 8, 16, 32, 64])) {
        let _ = from_csv(&text);
        for number in [Number::Unsigned, Number::Signed, Number::Real] {
            let _ = parse_value(&text, bits, number);
        }
    }
}

#[test]
fn bad_csv_is_refused_with_its_line() {
    for (text, words) in [
        ("", "is empty"),
        ("a,b\n", "expected the columns `name` and `value`"),
        (
            "name,value\nX,1\n\n# note\nX,2\n",
            "line 5: `X` stands there twice",
        ),
        ("name,value\nX\n", "line 2: expected 2 columns, found 1"),
    ] {
        let found = from_csv(text).unwrap_err();
        assert!(found.contains(words), "{text:?}: {found}");
    }
}

#[test]
fn points_are_set_all_or_none_and_only_inputs() {
    let cell = testing::cell();
    let gateway = testing::gateway_id();
    let points = Arc::new(Points::new(&cell, &gateway));
    let view = IoView::new(&cell, &gateway, Some(Arc::clone(&points)));
    let set = |pairs: &[(&str, &str)]| {
        let values = pairs
            .iter()
            .map(|(n, v)| ((*n).to_owned(), (*v).to_owned()));
        view.answer(&IoRequest::Set(values.collect()))
    };
    let answer = set(&[("I", "16#0201")]).unwrap();
    assert_eq!((answer[0].name.as_str(), answer[0].value), ("I", 0x0201));
    assert_eq!(points.inputs()[0].bytes, [1, 2, 0, 0]);
    for (pairs, words) in [
        (&[("I", "7"), ("Q", "1")][..], "`Q` is an output"),
        (&[("I", "7"), ("Z", "1")], "no point `Z`"),
        (&[("I", "70000")], "does not fit"),
    ] {
        let text = set(pairs).unwrap_err();
        assert!(text.contains(words), "{text}");
        assert_eq!(points.all()["I"].value, 0x0201, "nothing was set");
    }
    points.apply(&testing::mc_id(), &[1, 0]);
    assert_eq!(points.all()["Q"].value, 1);

    view.outputs(testing::mc_id(), vec![1, 0].into());
    let names: Vec<_> = view
        .answer(&IoRequest::Get(vec!["Station1".to_owned()]))
        .unwrap()
        .into_iter()
        .map(|p| (p.name, p.direction, p.value, p.place))
        .collect();
    assert_eq!(
        names,
        [
            (
                "Station1.I".to_owned(),
                Direction::Input,
                0,
                "image:I".to_owned()
            ),
            (
                "Station1.Q".to_owned(),
                Direction::Output,
                1,
                "image:Q".to_owned()
            ),
        ]
    );
    let text = view
        .answer(&IoRequest::Get(vec!["Stat".to_owned()]))
        .unwrap_err();
    assert!(text.contains("`Stat`"), "{text}");
}
