use super::failure::{Failure, INTERNAL};
use super::live::Strings;
use crate::bench::Intent;
use crate::workflow::ProgressCell;
use std::sync::mpsc::Sender;
pub(super) fn watch<T: Send + 'static>(
    _strings: Strings,
    _intents: Sender<Intent>,
    _progress: Option<ProgressCell>,
    _work: impl FnOnce(&Strings) -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    Err(Failure::new(INTERNAL, "no screen yet"))
}
