//! A table and its output formats.

use std::fmt::Write as _;

/// Output format of tables.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Format {
    /// GitHub Markdown.
    #[default]
    Markdown,
    /// LaTeX `tabular` with `booktabs`.
    Latex,
    /// RFC 4180, one table after another, separated by an empty line.
    Csv,
}

/// A table with its title and notes.
pub(super) struct FormattedTable {
    title: String,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    notes: Vec<String>,
}

impl FormattedTable {
    /// A table with a column for names and these columns.
    pub(super) fn new(title: &str, names: &str, columns: &[String]) -> Self {
        let head = std::iter::once(names.to_owned()).chain(columns.iter().cloned()).collect();
        Self { title: title.to_owned(), head, rows: Vec::new(), notes: Vec::new() }
    }

    pub(super) fn push(&mut self, name: &str, cells: Vec<String>) {
        let mut row = vec![name.to_owned()];
        row.extend(cells);
        row.resize(self.head.len(), String::new());
        self.rows.push(row);
    }

    /// Adds a sentence below the table.
    pub(super) fn note(&mut self, text: &str) {
        self.notes.push(text.to_owned());
    }

    pub(super) fn render(&self, format: Format) -> String {
        match format {
            Format::Markdown => self.markdown(),
            Format::Latex => self.latex(),
            Format::Csv => self.csv(),
        }
    }

    fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let rule: Vec<String> = self.head.iter().map(|_| "---".to_owned()).collect();
        let mut out = format!("{}\n\n{}{}", self.title, line(&self.head), line(&rule).replace(' ', ""));
        for row in &self.rows {
            out.push_str(&line(row));
        }
        for note in &self.notes {
            write!(out, "\n{note}\n").expect("a string takes all that is written to it");
        }
        out
    }

    fn latex(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| escaped(cell)).collect();
            format!("{} \\\\\n", cells.join(" & "))
        };
        let mut out = format!("% {}\n\\begin{{tabular}}{{l", self.title);
        out.push_str(&"c".repeat(self.head.len() - 1));
        write!(out, "}}\n\\toprule\n{}\\midrule\n", line(&self.head))
            .expect("a string takes all that is written to it");
        for row in &self.rows {
            out.push_str(&line(row));
        }
        out.push_str("\\bottomrule\n\\end{tabular}\n");
        for note in &self.notes {
            writeln!(out, "% {note}").expect("a string takes all that is written to it");
        }
        out
    }

    fn csv(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| quoted(cell)).collect();
            format!("{}\r\n", cells.join(","))
        };
        let mut out = line(&self.head);
        for row in &self.rows {
            out.push_str(&line(row));
        }
        out
    }
}

fn escaped(cell: &str) -> String {
    let mut out = String::new();
    for c in cell.chars() {
        match c {
            '\\' => out.push_str("\\textbackslash{}"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '°' => out.push_str("$^\\circ$"),
            '∞' => out.push_str("$\\infty$"),
            c => out.push(c),
        }
    }
    out
}

fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}
