//! Tables in a terminal, at most [`WIDTH`] columns wide.

use std::fmt;

/// The widest line of a table.
pub const WIDTH: usize = 100;
/// Spaces between columns.
const GAP: usize = 2;
/// Minimum width of a column of text that wraps.
const NARROWEST: usize = 8;

/// A table of text. Where it would be wider than [`WIDTH`], columns of text wrap between words, so that a name that is passed
/// to a flag stays in one piece. Where that is not enough, a label of the first column stands on a line of its own, above the
/// rest of its row; and where that is not enough, the columns are printed in several parts.
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

    /// The width of each column without wrapping.
    fn natural_widths(&self) -> Vec<usize> {
        let mut widths = vec![0; self.header.len()];
        for row in self.rows.iter().chain([&self.header]) {
            for (width, cell) in widths.iter_mut().zip(row) {
                let lines = cell.lines().map(|line| line.chars().count());
                *width = lines.max().unwrap_or(0).max(*width);
            }
        }
        widths
    }

    /// The width of each column if every word stays in one piece. Words that no line holds are broken.
    fn narrowest_widths(&self) -> Vec<usize> {
        let mut widths = self.natural_widths();
        for (column, width) in widths.iter_mut().enumerate() {
            if self.is_text[column] {
                let cells = self.rows.iter().chain([&self.header]).map(|row| &row[column]);
                let words = cells.flat_map(|cell| cell.split_whitespace());
                let lengths = words.map(|word| word.chars().count());
                let longest = lengths.filter(|length| *length <= WIDTH).max().unwrap_or(0);
                *width = longest.max(NARROWEST).min(*width);
            }
        }
        widths
    }

    /// The width of each column if columns of text wrap; `None` if the table is still wider than [`WIDTH`].
    fn wrapped_widths(&self) -> Option<Vec<usize>> {
        let (mut widths, narrowest) = (self.natural_widths(), self.narrowest_widths());
        // The widest column that can shrinks, one character at a time; after them the first one, whose labels can leave it.
        for _ in WIDTH..total_width(&widths) {
            let wide = (0..widths.len()).filter(|&column| widths[column] > narrowest[column]);
            let widest = wide.max_by_key(|&column| widths[column]);
            let first = (self.is_text.first() == Some(&true) && widths[0] > NARROWEST).then_some(0);
            widths[widest.or(first)?] -= 1;
        }
        Some(widths)
    }

    /// The table in parts that are not too wide: each has the first columns of text, and some of the others. There is none where
    /// all columns are text.
    fn parts(&self) -> Vec<Self> {
        let widths = self.natural_widths();
        let labels = self.is_text.iter().take_while(|is_text| **is_text).count();
        let mut parts: Vec<Vec<usize>> = Vec::new();
        for column in labels..widths.len() {
            let width_with = |part: &Vec<usize>| {
                total_width(&part.iter().chain([&column]).map(|&at| widths[at]).collect::<Vec<_>>())
            };
            match parts.last_mut().filter(|part| width_with(part) <= WIDTH) {
                Some(part) => part.push(column),
                None => parts.push((0..labels).chain([column]).collect()),
            }
        }
        parts.iter().map(|columns| self.with_columns(columns)).collect()
    }

    fn with_columns(&self, columns: &[usize]) -> Self {
        let of = |row: &Vec<String>| columns.iter().map(|&column| row[column].clone()).collect();
        Self {
            header: of(&self.header),
            rows: self.rows.iter().map(of).collect(),
            is_text: columns.iter().map(|&column| self.is_text[column]).collect(),
        }
    }

    fn write(&self, f: &mut fmt::Formatter<'_>, widths: &[usize]) -> fmt::Result {
        let rule = "─".repeat(total_width(widths));
        writeln!(f, "{rule}")?;
        self.write_row(f, &self.header, widths)?;
        writeln!(f, "{rule}")?;
        for row in &self.rows {
            self.write_row(f, row, widths)?;
        }
        write!(f, "{rule}")
    }

    /// Writes a row, on as many lines as its longest cell needs. A label with a word that its column does not hold has lines of its
    /// own.
    fn write_row(
        &self,
        f: &mut fmt::Formatter<'_>,
        row: &[String],
        widths: &[usize],
    ) -> fmt::Result {
        let mut cells: Vec<Vec<String>> =
            row.iter().zip(widths).map(|(cell, width)| wrap(cell, *width)).collect();
        if self.is_text.first() == Some(&true) && !has_room(&row[0], widths[0]) {
            cells[0].clear();
            for line in wrap(&row[0], WIDTH) {
                writeln!(f, "{line}")?;
            }
        }
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
        if let Some(widths) = self.wrapped_widths() {
            return self.write(f, &widths);
        }
        let parts = self.parts();
        if parts.is_empty() {
            return self.write(f, &self.narrowest_widths());
        }
        for (number, part) in parts.iter().enumerate() {
            if number > 0 {
                writeln!(f)?;
            }
            part.write(f, &part.wrapped_widths().unwrap_or_else(|| part.narrowest_widths()))?;
        }
        Ok(())
    }
}

fn total_width(widths: &[usize]) -> usize {
    widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1)
}

/// Whether every word of `text` fits in a column of this width.
fn has_room(text: &str, width: usize) -> bool {
    text.split_whitespace().all(|word| word.chars().count() <= width)
}

/// Breaks `text` into lines of at most `width` characters: between words; a word that is longer, anywhere.
pub fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = Vec::new();
    for line in text.lines() {
        let chars: Vec<char> = line.chars().collect();
        let mut rest = &chars[..];
        while rest.len() > width.max(1) {
            let fits = &rest[..=width.max(1)];
            let space = fits.iter().rposition(|c| *c == ' ').filter(|at| *at > 0);
            let (part, tail) = rest.split_at(space.unwrap_or(width.max(1)));
            lines.push(part.iter().collect::<String>().trim_end().to_owned());
            let spaces = tail.iter().take_while(|c| **c == ' ').count();
            rest = &tail[spaces..];
        }
        lines.push(rest.iter().collect());
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

    #[test]
    fn names_stay_in_one_piece() {
        let name = "full-context/original/unchanged/original/no-hint";
        let mut labelled = table(&["condition", "a", "b", "c", "example"], 1);
        labelled.set_text(4);
        labelled.add_row([
            name,
            "12345678",
            "12345678",
            "12345678",
            "t01-01,t01-02,t01-03,t01-04 x",
        ]);
        labelled.add_row(["short", "1", "2", "3", "-"]);
        insta::assert_snapshot!(labelled, @"
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        condition                                         a         b         c  example
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        full-context/original/unchanged/original/no-hint
                                                   12345678  12345678  12345678  t01-01,t01-02,t01-03,t01-04
                                                                                 x
        short                                             1         2         3  -
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        ");
        // Two columns of names that have no room beside each other.
        let long = "n/".repeat(40);
        let mut names = table(&["condition", "example"], 2);
        names.add_row([name, &long]);
        let text = names.to_string();
        assert!(text.contains(name) && text.contains(&long), "{text}");
        let mut counted = table(&["condition", "example", "n"], 2);
        counted.add_row([name, &long, "7"]);
        let text = counted.to_string();
        assert!(text.contains(name) && text.contains(&format!("{long}  7")), "{text}");
    }

    /// The time grows with the length: if it grew with the square, this would take hours.
    #[test]
    fn a_word_of_millions_of_letters_is_wrapped() {
        let word = "x".repeat(8 << 20);
        let lines = wrap(&word, 8);
        assert_eq!((lines.len(), lines.concat().len()), (1 << 20, word.len()));
    }

    #[test]
    fn a_table_of_too_many_columns_is_printed_in_parts() {
        let header: Vec<String> = (0..30).map(|column| format!("column {column}")).collect();
        let mut table = table(&header, 1);
        table.add_row((0..30).map(|column| format!("cell {column}")));
        let text = table.to_string();
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert_eq!((text.matches("column 0").count(), text.matches("cell 29").count()), (4, 1));
    }
}
