//! Which key means what: one table for the program, its help and its tests.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// What a key asks for, whatever the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Press {
    Stop,
    /// Ctrl-C: stop, then quit.
    Interrupt,
    Quit,
    Start,
    Yes,
    Help,
    Freeze,
    Zoom,
    Mark,
    ResetFault,
    Diagnose,
    NextScreen,
    PreviousScreen,
    Screen(usize),
    /// Lines to scroll, downwards positive.
    Scroll(i32),
    Other,
}

/// Keys as the help shows them.
pub(super) const HELP: [(&str, &str); 11] = [
    ("Space Esc", "STOP: ramp down; again: at once"),
    ("a Enter", "start, where the bench waits for it"),
    ("q", "quit, when nothing is energised"),
    ("Ctrl-C", "stop, then quit; 3 x: leave now"),
    ("Tab 1 2 3", "screens"),
    ("f", "freeze the view, capture goes on"),
    ("z", "zoom the time axis"),
    ("m", "mark this moment in the record"),
    ("r", "reset a fault of the drive"),
    ("Up Down d", "scroll the report; diagnosis by hand after it"),
    ("?", "this help"),
];

/// Rows that a page key scrolls.
const PAGE: i32 = 10;

/// `None` for the release of a key.
pub(super) fn press(key: KeyEvent) -> Option<Press> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    // Esc with another key right behind it arrives as Alt and that key: the stop must not be lost.
    if key.modifiers.contains(KeyModifiers::ALT) {
        return Some(Press::Stop);
    }
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        KeyCode::Char(' ') | KeyCode::Esc => Press::Stop,
        KeyCode::Char('c' | 'C') if control => Press::Interrupt,
        KeyCode::Char(_) if control => Press::Other,
        KeyCode::Char(letter) => character(letter.to_ascii_lowercase()),
        KeyCode::Enter => Press::Start,
        KeyCode::Tab => Press::NextScreen,
        KeyCode::BackTab => Press::PreviousScreen,
        KeyCode::Up => Press::Scroll(-1),
        KeyCode::Down => Press::Scroll(1),
        KeyCode::PageUp => Press::Scroll(-PAGE),
        KeyCode::PageDown => Press::Scroll(PAGE),
        _ => Press::Other,
    })
}

const fn character(letter: char) -> Press {
    match letter {
        'q' => Press::Quit,
        'a' => Press::Start,
        'y' => Press::Yes,
        '?' => Press::Help,
        'f' => Press::Freeze,
        'z' => Press::Zoom,
        'm' => Press::Mark,
        'd' => Press::Diagnose,
        'r' => Press::ResetFault,
        '1' => Press::Screen(0),
        '2' => Press::Screen(1),
        '3' => Press::Screen(2),
        _ => Press::Other,
    }
}
