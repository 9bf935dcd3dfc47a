//! Which key means what on this screen: one table for the program, its help and its tests.

use crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// What a key asks for, whatever the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Press {
    /// Rows, downwards positive.
    Move(i32),
    Open,
    Add,
    Remove,
    Map,
    Next,
    /// The curve that the error follows.
    Curve,
    /// That curve as an effect without a name.
    Table,
    Guess,
    Write,
    Help,
    Back,
    Quit,
    Interrupt,
    Other,
}

/// Keys as the help shows them.
pub(super) const HELP: [(&str, &str); 11] = [
    ("Up Down", "select an effect; scroll a page"),
    ("Enter", "the card of the effect: equation, causes, remedy"),
    ("a", "add it: refitted, judged on the hold-out, or refused"),
    ("r", "remove it: refused where it is needed"),
    ("m", "error over speed x current, each equation in turn"),
    ("n", "what these runs do not tell, and the run that would"),
    ("c t", "the curve that an unexplained error follows; add it"),
    ("g", "guess first: no names until you have given one"),
    ("w", "write the model to a new file"),
    ("Esc ?", "back; this help"),
    ("q Ctrl-C", "leave; leave at once"),
];

/// Rows that a page key moves.
const PAGE: i32 = 10;

/// `None` for the release of a key.
pub(super) fn press(key: KeyEvent) -> Option<Press> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        KeyCode::Esc => Press::Back,
        KeyCode::Char('c' | 'C') if control => Press::Interrupt,
        KeyCode::Char(_) if control => Press::Other,
        KeyCode::Char(letter) => match letter.to_ascii_lowercase() {
            'a' => Press::Add,
            'r' => Press::Remove,
            'm' => Press::Map,
            'n' => Press::Next,
            'c' => Press::Curve,
            't' => Press::Table,
            'g' => Press::Guess,
            'w' => Press::Write,
            '?' => Press::Help,
            'q' => Press::Quit,
            _ => Press::Other,
        },
        KeyCode::Enter => Press::Open,
        KeyCode::Up => Press::Move(-1),
        KeyCode::Down => Press::Move(1),
        KeyCode::PageUp => Press::Move(-PAGE),
        KeyCode::PageDown => Press::Move(PAGE),
        _ => Press::Other,
    })
}
