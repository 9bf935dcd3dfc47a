//! Run folders and CSV: writing while it runs, reading whatever is there.
