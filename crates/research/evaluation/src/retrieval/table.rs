//! The text table of searches.

use crate::results::text_table::{TextTable, percent};

use crate::retrieval::evaluate::RetrievalRow;

/// One line per row.
pub fn table(rows: &[RetrievalRow]) -> String {
    let head = ["images", "search", "build s", "MB", "search ms", "recall", "of the map"];
    let mut table = TextTable::new(head, 2);
    for row in rows {
        table.push(vec![
            row.images.to_string(),
            row.search.to_owned(),
            format!("{:.2}", row.build_seconds),
            format!("{:.1}", row.bytes as f64 / 1e6),
            format!("{:.3}", row.median_ms),
            percent(row.recall),
            percent(row.map_share),
        ]);
    }
    table.render()
}
