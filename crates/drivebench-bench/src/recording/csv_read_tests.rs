use std::fmt::Write as _;
use std::io::{self, Read as _};

use super::*;
use crate::recording::number_text;
use crate::testing::has;

fn own(text: &[u8]) -> Result<(Run, Vec<String>), RecordingError> {
    read_csv(text, "run.csv", ReadOptions::default())
}

fn mapped(text: &str, map: &str) -> Result<(Run, Vec<String>), RecordingError> {
    let map: ColumnMap = map.parse().unwrap();
    read_csv(text.as_bytes(), "foreign.csv", ReadOptions { map: Some(&map), in_run_folder: false })
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

/// Line ends are written as `/`.
#[test]
fn errors_name_row_column_and_value() {
    let allowed = "(allowed: a finite number with a decimal point, NaN or an empty cell)";
    let not_a_number =
        |cell| format!("row 1 (line 2), column \"current_a\": {cell:?} is not a number {allowed}");
    let (amps, infinite) = (not_a_number("1 A"), not_a_number("inf"));
    let quote = |line| {
        format!(
            "line {line}: a double quote is not closed on its line, or text follows a closed one"
        )
    };
    let (unclosed, swallows, joined) = (quote(2), quote(5), quote(4));
    let empty = "the file is empty (a header row and data rows are needed)";
    let stays = "row 2 (line 3): time 0 s is not after 0 s (time must be strictly increasing)";
    let timeless = "row 1 (line 2): no time in column \"time_s\"";
    let unknown = "no known column beside time_s";
    let two = "2 columns are called \"current_a\", exactly one is needed";
    let row = |cells: &str| format!("time_s,current_a/{cells}/");
    let (short, long) = (row("0,1/1/2,3"), row("0,1/1,2,3"));
    for (text, message) in [
        ("", empty),
        ("time_s,current_a/", "a header but no data row"),
        ("time_s,current_a/0,1/0,2/", stays),
        (&short, "row 2 (line 3): 1 cells, the header has 2"),
        (&long, "row 2 (line 3): 3 cells, the header has 2"),
        ("time_s,current_a/0,1 A/", &amps),
        ("time_s,current_a/0,inf/", &infinite),
        (&row("nan,1"), timeless),
        ("time_s,foo/0,1/", unknown),
        ("t,current_a/0,1/", "no column \"time_s\" in the header"),
        ("time_s,current_a,current_a/0,1,1/", two),
        ("time_s,current_a/0,\"1/1,2/", &unclosed),
        (&row("/0,1/1,\"2\"/2,\"3/4\"/3,1"), &swallows),
        (&row("0,1/1,\"2\" /2,\"3\"4/3,1"), &joined),
    ] {
        let error = own(text.replace('/', "\n").as_bytes()).unwrap_err();
        assert_eq!(error.to_string(), format!("run.csv: {message}"));
        assert!(!error.help().is_empty());
    }
}

#[test]
fn text_that_is_not_utf8_is_named_with_its_line() {
    for (text, at) in [
        (&b"time_s,current_a\n0,\xff\n1,2\n"[..], 2),
        (b"time_s,current_a,\xb5x\n0,1,2\n", 1),
        // UTF-16 with its byte order mark
        (b"\xff\xfet\0\n\0", 1),
    ] {
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

#[test]
fn a_torn_row_is_an_error_unless_it_is_the_last() {
    assert!(matches!(
        own(b"time_s,current_a\n0,1\n0.1,\n0.2\n0.3,4\n").unwrap_err(),
        RecordingError::Row { row: 3, line: 4, problem: RowProblem::FieldCount { .. }, .. }
    ));
    // what a file system may leave behind after a power cut
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
    // A file has one decimal mark: here the comma would part thousands.
    let error = mapped("t;i\n0,5;1\n1,5;1.234,5\n", "time_s=t,current_a=i").unwrap_err();
    has(&error, "\"1.234,5\" is not a number");
    let error = mapped("t;i\n0.5;1\n1.5;1,234\n", "time_s=t,current_a=i").unwrap_err();
    has(&error, "\"1,234\" is not a number");
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
