//! A CSV table as one Parquet file, for pandas, Polars and `DuckDB`; only with the feature `parquet`.

use std::fmt::Write as _;
use std::io::Read;
use std::sync::Arc;

use ::parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use ::parquet::schema::parser::parse_message_type;

use super::ColumnKind;

/// The cells of a column; `None`: empty or no number.
enum Column {
    Quantities(Vec<Option<f64>>),
    Counts(Vec<Option<i64>>),
    Words(Vec<Option<ByteArray>>),
    /// Microseconds since 1970.
    Instants(Vec<Option<i64>>),
}

impl Column {
    const fn of(kind: ColumnKind) -> Self {
        match kind {
            ColumnKind::Quantity => Self::Quantities(Vec::new()),
            ColumnKind::Count => Self::Counts(Vec::new()),
            ColumnKind::Word => Self::Words(Vec::new()),
            ColumnKind::Instant => Self::Instants(Vec::new()),
        }
    }

    const fn kind(&self) -> (&'static str, &'static str) {
        match self {
            Self::Quantities(_) => ("DOUBLE", ""),
            Self::Counts(_) => ("INT64", ""),
            Self::Words(_) => ("BYTE_ARRAY", " (STRING)"),
            Self::Instants(_) => ("INT64", " (TIMESTAMP(MICROS,true))"),
        }
    }

    fn push(&mut self, cell: &str) {
        match self {
            Self::Quantities(cells) => {
                cells.push(cell.parse().ok().filter(|value: &f64| value.is_finite()));
            }
            Self::Counts(cells) => cells.push(cell.parse().ok()),
            Self::Words(cells) => cells.push((!cell.is_empty()).then(|| ByteArray::from(cell))),
            Self::Instants(cells) => {
                let instant = cell.parse::<jiff::Timestamp>().ok();
                cells.push(instant.map(jiff::Timestamp::as_microsecond));
            }
        }
    }

    /// Moves the cells into the next column of a group.
    fn write(&mut self, rows: &mut RowGroup<'_>) -> Result<(), ParquetError> {
        match self {
            Self::Quantities(cells) => write::<DoubleType>(cells, rows),
            Self::Counts(cells) | Self::Instants(cells) => write::<Int64Type>(cells, rows),
            Self::Words(cells) => write::<ByteArrayType>(cells, rows),
        }
    }
}

type RowGroup<'a> = SerializedRowGroupWriter<'a, Vec<u8>>;

fn write<T: DataType>(
    cells: &mut Vec<Option<T::T>>,
    rows: &mut RowGroup<'_>,
) -> Result<(), ParquetError> {
    let is_some: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
    let values: Vec<T::T> = cells.drain(..).flatten().collect();
    if let Some(mut column) = rows.next_column()? {
        column.typed::<T>().write_batch(&values, Some(&is_some), None)?;
        column.close()?;
    }
    Ok(())
}

/// The bytes of the file: every column of the table by its name, of the type that `kind` returns.
///
/// # Errors
/// A text that is no table.
pub fn parquet(csv: impl Read, kind: impl Fn(&str) -> ColumnKind) -> Result<Vec<u8>, ParquetError> {
    let unread = |error: csv::Error| ParquetError::External(Box::new(error));
    let mut reader = csv::Reader::from_reader(csv);
    let header = reader.headers().map_err(unread)?;
    let mut schema = "message run { ".to_owned();
    let mut columns = Vec::new();
    for name in header {
        let column = Column::of(kind(name));
        let (physical, meaning) = column.kind();
        let _ = write!(schema, "OPTIONAL {physical} {name}{meaning}; ");
        columns.push(column);
    }
    schema.push('}');
    let schema = Arc::new(parse_message_type(&schema)?);
    let properties = Arc::new(WriterProperties::builder().build());
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, properties)?;
    // The rows of a group are in memory.
    let most_rows = 100_000;
    let mut record = csv::StringRecord::new();
    let (mut is_more, mut has_group) = (true, false);
    while is_more {
        let mut rows = 0;
        while rows < most_rows && is_more {
            is_more = reader.read_record(&mut record).map_err(unread)?;
            if is_more {
                columns.iter_mut().zip(&record).for_each(|(column, cell)| column.push(cell));
                rows += 1;
            }
        }
        if rows == 0 && has_group {
            break;
        }
        has_group = true;
        let mut group = writer.next_row_group()?;
        for column in &mut columns {
            column.write(&mut group)?;
        }
        group.close()?;
    }
    writer.into_inner()
}
