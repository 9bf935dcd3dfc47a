use super::*;
use crate::drive::DriveProfile;

/// A map with a supply voltage of two registers, and what a drive shows that has 120 V, 0.03 A and a standing shaft.
fn map(bus: &str) -> RegisterMap {
    let text = DriveProfile::text("epulse50-dc").unwrap().replace(
        "[missing]",
        &format!(
            "[signals.bus]\naddress = 0x1220\n{bus}\nunit = \"V\"\nquantity = \"bus_voltage\"\norigin = \"measured\"\npoll = \"fast\"\n\n[missing]"
        ),
    );
    RegisterMap::parse("x.toml", &text).unwrap()
}

/// Windows by name; the others read zeros.
fn windows(map: &RegisterMap, known: &[(&str, Window)]) -> Vec<Window> {
    map.signals
        .iter()
        .map(|signal| {
            let zeros = || Some(vec![0; usize::from(signal.location.layout.registers())]);
            let given = known.iter().find(|(name, _)| *name == signal.name);
            given.map_or_else(
                || Window {
                    below: zeros(),
                    here: zeros(),
                    above: zeros(),
                },
                |(_, window)| window.clone(),
            )
        })
        .collect()
}

fn index(map: &RegisterMap, name: &str) -> usize {
    map.signals.iter().position(|s| s.name == name).unwrap()
}

fn picture<'a>(map: &'a RegisterMap, windows: &'a [Window]) -> Picture<'a> {
    Picture {
        map,
        windows,
        rated_current_a: None,
    }
}

#[test]
fn a_swapped_word_order_is_the_first_candidate_and_a_hypothesis() {
    let map = map("type = \"u32\"\nscale = 0.1\nword_order = \"low_first\"");
    let here = Window {
        here: Some(vec![0, 1200]),
        below: None,
        above: Some(vec![1200, 7]),
    };
    let windows = windows(&map, &[("bus", here)]);
    let picture = picture(&map, &windows);
    let bus = index(&map, "bus");
    assert_eq!(picture.reading(bus), Reading::Value(7_864_320.0));
    assert_eq!(picture.fits(bus, picture.reading(bus)), Some(false));
    let first = &picture.candidates(bus)[0];
    assert_eq!(first.change, "word_order = \"high_first\"");
    assert!((first.value - 120.0).abs() < 1e-9 && first.plausible);
    let best = &picture.hypotheses()[0];
    assert_eq!(best.change, "word_order = \"high_first\" everywhere");
    assert_eq!((best.plausible, best.as_written, best.judged), (3, 2, 3));
}

#[test]
fn an_address_one_beside_is_found_on_its_side() {
    let map = map("type = \"u16\"\nscale = 0.1");
    let beside = Window {
        below: Some(vec![9]),
        here: Some(vec![0]),
        above: Some(vec![1200]),
    };
    let windows = windows(&map, &[("bus", beside)]);
    let picture = picture(&map, &windows);
    let candidates = picture.candidates(index(&map, "bus"));
    assert!(
        candidates[0]
            .change
            .contains("one higher (base 0 instead of 1)")
    );
    assert!(candidates[0].plausible && (candidates[0].value - 120.0).abs() < 1e-9);
    // 0.9 V is no supply, and is told as what it would be.
    let lower = candidates
        .iter()
        .find(|c| c.change == "the address one lower (base 1 instead of 0)");
    assert!(!lower.unwrap().plausible);
    assert!(
        picture.hypotheses()[0]
            .change
            .starts_with("every address one higher")
    );
}

/// One register too high: the low word reads as the high one, and the other word is that of the next signal.
#[test]
fn a_register_of_another_signal_explains_less_than_an_address_one_lower() {
    let mut map = map("type = \"u32\"\nscale = 0.1");
    let (bus, current) = (index(&map, "bus"), index(&map, "current"));
    // The voltage's second register is that of the current.
    let next = map.signals[bus].location.address + 1;
    map.signals[current].location.address = next;
    map.signals[current].location.table = map.signals[bus].location.table;
    let here = Window {
        below: Some(vec![0, 1200]),
        here: Some(vec![1200, 0]),
        above: None,
    };
    // The current stands where it should: one lower is the voltage's register.
    let right = Window {
        below: Some(vec![1200]),
        here: Some(vec![0]),
        above: None,
    };
    let windows = windows(&map, &[("bus", here), ("current", right)]);
    let picture = picture(&map, &windows);
    assert_eq!(picture.fits(bus, picture.reading(bus)), Some(false));
    let candidates = picture.candidates(bus);
    assert!(
        candidates[0].plausible && candidates[0].change.starts_with("the address one lower"),
        "{candidates:?}"
    );
    let hypotheses = picture.hypotheses();
    assert_eq!(hypotheses[0].change, "the address one lower for bus alone");
    assert_eq!(hypotheses[0].plausible, hypotheses[0].as_written + 1);
}

#[test]
fn signs_and_bytes_are_tried_and_what_changes_nothing_is_no_candidate() {
    let map = map("type = \"u16\"");
    // -3 raw of a drive whose current is signed after all; 120 V with its bytes exchanged.
    let current = Window {
        here: Some(vec![0xFFFD]),
        ..Window::default()
    };
    let bus = Window {
        here: Some(vec![120_u16.swap_bytes()]),
        ..Window::default()
    };
    let mut unsigned = map.clone();
    let at = index(&map, "current");
    unsigned.signals[at].location.layout.kind = Kind::U16;
    let windows = windows(&map, &[("current", current), ("bus", bus)]);
    let picture = picture(&unsigned, &windows);
    let candidates = picture.candidates(at);
    assert_eq!(candidates[0].change, "type = \"i16\"");
    assert!((candidates[0].value + 0.3).abs() < 1e-9 && candidates[0].plausible);
    let candidates = picture.candidates(index(&map, "bus"));
    assert_eq!(candidates[0].change, "byte_order = \"low_first\"");
    assert!((candidates[0].value - 120.0).abs() < 1e-9);
    assert!(
        candidates.iter().all(|c| c.change != "type = \"i16\""),
        "{candidates:?}"
    );
}

#[test]
fn codes_ranges_and_refusals_are_no_values() {
    let map = map("type = \"u16\"\nvalid = [50, 900]\ninvalid = [0xFFFF]");
    let bus = index(&map, "bus");
    let read = |registers: Option<Vec<u16>>| {
        let window = Window {
            here: registers,
            ..Window::default()
        };
        let windows = windows(&map, &[("bus", window)]);
        let picture = picture(&map, &windows);
        (
            picture.reading(bus),
            picture.fits(bus, picture.reading(bus)),
        )
    };
    assert_eq!(read(Some(vec![0xFFFF])), (Reading::NotAvailable, None));
    assert_eq!(read(Some(vec![5])), (Reading::Outside(5.0), Some(false)));
    assert_eq!(read(None), (Reading::Unread, Some(false)));
    assert_eq!(read(Some(vec![120])), (Reading::Value(120.0), Some(true)));
}

#[test]
fn a_factor_is_read_with_the_same_change() {
    let map = DriveProfile::named("toshiba-vfs11")
        .unwrap()
        .registers
        .unwrap();
    // All registers one higher than the profile says: 5.7 A rated, current 1 % of it.
    let one_higher = |value: u16| Window {
        here: Some(vec![0]),
        above: Some(vec![value]),
        below: None,
    };
    let windows = windows(
        &map,
        &[
            ("rated_current", one_higher(57)),
            ("rated_voltage", one_higher(1100)),
            ("current", one_higher(100)),
        ],
    );
    let picture = picture(&map, &windows);
    let best = &picture.hypotheses()[0];
    assert!(
        best.change.starts_with("every address one higher"),
        "{best:?}"
    );
    assert_eq!((best.plausible, best.judged), (5, 5));
    assert_eq!(best.as_written, 3);
}
