use super::*;
use crate::recording::{ColumnMap, ReadOptions, read_preview};
use crate::testing::{cases, has};
use drivebench_model::plant::{Input, Plant, State, testing};
use drivebench_model::units::rpm_from_rad_s;
use proptest::prelude::*;
use std::fmt::Write as _;

/// Time, voltage, current, speed and angle of a motor under steps of both directions, 2 ms apart.
fn motor() -> Vec<[f64; 5]> {
    let model = Model::baseline(testing::motor("bench", &[1.2, 0.6e-3, 0.05, 4e-5, 0.012]));
    let levels = [0.0, 6.0, -9.0, 11.0, -5.0, 8.0].repeat(2);
    let events = levels.into_iter().enumerate().map(|(step, volts)| (0.5 * step as f64, volts));
    let times = (0..3000).map(|row| 0.002 * f64::from(row)).collect();
    let run = Scenario::planned("bench", Input::Voltage, Channel::Voltage, events.collect(), times);
    let out = Plant::new(&model, Input::Voltage).unwrap().simulate(&run, State::default());
    let mut angle = 0.0;
    let row = |(row, time_s): (usize, &f64)| {
        let (current, speed) = (out.current_a[row], out.speed_rad_s[row]);
        angle += 0.002 * speed;
        [*time_s, run.input_at(*time_s), current, speed, angle]
    };
    run.sample_time_s.iter().enumerate().map(row).collect()
}

fn proposal(head: &str, row: impl Fn(usize, &[f64; 5]) -> String) -> Proposal {
    proposal_with(head, row, &[])
}

fn proposal_with(
    head: &str,
    row: impl Fn(usize, &[f64; 5]) -> String,
    given: &[(&str, f64)],
) -> Proposal {
    let mut text = format!("{head}\n");
    for (place, values) in motor().iter().enumerate() {
        let _ = writeln!(text, "{}", row(place, values));
    }
    let preview =
        read_preview(text.as_bytes(), "log.csv", ReadOptions::default(), known_headers).unwrap();
    let given = given.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let found = propose(&preview, &given);
    let has_hole = found.holes().count() > 0;
    if let Some(map) = found.map.as_ref().filter(|_| !has_hole) {
        let parsed: Result<ColumnMap, _> = map.parse();
        assert!(parsed.is_ok(), "{map}: {parsed:?}");
    }
    found
}

/// Confidence and source of one quantity.
fn of(found: &Proposal, target: &str) -> String {
    let item = found.items.iter().find(|item| item.target == target);
    item.map_or_else(String::new, |item| format!("{} {}", item.confidence.code(), item.source))
}

#[test]
fn a_unit_that_nothing_shows_is_unsure() {
    let found =
        proposal("Time,Voltage,Current,Speed", |_, [t, u, i, w, _]| format!("{t},{u},{i},{w}"));
    assert_eq!(found.confidence(), Confidence::Unsure);
    assert_eq!(of(&found, "time_s"), "likely Time");
    assert_eq!(of(&found, "voltage_v"), "likely Voltage");
    assert_eq!(of(&found, "current_a"), "likely Current");
    assert_eq!(of(&found, "speed_rad_s"), "unsure Speed");
    has(format!("{found:?}"), "SpeedUnit { unit: \"rad/s\"");
    has(format!("{found:?}"), "BalanceHolds { resistance: 1.298");
    // With its unit it is sure.
    let found = proposal("Time (s),Voltage (V),Current (A),Speed (rpm)", |_, [t, u, i, w, _]| {
        format!("{t},{u},{i},{}", rpm_from_rad_s(*w))
    });
    assert_eq!(found.confidence(), Confidence::Sure, "{found:#?}");
    let map = found.map.unwrap();
    assert_eq!(
        map,
        "time_s=Time (s),voltage_v=Voltage (V),current_a=Current (A),speed_rad_s=Speed (rpm)*0.104719755"
    );
}

#[test]
fn balances_distinguish_columns_and_signs() {
    // Without names that are known: in another order, and a constant column between them.
    let found = proposal("a,b,c,d,e", |place, [t, u, i, w, _]| {
        format!("{w},{i},{t},7,{}", u + 1e-9 * place as f64)
    });
    assert_eq!(of(&found, "time_s"), "unsure c", "{found:#?}");
    assert_eq!(of(&found, "voltage_v"), "likely e");
    assert_eq!(of(&found, "current_a"), "likely b");
    assert_eq!(of(&found, "speed_rad_s"), "unsure a");
    assert!(!found.is_settled());
    for (sign, place) in [([-1.0, 1.0], "current_a"), ([1.0, -1.0], "speed_rad_s")] {
        let found = proposal("t_s,u_V,i_A,w_rad_s", |_, [t, u, i, w, _]| {
            format!("{t},{u},{},{}", sign[0] * i, sign[1] * w)
        });
        assert!(of(&found, place).ends_with("*-1"), "{found:#?}");
        assert_eq!(found.confidence(), Confidence::Likely);
        has(format!("{found:?}"), "Reversed {");
    }
    // A voltage that never changes drives no motor both ways.
    let found = proposal("t_s,u_V,i_A,w_rad_s", |_, [t, _, i, w, _]| format!("{t},36,{i},{w}"));
    assert_eq!(of(&found, "voltage_v"), "", "{found:#?}");
    // Two currents, one of them that of something else.
    let found =
        proposal("t_s,u_V,fan_current_A,motor_current_A,w_rad_s", |place, [t, u, i, w, _]| {
            format!("{t},{u},{},{i},{w}", 0.5 + 0.1 * (place as f64 * 0.7).sin())
        });
    assert!(of(&found, "current_a").ends_with("motor_current_A"), "{found:#?}");
    has(format!("{found:?}"), "Other { source: \"current_a=fan_current_A*sign(u_V)\" }");
}

#[test]
fn the_angle_shows_the_unit_of_the_speed() {
    let found = proposal("t_s,u_V,i_A,vel,pos_deg", |_, [t, u, i, w, angle]| {
        format!("{t},{u},{i},{},{}", rpm_from_rad_s(*w), angle.to_degrees())
    });
    assert_eq!(of(&found, "speed_rad_s"), "likely vel*0.104719755", "{found:#?}");
    // An electrical speed and an encoder.
    let found = proposal("t_s,u_V,i_A,erpm,encoder_deg", |_, [t, u, i, w, angle]| {
        format!("{t},{u},{i},{},{}", 7.0 * rpm_from_rad_s(*w), angle.to_degrees())
    });
    assert_eq!(of(&found, "speed_rad_s"), "likely erpm*0.014959965", "{found:#?}");
    has(format!("{found:?}"), "pairs: 7.0");
}

#[test]
fn programs_that_leave_the_unit_to_their_user_are_doubted() {
    let tau = std::f64::consts::TAU;
    let found = proposal(
        "timestamp,voltage,position,velocity,sysid-test-state",
        |_, [t, u, _, w, angle]| format!("{t},{u},{},{},dynamic-forward", angle / tau, w / tau),
    );
    assert_eq!(found.tool, Some("WPILib SysId"));
    assert_eq!(of(&found, "voltage_v"), "sure voltage");
    assert_eq!(of(&found, "speed_rad_s"), "unsure velocity*6.283185307", "{found:#?}");
    has(format!("{found:?}"), "SpeedUnit { unit: \"turns/s\"");
}

/// Header, source with a hole, name and value of its number, and the source that it gives.
const HOLES: &str = "
t_s,u_V,i_A,erpm | speed_rad_s=erpm*{0.104719755/POLE_PAIRS} | POLE_PAIRS | 7 | speed_rad_s=erpm*0.014959965
t_s,duty,i_A,w_rad_s | voltage_v=duty*{SUPPLY_V} | SUPPLY_V | 24 | voltage_v=duty*24
t_s,u_V,i_A,speed (counts/s) | speed_rad_s=speed (counts/s)*{6.283185307/COUNTS_PER_TURN} | COUNTS_PER_TURN | 628.3185307 | speed_rad_s=speed (counts/s)*0.01
sample,u_V,i_A,w_rad_s | time_s=sample*{PERIOD_S} | PERIOD_S | 0.002 | time_s=sample*0.002
";

#[test]
fn what_the_file_does_not_contain_is_a_hole() {
    for [head, hole, name, value, filled] in cases(HOLES) {
        let row = |_, [t, u, i, w, _]: &[f64; 5]| match name {
            "POLE_PAIRS" => format!("{t},{u},{i},{}", 7.0 * rpm_from_rad_s(*w)),
            "SUPPLY_V" => format!("{t},{},{i},{w}", u / 24.0),
            "COUNTS_PER_TURN" => format!("{t},{u},{i},{}", w * 100.0),
            _ => format!("{},{u},{i},{w}", (t / 0.002).round()),
        };
        let found = proposal(head, row);
        let map = found.map.clone().unwrap();
        assert!(map.contains(hole), "{head}: {map}");
        assert!(!found.is_settled(), "{head}");
        let named = found.holes().next().unwrap();
        assert!(named.name == name && !named.how.is_empty(), "{head}");
        let found = proposal_with(head, row, &[(name, value.parse().unwrap())]);
        let map = found.map.clone().unwrap();
        assert!(map.contains(filled) && found.is_settled(), "{head}: {map} {found:#?}");
    }
}

#[test]
fn supplies_duties_and_unsigned_signals() {
    // A voltage that only sags belongs to the supply: with a duty it is multiplied, without one it is no use.
    let supply = |i: f64| 24.0 - 0.1 * i.abs();
    let found =
        proposal("t_s,Voltage (V),duty (%),Current (A),Speed (rad/s)", |_, [t, u, i, w, _]| {
            format!("{t},{},{},{i},{w}", supply(*i), 100.0 * u / supply(*i))
        });
    assert_eq!(of(&found, "voltage_v"), "sure duty (%)*Voltage (V)*0.01", "{found:#?}");
    let found = proposal("t_s,Voltage (V),Speed (rad/s)", |_, [t, _, i, w, _]| {
        format!("{t},{},{w}", supply(*i))
    });
    assert_eq!(found.map, None);
    has(format!("{found:?}"), "SupplyVoltage { header");
    has(format!("{found:?}"), "missing: [Input]");
    // A speed without a sign takes that of the duty.
    let found = proposal("t_s,duty,vbus,i_A,w_rad_s", |_, [t, u, i, w, _]| {
        format!("{t},{},24,{i},{}", u / 24.0, w.abs())
    });
    assert_eq!(of(&found, "speed_rad_s"), "likely w_rad_s*sign(duty)", "{found:#?}");
    // So does a current by the set-point of the same motor.
    let head = "t_ms,m1setvel,m1vel,m1cur,m2setvel,m2vel,m2cur";
    let found = proposal(head, |_, [t, u, i, w, _]| {
        format!("{},{u},{w},{},{},{},{}", 1e3 * t, i.abs(), -u, -w, i.abs())
    });
    assert_eq!(of(&found, "current_a"), "likely m1cur*sign(m1setvel)", "{found:#?}");
    // A torque that a sensor of the reaction counts.
    let found =
        proposal("t_s,torque_Nm,w_rad_s", |_, [t, _, i, w, _]| format!("{t},{},{w}", -0.05 * i));
    assert_eq!(of(&found, "torque_n_m"), "likely torque_Nm*-1", "{found:#?}");
}

#[test]
fn clocks_by_their_values() {
    type Stamp = fn(f64) -> String;
    let cases: [(&str, Stamp, &str); 6] = [
        ("time", |t| format!("{}", 1e3 * t), "likely time*0.001"),
        ("time", |t| format!("{}", (1e3 * t).round() + 5000.0), "likely time*0.001"),
        ("timestamp", |t| format!("{:.4}", 1.714e9 + t), "sure timestamp"),
        ("timestamp", |t| format!("{:.0}", 1e3 * (1.714e9 + t)), "sure timestamp*0.001"),
        ("t_us", |t| format!("{:.0}", 1e6 * t), "sure t_us*0.000001"),
        ("zeit", |t| format!("{t:.3}"), "likely zeit"),
    ];
    for (header, stamp, expected) in cases {
        let head = format!("{header},u_V,i_A,w_rad_s");
        let found = proposal(&head, |_, [t, u, i, w, _]| format!("{},{u},{i},{w}", stamp(*t)));
        assert_eq!(of(&found, "time_s"), expected, "{found:#?}");
    }
    // A column of that name that falls is none.
    let found = proposal("time,u_V,i_A,w_rad_s", |place, [_, u, i, w, _]| {
        format!("{},{u},{i},{w}", place % 7)
    });
    assert_eq!(found.map, None);
    has(format!("{found:?}"), "NoClock {");
}

#[test]
fn two_motors_own_headers_and_equal_headers() {
    let found =
        proposal("t_s,m1_u_V,m1_i_A,m1_w_rad_s,m2_u_V,m2_i_A,m2_w_rad_s", |_, [t, u, i, w, _]| {
            format!("{t},{u},{i},{w},{u},{i},{w}")
        });
    let map = found.map.clone().unwrap();
    assert_eq!(
        map, "time_s=t_s,voltage_v=m1_u_V,current_a=m1_i_A,speed_rad_s=m1_w_rad_s",
        "{found:#?}"
    );
    has(format!("{found:?}"), r#"OtherMotor(["m2_u_V", "m2_i_A", "m2_w_rad_s"])"#);
    let own = proposal("time_s,voltage_v,current_a,speed_rad_s", |_, [t, u, i, w, _]| {
        format!("{t},{u},{i},{w}")
    });
    assert!(own.is_own && own.items.is_empty());
    let found =
        proposal("t_s,u_V,i_A,i_A,w_rad_s", |_, [t, u, i, w, _]| format!("{t},{u},{i},{i},{w}"));
    assert_eq!(found.map, None);
    has(format!("{found:?}"), "count: 2");
}

proptest! {
    #[test]
    fn any_table_gives_a_proposal_that_parses_or_an_error(
        head in prop::collection::vec("[a-zA-Z_ ]{0,12}|time|t_ms|u_V|i_A|rpm|duty|vbus|pos|erpm|\\PC{0,8}", 1..8),
        rows in prop::collection::vec(prop::collection::vec("-?[0-9]{1,3}|[0-9]\\.[0-9]e[0-9]{1,3}|[0-9]{2}:[0-9]{2}:[0-9]{2}||\\PC{0,4}", 1..8), 0..40),
    ) {
        let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        let text = format!("{}\n{}\n", head.join(","), rows.join("\n"));
        if let Ok(preview) = read_preview(text.as_bytes(), "log.csv", ReadOptions::default(), known_headers) {
            let found = propose(&preview, &BTreeMap::new());
            let is_whole = found.holes().count() == 0;
            if let Some(map) = found.map.filter(|_| is_whole) {
                prop_assert!(map.parse::<ColumnMap>().is_ok(), "{}", map);
            }
        }
    }
}

#[test]
fn headers_are_quoted_where_a_map_needs_it() {
    let found =
        proposal("t_s,\"u, V\",i*2 [A],w_rad_s", |_, [t, u, i, w, _]| format!("{t},{u},{i},{w}"));
    let map = found.map.unwrap();
    assert!(map.contains("voltage_v=\"u, V\",current_a=\"i*2 [A]\""), "{map}");
}
