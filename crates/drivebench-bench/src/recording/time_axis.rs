//! Order of the stamps of a foreign file.

use super::RecordingError;

/// Rows of a foreign file that were left out for their time.
#[derive(Default)]
pub(super) struct Stamps {
    pub repeated: usize,
    pub backwards: usize,
    /// Of the first row that goes back.
    pub first: Option<RecordingError>,
}

impl Stamps {
    pub(super) fn sentence(&self, file: &str) -> Option<String> {
        let (repeated, backwards) = (self.repeated, self.backwards);
        let all = repeated + backwards;
        (all > 0).then(|| {
            format!(
                "{file}: {all} rows whose time is not after that of the row before were left out: {repeated} repeat it, {backwards} go back"
            )
        })
    }
}
