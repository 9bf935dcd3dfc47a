//! `map`: logs of one motor as ten programs and instruments write them; what is proposed identifies the motor.

use crate::kit::motor_log::{Bench, Row, steps};
use crate::kit::prelude::*;
use std::f64::consts::TAU;

/// Supply of the bridge, V, and pole pairs of the motor.
const SUPPLY_V: f64 = 80.0;
const POLE_PAIRS: f64 = 7.0;
const RPM: f64 = 60.0 / TAU;

/// A form of a log: lines before the rows, one row, and what the user has to add.
struct Form {
    name: &'static str,
    head: &'static str,
    row: fn(&Row) -> String,
    numbers: &'static str,
    /// Least confidence: the last word of the card's verdict.
    verdict: &'static str,
}

const VESC: &str = "ms_today;input_voltage;temp_mos_max;temp_mos_1;temp_mos_2;temp_mos_3;temp_motor;current_motor;current_in;d_axis_current;q_axis_current;erpm;duty_cycle;amp_hours_used;amp_hours_charged;watt_hours_used;watt_hours_charged;tachometer;tachometer_abs;encoder_position;fault_code;vesc_id;d_axis_voltage;q_axis_voltage;\n";

fn vesc([t, u, i, w, angle]: &Row) -> String {
    let supply = SUPPLY_V - 0.02 * i * u / SUPPLY_V;
    let duty = u / supply;
    format!(
        "{:.0};{supply:.4};31.2;0;0;0;25.0;{i:.4};{:.4};0;{i:.4};{:.2};{duty:.6};0;0;0;0;{:.0};0;0;0;1;0;0;",
        43_200_000.0 + 1e3 * t,
        i * duty,
        w * RPM * POLE_PAIRS,
        angle / TAU * 6.0 * POLE_PAIRS
    )
}

const FORMS: &[Form] = &[
    Form { name: "VESC Tool", head: VESC, row: vesc, numbers: "POLE_PAIRS=7", verdict: "SURE" },
    Form {
        name: "ODrive",
        head: "timestamp,odrv0.vbus_voltage,odrv0.axis0.encoder.pos_estimate,odrv0.axis0.encoder.vel_estimate,odrv0.axis0.motor.current_control.Iq_measured,odrv0.axis0.motor.current_control.Iq_setpoint,odrv0.axis0.motor.foc.mod_q\n",
        row: |[t, u, i, w, angle]| {
            let mod_q = 1.5 * u / SUPPLY_V;
            format!("{t},{SUPPLY_V},{},{},{i},0,{mod_q}", angle / TAU, w / TAU)
        },
        numbers: "",
        verdict: "LIKELY",
    },
    Form {
        name: "moteus",
        head: "timestamp,servo_stats.mode,servo_stats.filt_bus_V,servo_stats.position,servo_stats.velocity,servo_stats.torque_Nm,servo_stats.q_A,servo_stats.d_A,servo_control.q_V,servo_control.d_V\n",
        row: |[t, u, i, w, angle]| {
            let (turns, speed) = (angle / TAU, w / TAU);
            format!("{t},10,24.1,{turns},{speed},{},{i},0.01,{u},0", 0.3538 * i)
        },
        numbers: "",
        verdict: "LIKELY",
    },
    Form {
        name: "PlotJuggler",
        head: "__time,/drive/current,/drive/voltage,/joint_states/joint_1/position,/joint_states/joint_1/velocity\n",
        row: |[t, u, i, w, angle]| format!("{:.4},{i},{u},{angle},{w}", 1.714e9 + t),
        numbers: "",
        verdict: "LIKELY",
    },
    Form {
        name: "German",
        head: "Zeit [ms];Ankerspannung [V];Motorstrom [mA];Istdrehzahl [U/min];Temperatur [\u{b0}C]\n",
        row: |[t, u, i, w, _]| {
            format!("{:.1};{u};{:.2};{:.4};25.5", 1e3 * t, 1e3 * i, w * RPM).replace('.', ",")
        },
        numbers: "",
        verdict: "SURE",
    },
    Form {
        name: "French, without units of voltage and current",
        head: "temps (s)\ttension\tcourant\tvitesse (tr/min)\tconsigne (tr/min)\n",
        row: |[t, u, i, w, _]| format!("{t}\t{u}\t{i}\t{}\t500", w * RPM),
        numbers: "",
        verdict: "LIKELY",
    },
    Form {
        name: "Spanish, current reversed",
        head: "tiempo_ms,voltaje_V,corriente_A,velocidad_rad_s\n",
        row: |[t, u, i, w, _]| format!("{},{u},{},{w}", 1e3 * t, -i),
        numbers: "",
        verdict: "LIKELY",
    },
    // Of instruments: the current by a probe, the speed by a tachometer of 50 rad/s for one volt.
    Form {
        name: "PicoScope",
        head: "Time,Channel A,Channel B,Channel C\n(ms),(V),(A),(V)\n\n",
        row: |[t, u, i, w, _]| format!("{},{u},{i},{}", 1e3 * t, w / 50.0),
        numbers: "RAD_S_PER_VOLT=50",
        verdict: "LIKELY",
    },
    Form {
        name: "Keysight",
        head: "x-axis,1,2,3\nsecond,Volt,Ampere,Volt\n",
        row: |[t, u, i, w, _]| format!("{t:+.6E},{:+.6E},{i:+.6E},{u:+.6E}", w / 50.0),
        numbers: "RAD_S_PER_VOLT=50",
        verdict: "LIKELY",
    },
    Form {
        name: "Tektronix, scaled to A and rad/s",
        head: "Model,MSO24\nFirmware Version,1.22\nPoint Format,Y,,\nHorizontal Units,S,,\nSample Interval,0.005,,\nLabel,,,\nTIME,CH1,CH2,CH3\n",
        row: |[t, u, i, w, _]| format!("{t:.6e},{u:.5e},{i:.5e},{w:.5e}"),
        numbers: "",
        verdict: "UNSURE",
    },
    Form {
        name: "Siglent",
        head: "Record Length,Analog:1600\nSample Interval,0.005000000\nVertical Units,V,A,V\nSource,CH1,CH2,CH3\nSecond,Volt,Ampere,Volt\n",
        row: |[t, u, i, w, _]| format!("{t:.6},{u:.5},{i:.5},{:.5}", w / 50.0),
        numbers: "RAD_S_PER_VOLT=50",
        verdict: "LIKELY",
    },
    Form {
        name: "Rigol",
        head: "X,CH1,CH2,CH3,Start,Increment\nSequence,Volt,Ampere,Volt,0,0.005\n",
        row: |[t, u, i, w, _]| format!("{:.0},{u},{i},{},,", t / 0.005, w / 50.0),
        numbers: "RAD_S_PER_VOLT=50",
        verdict: "LIKELY",
    },
    Form {
        name: "a microcontroller",
        head: "millis,pwm,vbat,current,rpm\n",
        row: |[t, u, i, w, _]| {
            format!("{:.0},{:.4},{SUPPLY_V},{i:.4},{:.3}", 1e3 * t, 255.0 * u / SUPPLY_V, w * RPM)
        },
        numbers: "FULL_SCALE=255",
        verdict: "LIKELY",
    },
];

/// The map that is printed, and the whole answer.
fn proposed(file: &Path, numbers: &str) -> Value {
    let mut arguments = line("map {} --json", &[file]);
    if !numbers.is_empty() {
        arguments.extend(["--number".into(), numbers.into()]);
    }
    drivebench(arguments).json()
}

fn text_of(form: &Form, rows: &[Row]) -> String {
    let mut text = form.head.to_owned();
    for row in rows {
        let _ = writeln!(text, "{}", (form.row)(row));
    }
    text
}

#[test]
fn the_proposed_map_of_ten_forms_identifies_the_motor() {
    let (desk, rows) = (Desk::new(), Bench::PAPER_A.record(steps));
    for form in FORMS {
        let text = text_of(form, &rows);
        let file = desk.put("log.csv", &text);
        let found = proposed(&file, form.numbers);
        let name = form.name;
        assert_eq!(found["confidence"], form.verdict.to_lowercase(), "{name}: {found:#}");
        let map = found["map"].as_str().unwrap_or_else(|| panic!("{name}: {found:#}"));
        let mut arguments = line("identify {} --json --map", &[&file]);
        arguments.push(map.into());
        let model = drivebench(arguments).expect(0).json();
        for (key, truth) in
            [("resistance_ohm", 1.1), ("back_emf_v_s_per_rad", 0.3538), ("inertia_kg_m2", 0.0045)]
        {
            let value = parameter(&model, key).unwrap_or(f64::NAN);
            assert!((value / truth - 1.0).abs() < 0.05, "{name}: {key} {value}, {map}");
        }
    }
}

#[test]
fn without_a_map_the_error_names_the_command_and_a_sure_map() {
    let (desk, rows) = (Desk::new(), Bench::PAPER_A.record(steps));
    let rows = &rows[..200];
    for (form, is_sure) in [(&FORMS[4], true), (&FORMS[3], false)] {
        desk.put("log.csv", &text_of(form, rows));
        for command in ["identify", "compare", "diagnose"] {
            let done = desk.call(&format!("{command} log.csv")).expect(2);
            has(&done.error(), &["`drivebench map log.csv` proposes"]);
            assert_eq!(done.error().contains("it is sure of --map"), is_sure, "{}", done.error());
        }
    }
    let own = desk.put("own.csv", "time_s,voltage_v\n0,1\n1,x\n");
    lacks(&refusal("identify {}", &[&own]), &["drivebench map"]);
    call("map {}", &[&own]).expect(0);
}

#[test]
fn a_map_that_is_not_whole_is_status_1_and_names_what_it_lacks() {
    let (desk, rows) = (Desk::new(), Bench::PAPER_A.record(steps));
    let vesc = desk.put("log.csv", &text_of(&FORMS[0], &rows[..400]));
    let done = call("map {}", &[&vesc]).expect(1);
    has(
        &done.stdout,
        &[
            "UNSURE",
            "erpm*{0.104719755/POLE_PAIRS}",
            "half the number of its magnets",
            "--number POLE_PAIRS=VALUE",
        ],
    );
    has(&done.error(), &["speed_rad_s needs POLE_PAIRS"]);
    let few = desk.put("few.csv", "colour,shape\n1,2\n2,1\n1,3\n2,2\n");
    call("map {}", &[&few]).fails(1, &["no map", "a time"]);
    let found = call("map {} --json", &[&few]).expect(1).json();
    assert_eq!(found["missing"][0]["code"], "no_time");
    assert_eq!(found["items"][0]["doubts"][0]["code"], "another_column_fits_as_well");
    call("map {}", &[&desk.path("none.csv")]).fails(2, &["none.csv"]);
    refusals("map log.csv --number POLES=7 => POLE_PAIRS", &[]);
}
