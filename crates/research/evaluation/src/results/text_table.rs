//! Text tables: aligned columns, no empty column, a rule below the head.

use std::fmt::Write as _;

/// Width that every terminal has.
pub const WIDTH: usize = 120;

/// A share as percent with one decimal.
pub fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// A length with four decimals, or with more when it would have fewer than three significant digits; a length of a
/// thousand or more is whole.
pub fn length(value: f64) -> String {
    let size = value.abs();
    let decimals = match size {
        s if s >= 1000.0 => 0.0,
        s if s > 0.0 => (2.0 - s.log10().floor()).clamp(4.0, 12.0),
        _ => 4.0,
    };
    format!("{value:.*}", decimals as usize)
}

/// A table under construction; all rows have the length of the head.
#[derive(Debug, Clone, Default)]
pub struct TextTable {
    head: Vec<String>,
    /// This many columns from the left are names, aligned left; numbers are aligned right.
    names: usize,
    rows: Vec<Vec<String>>,
}

impl TextTable {
    /// A table with these columns, of which the first `names` hold names.
    pub fn new(head: impl IntoIterator<Item = impl Into<String>>, names: usize) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), names, rows: Vec::new() }
    }

    /// Appends a row; missing cells are empty.
    pub fn push(&mut self, mut cells: Vec<String>) {
        cells.resize(self.head.len(), String::new());
        self.rows.push(cells);
    }

    /// The names of the first table once, then the numbers of both: for tables with the same rows.
    pub fn beside(&self, other: &Self) -> Self {
        let join = |a: &Vec<String>, b: &Vec<String>| a.iter().chain(&b[other.names..]).cloned().collect();
        Self {
            head: join(&self.head, &other.head),
            names: self.names,
            rows: self.rows.iter().zip(&other.rows).map(|(a, b)| join(a, b)).collect(),
        }
    }

    /// Whether it has any number.
    pub fn has_numbers(&self) -> bool {
        self.rows.iter().any(|row| row[self.names..].iter().any(|cell| !cell.is_empty()))
    }

    /// Width of a line, characters.
    pub fn width(&self) -> usize {
        let widths = self.widths();
        widths.iter().sum::<usize>() + 2 * widths.iter().filter(|w| **w > 0).count().saturating_sub(1)
    }

    /// Width of each column, characters; 0 for an empty column.
    fn widths(&self) -> Vec<usize> {
        (0..self.head.len())
            .map(|c| {
                let widest = self.rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0);
                if widest == 0 { 0 } else { widest.max(self.head[c].chars().count()) }
            })
            .collect()
    }

    /// The text; every line ends with a line feed.
    pub fn render(&self) -> String {
        let widths = self.widths();
        let mut text = String::new();
        for (index, cells) in std::iter::once(&self.head).chain(&self.rows).enumerate() {
            let start = text.len();
            for (column, (cell, width)) in cells.iter().zip(&widths).enumerate().filter(|(_, (_, w))| **w > 0)
            {
                let gap = if text.len() == start { "" } else { "  " };
                let _ = if column < self.names {
                    write!(text, "{gap}{cell:<width$}")
                } else {
                    write!(text, "{gap}{cell:>width$}")
                };
            }
            text.truncate(text.trim_end_matches(' ').len());
            text.push('\n');
            if index == 0 {
                text.push_str(&"─".repeat(self.width()));
                text.push('\n');
            }
        }
        text
    }
}

/// Tables with the same rows, side by side if they fit [`WIDTH`], otherwise below each other; tables without numbers
/// are left out.
pub fn side_by_side(tables: impl IntoIterator<Item = TextTable>) -> String {
    let mut tables = tables.into_iter().filter(TextTable::has_numbers);
    let Some(mut open) = tables.next() else { return String::new() };
    let mut text = String::new();
    for table in tables {
        let joined = open.beside(&table);
        if joined.width() <= WIDTH {
            open = joined;
        } else {
            text += &(open.render() + "\n");
            open = table;
        }
    }
    text + &open.render()
}

#[cfg(test)]
mod tests {
    use super::{TextTable, WIDTH, length, side_by_side};

    #[test]
    fn lengths_of_any_unit_have_significant_digits() {
        let lengths = [0.035, 12.345_67, 12_345.678, 0.000_012_34, 0.0, f64::INFINITY].map(length);
        assert_eq!(lengths, ["0.0350", "12.3457", "12346", "0.0000123", "0.0000", "inf"]);
    }

    #[test]
    fn columns_are_aligned_and_empty_ones_omitted() {
        let mut table = TextTable::new(["name", "unused", "°"], 1);
        table.push(vec!["a".into(), String::new(), "12.5".into()]);
        table.push(vec!["bcdef".into()]);
        assert_eq!(table.render(), "name      °\n───────────\na      12.5\nbcdef\n");
        assert_eq!(table.width(), 11);
    }

    #[test]
    fn tables_with_equal_rows_are_merged() {
        let (mut a, mut b) = (TextTable::new(["name", "x"], 1), TextTable::new(["name", "y"], 1));
        for (name, x, y) in [("p", "1", "2"), ("q", "3", "4")] {
            a.push(vec![name.into(), x.into()]);
            b.push(vec![name.into(), y.into()]);
        }
        assert_eq!(a.beside(&b).render(), "name  x  y\n──────────\np     1  2\nq     3  4\n");
        assert!(b.has_numbers());
        assert!(!TextTable::new(["name", "x"], 1).has_numbers());
    }

    #[test]
    fn tables_are_side_by_side_if_they_fit() {
        let table = |column: &str, cell: &str| {
            let mut table = TextTable::new(["name", column], 1);
            table.push(vec!["p".into(), cell.into()]);
            table
        };
        let wide = "w".repeat(WIDTH - 10);
        let text =
            side_by_side([table("short", "1"), table("empty", ""), table(&wide, "2"), table("y", "3")]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 7, "{text}");
        assert_eq!((lines[0], lines[2], lines[3]), ("name  short", "p         1", ""));
        assert!(lines[4].ends_with("w  y") && lines[6].ends_with("2  3"), "{text}");
        assert_eq!(side_by_side([table("empty", "")]), "");
    }
}
