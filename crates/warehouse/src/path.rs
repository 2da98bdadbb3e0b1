//! How closely an agent's path follows that of the reference: nDTW (G. Ilharco et al., 2019), computed in metres.

use case_book::PathFact;
use domain::{Cell, Pose};

/// The distance of the path of `poses` from that of `reference`, under dynamic time warping. `None` if one is empty.
///
/// A path is the list of the cells that it goes through; turning on the spot adds none. A cell is one metre wide.
pub(crate) fn path_fact(poses: &[Pose], reference: &[Pose]) -> Option<PathFact> {
    let reference = cells(reference);
    let distance_m = dtw(&cells(poses), &reference)?;
    Some(PathFact { distance_m, length: reference.len() as u32 })
}

/// The cells of a path, without repetitions in a row.
fn cells(poses: &[Pose]) -> Vec<Cell> {
    let mut cells: Vec<Cell> = poses.iter().map(|pose| pose.cell).collect();
    cells.dedup();
    cells
}

/// The distance of two paths under dynamic time warping: the least sum of distances in metres between matched cells, over all
/// matchings that keep the order, match every cell, and match first with first and last with last. None if one is empty.
fn dtw(path: &[Cell], reference: &[Cell]) -> Option<f64> {
    // `row[j]`: the least sum up to this cell of the path and cell `j - 1` of the reference.
    let mut row = vec![f64::INFINITY; reference.len() + 1];
    row[0] = 0.0;
    for &at in path {
        let mut diagonal = std::mem::replace(&mut row[0], f64::INFINITY);
        for (j, &to) in (1..).zip(reference) {
            let least = diagonal.min(row[j]).min(row[j - 1]);
            diagonal = std::mem::replace(&mut row[j], least + metres(at, to));
        }
    }
    row.last().copied().filter(|sum| sum.is_finite() && !path.is_empty() && !reference.is_empty())
}

/// The distance of the centres of two cells, in a straight line.
fn metres(one: Cell, other: Cell) -> f64 {
    let squared = |a: u8, b: u8| u32::from(a.abs_diff(b)).pow(2);
    f64::from(squared(one.x, other.x) + squared(one.y, other.y)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warping_by_hand() {
        let path = |cells: &[(u8, u8)]| -> Vec<Cell> {
            cells.iter().map(|&(x, y)| Cell::new(x, y)).collect()
        };
        let along = path(&[(0, 0), (1, 0), (2, 0)]);
        for (other, expected) in [
            (path(&[(0, 0), (1, 0), (2, 0)]), Some(0.0)),
            // Waiting and overtaking cost the distances between the matched cells: here 1 for (3, 0).
            (path(&[(0, 0), (1, 0), (2, 0), (3, 0)]), Some(1.0)),
            // Beside it, every cell 2 away.
            (path(&[(0, 2), (1, 2), (2, 2)]), Some(6.0)),
            // All three against one: 0 + 1 + 2.
            (path(&[(0, 0)]), Some(3.0)),
            (path(&[(3, 4)]), Some(5.0 + 20.0_f64.sqrt() + 17.0_f64.sqrt())),
            (Vec::new(), None),
        ] {
            let found = dtw(&other, &along);
            assert_eq!(
                found.map(|sum| (sum * 1e9).round()),
                expected.map(|sum| (sum * 1e9).round())
            );
        }
    }
}
