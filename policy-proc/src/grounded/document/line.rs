//! One line of a document, taken apart: cells, stretches of columns and rows, and label plates.

use domain::Cell;

/// Most rectangles read in one line.
const MOST_RECTS: usize = 64;

/// Columns and rows, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rect {
    pub(crate) columns: (u8, u8),
    pub(crate) rows: (u8, u8),
}

impl Rect {
    /// Its cells, by column.
    pub(crate) fn cells(self) -> impl Iterator<Item = Cell> {
        let Self { columns, rows } = self;
        (columns.0..=columns.1).flat_map(move |x| (rows.0..=rows.1).map(move |y| Cell::new(x, y)))
    }

    /// Whether `cell` lies in it.
    pub(crate) fn contains(self, cell: Cell) -> bool {
        (self.columns.0..=self.columns.1).contains(&cell.x)
            && (self.rows.0..=self.rows.1).contains(&cell.y)
    }
}

/// A label plate as it is written: the category's digits, and perhaps the type's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Spelled {
    pub(crate) category: [u8; 3],
    pub(crate) item_type: Option<[u8; 3]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Token<'a> {
    Word(&'a str),
    Number(u32),
    Range(u32, u32),
    Cell(Cell),
    Mark(char),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    Column,
    Row,
}

/// Cells written `(column, row)`, each with the word before it.
pub(crate) fn cells(line: &str) -> Vec<(&str, Cell)> {
    let mut word = "";
    let mut cells = Vec::new();
    for token in tokens(line) {
        match token {
            Token::Word(text) => word = text,
            Token::Cell(cell) => {
                cells.push((word, cell));
                word = "";
            }
            _ => {}
        }
    }
    cells
}

/// Rectangles written as columns with rows, in either order: "column 3: rows 1-14, 17-28", "row 15 (columns
/// 0-15)", "columns 2-5, rows 6-9".
pub(crate) fn rects(line: &str) -> Vec<Rect> {
    let spans = spans(line);
    let mut rects = Vec::new();
    for group in groups(&spans) {
        let of = |axis| group.iter().filter(move |span| span.0 == axis);
        for &(_, from, to) in of(Axis::Column) {
            rects.extend(
                of(Axis::Row)
                    .map(|&(_, low, high)| Rect { columns: (from, to), rows: (low, high) }),
            );
        }
        if rects.len() >= MOST_RECTS {
            rects.truncate(MOST_RECTS);
            break;
        }
    }
    rects
}

/// Label plates, "plate 061-245" or, of a category, "plate 061".
pub(crate) fn plates(line: &str) -> Vec<Spelled> {
    let read = |after: &str| {
        let category = digits(after)?;
        let item_type = after.get(3..)?.strip_prefix('-').and_then(digits);
        Some(Spelled { category, item_type })
    };
    line.split("plate ").skip(1).filter_map(read).collect()
}

/// Three digits in base 7.
fn digits(text: &str) -> Option<[u8; 3]> {
    let digit = |byte: &u8| (b'0'..=b'6').contains(byte).then(|| byte - b'0');
    match text.as_bytes() {
        [a, b, c, ..] => Some([digit(a)?, digit(b)?, digit(c)?]),
        _ => None,
    }
}

/// Stretches of columns or rows.
fn spans(line: &str) -> Vec<(Axis, u8, u8)> {
    let (mut axis, mut joined) = (None, false);
    let mut spans: Vec<(Axis, u8, u8)> = Vec::new();
    for token in tokens(line) {
        let (from, to) = match token {
            Token::Word("column" | "columns" | "col" | "cols" | "x") => {
                axis = Some(Axis::Column);
                continue;
            }
            Token::Word("row" | "rows" | "y") => {
                axis = Some(Axis::Row);
                continue;
            }
            Token::Word("to" | "through") => {
                joined = true;
                continue;
            }
            Token::Word("and") | Token::Mark(',' | ':' | '(' | ')' | '=') => continue,
            Token::Word(_) | Token::Mark(_) | Token::Cell(_) => {
                axis = None;
                continue;
            }
            Token::Number(number) => (number, number),
            Token::Range(from, to) => (from, to),
        };
        let was_joined = std::mem::take(&mut joined);
        let (Some(axis), Ok(from), Ok(to)) = (axis, u8::try_from(from), u8::try_from(to)) else {
            continue;
        };
        match spans.last_mut() {
            Some((last, low, high)) if was_joined && *last == axis => {
                (*low, *high) = ((*low).min(to), (*high).max(to));
            }
            _ => spans.push((axis, from.min(to), from.max(to))),
        }
    }
    spans
}

/// Spans that belong together: some of one axis, then some of the other.
fn groups(spans: &[(Axis, u8, u8)]) -> Vec<&[(Axis, u8, u8)]> {
    let runs: Vec<&[(Axis, u8, u8)]> = spans.chunk_by(|a, b| a.0 == b.0).collect();
    let mut groups = Vec::new();
    let mut from = 0;
    for pair in runs.chunks(2) {
        let length = pair.iter().map(|run| run.len()).sum::<usize>();
        groups.push(&spans[from..from + length]);
        from += length;
    }
    groups
}

fn tokens(line: &str) -> impl Iterator<Item = Token<'_>> {
    let mut rest = line;
    std::iter::from_fn(move || {
        rest = rest.trim_start();
        let first = rest.chars().next()?;
        let (token, after) = if let Some(found) = cell(rest) {
            found
        } else if first.is_ascii_digit() {
            number_or_range(rest)
        } else if first.is_alphabetic() {
            let end = rest.find(|c: char| !c.is_alphanumeric()).unwrap_or(rest.len());
            (Token::Word(&rest[..end]), &rest[end..])
        } else {
            (Token::Mark(first), &rest[first.len_utf8()..])
        };
        rest = after;
        Some(token)
    })
}

/// "(12, 4)".
fn cell(text: &str) -> Option<(Token<'_>, &str)> {
    let (x, rest) = number(text.strip_prefix('(')?.trim_start())?;
    let (y, rest) = number(rest.trim_start().strip_prefix(',')?.trim_start())?;
    let rest = rest.trim_start().strip_prefix(')')?;
    let cell = Cell::new(u8::try_from(x).ok()?, u8::try_from(y).ok()?);
    Some((Token::Cell(cell), rest))
}

fn number_or_range(text: &str) -> (Token<'_>, &str) {
    let Some((from, rest)) = number(text) else { return (Token::Mark('?'), "") };
    let dash = rest.trim_start();
    let after = dash.strip_prefix(['-', '–']).and_then(|after| number(after.trim_start()));
    match after {
        Some((to, rest)) => (Token::Range(from, to), rest),
        None => (Token::Number(from), rest),
    }
}

/// A number, huge ones as the largest there is.
fn number(text: &str) -> Option<(u32, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    (end > 0).then(|| (text[..end].parse().unwrap_or(u32::MAX), &text[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_read_with_the_word_before() {
        let line = "- x: stand at (3, 7) facing e; at(12,4), not (300, 1) nor (1; 2); (0 , 0 )";
        let expected =
            [("at", Cell::new(3, 7)), ("at", Cell::new(12, 4)), ("nor", Cell::new(0, 0))];
        assert_eq!(cells(line), expected);
    }

    #[test]
    fn rectangles_are_read_in_every_manner_of_writing() {
        let rect = |a, b, c, d| Rect { columns: (a, b), rows: (c, d) };
        for (line, expected) in [
            ("- column 3: rows 1-14", vec![rect(3, 3, 1, 14)]),
            ("- row 15: columns 0-15", vec![rect(0, 15, 15, 15)]),
            ("- column 3: rows 1-14, 17-28", vec![rect(3, 3, 1, 14), rect(3, 3, 17, 28)]),
            (
                "- corridors: column 3 (rows 1-14), column 6 (rows 2–13)",
                vec![rect(3, 3, 1, 14), rect(6, 6, 2, 13)],
            ),
            ("barrels [plate 061]: columns 2-5, rows 6-9; seen", vec![rect(2, 5, 6, 9)]),
            ("columns 3 and 6, rows 4 to 9", vec![rect(3, 3, 4, 9), rect(6, 6, 4, 9)]),
            ("change corridors in an aisle: rows 0, 15, 29.", vec![]),
            ("columns 2-5 hold 12 things; rows 999", vec![]),
        ] {
            assert_eq!(rects(line), expected, "{line}");
        }
    }

    #[test]
    fn plates_are_read_in_base_7() {
        let spelled = |category, item_type| Spelled { category, item_type };
        assert_eq!(plates("a [plate 061-245]:"), [spelled([0, 6, 1], Some([2, 4, 5]))]);
        assert_eq!(plates("barrels [plate 061]"), [spelled([0, 6, 1], None)]);
        assert_eq!(plates("plate 071, plate 0, plate"), []);
    }
}
