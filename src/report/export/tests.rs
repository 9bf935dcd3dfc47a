//! Every target is run and compared with the simulation of the program itself.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::*;
use drivebench_control::{AntiWindup, Measured, Pi, SpeedController};
use drivebench_model::plant::effect::{self, CATALOGUE, define};
use drivebench_model::plant::testing::held;
use drivebench_model::plant::{
    ActiveEffect, Effect, Motor, ParameterRole, ParameterSpec, Scenario, State, Trajectory,
};
use drivebench_model::plant::{MapBin, MappedTorque, MappedValue, TorqueMap};
use drivebench_model::sample::Channel;

const END_S: f64 = 0.4;
const ROWS: usize = 201;

/// Steps both ways with rests, so that the shaft starts, reverses, stops and sticks.
fn events() -> Vec<(f64, f64)> {
    held([0.0, 0.02, 0.12, 0.24, 0.34], [0.0, 30.0, -25.0, 2.0, 0.0])
}

/// Samples of our own simulation for each row: short steps, so that what is compared with is the more exact.
const FINE: usize = 20;

fn scenario(fine: usize) -> Scenario {
    let samples = (ROWS - 1) * fine + 1;
    let step_s = END_S / (samples - 1) as f64;
    let times: Vec<f64> = (0..samples).map(|row| row as f64 * step_s).collect();
    Scenario {
        // No measured speed: the angle is that of the simulation, as in what is exported.
        speed_rad_s: vec![f64::NAN; samples],
        current_a: vec![f64::NAN; samples],
        ..Scenario::planned("export", Input::Voltage, Channel::VoltageCmd, events(), times)
    }
}

/// The voltage that is held from each row on.
fn voltages(scenario: &Scenario) -> Vec<f64> {
    let held = |time: &f64| {
        let after = scenario.events.partition_point(|event| event.0 <= *time + 1e-9);
        scenario.events[after.max(1) - 1].1
    };
    scenario.sample_time_s.iter().map(held).collect()
}

fn active(effect: &'static dyn Effect) -> ActiveEffect {
    let value = |spec: &ParameterSpec| match spec.role {
        ParameterRole::Coefficient => 2.0 * spec.scale,
        ParameterRole::Shape | ParameterRole::Choice => spec.guess(),
        ParameterRole::EventTime => 0.2,
    };
    let values: Vec<f64> = effect.parameters().iter().map(value).collect();
    ActiveEffect::with(effect, &values)
}

fn model(effects: Vec<ActiveEffect>) -> Model {
    // Light, so that it turns within the time of the test.
    Model { effects, ..Model::baseline(Motor::zk_22fc().with(MotorKey::Inertia, 0.0008)) }
}

fn of_the_catalogue(ids: &[&str]) -> Model {
    model(ids.iter().map(|id| active(effect::find(id).unwrap())).collect())
}

fn defined() -> Model {
    let own = "equation = \"torque\"\nexpression = \"(a + b*exp(-(w/9)^2))*sgn(w)\"\nparameters = { a = 0.1, b = 0.2 }";
    let curve = "equation = \"voltage\"\naxis = \"speed_rad_s\"\nknots = [-50.0, 0.0, 20.0]\nvalues = [-1.0, 0.5, 2.0]";
    let effects = [("custom", own), ("table", curve)].map(|(id, text)| {
        let (effect, values) = define(id, &text.parse().unwrap()).unwrap();
        ActiveEffect { effect, values }
    });
    model(effects.into())
}

/// The bare motor, models of several effects that hold every kind of term, and what users define.
fn few() -> Vec<(String, Model)> {
    let sets: [&[&str]; 3] = [
        &[],
        &["stribeck_friction", "lagged_load", "cogging", "inertia_change", "speed_filter"],
        &[
            "voltage_drop",
            "winding_heating",
            "inductance_saturation",
            "supply_sag",
            "load_dependent_friction",
            "current_filter",
            "speed_offset",
        ],
    ];
    let mut models: Vec<(String, Model)> = sets
        .iter()
        .enumerate()
        .map(|(number, ids)| (format!("set_{number}"), of_the_catalogue(ids)))
        .collect();
    models.push(("defined".to_owned(), defined()));
    models
}

/// Every effect that has a formula, alone, after the few.
fn all() -> Vec<(String, Model)> {
    let alone = CATALOGUE.iter().filter(|effect| effect.formula().is_some()).map(|effect| {
        let id = effect.card().id;
        (format!("only_{id}"), of_the_catalogue(&[id]))
    });
    few().into_iter().chain(alone).collect()
}

/// Compares the first rows of current and speed, for one model after the other, with our own simulation.
fn check(models: &[(String, Model)], printed: &str, rows: usize) {
    let numbers: Vec<f64> = printed
        .split_whitespace()
        .map(|word| word.parse().unwrap_or_else(|_| panic!("{word:?} in {printed:.300}")))
        .collect();
    assert_eq!(numbers.len(), models.len() * rows * 2, "{printed:.300}");
    for ((name, model), theirs) in models.iter().zip(numbers.chunks(2 * rows)) {
        let mut plant = Plant::new(model, Input::Voltage).unwrap();
        let Trajectory { current_a, speed_rad_s } =
            plant.simulate(&scenario(FINE), State::default());
        let columns: [(&str, &[f64], usize); 2] =
            [("current", &current_a, 0), ("speed", &speed_rad_s, 1)];
        for (signal, ours, column) in columns {
            let range = ours.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            let off = ours
                .iter()
                .step_by(FINE)
                .take(rows)
                .enumerate()
                .map(|(row, value)| (value - theirs[2 * row + column]).abs())
                .fold(0.0, f64::max);
            assert!(range > 1.0, "{name}: the {signal} stays at {range}");
            assert!(off < 1e-3 * range, "{name}: {signal} is off by {off} of {range}");
        }
    }
}

/// A reference and a measured speed for the regulator, which drive it into its limit and back.
fn loop_input(cycle: usize) -> (f64, f64) {
    let time = cycle as f64;
    (if (cycle / 60).is_multiple_of(2) { 40.0 } else { -10.0 }, 30.0 * (0.11 * time).sin())
}

const CYCLES: usize = 240;

fn regulator() -> Regulator {
    Regulator {
        gains: PiGains {
            proportional: 0.4,
            integral_time_s: 0.3,
            notch: None,
            reference_filter_s: 0.05,
        },
        holding: Holding { per_speed: 0.36, against: 1.4 },
        period_s: 0.01,
        leaving_s: 0.02,
        limit_v: 12.0,
    }
}

fn regulated() -> Vec<f64> {
    let Regulator { gains, holding, period_s, leaving_s, limit_v } = regulator();
    let mut pi = Pi::new(gains, AntiWindup::Hold, holding).leaving_after(leaving_s);
    let cycles = (0..CYCLES).map(|cycle| {
        let (reference, speed) = loop_input(cycle);
        let output = pi.step(reference, &Measured::at(speed), period_s).clamp(-limit_v, limit_v);
        pi.applied(output);
        output
    });
    cycles.collect()
}

fn check_regulator(printed: &str) {
    let ours = regulated();
    let cut = ours.iter().filter(|output| output.abs() >= 12.0).count();
    assert!((20..220).contains(&cut), "{cut} of {CYCLES} cycles at the limit");
    let theirs: Vec<f64> = printed.split_whitespace().map(|word| word.parse().unwrap()).collect();
    assert_eq!(theirs.len(), CYCLES);
    for (cycle, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
        assert!((ours - theirs).abs() < 1e-9, "cycle {cycle}: {ours} and {theirs}");
    }
}

fn export(name: &str, model: &Model) -> Export {
    Export::new(model, Some(regulator()), name, "A motor of a test").unwrap()
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

/// What a program prints; it must succeed without a message on stderr.
fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && errors.is_empty(), "{command:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// A program in strict C99.
fn compiled(folder: &Path, main: &str) -> PathBuf {
    let (source, program) = (write(folder, "main.c", main), folder.join("main"));
    let strict =
        ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wno-missing-field-initializers"];
    printed(Command::new("cc").args(strict).arg(source).arg("-o").arg(&program).arg("-lm"));
    program
}

/// Whether a tool is available; where it is not, the test reports on stderr that nothing was checked against it.
fn is_available(program: &str, arguments: &[&str]) -> bool {
    let found = Command::new(program).args(arguments).output();
    let works = found.is_ok_and(|output| output.status.success());
    if !works {
        let command = arguments.join(" ");
        eprintln!(
            "SKIPPED: `{program} {command}` does not work here: nothing was checked against it"
        );
    }
    works
}

/// Lines of the loop's inputs and of the rows, as every language writes a list.
fn lists() -> [(&'static str, String); 4] {
    let scenario = scenario(1);
    let list = |values: &[f64]| {
        let words: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
        words.join(", ")
    };
    let (references, speeds): (Vec<f64>, Vec<f64>) = (0..CYCLES).map(loop_input).unzip();
    [
        ("time_s", list(&scenario.sample_time_s)),
        ("voltage_v", list(&voltages(&scenario))),
        ("reference_rad_s", list(&references)),
        ("speed_rad_s", list(&speeds)),
    ]
}

#[test]
fn c_gives_what_the_simulation_gives() {
    if !is_available("cc", &["--version"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let models = all();
    let mut main = String::from("#include <stdio.h>\n");
    let mut body = String::new();
    for (name, model) in &models {
        let file = format!("{name}.h");
        write(folder.path(), &file, &export(name, model).written(Target::C).unwrap());
        let _ = writeln!(main, "#include \"{file}\"");
        let _ = write!(
            body,
            "    {{\n        {name}_state s = {{0}};\n        for (row = 0; row < {ROWS}; ++row) {{\n            \
             if (row) {name}_step(&{name}_identified, &s, voltage_v[row - 1], time_s[row] - time_s[row - 1]);\n            \
             printf(\"%.17g %.17g\\n\", {name}_current_a(&{name}_identified, &s), {name}_speed_rad_s(&{name}_identified, &s));\n        \
             }}\n    }}\n"
        );
    }
    for (name, values) in lists() {
        let _ = writeln!(main, "static const double {name}[] = {{ {values} }};");
    }
    let name = &models[0].0;
    let _ = write!(
        main,
        "int main(int count, char **words)\n{{\n    int row;\n    (void)words;\n    if (count > 1) {{\n        \
         {name}_regulator r = {{0}};\n        for (row = 0; row < {CYCLES}; ++row)\n            \
         printf(\"%.17g\\n\", {name}_regulate(&{name}_tuned, &r, reference_rad_s[row], speed_rad_s[row]));\n        \
         return 0;\n    }}\n{body}    return 0;\n}}\n"
    );
    let program = compiled(folder.path(), &main);
    check(&models, &printed(&mut Command::new(&program)), ROWS);
    check_regulator(&printed(Command::new(&program).arg("regulator")));
}

/// A map with gaps, of either kind.
fn gapped(of: MappedTorque) -> TorqueMap {
    let (first, width, count) = match of {
        MappedTorque::Friction => (-96.0, 8.0, 24),
        MappedTorque::Cogging => (0.0, std::f64::consts::TAU / 72.0, 72),
    };
    let bin = |index: u32| {
        let from = first + width * f64::from(index);
        let torque_n_m = 0.4 * (from + 0.5 * width).signum() + 0.01 * f64::from(index % 5);
        let is_known = !(index % 7 == 3 || index == 0 || index == 15);
        MapBin {
            from,
            to: from + width,
            windows: if is_known { 9 } else { 2 },
            torque: is_known.then_some(MappedValue {
                torque_n_m,
                low_n_m: torque_n_m - 0.02,
                high_n_m: torque_n_m + 0.02,
            }),
        }
    };
    TorqueMap { torque: of, bins: (0..count).map(bin).collect() }
}

#[test]
fn a_map_as_csv_has_empty_cells_where_nothing_was_measured() {
    let text = gapped(MappedTorque::Friction).to_csv();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 25);
    assert_eq!(lines[0], "speed_rad_s,torque_n_m,torque_low_n_m,torque_high_n_m,windows");
    assert_eq!(lines[1], "-92.0,,,,2");
    let cells: Vec<&str> = lines[2].split(',').collect();
    assert_eq!((cells.len(), cells[0], cells[1], cells[4]), (5, "-84.0", "-0.39", "9"));
}

#[test]
fn a_map_in_c_gives_what_the_program_reads_from_it() {
    if !is_available("cc", &["--version"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut main = String::from("#include <stdio.h>\n");
    let mut body = String::new();
    let mut expected = Vec::new();
    for of in MappedTorque::ALL {
        let (map, name) = (gapped(of), of.name());
        write(folder.path(), &format!("{name}.h"), &map_as_c(&map, name, "a test"));
        let _ = writeln!(main, "#include \"{name}.h\"");
        for step in -110..=110 {
            // In float as in double on the same side of every edge.
            let place = f64::from(step) * 0.9375;
            expected.push(map.at(place));
            let _ = writeln!(
                body,
                "    known = {name}_torque({place:?}f, &torque); printf(\"%d %.9g\\n\", known, (double)torque);"
            );
        }
    }
    let _ = write!(
        main,
        "int main(void)\n{{\n    float torque = 0.0f;\n    int known;\n{body}    return 0;\n}}\n"
    );
    let found = printed(&mut Command::new(compiled(folder.path(), &main)));
    assert_eq!(found.lines().count(), expected.len());
    assert!(expected.iter().flatten().count() > 100 && expected.contains(&None));
    for (line, expected) in found.lines().zip(expected) {
        let (known, torque) = line.split_once(' ').unwrap();
        assert_eq!(known == "1", expected.is_some(), "{line} {expected:?}");
        if let Some(expected) = expected {
            let torque: f64 = torque.parse().unwrap();
            assert!((torque - expected).abs() < 1e-4, "{line} {expected}");
        }
    }
}

#[test]
fn python_gives_what_the_simulation_gives() {
    if !is_available("python3", &["-c", "import numpy"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let models = few();
    let mut main = String::from("import sys\nimport numpy as np\n");
    for (name, values) in lists() {
        let _ = writeln!(main, "{name} = np.array([{values}])");
    }
    let first = camel(&models[0].0);
    for (name, model) in &models {
        let text = export(name, model).written(Target::Python).unwrap();
        write(folder.path(), &format!("{name}.py"), &text);
        let _ = writeln!(main, "import {name}");
    }
    let _ = writeln!(
        main,
        "if len(sys.argv) > 1:\n    r = {}.{first}Regulator()\n    for row in zip(reference_rad_s, speed_rad_s):\n        \
         print(repr(float(r.step(*row))))\n    sys.exit()",
        models[0].0
    );
    for (name, _) in &models {
        let class = camel(name);
        let _ = writeln!(
            main,
            "for row in zip(*{name}.{class}().simulate(time_s, voltage_v)):\n    print(*(repr(float(v)) for v in row))"
        );
    }
    let source = write(folder.path(), "main.py", &main);
    let mut python = Command::new("python3");
    python.arg("-B").arg(&source);
    check(&models, &printed(&mut python), ROWS);
    check_regulator(&printed(python.arg("regulator")));
}

#[test]
fn octave_gives_what_the_simulation_gives() {
    if !is_available("octave-cli", &["--version"]) {
        return;
    }
    // Octave is slow: only up to the standstill in the first reversal.
    let rows = ROWS / 2;
    let folder = tempfile::tempdir().unwrap();
    let models = few();
    let mut main = String::new();
    for (name, values) in lists() {
        let _ = writeln!(main, "{name} = [{values}];");
    }
    for (name, model) in &models {
        let text = export(name, model).written(Target::Matlab).unwrap();
        write(folder.path(), &format!("{name}.m"), &text);
        let _ = writeln!(
            main,
            "m = {name}(); [i, w] = m.simulate(m.parameters, time_s(1:{rows}), voltage_v(1:{rows})); printf(\"%.17g %.17g\\n\", [i, w]');"
        );
    }
    let _ = writeln!(
        main,
        "printf(\"regulator\\n\"); r = []; for row = 1:{CYCLES}\n  [u, r] = m.regulate(m.gains, r, reference_rad_s(row), speed_rad_s(row)); printf(\"%.17g\\n\", u);\nend"
    );
    write(folder.path(), "run_all.m", &main);
    let mut octave = Command::new("octave-cli");
    octave.args(["--norc", "--no-window-system", "--eval", "run_all"]);
    let output = octave.current_dir(folder.path()).output().unwrap();
    // Octave may print messages at its end, so that only its status counts.
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let out = String::from_utf8(output.stdout).unwrap();
    let (simulated, regulated) = out.split_once("regulator").unwrap();
    check(&models, simulated, rows);
    check_regulator(regulated);
}

/// Runs the bench of each model that follows and prints its columns at the rows: the compiler adds more where something
/// happens, of which the last stands for its instant.
const RUN_MODELICA: &str = "\
import bisect, pathlib, rumoca
here = pathlib.Path(__file__).parent
def run(name, end_s, rows):
    session = rumoca.Session()
    bench = session.loads((here / f'{name}.mo').read_text(), model='Bench')
    close = rumoca.SimConfig(solver='rk-like', rtol=1e-8, atol=1e-8)
    found = bench.simulate(end_s, dt=end_s / (rows - 1), config=close)
    times = [float(time) for time in found.time]
    columns = found['motor.current_a'], found['motor.speed_rad_s']
    for row in range(rows):
        here_is = bisect.bisect(times, end_s * row / (rows - 1) + 1e-9) - 1
        print(*(repr(float(column[here_is])) for column in columns))
";

#[test]
fn modelica_gives_what_the_simulation_gives() {
    if !is_available("python3", &["-c", "import rumoca"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let models = all();
    let voltage =
        events().iter().fold(String::new(), |before, (time_s, voltage_v)| match *time_s {
            0.0 => format!("{voltage_v:?}"),
            _ => format!("if time >= {time_s:?} then {voltage_v:?} else {before}"),
        });
    let mut main = RUN_MODELICA.to_owned();
    for (name, model) in &models {
        let class = camel(name);
        let export = Export::new(model, None, name, "A motor of a test").unwrap();
        let text = export.written(Target::Modelica).unwrap();
        let bench = format!(
            "model Bench\n  {class} motor;\nequation\n  motor.voltage_v = {voltage};\nend Bench;\n"
        );
        write(folder.path(), &format!("{name}.mo"), &(text + &bench));
        let _ = writeln!(main, "run({name:?}, {END_S:?}, {ROWS})");
    }
    let source = write(folder.path(), "main.py", &main);
    check(&models, &printed(Command::new("python3").arg("-B").arg(&source)), ROWS);
}

#[test]
fn what_has_no_formula_is_refused_by_its_name() {
    let delays = ["command_delay", "start_delay", "restart_delay", "speed_delay"];
    for id in ["backlash", "elastic_coupling"].into_iter().chain(delays) {
        let error = Export::new(&of_the_catalogue(&["viscous_friction", id]), None, "m", "t")
            .err()
            .unwrap();
        assert!(error.to_string().contains(id), "{error}");
        assert!(error.help().contains(&format!("remove {id}")), "{}", error.help());
    }
    let mechanical = Model::baseline(
        Motor::new("axis").with(MotorKey::Inertia, 1.0).with(MotorKey::LoadTorque, 1.0),
    );
    let error = Export::new(&mechanical, None, "m", "t").err().unwrap();
    assert!(error.to_string().contains("resistance_ohm"), "{error}");
    let whole = export("m", &of_the_catalogue(&[]));
    assert_eq!(whole.written(Target::Modelica), Err(ExportError::Gains));
}

#[test]
fn names_are_those_that_every_language_takes() {
    for (text, expected) in [
        ("ZK-22FC", "zk_22fc"),
        (" 24 V motor! ", "motor_24_v_motor"),
        ("", "motor"),
        ("_x", "x"),
        ("\u{e4}", "motor"),
    ] {
        assert_eq!(identifier(text), expected, "{text:?}");
    }
    assert_eq!(camel("zk_22fc"), "Zk22fc");
}

#[test]
fn a_formula_keeps_its_order_in_every_notation() {
    let model = of_the_catalogue(&["stribeck_friction", "winding_heating", "flux_saturation"]);
    let export = Export::new(&model, None, "pump", "A motor of a test").unwrap();
    let written = [Target::C, Target::Python, Target::Matlab, Target::Modelica]
        .map(|target| export.written(target).unwrap());
    for (text, parts) in written.iter().zip([
        [
            "p->stribeck_friction_stribeck_n_m * exp(-pow(s->speed_rad_s / p->stribeck_friction_stribeck_speed_rad_s, 2.0))",
            "rate.winding_heating = (pow(s->current_a, 2.0) - s->winding_heating / p->winding_heating_time_constant_s);",
        ],
        [
            "self.stribeck_friction_stribeck_n_m * math.exp(-(s[1] / self.stribeck_friction_stribeck_speed_rad_s)**2.0)",
            "(s[0]**2.0 - s[4] / self.winding_heating_time_constant_s),",
        ],
        [
            "p.stribeck_friction_stribeck_n_m * exp(-(s(2) / p.stribeck_friction_stribeck_speed_rad_s)^2.0)",
            "rate(5) = (s(1)^2.0 - s(5) / p.winding_heating_time_constant_s);",
        ],
        [
            "stribeck_friction_stribeck_n_m * exp(-(w / stribeck_friction_stribeck_speed_rad_s)^2.0)",
            "der(winding_heating_state) = (i^2.0 - winding_heating_state / winding_heating_time_constant_s);",
        ],
    ]) {
        for part in parts {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains("{{"), "a place of the template is left in\n{text}");
    }
}
