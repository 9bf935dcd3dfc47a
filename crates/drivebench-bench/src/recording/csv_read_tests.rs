use std::fmt::Write as _;
use std::io::{self, Read as _};

use proptest::prelude::*;

use super::*;
use crate::recording::number_text;
use crate::testing::{cases, has};

fn own(text: &[u8]) -> Result<(Run, Vec<String>), RecordingError> {
    read_csv(text, "run.csv", ReadOptions::default())
}

fn mapped(text: &str, map: &str) -> Result<(Run, Vec<String>), RecordingError> {
    let map: ColumnMap = map.parse().unwrap();
    read_csv(text.as_bytes(), "foreign.csv", ReadOptions::mapped(&map))
}

fn points(run: &Run, channel: Channel) -> Vec<(f64, f64)> {
    run.points(channel).collect()
}

#[test]
fn our_own_columns_with_missing_cells_and_bookkeeping() {
    let text = "time_s,host_time_s,seq,voltage_cmd_v,current_a,speed_rad_s,status,quality\n\
                0,0.1,1,5,,,,\n\
                0.01,0.11,1,,0.5,nan,ready,speed_rad_s:stale\n\
                0.02,,2,-0,NaN,3e0,7,\n";
    let (run, warnings) = own(text.as_bytes()).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(run.time_s(), &[0.0, 0.01, 0.02]);
    assert_eq!(points(&run, Channel::Current), [(0.01, 0.5)]);
    assert_eq!(points(&run, Channel::Speed), [(0.02, 3.0)]);
    assert_eq!(run.points(Channel::VoltageCmd).count(), 2);
    assert_eq!(run.origin(Channel::VoltageCmd), Origin::Commanded);
    assert_eq!(run.origin(Channel::Current), Origin::Unknown);
    let (run, _) = own(b"time_s,angle_rad\n0,1\n1,2\n").unwrap();
    assert_eq!(run.notes.len(), 1, "speed has to be derived: {:?}", run.notes);
}

#[test]
fn a_byte_order_mark_crlf_blank_lines_and_no_last_line_end() {
    let text = b"\xef\xbb\xbftime_s,current_a\r\n\r\n-5,1\r\n-4.5,2\r\n\r\n-4,3";
    let (run, warnings) = own(text).unwrap();
    assert_eq!(run.time_s(), &[-5.0, -4.5, -4.0]);
    assert_eq!(run.rows_dropped, 0);
    assert!(warnings.is_empty());
    assert_eq!(run.notes, ["run.csv: it begins with a byte order mark"]);
}

#[test]
fn a_foreign_file_with_units_in_its_headers() {
    let text = "\u{feff}Time (ms),ESC,Torque (N\u{b7}m),\"Speed, optical\",,\n\
                1000,x,0.5,60,,\n\
                ,,,,,\n\
                1010,y,,120,,\n\
                1020,z,,,,\n";
    let map = "time_s=Time (ms)*0.001,torque_n_m=Torque (N\u{b7}m)*-1+0.25,speed_rad_s=\"Speed, optical\"*0.5";
    let (run, _) = mapped(text, map).unwrap();
    assert_eq!(run.time_s(), &[1.0, 1.01, 1.02]);
    assert_eq!(points(&run, Channel::Torque), [(1.0, -0.25)]);
    assert_eq!(points(&run, Channel::Speed), [(1.0, 30.0), (1.01, 60.0)]);
    assert_eq!(run.origin(Channel::Speed), Origin::Unknown);
}

#[test]
fn one_column_may_serve_two_targets_and_an_empty_column_is_none() {
    let text = "t,u,i\n0,1,\n1,2,\n";
    let (run, _) = mapped(text, "time_s=t,voltage_v=u,voltage_cmd_v=u*2,current_a=i").unwrap();
    assert_eq!(run.column(Channel::VoltageCmd).unwrap(), &[2.0, 4.0]);
    assert_eq!(run.column(Channel::Voltage).unwrap(), &[1.0, 2.0]);
    assert!(run.column(Channel::Current).is_none());
}

/// Files of ours, in which line ends are written as `/`, and the whole message of their refusal.
const MESSAGES: &str = r#"
 | the file is empty (a header row and data rows are needed)
time_s,current_a/ | a header but no data row
time_s,current_a/0,1/1,2,3/ | row 2 (line 3): 3 cells, the header has 2
time_s,current_a/0,1 A/ | row 1 (line 2), column "current_a": "1 A" is not a number (allowed: a finite number with a decimal point, NaN or an empty cell)
time_s,current_a/nan,1/ | row 1 (line 2): no time in column "time_s"
time_s,foo/0,1/ | no known column beside time_s
t,current_a/0,1/ | no column "time_s" in the header
time_s,current_a/0,"1/1,2/ | line 2: a double quote is not closed on its line, or text follows a closed one
time_s,current_a//0,1/1,"2"/2,"3/4"/3,1/ | line 5: a double quote is not closed on its line, or text follows a closed one
time_s,current_a/0,1/1,"2" /2,"3"4/3,1/ | line 4: a double quote is not closed on its line, or text follows a closed one
"#;

#[test]
fn errors_name_row_column_and_value() {
    for [text, message] in cases(MESSAGES) {
        let error = own(text.replace('/', "\n").as_bytes()).unwrap_err();
        assert_eq!(error.to_string(), format!("run.csv: {message}"));
        assert!(!error.help().is_empty());
    }
}

#[test]
fn text_that_is_not_utf8_is_named_with_its_line() {
    for (text, at) in
        [(&b"time_s,current_a\n0,\xff\n1,2\n"[..], 2), (b"time_s,current_a,\xb5x\n0,1,2\n", 1)]
    {
        let error = own(text).unwrap_err();
        assert!(matches!(error, RecordingError::NotUtf8 { line, .. } if line == at), "{error}");
    }
}

#[test]
fn help_lists_the_headers_and_the_nearest() {
    let error = mapped("Zeit,Strom\n0,1\n", "time_s=Zeit,current_a=strom").unwrap_err();
    has(error.help(), "did you mean \"Strom\"?");
    has(error.help(), "\"Zeit\", \"Strom\"");
    has(own(b"t;current_a\n0;1\n").unwrap_err().help(), "\"t\", \"current_a\"");
}

#[test]
fn a_foreign_file_cut_at_any_byte_keeps_every_whole_row() {
    let mut text = String::from("time_s,current_a,quality\n");
    for row in 0..60 {
        let [time_s, amps] = [0.01, 0.37].map(|step| number_text(f64::from(row) * step));
        writeln!(text, "{time_s},{amps},ok").unwrap();
    }
    let line_ends: Vec<usize> = text.match_indices('\n').map(|(at, _)| at + 1).collect();
    for cut in line_ends[1]..=text.len() {
        let whole_rows = line_ends.iter().filter(|end| **end <= cut).count() - 1;
        let torn = usize::from(!line_ends.contains(&cut));
        // A foreign writer may leave the last line end out, so there a row that can be read is kept.
        let (run, _) = own(&text.as_bytes()[..cut]).unwrap();
        assert!(run.rows() == whole_rows || run.rows() == whole_rows + 1);
        assert_eq!(run.rows() + run.rows_dropped, whole_rows + torn);
    }
}

/// What a file system may leave behind.
#[test]
fn a_row_that_a_power_cut_tore_is_dropped_with_a_warning() {
    let (run, warnings) = own(b"time_s,current_a\n0,1\n\0\0\0\0\0\0").unwrap();
    assert_eq!((run.rows(), run.rows_dropped, warnings.len()), (1, 1, 1));
}

#[test]
fn a_line_without_an_end_fills_no_memory() {
    let text = b"time_s,current_a\n0,1\n".chain(io::BufReader::new(io::repeat(b'1')));
    let error = read_csv(text, "run.csv", ReadOptions::default()).unwrap_err();
    has(error, "run.csv: line 3 is longer than 1048576 bytes");
    let error = read_csv(io::BufReader::new(io::repeat(b',')), "run.csv", ReadOptions::default());
    has(error.unwrap_err(), "run.csv: line 1 is longer than 1048576 bytes");
}

#[test]
fn comments_in_foreign_files_are_left_out_and_counted() {
    let text = "# made by hand, \"quick\nt,i\n0,1\n# half time\n1,2\n\n# a-> Type: rise, 0.008";
    let (run, warnings) = mapped(text, "time_s=t,current_a=i").unwrap();
    assert_eq!((run.rows(), run.rows_dropped), (2, 0));
    assert_eq!(warnings, ["foreign.csv: 2 lines that begin with # were left out"]);
    // numpy writes its header as a comment.
    let (run, _) = mapped("# t,i\n0,1\n", "time_s=# t,current_a=i").unwrap();
    assert_eq!(run.rows(), 1);
}

/// Line ends are written as `/`.
#[test]
fn every_dialect_is_found_and_named() {
    let comma = "numbers have a decimal comma";
    let sep = "a sep= line names the separator";
    let semicolon = "';' separates the cells";
    let mark = "it begins with a byte order mark";
    let carriage_returns = "sep=;\r/t;u;i\r/0;1,5;-2\r/1;2;0,3";
    let tabs = "t\tu\ti/0\t1.5\t-2/1\t2\t0.3/";
    let bar = "\u{feff}sep=|//t|u|i/0|1.5|-2/1|2|0.3/";
    let commas = "\"t\";\"u\";i;\"a, b, c, d\"/0;1.5;-2;/1;2;0.3;/";
    for (text, named) in [
        ("t,u,i/0,1.5,-2/1,2,3e-1/", vec![]),
        ("t;u;i/0;1.5;-2/1;2;0.3/", vec![semicolon]),
        ("t;u;i/0;1,5;-2/1;2;3e-1/", vec![semicolon, comma]),
        (tabs, vec!["a tab separates the cells"]),
        (carriage_returns, vec![semicolon, comma, sep]),
        (bar, vec!["'|' separates the cells", sep, mark]),
        // The comma within a name is no separator.
        (commas, vec![semicolon]),
    ] {
        let text = text.replace('/', "\n");
        let (run, warnings) = mapped(&text, "time_s=t,voltage_v=u,current_a=i").unwrap();
        assert_eq!(run.time_s(), &[0.0, 1.0], "{text}");
        let columns = [Channel::Voltage, Channel::Current].map(|c| run.column(c).unwrap());
        assert_eq!(columns, [&[1.5, 2.0], &[-2.0, 0.3]], "{text}");
        assert!(warnings.is_empty(), "{warnings:?}");
        let named = (!named.is_empty()).then(|| format!("foreign.csv: {}", named.join(", ")));
        assert_eq!(run.notes.first(), named.as_ref(), "{text}");
    }
}

#[test]
fn foreign_rows_that_repeat_or_go_back_are_left_out_and_counted() {
    let mut text = String::from("t,i\n");
    for row in 0..100 {
        let stamp = match row {
            40 | 41 => 39,
            70 => 12,
            other => other,
        };
        writeln!(text, "{stamp},{row}").unwrap();
    }
    let (run, warnings) = mapped(&text, "time_s=t,current_a=i").unwrap();
    assert_eq!((run.rows(), run.rows_dropped), (97, 3));
    let text = "foreign.csv: 3 rows whose time is not after that of the row before were left out: 2 repeat it, 1 go back";
    assert_eq!(warnings, [text]);
    assert_eq!(run.notes, [text]);
    // A column that often goes back is no time; the first such row is named.
    let error = mapped("t,i\n0,1\n1,2\n0.5,3\n1.5,1\n1.2,1\n", "time_s=t,current_a=i").unwrap_err();
    has(&error, "row 3 (line 4): time 0.5 s is not after 1 s");
}

/// Milliseconds of the day as a clock.
fn clock(ms: u32) -> String {
    let (s, ms) = (ms / 1000, ms % 1000);
    format!("{:02}:{:02}:{:02}.{ms:03}", s / 3600 % 24, s / 60 % 60, s % 60)
}

/// Forms of a time: name, source of the time in the map, first time in s, and a part of what is said.
const TIMES: &str = "
ISO 8601 | t | 43195 | column \"t\" is a date or a clock: time_s counts the seconds since midnight of 2024-05-06
a date and a clock over midnight | Date+Time | 86399.96 | column \"Date+Time\" is a date or a clock: time_s counts the seconds since midnight of 2024-05-05
a clock over midnight | t | 86399.96 | begins again once, first in line 22, as a counter of a day does: 86400 s were added
a clock of twelve hours | t | 3600 | the seconds since midnight
minutes over the hour | t | 3599.96 | as a counter of an hour does
an hour of summer time | t | 7200 | the clock was set back by 3600 s
16 bits of ms | t*0.001 | 65.5 | as a counter of 16 bits does: 65.536 s were added
32 bits of us | t*1e-6 | 4294.93 | as a counter of 32 bits does
ns since 1970 | t*1e-9 | 0 | time_s counts from the first row, at 1714996795123456789 in column \"t\"
days of a spreadsheet | t*86400 | 0 | time_s counts from the first row, at 45418.500000000000
a clock set back | t*0.001 | 5 | the clock was set back by 2.998 s in line 22: the rows go on one usual step (0.002 s)
";

/// The stamp of a row in one of these forms.
fn stamp(form: &str, k: u32) -> String {
    let late = 86_400_000 - 40;
    let before_or_behind = |before, behind| if k < 20 { before } else { behind };
    match form {
        "ISO 8601" => format!("2024-05-06T11:59:55.{:03}Z", 2 * k),
        "a date and a clock over midnight" => {
            format!("0{}/05/2024,{}", before_or_behind(5, 6), clock(late + 2 * k))
        }
        "a clock over midnight" => clock(late + 2 * k),
        "a clock of twelve hours" => format!("{} AM", &clock(3_600_000 + 2 * k)[1..]),
        "minutes over the hour" => clock(3_600_000 - 40 + 2 * k)[3..].to_owned(),
        "an hour of summer time" => {
            format!("2024-10-27 0{}:00:00.{:03}", before_or_behind(2, 1), 2 * k)
        }
        "16 bits of ms" => ((65_500 + 2 * k) % 65_536).to_string(),
        "32 bits of us" => 4_294_930_000_u32.wrapping_add(2000 * k).to_string(),
        "ns since 1970" => (1_714_996_795_123_456_789 + 2_000_000 * u64::from(k)).to_string(),
        "days of a spreadsheet" => format!("{:.12}", 45_418.5 + f64::from(k) * 2e-3 / 86_400.0),
        "a clock set back" => (before_or_behind(5000, 2000) + 2 * k).to_string(),
        other => panic!("{other}"),
    }
}

/// 40 rows 2 ms apart.
#[test]
fn every_form_of_time_is_read_and_said() {
    for [name, time, first_s, part] in cases(TIMES) {
        let header = if time == "Date+Time" { "Date,Time,i" } else { "t,i" };
        let rows: Vec<String> = (0..40).map(|k| format!("{},{k}", stamp(name, k))).collect();
        let text = format!("{header}\n{}\n", rows.join("\n"));
        let (run, warnings) = mapped(&text, &format!("time_s={time},current_a=i"))
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let time_s = run.time_s();
        assert_eq!((time_s.len(), run.rows_dropped), (40, 0), "{name}: {warnings:?}");
        let first_s: f64 = first_s.parse().unwrap();
        assert!((time_s[0] - first_s).abs() < 1e-9, "{name}: {}", time_s[0]);
        for (place, step) in time_s.windows(2).map(|pair| pair[1] - pair[0]).enumerate() {
            assert!((step - 2e-3).abs() < 1e-6, "{name}: step {place} is {step}");
        }
        for said in [&warnings, &run.notes] {
            assert!(said.iter().any(|sentence| sentence.contains(part)), "{name}: {said:?}");
        }
        // Our own headers are read likewise, but for what only a map can say.
        if time == "t" {
            let own = own(text.replacen("t,i", "time_s,current_a", 1).as_bytes()).unwrap().0;
            assert_eq!(own.time_s(), time_s, "{name}");
        }
    }
}

#[test]
fn only_in_a_run_folder_the_time_must_increase_strictly() {
    let text = b"time_s,current_a\n0,1\n0,2\n1,3\n";
    let (run, warnings) = own(text).unwrap();
    assert_eq!((run.rows(), run.rows_dropped), (2, 1));
    has(&warnings[0], "1 repeat it, 0 go back");
    let options = ReadOptions { in_run_folder: true, ..ReadOptions::default() };
    let error = read_csv(&text[..], "run.csv", options).unwrap_err();
    has(error, "row 2 (line 3): time 0 s is not after 0 s (time must be strictly increasing)");
}

/// Voltage and current of two rows in tables of every shape, in which line ends are written as `/`: name, file, parts of the
/// notes, and the option that it needs.
const SHAPES: &str = "
units | t,u,i/s,V,A/0,1500.5,-2/1,2,0.3/ | a row of units stands |
units in brackets | t;u;i/(ms);(mV);[mA]/0;1500500;-2000/1000;2000;300/ | names ms for column \"t\" & voltage_v is the column times 0.001 & names mA |
units against the map | t,u,i/ms,V,mA/0,1500.5,-200/1000,2,30/ | names mA for column \"i\", that is a factor 0.001 to current_a, and the map gives 0.01 | --map time_s=t*0.001,voltage_v=u,current_a=i*0.01
an unknown unit | t,u,i/s,counts,A/0,1500.5,-2/1,2,0.3/ | names \"counts\" for column \"u\", which is no known unit of voltage_v |
lines before the header | Report, of the run/from,12:00//t,u,i/0,1500.5,-2/1,2,0.3/ | 2 lines with text stand before the header row |
skipped lines | t,u,i/t,u,i/0,1500.5,-2/1,2,0.3/ |  | --skip 1
thousands in quotes | t,u,i/0,\"1,500.5\",-2/1,2,0.3/ | parts thousands |
thousands of Germany | t;u;i/0;1.500,5;-2/1;2;0,3/ | decimal comma, '.' parts thousands |
thousands with blanks | t;u;i/0;1 500,5;-2/1;2;0,3/ | a blank parts thousands |
thousands of Switzerland | t;u;i/0;1'500.5;-2/1;2;0.3/ | parts thousands |
decimal commas in quotes | t,u,i/0,\"1500,5\",-2/1,2,\"0,3\"/ | decimal comma |
separators at the ends of rows | t;u;i/0;1500.5;-2;/1;2;0.3;;/ |  |
a separator at the end of the header | t;u;i;/0;1500.5;-2/1;2;0.3/ |  |
the header again | t,u,i/0,1500.5,-2/t,u,i/1,2,0.3/ | the header row stands again 1 times, first in line 3 |
texts for missing | t,u,i/0,1500.5,-2/0.5,#NA,ERR/0.7,-9999.0,/1,2,0.3/ |  | --missing #NA,err,-9999
carriage returns | t,u,i\r0,1500.5,-2\r1,2,0.3\r | carriage returns end its lines |
";

/// Reads a file, in which line ends are written as `/`, with one option: another map, `--missing` or `--skip`.
fn read_with(text: &str, map: &str, option: &str) -> Result<Run, RecordingError> {
    let text = text.replace('/', "\n");
    let (name, value) = option.split_once(' ').unwrap_or_default();
    let map: ColumnMap = if name == "--map" { value } else { map }.parse().unwrap();
    let missing = (name == "--missing").then(|| value.parse().unwrap());
    let skip = (name == "--skip").then(|| value.parse().unwrap());
    let options = ReadOptions { skip, missing: missing.as_ref(), ..ReadOptions::mapped(&map) };
    read_csv(text.as_bytes(), "foreign.csv", options).map(|(run, _)| run)
}

#[test]
fn every_shape_of_table_gives_the_same_values() {
    for [name, text, parts, option] in cases(SHAPES) {
        let run = read_with(text, "time_s=t,voltage_v=u,current_a=i", option)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((run.time_s()[0], run.time_s()[run.rows() - 1]), (0.0, 1.0), "{name}");
        for (channel, expected) in
            [(Channel::Voltage, [1500.5, 2.0]), (Channel::Current, [-2.0, 0.3])]
        {
            let values: Vec<f64> = points(&run, channel).iter().map(|point| point.1).collect();
            let are_equal = values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(values.len() == 2 && are_equal, "{name}: {values:?}");
        }
        let notes = run.notes.join("; ");
        for part in parts.split(" & ") {
            assert!(notes.contains(part), "{name}: {notes}");
        }
    }
}

/// Refusals: name, file with time `t` and current `i`, a part of the reason, a part of the help, and what the help leads to: the
/// file, or an option.
const REFUSALS: &str = "
text | t,i/0,1/1,#NA/ | row 2 (line 3), column \"i\": \"#NA\" is not a number | --missing '#NA' | --missing #NA
a text with a comma | t;i/0;1/1;a,b/ | \"a,b\" | --missing '\"a,b\"' | --missing \"a,b\"
infinite | t,i/0,1/1,inf/ | \"inf\" is not a number | --missing 'inf' | --missing inf
a unit in the cell | t,i/0,1 A/1,2 A/ | \"1 A\" | without their unit \"A\" | t,i/0,1/1,2/
open thousands | t;i/0;1,234/ | \"1,234\" | write 1234 if | t;i/0;1.234/
two decimal marks | t;i/0;1,5/1;1.25/ | \"1.25\" | decimal mark of the others | t;i/0;1,5/1;1,25/
hexadecimal | t,i/0,0x1F/ | \"0x1F\" | decimal digits | t,i/0,31/
a torn row | t,i/0,1/1/2,3/ | row 2 (line 3): 1 cells, the header has 2 | sed '3d' | t,i/0,1/2,3/
too few names | t,i/0,1,2/1,2,3/ | 3 cells, the header has 2 | one name for each cell | t,i,x/0,1,2/1,2,3/
no time | t,i/0,1/,2/ | no time in column \"t\" | sed '3d' | t,i/0,1/
a second header | t,i/number,text/0,1/ | row 1 (line 2): a second row of texts | sed '2d' | t,i/0,1/
a footer | t,i/0,1/1,2//End of data/Rows: 2/ | row 3 (line 5): here a block of text | head -n 4 | t,i/0,1/1,2//
NUL bytes | t,i/0,1/\0\0\0/1,2/ | NUL bytes | tr -d '\\000' | t,i/0,1//1,2/
no stamp | t,i/noon,1/0,2/ | \"noon\" is neither a number nor a date | name a column | --map time_s=i
a date alone | t,c,i/2024-05-06,11:59:55.1,1/ | \"2024-05-06\" is neither | 'time_s=t+CLOCK' | --map time_s=t+c,current_a=i
one wrong stamp | t,i/11:59:55.1,1/?,2/11:59:55.3,1/ | \"?\" is neither | sed '3d' | t,i/11:59:55.1,1/11:59:55.3,1/
ms since 1970 | t,i/1714996795123,1/1714996795125,2/ | column \"t\" is in ms since 1970, not in s | time_s=t*0.001 | --map time_s=t*0.001,current_a=i
days | t,i/45418.5,1/45418.50000002,2/ | in days of a spreadsheet | time_s=t*86400 | --map time_s=t*86400,current_a=i
no header | 0,1/1,2/ | no header row | sed '1i c1,c2' | t,i/0,1/1,2/
none, tabs | 0\t1/1\t2/ | no header row | sed '1i c1\\tc2' | t\ti/0\t1/1\t2/
none, commas | # a/0;1,5/1;2/ | no header row | sed '2i c1;c2' | # a/t;i/0;1,5/1;2/
a header twice | t,i,i/0,1,2/ | 2 columns are called \"i\" | rename one | t,i,j/0,1,2/
a wrong name | T,i/0,1/ | no column \"t\" | did you mean \"T\"? | --map time_s=T,current_a=i
";

fn mends([name, text, reason, help, mended]: [&str; 5]) {
    let map = "time_s=t,current_a=i";
    let error = read_with(text, map, "").unwrap_err();
    assert!(error.to_string().contains(reason), "{name}: {error}");
    assert!(error.help().contains(help), "{name}: {}", error.help());
    let (mended, option) = if mended.starts_with("--") { (text, mended) } else { (mended, "") };
    if let Err(error) = read_with(mended, map, option) {
        panic!("{name}: the advice does not mend: {error}");
    }
}

#[test]
fn each_refusal_names_its_reason_and_a_way_on_that_mends() {
    cases(REFUSALS).for_each(mends);
    // A factor of a stamp.
    let text = "t,i\n11:59:55.1,1\n";
    let error = mapped(text, "time_s=t*0.001,current_a=i").unwrap_err();
    has(&error, "is a date or a clock, which is read in seconds, and the map gives it a factor");
    has(error.help(), "time_s=t without a factor");
    assert!(mapped(text, "time_s=t,current_a=i").is_ok());
}

#[test]
fn a_time_that_falls_is_refused_with_what_mends_it() {
    let rows = |stamps: &mut dyn Iterator<Item = u32>| {
        stamps.fold("t,i/".to_owned(), |text, stamp| format!("{text}{stamp},1/"))
    };
    let (reversed, sorted) = (rows(&mut (0..40).rev()), rows(&mut (0..40)));
    let help = "sort the rows by column \"t\"";
    mends(["reversed", &reversed, "row 2 (line 3): time 38 s is not after 39 s", help, &sorted]);
    let begun = rows(&mut (100..140));
    let falls = begun.clone() + "50,1/20,1/80,1/10,1/60,1/5,1/40,1/30,1/";
    let reason = "row 41 (line 42): time 50 s is not after 139 s";
    mends(["a fall", &falls, reason, "head -n 41", &begun]);
    let no_time = own(b"time_s,current_a\n2,1\n0,1\n-3,1\n").unwrap_err();
    has(no_time.help(), "name another with --map");
}

#[test]
fn a_quantity_may_be_a_product_with_the_sign_of_a_command() {
    let text = "t,duty,bus_v,rpm,a*b\n\
                0,0,100,2,1\n1,0.5,100,10,2\n2,0,100,8,3\n3,-0.5,90,10,4\n4,,90,20,5\n";
    let map = "time_s=t,voltage_v=duty*bus_v,speed_rad_s=rpm*0.5*sign(duty),current_a=a*b*2+1";
    let (run, _) = mapped(text, map).unwrap();
    assert_eq!(points(&run, Channel::Voltage), [(0.0, 0.0), (1.0, 50.0), (2.0, 0.0), (3.0, -45.0)]);
    // Where the command is zero or missing its last sign holds.
    assert_eq!(run.column(Channel::Speed).unwrap(), &[1.0, 5.0, 4.0, -5.0, -10.0]);
    // A header that holds a star is one column.
    assert_eq!(run.column(Channel::Current).unwrap(), &[3.0, 5.0, 7.0, 9.0, 11.0]);
    has(mapped(text, "time_s=t,voltage_v=duty*bus").unwrap_err(), "no column \"bus\"");
}

proptest! {
    /// Any bytes, and tables of what stands in files, with every option.
    #[test]
    fn any_bytes_are_read_or_refused(
        pieces in prop::collection::vec(prop::sample::select(PIECES.split('|').collect::<Vec<_>>()), 0..60),
        bytes in prop::collection::vec(any::<u8>(), 0..40),
        skip in prop::option::of(0..4_usize),
    ) {
        let map: ColumnMap = "time_s=t+c,current_a=i*2".parse().unwrap();
        let missing: MissingValues = "#N/A,-9999".parse().unwrap();
        let mut text = pieces.concat().into_bytes();
        text.extend(bytes);
        for map in [None, Some(&map)] {
            let options = ReadOptions { map, skip, missing: Some(&missing), in_run_folder: false };
            if let Ok((run, _)) = read_csv(&text[..], "f", options) {
                prop_assert!(run.time_s().windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
    }
}

const PIECES: &str = "time_s,current_a\n|t,c,i\n|t;c;i\r\n|s,A\n|(ms),[mA]\n|0,1\n|0.1,2\n|0.2,3\n|1,234|\
    1.234,5|\"1,234.5\"|2024-05-06|06/05/24|T| |11:59:55.1|59:55,5|AM|Z|+02:00|,|;|\t|\n|\r|\
    \"|#|#N/A|-9999|\0|\u{feff}|sep=;\n|1e999|nan|99999999999999999999|4294967295";
