//! Flat tables of figures for other programs: typed columns in full precision, with nulls.

use std::rc::Rc;

use scores::Interval;

/// A table of values, which are computed when they are read: a table of any length takes no more memory than what it is made of.
#[derive(Debug)]
pub struct DataFrame<'a> {
    /// The number of its rows.
    pub rows: usize,
    /// Its columns.
    pub columns: Vec<Series<'a>>,
}

/// A column.
#[derive(Debug)]
pub struct Series<'a> {
    /// Its name, unique in the frame: lower case with underscores.
    pub name: String,
    /// Its values.
    pub values: Values<'a>,
}

/// The value of a row; `None` is a null.
pub type Value<'a, T> = Box<dyn Fn(usize) -> Option<T> + 'a>;

/// The values of a column, by its type. `docs/exports.md` says what each type is in each format.
pub enum Values<'a> {
    /// Text.
    Text(Value<'a, String>),
    /// One of few texts.
    Word(Value<'a, String>),
    /// Integers.
    Whole(Value<'a, i64>),
    /// Integers without a sign, of which each bit may count.
    Natural(Value<'a, u64>),
    /// Floating-point numbers.
    Real(Value<'a, f64>),
    /// Booleans.
    Flag(Value<'a, bool>),
}

impl Values<'_> {
    /// The name of the type.
    pub const fn type_name(&self) -> &'static str {
        match self {
            Self::Text(_) => "text",
            Self::Word(_) => "word",
            Self::Whole(_) => "whole",
            Self::Natural(_) => "natural",
            Self::Real(_) => "real",
            Self::Flag(_) => "flag",
        }
    }

    /// The value in `row` as text; empty for a null.
    pub fn text(&self, row: usize) -> String {
        fn shown<T: ToString>(value: Option<T>) -> String {
            value.as_ref().map_or_else(String::new, T::to_string)
        }
        match self {
            Self::Text(value) | Self::Word(value) => value(row).unwrap_or_default(),
            Self::Whole(value) => shown(value(row)),
            Self::Natural(value) => shown(value(row)),
            Self::Real(value) => shown(value(row)),
            Self::Flag(value) => shown(value(row)),
        }
    }
}

impl std::fmt::Debug for Values<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.type_name())
    }
}

/// Makes a [`DataFrame`] of a list, column by column.
#[derive(Debug)]
pub(super) struct FrameBuilder<'a, T> {
    rows: Rc<[T]>,
    columns: Vec<Series<'a>>,
}

impl<'a, T: 'a> FrameBuilder<'a, T> {
    pub(super) fn new(rows: Vec<T>) -> Self {
        Self { rows: rows.into(), columns: Vec::new() }
    }

    fn value<V>(&self, value: impl Fn(&T) -> Option<V> + 'a) -> Value<'a, V> {
        let rows = Rc::clone(&self.rows);
        Box::new(move |row| value(rows.get(row)?))
    }

    fn add(&mut self, name: impl Into<String>, values: Values<'a>) {
        self.columns.push(Series { name: name.into(), values });
    }

    pub(super) fn text(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<String> + 'a,
    ) {
        self.add(name, Values::Text(self.value(value)));
    }

    pub(super) fn word(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<String> + 'a,
    ) {
        self.add(name, Values::Word(self.value(value)));
    }

    /// A count that is not an `i64` is a null.
    pub(super) fn whole<N: TryInto<i64>>(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<N> + 'a,
    ) {
        let whole = move |row: &T| value(row)?.try_into().ok();
        self.add(name, Values::Whole(self.value(whole)));
    }

    pub(super) fn natural(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<u64> + 'a,
    ) {
        self.add(name, Values::Natural(self.value(value)));
    }

    pub(super) fn real(&mut self, name: impl Into<String>, value: impl Fn(&T) -> Option<f64> + 'a) {
        self.add(name, Values::Real(self.value(value)));
    }

    /// The bounds of the intervals, in two columns.
    pub(super) fn interval(
        &mut self,
        name: &str,
        value: impl Fn(&T) -> Option<Interval> + Clone + 'a,
    ) {
        let low = value.clone();
        self.real(format!("{name}_low"), move |row| Some(low(row)?.low));
        self.real(format!("{name}_high"), move |row| Some(value(row)?.high));
    }

    pub(super) fn flag(
        &mut self,
        name: impl Into<String>,
        value: impl Fn(&T) -> Option<bool> + 'a,
    ) {
        self.add(name, Values::Flag(self.value(value)));
    }

    /// Columns so far.
    pub(super) fn len(&self) -> usize {
        self.columns.len()
    }

    pub(super) fn finish(self) -> DataFrame<'a> {
        DataFrame { rows: self.rows.len(), columns: self.columns }
    }
}
