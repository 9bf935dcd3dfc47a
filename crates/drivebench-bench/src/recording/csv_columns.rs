//! Which cells of a line are the time and the quantities: by a map, or by our own headers.

use super::{ColumnMap, Factor, RecordingError};
use drivebench_model::config_text::nearest;
use drivebench_model::sample::Channel;

/// Own columns that are no quantity.
const BOOKKEEPING: [&str; 4] = ["host_time_s", "seq", "status", QUALITY];
/// The one of them that is kept.
pub(super) const QUALITY: &str = "quality";

/// One column of the run: the product of some cells and `factor`, plus `offset`.
pub(super) struct Column {
    /// `None` is the time axis.
    pub target: Option<Channel>,
    pub cells: Vec<Cell>,
    pub factor: f64,
    pub offset: f64,
}

pub(super) struct Cell {
    pub field: usize,
    /// Only the sign of the cell counts: that of its last value that was not zero, +1 before there is one.
    pub sign: Option<f64>,
}

pub(super) fn columns_by_map(
    headers: &[String],
    map: &ColumnMap,
    file: &str,
) -> Result<Vec<Column>, RecordingError> {
    let cell = |name: &str, sign| -> Result<Cell, RecordingError> {
        Ok(Cell { field: field_of(headers, name, file)?, sign })
    };
    let columns = map.items().iter().map(|item| {
        // A header may contain a star itself.
        let cells = if headers.contains(&item.header) {
            vec![cell(&item.header, None)?]
        } else {
            let cells = item.columns.iter().map(|factor| match factor {
                Factor::Column(name) => cell(name, None),
                Factor::SignOf(name) => cell(name, Some(1.0)),
            });
            cells.collect::<Result<_, RecordingError>>()?
        };
        Ok(Column { target: item.target, cells, factor: item.factor, offset: item.offset })
    });
    columns.collect()
}

pub(super) fn columns_of_our_own(
    headers: &[String],
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Column>, RecordingError> {
    let plain = |header, target| {
        let field = field_of(headers, header, file)?;
        Ok(Column { target, cells: vec![Cell { field, sign: None }], factor: 1.0, offset: 0.0 })
    };
    let mut columns = vec![plain("time_s", None)?];
    let mut ignored = Vec::new();
    for header in headers {
        if let Some(channel) = Channel::from_key(header) {
            columns.push(plain(header, Some(channel))?);
        } else if header != "time_s" && !BOOKKEEPING.contains(&header.as_str()) {
            ignored.push(format!("{header:?}"));
        }
    }
    if columns.len() == 1 {
        let (file, help) = (file.to_owned(), map_help(headers));
        return Err(RecordingError::NoKnownColumn { file, help });
    }
    if !ignored.is_empty() {
        warnings.push(format!("{file}: unknown columns were ignored: {}", ignored.join(", ")));
    }
    Ok(columns)
}

fn field_of(headers: &[String], header: &str, file: &str) -> Result<usize, RecordingError> {
    let fields: Vec<usize> = (0..headers.len()).filter(|field| headers[*field] == header).collect();
    let (file, header) = (file.to_owned(), header.to_owned());
    match (fields.first(), fields.len()) {
        (Some(field), 1) => Ok(*field),
        (Some(_), count) => Err(RecordingError::AmbiguousHeader { file, header, count }),
        (None, _) => {
            let names = headers.iter().map(String::as_str).filter(|name| !name.is_empty());
            let near = nearest(&header, names)
                .map_or_else(String::new, |name| format!("did you mean {name:?}? "));
            Err(RecordingError::HeaderNotFound { file, header, help: near + &map_help(headers) })
        }
    }
}

fn map_help(headers: &[String]) -> String {
    let there: Vec<String> = headers.iter().map(|name| format!("{name:?}")).collect();
    format!("the file has {}; name them with --map 'time_s=HEADER,...'", there.join(", "))
}
