//! The key table: one meaning for each key on every screen, for the program, its help and its tests.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::Position;

/// The meaning of a key, whatever the screen and its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Press {
    /// Stop the motor; where none can be on, close what is open.
    Stop,
    Interrupt,
    Suspend,
    Quit,
    Start,
    Yes,
    Help,
    Freeze,
    Zoom,
    Mark,
    ResetFault,
    Experiment,
    SpeedLoop,
    Diagnose,
    NextScreen,
    PreviousScreen,
    Page(usize),
    /// Rows to scroll or to select by, downwards positive.
    Move(i32),
    /// The same from the wheel of a mouse, which zooms a time axis.
    Wheel(i32),
    /// The left button of the mouse, at this place.
    Click(Position),
    Open,
    Add,
    Remove,
    Map,
    Next,
    Curve,
    /// Adds that curve as a table.
    Table,
    Write,
    Traces,
    Response,
    /// The next of the places where the model is farthest off.
    Worst,
    /// Zoom in, or out.
    Zoomed(bool),
    /// Along the time axis, backwards negative.
    Pan(i32),
    Cursor(i32),
    Signals,
    Undo,
    /// The model before the last change, or after it.
    Before,
    Other,
}

/// Characters, letters in either case.
pub(super) const CHARACTERS: [(char, Press); 31] = [
    ('q', Press::Quit),
    ('?', Press::Help),
    ('s', Press::Start),
    ('y', Press::Yes),
    ('f', Press::Freeze),
    ('z', Press::Zoom),
    ('m', Press::Mark),
    ('k', Press::ResetFault),
    ('x', Press::Experiment),
    ('l', Press::SpeedLoop),
    ('d', Press::Diagnose),
    ('1', Press::Page(0)),
    ('2', Press::Page(1)),
    ('3', Press::Page(2)),
    ('a', Press::Add),
    ('r', Press::Remove),
    ('e', Press::Map),
    ('n', Press::Next),
    ('c', Press::Curve),
    ('t', Press::Table),
    ('w', Press::Write),
    ('v', Press::Traces),
    ('g', Press::Response),
    ('j', Press::Worst),
    ('+', Press::Zoomed(true)),
    ('-', Press::Zoomed(false)),
    (',', Press::Pan(-1)),
    ('.', Press::Pan(1)),
    ('o', Press::Signals),
    ('u', Press::Undo),
    ('b', Press::Before),
];

/// The screens on which a key does something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum On {
    Every,
    Live,
    Diagnosis,
    Response,
}

const HELP: [(On, &str, &str); 34] = [
    (On::Every, "Space Esc", "STOP: ramp down; again: at once; without a motor: back"),
    (On::Live, "s", "start, where the bench waits for it"),
    (On::Every, "q", "quit, when nothing is energised"),
    (On::Every, "Ctrl-C", "stop, then quit; 3 x: leave now"),
    (On::Every, "Ctrl-Z", "to the shell, once nothing is energised; fg returns"),
    (On::Live, "Tab 1 2 3", "screens"),
    (On::Live, "f", "freeze the view, capture goes on"),
    (On::Live, "z", "zoom the time axis"),
    (On::Live, "m", "mark this moment in the record"),
    (On::Live, "k", "acknowledge (reset) a fault of the drive"),
    (On::Every, "Up Down", "scroll a page; select an effect"),
    (On::Live, "Enter", "what each step needs, unlocks, and its command"),
    (On::Live, "d", "diagnosis by hand, after the run"),
    (On::Live, "v", "measured and model over time, after the run"),
    (On::Live, "x", "the recommended run, after the report"),
    (On::Live, "l", "the speed loop with the identified model, after the report"),
    (On::Diagnosis, "Enter", "the card of the effect: equation, causes, remedy"),
    (On::Diagnosis, "a", "add it: judged on the hold-out; where refused, a again forces it"),
    (On::Diagnosis, "r", "remove it: refused where it is needed"),
    (On::Diagnosis, "e", "signed error over speed x current, each equation in turn"),
    (On::Diagnosis, "v", "traces: measured and model over time, residual with its noise"),
    (On::Diagnosis, "g", "frequency response: magnitude, phase, coherence, resonances"),
    (On::Diagnosis, "j", "traces: the next of the worst places"),
    (On::Diagnosis, "+ - , .", "traces: zoom, pan"),
    (On::Diagnosis, "Left Right", "cursor of traces, curves and response"),
    (On::Diagnosis, "o Tab", "traces: choose signals; another run, or pathway of the response"),
    (On::Response, "Tab", "the next pathway"),
    (On::Response, "Left Right", "cursor over frequency"),
    (On::Diagnosis, "n", "open questions, and the recommended run"),
    (On::Diagnosis, "c t", "error over its axis, with the curve of the effect; add a curve"),
    (On::Diagnosis, "u", "undo the last change by hand"),
    (On::Diagnosis, "b", "before and after the last change, in turn"),
    (On::Diagnosis, "w", "write the model to a new file"),
    (On::Every, "?", "this help"),
];

pub(super) fn help(on: On) -> impl Iterator<Item = (&'static str, &'static str)> {
    HELP.iter().filter(move |row| row.0 == On::Every || row.0 == on).map(|row| (row.1, row.2))
}

/// `None` for the release of a key.
pub(super) fn press(key: KeyEvent) -> Option<Press> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    // Esc and another key at once arrive as Alt and that key: the stop must not be lost.
    if key.modifiers.contains(KeyModifiers::ALT) {
        return Some(Press::Stop);
    }
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        // With Ctrl as well: a hand that changes from Ctrl-C to Space still holds it.
        KeyCode::Esc | KeyCode::Char(' ') => Press::Stop,
        KeyCode::Char('c' | 'C') if control => Press::Interrupt,
        KeyCode::Char('z' | 'Z') if control => Press::Suspend,
        KeyCode::Char(character) if !control => {
            let wanted = character.to_ascii_lowercase();
            let found = CHARACTERS.iter().find(|(known, _)| *known == wanted);
            found.map_or(Press::Other, |(_, press)| *press)
        }
        KeyCode::Enter => Press::Open,
        KeyCode::Tab => Press::NextScreen,
        KeyCode::BackTab => Press::PreviousScreen,
        KeyCode::Left => Press::Cursor(-1),
        KeyCode::Right => Press::Cursor(1),
        KeyCode::Up => Press::Move(-1),
        KeyCode::Down => Press::Move(1),
        KeyCode::PageUp => Press::Move(-10),
        KeyCode::PageDown => Press::Move(10),
        _ => Press::Other,
    })
}

/// Most frames between two repeats of a held key, and before its first repeat.
const REPEAT_FRAMES: u32 = 2;
const DELAY_FRAMES: u32 = 20;

/// Filter for the auto-repeat of stop keys: a terminal reports a held key as one press after the other. The second press
/// counts only if no third follows within the time of a repeat.
#[derive(Debug, Default)]
pub(super) struct KeyRepeat {
    last: Option<Press>,
    /// Frames since the last press.
    frames: u32,
    /// The press came a second time: held or repeated is not decided yet.
    is_undecided: bool,
}

impl KeyRepeat {
    /// A press, unless it is, or may be, a repeat of a held key.
    pub(super) fn key(&mut self, press: Press) -> Option<Press> {
        let is_same = self.last.replace(press) == Some(press);
        let frames = std::mem::take(&mut self.frames);
        // An effect that is refused is forced by the same key: not by one that is still held.
        let stops = matches!(press, Press::Stop | Press::Interrupt | Press::Add);
        let may_be_held = stops && is_same && frames <= DELAY_FRAMES;
        self.is_undecided = may_be_held && frames > REPEAT_FRAMES;
        (!may_be_held).then_some(press)
    }

    /// A frame without a key; returns a delayed press that was not a repeat.
    pub(super) fn frame(&mut self) -> Option<Press> {
        self.frames = self.frames.saturating_add(1);
        let is_pressed = self.is_undecided && self.frames > REPEAT_FRAMES;
        self.is_undecided &= !is_pressed;
        self.last.filter(|_| is_pressed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_stop_key_is_one_press_and_a_repeated_one_is_two() {
        // Frames before each Space, and the number of stops.
        let held = [[0, 12].to_vec(), [1, 2, 0, 1].repeat(5)].concat();
        for (before, presses) in [(&held[..], 1), (&[0, 4], 2), (&[0, 3, 3], 3), (&[0, 30], 2)] {
            for press in [Press::Stop, Press::Interrupt] {
                let mut keys = KeyRepeat::default();
                let mut counted = 0;
                let last = [DELAY_FRAMES];
                for frames in before.iter().chain(&last) {
                    counted += (0..*frames).filter_map(|_| keys.frame()).count();
                    counted += keys.key(press).iter().count();
                }
                // The last one, long after the others, is not one of them.
                assert_eq!(counted, presses, "{before:?}");
            }
        }
        let mut keys = KeyRepeat::default();
        let moves = (0..9).filter_map(|_| keys.key(Press::Move(1)));
        assert_eq!(moves.count(), 9, "a held arrow moves on");
    }

    #[test]
    fn the_help_names_every_key_that_does_something() {
        let named: Vec<&str> = HELP.iter().flat_map(|row| row.1.split(' ')).collect();
        for word in ["Space", "Esc", "Enter", "Tab", "Ctrl-C", "Up", "Down", "Left", "Right"] {
            assert!(named.contains(&word), "{word}");
        }
        // `y` answers a question that names it.
        for (character, _) in CHARACTERS.iter().filter(|key| key.0 != 'y') {
            assert!(named.contains(&character.to_string().as_str()), "{character}");
        }
    }

    #[test]
    fn a_key_has_one_meaning_and_one_row_in_the_help() {
        for on in [On::Live, On::Diagnosis, On::Response] {
            let mut named: Vec<&str> = help(on).flat_map(|(keys, _)| keys.split(' ')).collect();
            named.sort_unstable();
            assert!(named.windows(2).all(|pair| pair[0] != pair[1]), "{named:?}");
        }
        for (index, (character, press)) in CHARACTERS.iter().enumerate() {
            let others = &CHARACTERS[index + 1..];
            let again = |key: &&(char, Press)| key.0 == *character || key.1 == *press;
            assert_eq!(others.iter().find(again), None, "{character}");
        }
    }

    fn pressed(code: KeyCode, modifiers: KeyModifiers) -> Press {
        press(KeyEvent::new(code, modifiers)).expect("a key that goes down has a meaning")
    }

    #[test]
    fn space_and_escape_stop_with_any_key_held_but_no_release() {
        let held =
            [KeyModifiers::NONE, KeyModifiers::SHIFT, KeyModifiers::CONTROL, KeyModifiers::ALT];
        for modifiers in held {
            for code in [KeyCode::Char(' '), KeyCode::Esc] {
                assert_eq!(pressed(code, modifiers), Press::Stop, "{code:?} {modifiers:?}");
            }
        }
        let q = KeyCode::Char('q');
        assert_eq!(pressed(q, KeyModifiers::ALT), Press::Stop);
        assert_eq!(pressed(q, KeyModifiers::NONE), Press::Quit);
        assert_eq!(pressed(q, KeyModifiers::CONTROL), Press::Other);
        for code in [KeyCode::Char(' '), KeyCode::Esc, q] {
            let event = KeyEvent::new_with_kind(code, KeyModifiers::NONE, KeyEventKind::Release);
            assert_eq!(press(event), None, "{code:?}");
        }
    }

    #[test]
    fn no_key_but_s_starts_and_none_but_y_agrees() {
        let others = [
            KeyCode::Enter,
            KeyCode::Tab,
            KeyCode::BackTab,
            KeyCode::Up,
            KeyCode::Down,
            KeyCode::PageUp,
            KeyCode::PageDown,
            KeyCode::Home,
            KeyCode::F(1),
            KeyCode::Backspace,
        ];
        for code in (' '..='~').map(KeyCode::Char).chain(others) {
            let found = pressed(code, KeyModifiers::NONE);
            let is = |keys: [char; 2]| keys.map(KeyCode::Char).contains(&code);
            assert_eq!(found == Press::Start, is(['s', 'S']), "{code:?}");
            assert_eq!(found == Press::Yes, is(['y', 'Y']), "{code:?}");
        }
    }
}
