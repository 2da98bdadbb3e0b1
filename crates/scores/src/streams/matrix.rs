//! The matrix R and what follows from it: average success, backward and forward transfer, forgetting.
//!
//! R\[i\]\[j\] is the success rate, in percent, on the cases of block j, evaluated after i blocks were learned; i is 0 before
//! any, j counts from 1 in the order of the sequence, and T is the number of blocks. Block j is evaluated in its own world
//! state. The figures are None where a cell that they need is missing.

use super::sequence::{Sequence, success_rate};
use crate::mean::mean;

/// R of one sequence: `rows[i][j - 1]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ResultMatrix {
    pub(super) rows: Vec<Vec<Option<f64>>>,
}

impl ResultMatrix {
    pub(super) fn of(sequence: &Sequence<'_>) -> Self {
        let blocks = sequence.blocks();
        let cell = |after: u32, place: u32| {
            let of_cell = sequence
                .evaluations()
                .filter(|e| e.stream.after == after && e.stream.place == place);
            success_rate(of_cell)
        };
        let row = |after| (0..blocks).map(|place| cell(after, place)).collect();
        Self { rows: (0..=blocks).map(row).collect() }
    }

    /// R\[i\]\[j\].
    pub(super) fn at(&self, i: usize, j: usize) -> Option<f64> {
        *self.rows.get(i)?.get(j.checked_sub(1)?)?
    }

    /// The number of blocks, T.
    fn blocks(&self) -> usize {
        self.rows.len() - 1
    }

    /// Average success: the mean over j of R\[T\]\[j\] (ACC; D. Lopez-Paz and M. Ranzato, "Gradient episodic memory for
    /// continual learning", NeurIPS 2017, equation 2).
    pub(super) fn average(&self) -> Option<f64> {
        let last = self.blocks();
        over(1..=last, |j| self.at(last, j))
    }

    /// Backward transfer: the mean over j < T of R\[T\]\[j\] − R\[j\]\[j\] (BWT; Lopez-Paz and Ranzato, equation 3).
    pub(super) fn backward(&self) -> Option<f64> {
        let last = self.blocks();
        over(1..last, |j| Some(self.at(last, j)? - self.at(j, j)?))
    }

    /// Forward transfer: the mean over j > 1 of R\[j − 1\]\[j\] − b\[j\] (FWT; Lopez-Paz and Ranzato, equation 4). b\[j\] is
    /// the same cell of `baseline`, the matrix of the paired sequence without memory.
    pub(super) fn forward(&self, baseline: &Self) -> Option<f64> {
        over(2..=self.blocks(), |j| Some(self.at(j - 1, j)? - baseline.at(j - 1, j)?))
    }

    /// Forgetting: the mean over j < T of the largest R\[l\]\[j\] with 1 ≤ l < T, minus R\[T\]\[j\] (A. Chaudhry et al.,
    /// "Riemannian walk for incremental learning", ECCV 2018). Below zero if every block gained.
    pub(super) fn forgetting(&self) -> Option<f64> {
        let last = self.blocks();
        over(1..last, |j| {
            let earlier: Option<Vec<f64>> = (1..last).map(|l| self.at(l, j)).collect();
            Some(earlier?.into_iter().fold(f64::NEG_INFINITY, f64::max) - self.at(last, j)?)
        })
    }
}

/// The mean of `term` over `blocks`; None if there is no block, or a term is undefined.
fn over(blocks: impl Iterator<Item = usize>, term: impl Fn(usize) -> Option<f64>) -> Option<f64> {
    let terms: Option<Vec<f64>> = blocks.map(term).collect();
    mean(terms?.into_iter())
}
