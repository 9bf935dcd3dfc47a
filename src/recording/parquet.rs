//! A run as one Parquet file, for programs that read columns: pandas, Polars, DuckDB. Built with the feature `parquet` only.

use std::fmt::Write as _;
use std::sync::Arc;

use ::parquet::data_type::DoubleType;
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;

use crate::sample::{Channel, Run};

/// The bytes of the file: `time_s`, then a column of numbers for each channel of the run, null where a value is missing.
pub fn parquet(run: &Run) -> Result<Vec<u8>, ParquetError> {
    let columns: Vec<(&str, &[f64])> = Channel::ALL
        .into_iter()
        .filter_map(|channel| Some((channel.key(), run.column(channel)?)))
        .collect();
    let mut schema = "message run { REQUIRED DOUBLE time_s; ".to_owned();
    for (key, _) in &columns {
        let _ = write!(schema, "OPTIONAL DOUBLE {key}; ");
    }
    schema.push('}');
    let schema = Arc::new(parse_message_type(&schema)?);
    let properties = Arc::new(WriterProperties::builder().build());
    let mut file = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut file, schema, properties)?;
    let mut rows = writer.next_row_group()?;
    if let Some(mut column) = rows.next_column()? {
        let time = column.typed::<DoubleType>();
        time.write_batch(run.time_s(), None, None)?;
        column.close()?;
    }
    for (_, values) in &columns {
        let known: Vec<f64> = values
            .iter()
            .copied()
            .filter(|value| value.is_finite())
            .collect();
        let is_there: Vec<i16> = values
            .iter()
            .map(|value| i16::from(value.is_finite()))
            .collect();
        if let Some(mut column) = rows.next_column()? {
            let written = column.typed::<DoubleType>();
            written.write_batch(&known, Some(&is_there), None)?;
            column.close()?;
        }
    }
    rows.close()?;
    writer.close()?;
    Ok(file)
}
