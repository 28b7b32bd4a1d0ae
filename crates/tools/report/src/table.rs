//! Tables: a caption for screen readers, headers of columns and rows, empty columns left out.

use maud::{Markup, html};

/// A table under construction.
pub struct Table {
    label: String,
    /// The first column holds the rows' headers.
    columns: Vec<Column>,
    rows: Vec<Row>,
}

/// Header of a column.
pub struct Column {
    /// A newline is a line break.
    name: String,
    is_text: bool,
}

/// Content of a cell; a dash if empty.
pub type Cell = Option<Markup>;

struct Row {
    class: &'static str,
    head: Markup,
    cells: Vec<Cell>,
}

/// A column of numbers.
pub fn number(name: impl Into<String>) -> Column {
    Column { name: name.into(), is_text: false }
}

/// A column of text.
pub fn words(name: impl Into<String>) -> Column {
    Column { name: name.into(), is_text: true }
}

/// A cell with a text.
pub fn cell(text: impl Into<Option<String>>) -> Cell {
    text.into().map(|text| html! { (text) })
}

impl Table {
    /// `label`: accessible name of the table.
    pub fn new(label: impl Into<String>, columns: Vec<Column>) -> Self {
        Self { label: label.into(), columns, rows: Vec::new() }
    }

    /// Adds a row. `class`: its CSS class, may be empty.
    pub fn push(&mut self, class: &'static str, head: Markup, cells: Vec<Cell>) {
        debug_assert_eq!(cells.len() + 1, self.columns.len(), "{}", self.label);
        self.rows.push(Row { class, head, cells });
    }

    /// The table; empty without rows.
    pub fn html(&self) -> Markup {
        let is_filled = |column: usize| self.rows.iter().any(|row| row.cells[column].is_some());
        let shown: Vec<usize> = (0..self.columns.len() - 1).filter(|column| is_filled(*column)).collect();
        let class = |column: &Column| column.is_text.then_some("words");
        html! {
            @if !self.rows.is_empty() {
                div.scroll tabindex="0" role="region" aria-label=(self.label) {
                    table {
                        thead {
                            tr {
                                (head(&self.columns[0]))
                                @for column in &shown { (head(&self.columns[column + 1])) }
                            }
                        }
                        tbody {
                            @for row in &self.rows {
                                tr class=[Some(row.class).filter(|class| !class.is_empty())] {
                                    th scope="row" { (row.head) }
                                    @for column in &shown {
                                        td class=[class(&self.columns[column + 1])] {
                                            @if let Some(cell) = &row.cells[*column] { (cell) } @else { "–" }
                                        }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn head(column: &Column) -> Markup {
    html! {
        th scope="col" class=[column.is_text.then_some("words")] {
            @for (line, text) in column.name.split('\n').enumerate() { @if line > 0 { br; } (text) }
        }
    }
}

/// A bar whose length is the share; an SVG, since the page's policy forbids inline styles.
pub fn bar(share: f64) -> Markup {
    let width = 46.0 * if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    html! {
        svg.bar viewBox="0 0 46 7" aria-hidden="true" {
            rect.rail width="46" height="7" rx="3.5" {}
            rect.fill width=(format!("{width:.1}")) height="7" rx="3.5" {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_columns_are_omitted() {
        let columns = vec![words("Name"), number("First\nvalue"), number("Second"), words("Third")];
        let mut table = Table::new("Values", columns);
        assert_eq!(table.html().0, "");
        table.push("", html! { "<a>" }, vec![cell("1".to_owned()), None, cell("x<y".to_owned())]);
        table.push("group", html! { "b" }, vec![None, None, cell("z".to_owned())]);
        let html = table.html().0;
        assert!(html.contains("First<br>value") && !html.contains("Second"), "{html}");
        assert!(
            html.contains("x&lt;y") && html.contains("<td>–</td>") && html.contains("<tr class=\"group\">")
        );
        assert_eq!(html.matches("<th scope=\"row\">").count(), 2);
    }
}
