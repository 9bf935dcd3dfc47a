"""Reads the samples of a run as Parquet with pyarrow: every column is that of the CSV, cell by cell.

    parquet_peer.py samples.csv samples.parquet
"""

import csv
import sys

import pyarrow.parquet

table = pyarrow.parquet.read_table(sys.argv[2])
with open(sys.argv[1], encoding="utf-8", newline="") as file:
    header, *rows = csv.reader(file)
assert table.column_names == header, (table.column_names, header)
assert table.num_rows == len(rows) > 0, (table.num_rows, len(rows))
for place, name in enumerate(header):
    kind = {"seq": int, "status": str, "quality": str}.get(name, float)
    cells = [kind(row[place]) if row[place] else None for row in rows]
    assert table.column(name).to_pylist() == cells, name
print(f"{len(rows)} rows of {len(header)} columns")
