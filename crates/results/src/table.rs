//! Tables in a terminal, at most [`WIDTH`] columns wide.

use std::fmt;

/// The widest line of a table.
pub const WIDTH: usize = 100;
/// Spaces between columns.
const GAP: usize = 2;
/// Minimum width of a column of text that wraps.
const NARROWEST: usize = 8;

/// A table of text. Columns of text wrap where the table would be wider than [`WIDTH`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextTable {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Whether each column is text, which is aligned to the left and wraps; numbers are aligned to the right.
    is_text: Vec<bool>,
}

/// Makes a table with columns of numbers from column `numbers` on.
pub fn table<T: AsRef<str>>(header: &[T], numbers: usize) -> TextTable {
    let is_text = (0..header.len()).map(|column| column < numbers).collect();
    let header = header.iter().map(|name| name.as_ref().to_owned()).collect();
    TextTable { header, rows: Vec::new(), is_text }
}

impl TextTable {
    /// Makes column `column` a column of text.
    pub fn set_text(&mut self, column: usize) {
        if let Some(is_text) = self.is_text.get_mut(column) {
            *is_text = true;
        }
    }

    /// Adds a row; missing cells are empty.
    pub fn add_row<T: Into<String>>(&mut self, cells: impl IntoIterator<Item = T>) {
        let mut row: Vec<String> = cells.into_iter().map(Into::into).collect();
        row.resize(self.header.len(), String::new());
        self.rows.push(row);
    }

    /// The width of each column.
    fn widths(&self) -> Vec<usize> {
        let mut widths = vec![0; self.header.len()];
        for row in self.rows.iter().chain([&self.header]) {
            for (width, cell) in widths.iter_mut().zip(row) {
                let lines = cell.lines().map(|line| line.chars().count());
                *width = lines.max().unwrap_or(0).max(*width);
            }
        }
        let gaps = GAP * widths.len().saturating_sub(1);
        let mut excess = (widths.iter().sum::<usize>() + gaps).saturating_sub(WIDTH);
        // The widest column of text shrinks, one character at a time.
        while excess > 0 {
            let text = widths.iter_mut().zip(&self.is_text).filter(|(_, is_text)| **is_text);
            match text.max_by_key(|(width, _)| **width).filter(|(width, _)| **width > NARROWEST) {
                Some((width, _)) => *width -= 1,
                None => break,
            }
            excess -= 1;
        }
        widths
    }

    /// Writes a row, on as many lines as its longest cell needs.
    fn write_row(
        &self,
        f: &mut fmt::Formatter<'_>,
        row: &[String],
        widths: &[usize],
    ) -> fmt::Result {
        let cells: Vec<Vec<String>> =
            row.iter().zip(widths).map(|(cell, width)| wrap(cell, *width)).collect();
        let height = cells.iter().map(Vec::len).max().unwrap_or(0).max(1);
        for line in 0..height {
            let mut text = String::new();
            for ((cell, width), is_text) in cells.iter().zip(widths).zip(&self.is_text) {
                let part = cell.get(line).map_or("", String::as_str);
                text += &match is_text {
                    true => format!("{part:<width$}"),
                    false => format!("{part:>width$}"),
                };
                text += &" ".repeat(GAP);
            }
            writeln!(f, "{}", text.trim_end())?;
        }
        Ok(())
    }
}

impl fmt::Display for TextTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = self.widths();
        let rule = "─".repeat(widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1));
        writeln!(f, "{rule}")?;
        self.write_row(f, &self.header, &widths)?;
        writeln!(f, "{rule}")?;
        for row in &self.rows {
            self.write_row(f, row, &widths)?;
        }
        write!(f, "{rule}")
    }
}

/// Breaks `text` into lines of at most `width` characters: after a space, a comma, a slash or a hyphen where there
/// is one, else anywhere.
fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = Vec::new();
    for line in text.lines() {
        let mut rest: Vec<char> = line.chars().collect();
        while rest.len() > width.max(1) {
            let fits = &rest[..=width.max(1)];
            let space = fits.iter().rposition(|c| *c == ' ').filter(|at| *at > 0);
            let mark = fits[..fits.len() - 1].iter().rposition(|c| ",/-+".contains(*c));
            let end = space.or(mark.map(|at| at + 1)).unwrap_or(width.max(1));
            let tail = rest.split_off(end);
            lines.push(rest.iter().collect::<String>().trim_end().to_owned());
            rest = tail.into_iter().skip_while(|c| *c == ' ').collect();
        }
        lines.push(rest.into_iter().collect());
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_right_and_long_text_wraps_to_a_hundred_columns() {
        let mut short = table(&["name", "count"], 1);
        short.add_row(["ä", "10"]);
        short.add_row(["long name\nsecond line", "9"]);
        insta::assert_snapshot!(short, @"
        ──────────────────
        name         count
        ──────────────────
        ä               10
        long name        9
        second line
        ──────────────────
        ");
        let mut wide = table(&["what", "where", "n"], 2);
        wide.add_row(["word ".repeat(30), "a/b/c".repeat(30), "123456".to_owned()]);
        wide.add_row(["x".repeat(200), String::new(), "1".to_owned()]);
        let text = wide.to_string();
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert_eq!(text.matches("word").count(), 30);
        assert_eq!(text.matches('x').count(), 200);
    }
}
