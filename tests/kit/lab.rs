//! A bench file and its drive in a process of its own, for runs in real time: both leave a loaded machine some time.

use super::prelude::*;

/// The motor of paper A with its nameplate, as the benches of real time and the drives behind them have it.
fn motor() -> String {
    format!("{MODEL}rated_voltage_v = 110.0\nrated_current_a = 5.7\nrated_speed_rad_s = 293.2\n")
}

/// A plain motor behind a drive with a long watchdog.
fn emulator() -> String {
    format!(
        "watchdog_ms = 1000\n{}[limits]\ncurrent_limit_a = 11.4\nbus_v = 120.0\nspeed_limit_rad_s = 350.0\n\
         [noise]\nvoltage_v = 0.02\ncurrent_a = 0.03\nspeed_rad_s = 0.15\n",
        motor()
    )
}

/// A bench file around that motor; what is left out is its default.
pub(crate) struct BenchFile<'a> {
    pub(crate) profile: &'a str,
    /// Keys of `[link]` besides the port, which the command line gives.
    pub(crate) link: String,
    pub(crate) back_emf_v_s_per_rad: f64,
    pub(crate) limits: &'a str,
    pub(crate) speed: &'a str,
    /// Parts of the sequence, parted by line ends.
    pub(crate) sequence: &'a str,
}

/// About two seconds.
const SHORT: &str =
    "standstill = { seconds = 0.5 }\nsteps = { levels_v = [40.0, -40.0, 0.0], hold_s = 0.5 }";
/// Long enough to be ended from outside.
const LONG: &str = "standstill = { seconds = 0.3 }\nsteps = { levels_v = [40.0], hold_s = 50.0 }";
/// What the drive of paper A can bear.
pub(crate) const LIMITS: &str = "current_a = 11.0\nspeed_rad_s = 340.0\nvoltage_v = 110.0\nslew_v_per_s = 200.0\nlink_silence_s = 0.95";

impl BenchFile<'_> {
    pub(crate) fn short(protocol: &str) -> Self {
        Self {
            profile: "own",
            link: format!("protocol = {protocol:?}\nrate_hz = 50.0"),
            back_emf_v_s_per_rad: 0.3538,
            limits: LIMITS,
            speed: "",
            sequence: SHORT,
        }
    }

    /// The motor turns until the run is ended from outside.
    pub(crate) fn long(protocol: &str) -> Self {
        Self { sequence: LONG, ..Self::short(protocol) }
    }

    pub(crate) fn text(&self) -> String {
        let constant = format!("back_emf_v_s_per_rad = {:?}", self.back_emf_v_s_per_rad);
        let motor = motor().replace("back_emf_v_s_per_rad = 0.3538", &constant);
        let sequence = self.sequence.replace('\n', "\n[[sequence]]\n");
        format!(
            "name = \"lab\"\n[drive]\nprofile = {:?}\n[link]\nport = \"sim:\"\n{}\n{motor}[limits]\n{}\n{}\n\
             [[sequence]]\n{sequence}\n",
            self.profile, self.link, self.limits, self.speed
        )
    }
}

impl Desk {
    /// The plain motor behind a drive over `link`, in a process of its own.
    pub(crate) fn drive(&self, link: &str, options: &str) -> Emulator {
        let config = self.put("emulator.toml", &emulator());
        let text = format!("{{}} {options}");
        Emulator::on(link, &self.path("drive"), &text, &[&config])
    }

    /// Arguments of a command on the desk's bench file.
    fn on_bench(&self, command: &str, bench: &str, port: &str, options: &str) -> Vec<PathBuf> {
        let file = self.put("bench.toml", bench);
        let mut arguments = line(
            &format!("{command} {{}} --port {{}} --out {{}}"),
            &[&file, Path::new(port), &self.out()],
        );
        arguments.extend(line(options, &[]));
        arguments
    }

    /// A command on a bench file, without a screen, to its end.
    pub(crate) fn at_port(&self, command: &str, bench: &str, port: &str, options: &str) -> Done {
        drivebench(self.on_bench(command, bench, port, options))
    }

    /// A run on a bench file, once its record shows that the motor turns fast.
    #[track_caller]
    pub(crate) fn until_turning(&self, bench: &str, port: &str, options: &str) -> Process {
        let options = format!("--headless --json {options}");
        self.turning(|| Process::start(&self.on_bench("run", bench, port, &options)))
    }

    /// What is started, once its record shows that the motor turns fast. Where the machine stands still the checks refuse
    /// the run.
    #[track_caller]
    pub(crate) fn turning(&self, start: impl Fn() -> Process) -> Process {
        let (done, run) = in_real_time(|| {
            let _ = fs::remove_dir_all(self.out());
            let mut run = start();
            let turns = wait_for("a motor that turns", || {
                let is_over = run.0.try_wait().expect("a child").is_some();
                (is_over || self.turns(80.0)).then_some(!is_over)
            });
            if turns { (Done::default(), Some(run)) } else { (run.end(), None) }
        });
        run.unwrap_or_else(|| panic!("no run began: {}", done.stderr))
    }

    /// The record of the newest run shows a speed beyond this.
    pub(crate) fn turns(&self, faster_than_rad_s: f64) -> bool {
        let samples = || {
            let runs = fs::read_dir(self.out()).ok()?;
            let runs = runs.filter_map(|run| Some(run.ok()?.path()));
            // `latest` is a link to the newest that has ended.
            let newest = runs.filter(|path| !path.is_symlink()).max()?;
            fs::read_to_string(newest.join("samples.csv")).ok()
        };
        let is_fast = |speed: &f64| *speed > faster_than_rad_s;
        samples().is_some_and(|text| column(&text, "speed_rad_s").iter().any(is_fast))
    }
}
