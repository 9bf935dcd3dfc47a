//! Run folders and CSV: written during the run, read complete or not.
//!
//! ```text
//! Sample, CommandRow -> RowOrder -> Row -+-> on-line identification
//!                           Event -------+-> Journal: Layout -> whole lines
//!                                             of a Recorder (writer thread, run folder) or a MemoryRecorder (virtual time)
//!
//! run folder | samples.csv | any CSV + ColumnMap -> RunRows (row by row) -> open_run -> LoadedRun { Run, Manifest, warnings }
//! ```
//!
//! * `samples.csv` has one strictly increasing time axis; a command stands at the drive time at which it was applied.
//! * The rows of a cycle, a command and its sample, reach the file in one write, so that a killed program loses at most the rows
//!   of the last cycle.
//! * `manifest.json` contains `"finished": false` until the run is closed; such a run is read to its last whole row.

mod column_map;
mod csv_cells;
mod csv_columns;
mod csv_head;
mod csv_number;
mod csv_read;
mod csv_time;
mod csv_write;
mod error;
mod journal;
mod manifest;
mod missing_values;
mod open_run;
#[cfg(feature = "parquet")]
mod parquet;
mod preview;
mod recorder;
mod row_order;
mod run_folder;
mod time_axis;

pub use column_map::{ColumnMap, Factor, Mapping};
pub use csv_number::NoNumber;
pub use csv_read::{CsvRows, ReadOptions, read_csv};
pub use csv_write::{ColumnKind, Layout, Row, number_text, write_run};
pub use error::{RecordingError, Remedy, RowProblem};
pub use journal::{Event, MemoryRecorder, Record, RecorderStatus};
pub use manifest::{Machine, Manifest};
pub use missing_values::MissingValues;
pub use open_run::{LoadedRun, RunRows, open_run, run_from_memory};
#[cfg(feature = "parquet")]
pub use parquet::parquet;
pub use preview::{Preview, PreviewColumn, preview, read_preview};
pub use recorder::{Kept, KeptLogs, Recorder};
pub use row_order::{CommandRow, RowOrder};
pub use run_folder::{FIRST_CAPTURE, LATEST, RunFile, RunFolder, read_text, resolved, utc_stamp};
