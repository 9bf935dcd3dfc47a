//! Lines of text, as the profile of a drive gives them (`[link.lines]`, `request` and `answer`).
//!
//! ```text
//! turn:   scratch = n, scratch?   set-point   question   scratch = n + 1, scratch?      each a line
//! reply:  n                       (ack)       answer     n + 1
//! ```
//!
//! An answer names nothing that it belongs to. So each turn writes a number of its own in front and behind, and reads it back: the
//! drive answers in order, and what comes between both numbers answers what went out between them.

use std::sync::Arc;

use super::{Expected, Search, Turn};
use crate::cell_bus::CellTable;
use crate::exchange::NoData;
use crate::register_map::Kind;
use crate::unexpected::Unexpected;

/// The language of one profile.
#[derive(Clone, Debug, PartialEq)]
pub struct Grammar {
    /// Ends a request.
    pub end: String,
    pub checksum: bool,
    /// Line that writes a number, line that reads it, and its answer: `{}` is the number.
    pub scratch: [String; 3],
    /// Acknowledges a written number; `None`: nothing does.
    pub ack: Option<String>,
    /// Whole lines by which the drive refuses.
    pub errors: Vec<String>,
    /// A number of so many characters is one that the drive has cut off.
    pub cut_at: Option<usize>,
    pub lines: Vec<Line>,
}

/// A line of the profile.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// `{}` takes the value of a set-point.
    pub send: String,
    /// `{}` is a number; empty: nothing answers.
    pub answer: String,
    /// Of the numbers of the answer, or of the set-point's.
    pub kinds: Vec<Kind>,
    /// Behind the point.
    pub digits: usize,
}

/// What comes back in reply to a turn: lines that follow one another, `{}` for a number.
#[derive(Clone, Debug, Default)]
pub(crate) struct Awaited {
    grammar: Option<Arc<Grammar>>,
    answers: Vec<String>,
}

/// One line that goes out, what answers it, and which line of the profile it is if its answer is read.
struct Part {
    send: String,
    answer: String,
    reads: Option<usize>,
}

/// Cells that a line of the profile has among those of a block: two for each of up to eight numbers.
pub(crate) const LINE_CELLS: u16 = 16;

const HOLE: &str = "{}";
/// Either ends a line of a drive.
const ENDS: [char; 2] = ['\r', '\n'];

/// Exclusive or of all characters, as a decimal number behind a star.
fn summed(text: &str) -> String {
    let sum = text.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("{text}*{sum}")
}

/// A line without its check sum; `None` where that is wrong or missing.
fn without_sum(line: &str) -> Option<&str> {
    let (text, sum) = line.rsplit_once('*')?;
    (summed(text) == format!("{text}*{sum}")).then_some(text)
}

/// The texts that stand in the holes of a template.
fn holes<'a>(template: &str, line: &'a str) -> Option<Vec<&'a str>> {
    let mut pieces = template.split(HOLE);
    let mut rest = line.strip_prefix(pieces.next()?)?;
    let mut found = Vec::new();
    let mut pieces = pieces.peekable();
    while let Some(piece) = pieces.next() {
        let at = if piece.is_empty() && pieces.peek().is_none() {
            rest.len()
        } else if pieces.peek().is_none() {
            rest.len().checked_sub(piece.len()).filter(|at| rest.ends_with(piece) && *at > 0)?
        } else {
            rest.find(piece)?
        };
        found.push(rest[..at].trim());
        rest = &rest[at + piece.len()..];
    }
    rest.is_empty().then_some(found)
}

impl Grammar {
    fn line(&self, text: &str) -> String {
        let end = &self.end;
        if self.checksum {
            format!("{}{end}", summed(&format!("{text} ")))
        } else {
            format!("{text}{end}")
        }
    }

    /// Writes a number and reads it.
    fn mark(&self, parts: &mut Vec<Part>, number: u32) {
        let number = number.to_string();
        let [write, read, answer] = &self.scratch;
        let part = |send: &str, answer: String| Part {
            send: send.replace(HOLE, &number),
            answer,
            reads: None,
        };
        parts.push(part(write, self.ack.clone().unwrap_or_default()));
        parts.push(part(read, answer.replace(HOLE, &number)));
    }

    /// The lines of a turn. Between two whose answers look alike stands another number, so that none is taken for the other.
    fn parts(&self, turn: Turn<'_>, number: u32) -> Vec<Part> {
        // From 1 to 2^30, which every drive's scratch holds; up to 64 in a turn.
        let mut number = 1 + (64 * (number % (1 << 23)));
        let mut parts = Vec::new();
        self.mark(&mut parts, number);
        if let Some(put) = turn.put
            && let Some(line) = self.lines.get(usize::from(put.address / 2))
        {
            let send = line.send.replace(HOLE, &line.value(put.cells));
            parts.push(Part { send, answer: line.answer.clone(), reads: None });
        }
        let mut since_mark: Vec<&str> = Vec::new();
        for (at, line) in self.lines.iter().enumerate().filter(|(at, _)| is_read(turn, *at)) {
            if since_mark.contains(&line.answer.as_str()) {
                number += 1;
                self.mark(&mut parts, number);
                since_mark.clear();
            }
            since_mark.push(&line.answer);
            let (send, answer) = (line.send.clone(), line.answer.clone());
            parts.push(Part { send, answer, reads: Some(at) });
        }
        self.mark(&mut parts, number + 1);
        parts
    }

    /// The bytes of a turn, and what is awaited.
    pub(crate) fn turn(self: &Arc<Self>, turn: Turn<'_>, number: u32) -> (Vec<u8>, Awaited) {
        let parts = self.parts(turn, number);
        let text: String = parts.iter().map(|part| self.line(&part.send)).collect();
        let answers = parts.into_iter().map(|part| part.answer).filter(|answer| !answer.is_empty());
        let awaited = Awaited { grammar: Some(Arc::clone(self)), answers: answers.collect() };
        (text.into_bytes(), awaited)
    }

    pub(crate) fn answers(&self, turn: Turn<'_>) -> u32 {
        let count = self.parts(turn, 0).iter().filter(|part| !part.answer.is_empty()).count();
        u32::try_from(count).unwrap_or(u32::MAX)
    }

    /// Bytes of a turn on the line, and of its reply with numbers of eight characters.
    pub(crate) fn bytes(self: &Arc<Self>, turn: Turn<'_>) -> (usize, usize) {
        let (request, awaited) = self.turn(turn, 1 << 13);
        let sum = if self.checksum { 4 } else { 0 };
        let length = |answer: &String| answer.len() + 8 * answer.matches(HOLE).count() + 2 + sum;
        (request.len(), awaited.answers.iter().map(length).sum())
    }

    /// The cells of a reply, [`LINE_CELLS`] for each line that was read.
    pub(crate) fn cells(&self, reply: &[u8], turn: Turn<'_>) -> Result<Vec<u16>, NoData> {
        let text = String::from_utf8_lossy(reply);
        let lines: Vec<&str> = self.texts(&text).flatten().collect();
        let refusal = self.errors.iter().position(|error| lines.contains(&error.as_str()));
        if let Some(code) = refusal {
            let code = 0x80 | u8::try_from(code).unwrap_or(0x7F);
            return Err(NoData::Refused { code, name: "an error line of the drive" });
        }
        let parts = self.parts(turn, 0);
        let answered = parts.iter().filter(|part| !part.answer.is_empty()).zip(&lines);
        let mut cells = Vec::new();
        for (part, answer) in answered {
            let Some(line) = part.reads.and_then(|at| self.lines.get(at)) else { continue };
            let end = cells.len() + usize::from(LINE_CELLS);
            let numbers = holes(&line.answer, answer).unwrap_or_default();
            for (text, kind) in numbers.iter().zip(&line.kinds) {
                cells.extend(self.number(text, *kind)?);
            }
            cells.resize(end, 0);
        }
        let Some(read) = turn.read else { return Ok(cells) };
        let part = cells.get(usize::from(read.address)..).map(<[u16]>::to_vec);
        part.ok_or_else(|| NoData::Mismatch(format!("{text:?} has too few numbers")))
    }

    /// Two cells; a number that is none, or cut off, is not a number where the type has one.
    fn number(&self, text: &str, kind: Kind) -> Result<[u16; 2], NoData> {
        let is_cut = self.cut_at.is_some_and(|most| text.len() >= most && !text.contains('.'));
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && !is_cut);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "casts of a float saturate"
        )]
        let bits = match (kind, value) {
            (Kind::F32, value) => value.map_or(f32::NAN, |value| value as f32).to_bits(),
            (_, None) => return Err(NoData::Mismatch(format!("{text:?} is no whole number"))),
            (Kind::I32, Some(value)) => (value as i32).cast_unsigned(),
            (_, Some(value)) => value as u32,
        };
        let [b3, b2, b1, b0] = bits.to_be_bytes();
        Ok([u16::from_be_bytes([b3, b2]), u16::from_be_bytes([b1, b0])])
    }

    /// The complete lines of a text that are not empty, `None` for one whose check sum is wrong.
    fn texts<'a>(&'a self, text: &'a str) -> impl Iterator<Item = Option<&'a str>> {
        let whole = text.split_inclusive(ENDS).filter(|line| line.ends_with(ENDS)).map(str::trim);
        let whole = whole.filter(|line| !line.is_empty());
        whole.map(
            |line| if self.checksum { without_sum(line).map(str::trim_end) } else { Some(line) },
        )
    }
}

impl Line {
    /// The value of a set-point as text.
    fn value(&self, cells: &[u16]) -> String {
        let bits = cells.iter().fold(0, |bits, cell| bits << 16 | u32::from(*cell));
        match self.kinds.first() {
            Some(Kind::I32) => bits.cast_signed().to_string(),
            Some(Kind::U32) => bits.to_string(),
            _ => format!("{:.*}", self.digits, f32::from_bits(bits)),
        }
    }
}

fn is_read(turn: Turn<'_>, at: usize) -> bool {
    matches!(turn.read, Some(read) if matches!(read.table, CellTable::Lines(mask) if mask >> at & 1 == 1))
}

pub(super) fn search(expected: &Expected, received: &[u8]) -> Search {
    let mut found = Search::default();
    let awaited = &expected.lines;
    let text = String::from_utf8_lossy(received);
    // Bytes that are no text move every position behind them.
    let is_text = text.len() == received.len();
    let Some(grammar) = awaited.grammar.as_deref() else {
        found.foreign += text.matches('\n').count();
        return found;
    };
    let (mut at, mut lines) = (0, Vec::new());
    for line in text.split_inclusive(ENDS).filter(|line| line.ends_with(ENDS)) {
        let text = grammar.texts(line).next();
        lines.extend(text.map(|text| (at, at + line.len(), text)));
        at += line.len();
    }
    let fits = |line: Option<&str>, answer: &String| {
        line.is_some_and(|line| holes(answer, line).is_some())
    };
    let count = awaited.answers.len();
    let whole = lines.windows(count.max(1)).position(|part| {
        let texts = part.iter().map(|(.., line)| line);
        texts.zip(&awaited.answers).all(|(line, answer)| fits(*line, answer))
    });
    // A refusal stands between the numbers in the place of an answer.
    let place = |answer: Option<&String>| {
        lines
            .iter()
            .position(|(.., line)| answer.is_some_and(|answer| *line == Some(answer.as_str())))
    };
    let marks: Vec<&String> = awaited
        .answers
        .iter()
        .filter(|answer| !answer.contains(HOLE) && grammar.ack.as_ref() != Some(answer))
        .collect();
    let between = place(marks.first().copied()).zip(place(marks.last().copied()));
    let refused = between.filter(|(first, last)| {
        lines.get(*first..*last).unwrap_or_default().iter().any(|(.., line)| {
            line.is_some_and(|line| grammar.errors.iter().any(|error| error == line))
        })
    });
    let whole = whole.map(|first| (first, first + count - 1)).or(refused);
    if let Some((first, last)) = whole.filter(|_| is_text) {
        found.reply = Some((lines[first].0, lines[last].1));
        return found;
    }
    for (..) in &lines {
        found.foreign(Unexpected::Frame);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DriveProfile;
    use crate::cell_bus::{Put, ReadRequest};

    fn grammar(profile: &str) -> Arc<Grammar> {
        DriveProfile::named(profile).unwrap().registers.unwrap().lines.clone().unwrap()
    }

    fn asking(grammar: &Grammar, sends: &[&str]) -> Turn<'static> {
        let is_it =
            |(at, line): (usize, &Line)| sends.contains(&line.send.as_str()).then_some(1 << at);
        let mask: u64 = grammar.lines.iter().enumerate().filter_map(is_it).sum();
        let count = LINE_CELLS * u16::try_from(sends.len()).unwrap();
        Turn::read(ReadRequest { table: CellTable::Lines(mask), address: 0, count })
    }

    /// Vectors of the maker's ASCII protocol: the sum is over all in front of the star, the blank included.
    #[test]
    fn every_line_is_that_of_the_makers_protocol() {
        let odrive = grammar("odrive-0.5");
        for (text, line) in [
            ("r vbus_voltage", "r vbus_voltage *93\n"),
            ("w test_property 4711", "w test_property 4711 *26\n"),
            ("r test_property", "r test_property *60\n"),
            ("c 0 0.05", "c 0 0.05 *104\n"),
            ("u 0", "u 0 *69\n"),
            ("f 0", "f 0 *86\n"),
            ("w axis0.requested_state 8", "w axis0.requested_state 8 *42\n"),
            ("w axis0.config.enable_watchdog 1", "w axis0.config.enable_watchdog 1 *4\n"),
        ] {
            assert_eq!(odrive.line(text), line);
        }
        assert_eq!(without_sum("4711*3"), Some("4711"));
        assert_eq!(without_sum("4712*3"), None);
        assert_eq!(without_sum("4711"), None);
    }

    #[test]
    fn holes_take_what_stands_in_their_places() {
        for (template, line, found) in [
            ("{}", "23.5", Some(vec!["23.5"])),
            ("{} {}", "1.25 -0.5", Some(vec!["1.25", "-0.5"])),
            ("V={}:{}:{}", "V=135:246:4730", Some(vec!["135", "246", "4730"])),
            ("A={}", "V=1", None),
            ("+", "+", Some(vec![])),
            ("+", "-", None),
            ("<{}>", "<7>", Some(vec!["7"])),
            ("<{}>", "<7", None),
        ] {
            assert_eq!(holes(template, line), found, "{template} {line}");
        }
    }

    /// Lines that look alike have a number between them; those that name their question follow one another.
    #[test]
    fn a_turn_is_bracketed_by_numbers_that_come_back() {
        let odrive = grammar("odrive-0.5");
        let turn = asking(&odrive, &["r axis0.current_state", "r axis0.error"]);
        let (text, awaited) = odrive.turn(turn, 2);
        let text = String::from_utf8(text).unwrap();
        assert_eq!(text.matches("w test_property").count(), 3, "{text}");
        assert_eq!(awaited.answers, ["129", "{}", "130", "{}", "131"]);
        let roboteq = grammar("roboteq-sdc");
        let turn = asking(&roboteq, &["?A 1", "?V"]);
        let (_, awaited) = roboteq.turn(turn, 2);
        assert_eq!(awaited.answers, ["+", "VAR=129", "A={}", "V={}:{}:{}", "+", "VAR=130"]);
    }

    #[test]
    fn only_what_stands_between_its_own_numbers_is_a_reply() {
        let roboteq = grammar("roboteq-sdc");
        let turn = asking(&roboteq, &["?A 1"]);
        let (_, lines) = roboteq.turn(turn, 2);
        let expected = Expected { lines, ..Expected::default() };
        let look = |text: &str| search(&expected, text.as_bytes()).reply;
        let right = "+\rVAR=129\rA=12\r+\rVAR=130\r";
        assert_eq!(look(right), Some((0, right.len())));
        for (text, is_taken) in [
            ("+\rVAR=129\rA=12\r+\rVAR=130", false),
            ("+\rVAR=127\rA=12\r+\rVAR=128\r", false),
            ("+\rVAR=129\r+\rVAR=130\r", false),
            ("+\rVAR=129\rA=11\rA=12\r+\rVAR=130\r", false),
            ("+\rVAR=129\rV=12\r+\rVAR=130\r", false),
            ("A=11\rVAR=127\r+\rVAR=129\rA=12\r+\rVAR=130\r", true),
            ("+\rVAR=129\r-\r+\rVAR=130\r", true),
        ] {
            assert_eq!(look(text).is_some(), is_taken, "{text:?}");
        }
        assert!(
            matches!(roboteq.cells(right.as_bytes(), turn), Ok(cells) if cells[..2] == [0, 12])
        );
        let refused = roboteq.cells(b"+\rVAR=129\r-\r+\rVAR=130\r", turn);
        assert!(matches!(refused, Err(NoData::Refused { code: 0x80, .. })));
    }

    #[test]
    fn a_number_that_is_cut_off_is_missing_and_a_set_point_is_text() {
        let odrive = grammar("odrive-0.5");
        let missing = odrive.number("123456789", Kind::F32).map(|[high, _]| high);
        assert!(matches!(missing, Ok(0x7FC0)));
        assert!(odrive.number("123456789", Kind::U32).is_err());
        let [b3, b2, b1, b0] = 2.3e-5_f32.to_be_bytes();
        let cells = [u16::from_be_bytes([b3, b2]), u16::from_be_bytes([b1, b0])];
        assert!(matches!(odrive.number("0.000023", Kind::F32), Ok(found) if found == cells));
        let at = odrive.lines.iter().position(|line| line.send == "v 0 {}").unwrap();
        let [b3, b2, b1, b0] = (-2.5_f32).to_be_bytes();
        let cells = [u16::from_be_bytes([b3, b2]), u16::from_be_bytes([b1, b0])];
        let put = Put { function: 2, address: 2 * u16::try_from(at).unwrap(), cells: &cells };
        let (text, awaited) = odrive.turn(Turn::write(put), 1);
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains("\nv 0 -2.500000 *"), "{text}");
        assert_eq!(awaited.answers, ["65", "66"]);
    }
}
