//! The text table of negatives, followed by the names of the trusted ones.

use std::fmt::Write as _;

use veiloc_pose::State;

use super::document::{NegativeRow, NegativesResult};
use crate::results::text_table::TextTable;

/// Maximum number of trusted negatives that are listed; the document has all.
const NAMED: usize = 20;

/// The rows as a table, followed by the worst negatives; empty without queries.
pub fn table(negatives: &NegativesResult) -> String {
    if negatives.rows.is_empty() {
        return String::new();
    }
    let head = ["scheme", "negatives", "trusted", "doubtful", "not found", "unusable"].map(str::to_owned);
    let quantiles = NegativeRow::QUANTILES.map(|p| match p {
        100 => "max".to_owned(),
        _ => format!("{p} %"),
    });
    let mut table = TextTable::new(head.into_iter().chain(quantiles.map(|q| format!("evidence {q}"))), 1);
    for row in &negatives.rows {
        let counts = [row.negatives, row.trusted, row.doubtful, row.not_found, row.unusable];
        let evidence = |p: &u32| {
            let value = row.log_evidence.get(&p.to_string()).copied().flatten();
            value.map_or("\u{2014}".to_owned(), |v| format!("{v:.1}"))
        };
        let numbers = counts.iter().map(usize::to_string).chain(NegativeRow::QUANTILES.iter().map(evidence));
        table.push([row.scheme.clone()].into_iter().chain(numbers).collect());
    }
    let mut text = table.render();
    let mut trusted: Vec<_> = negatives.queries.iter().filter(|q| q.state == State::Trusted).collect();
    trusted.sort_by(|a, b| b.log_evidence.unwrap_or(0.0).total_cmp(&a.log_evidence.unwrap_or(0.0)));
    if !trusted.is_empty() {
        text.push_str("Trusted (each is wrong):\n");
    }
    for query in trusted.iter().take(NAMED) {
        let _ = writeln!(
            text,
            "  {}  {}  log evidence {:.1}, {} of {} matches agree",
            query.name,
            query.scheme,
            query.log_evidence.unwrap_or(f64::NAN),
            query.inliers,
            query.matches
        );
    }
    if let Some(more @ 1..) = trusted.len().checked_sub(NAMED) {
        let _ = writeln!(text, "  and {more} more");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::document::tests::negative;
    use super::*;
    use crate::results::text_table::WIDTH;
    use veiloc_protocol::Scheme;

    fn negatives(queries: Vec<super::super::NegativeQuery>) -> NegativesResult {
        let row = NegativeRow::of(Scheme::default(), &queries.iter().collect::<Vec<_>>());
        NegativesResult { rows: vec![row], queries, unread: Vec::new() }
    }

    #[test]
    fn worst_negatives_are_listed() {
        let text = table(&negatives(vec![
            negative("dcl", None),
            negative("dcl", Some(70.0)),
            negative("dcl", Some(107.0)),
        ]));
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        let cells: Vec<&str> = text.lines().nth(2).expect("a row").split_whitespace().collect();
        assert_eq!(cells, ["dcl", "3", "2", "0", "1", "0", "70.0", "107.0", "107.0", "107.0"]);
        assert!(
            text.find("107.0, 30 of 200").expect("named") < text.find("70.0, 30").expect("named"),
            "{text}"
        );
        let many = table(&negatives(vec![negative("dcl", Some(99.0)); 23]));
        assert!(many.ends_with("  and 3 more\n"), "{many}");
        assert!(!table(&negatives(vec![negative("dcl", Some(9.0))])).contains("wrong"));
        assert_eq!(table(&NegativesResult::default()), "");
    }
}
