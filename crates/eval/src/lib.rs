//! Data sets, metrics, tables and reports.
