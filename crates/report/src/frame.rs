//! Flat tables of figures for other programs: typed columns in full precision, with nulls.

use scores::Interval;

/// A table of values.
#[derive(Debug, Clone, PartialEq)]
pub struct DataFrame {
    /// Its columns, all of the same length.
    pub columns: Vec<Series>,
}

/// A column.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name, unique in the frame: lower case with underscores.
    pub name: String,
    /// Its values.
    pub values: Values,
}

/// The values of a column; `None` is a null.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Text.
    Text(Vec<Option<String>>),
    /// Integers.
    Whole(Vec<Option<i64>>),
    /// Floating-point numbers.
    Real(Vec<Option<f64>>),
    /// Booleans.
    Flag(Vec<Option<bool>>),
}

impl Values {
    /// The number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(values) => values.len(),
            Self::Whole(values) => values.len(),
            Self::Real(values) => values.len(),
            Self::Flag(values) => values.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value in `row` as text; empty for a null.
    pub fn text(&self, row: usize) -> String {
        fn shown<T: ToString>(values: &[Option<T>], row: usize) -> String {
            values.get(row).and_then(Option::as_ref).map_or_else(String::new, T::to_string)
        }
        match self {
            Self::Text(values) => shown(values, row),
            Self::Whole(values) => shown(values, row),
            Self::Real(values) => shown(values, row),
            Self::Flag(values) => shown(values, row),
        }
    }
}

/// Makes a [`DataFrame`] of a list, column by column.
#[derive(Debug)]
pub(super) struct FrameBuilder<'a, T> {
    rows: &'a [T],
    columns: Vec<Series>,
}

impl<'a, T> FrameBuilder<'a, T> {
    pub(super) fn new(rows: &'a [T]) -> Self {
        Self { rows, columns: Vec::new() }
    }

    fn add(&mut self, name: impl Into<String>, values: Values) {
        self.columns.push(Series { name: name.into(), values });
    }

    pub(super) fn text(&mut self, name: impl Into<String>, value: impl Fn(&T) -> Option<String>) {
        self.add(name, Values::Text(self.rows.iter().map(value).collect()));
    }

    /// A count that is not an `i64` is a null.
    pub(super) fn whole<N: TryInto<i64>>(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<N>,
    ) {
        let whole = |row| value(row)?.try_into().ok();
        self.add(name, Values::Whole(self.rows.iter().map(whole).collect()));
    }

    pub(super) fn real(&mut self, name: impl Into<String>, value: impl Fn(&T) -> Option<f64>) {
        self.add(name, Values::Real(self.rows.iter().map(value).collect()));
    }

    /// The bounds of the intervals, in two columns.
    pub(super) fn interval(&mut self, name: &str, value: impl Fn(&T) -> Option<Interval>) {
        self.real(format!("{name}_low"), |row| Some(value(row)?.low));
        self.real(format!("{name}_high"), |row| Some(value(row)?.high));
    }

    pub(super) fn flag(&mut self, name: impl Into<String>, value: impl Fn(&T) -> Option<bool>) {
        self.add(name, Values::Flag(self.rows.iter().map(value).collect()));
    }

    /// Columns so far.
    pub(super) fn len(&self) -> usize {
        self.columns.len()
    }

    pub(super) fn finish(self) -> DataFrame {
        DataFrame { columns: self.columns }
    }
}

impl DataFrame {
    /// Rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }
}
