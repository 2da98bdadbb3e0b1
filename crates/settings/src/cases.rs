//! Which cases a run includes: `--cases` and `--limit`.

use std::collections::BTreeMap;

use conditions::settings::CaseSelector;
use domain::names::UnknownName;

/// The indices into `ids` that `selectors` and `limit` choose, ascending, each once.
///
/// A limit takes a prefix of one fixed order of the selected cases: in turn one of every task, tasks and
/// the cases of a task shuffled by a hash of their names. So every prefix is balanced over the tasks, and
/// a larger limit includes the cases of a smaller one.
///
/// # Errors
/// For a name or number that no case has.
pub fn select_cases(
    ids: &[&str],
    selectors: &[CaseSelector],
    limit: Option<u32>,
) -> Result<Vec<usize>, UnknownName> {
    let unknown = |given: &str| {
        let mut tasks: Vec<&str> = ids.iter().map(|id| task_of(id)).collect();
        tasks.dedup();
        UnknownName::new("case", given, ids.iter().copied().chain(tasks))
    };
    let position = |name: &str| ids.iter().position(|id| *id == name).ok_or_else(|| unknown(name));
    let mut chosen = vec![false; ids.len()];
    for selector in selectors {
        match selector {
            CaseSelector::All => chosen.fill(true),
            CaseSelector::Numbers(first, last) => match chosen.get_mut(first - 1..*last) {
                Some(range) => range.fill(true),
                None => {
                    let there = [format!("1-{}", ids.len())];
                    return Err(UnknownName::new("case", &selector.to_string(), there));
                }
            },
            CaseSelector::Name(name) => {
                let is_named = |id: &str| id == name || task_of(id) == name;
                if !ids.iter().any(|id| is_named(id)) {
                    return Err(unknown(name));
                }
                chosen.iter_mut().zip(ids).for_each(|(chosen, id)| *chosen |= is_named(id));
            }
            CaseSelector::Names(first, last) => {
                let (first, last) = (position(first)?, position(last)?);
                chosen[first.min(last)..=first.max(last)].fill(true);
            }
        }
    }
    let chosen = (0..ids.len()).filter(|&index| chosen[index]);
    Ok(match limit {
        None => chosen.collect(),
        Some(limit) => limited(ids, chosen, limit as usize),
    })
}

/// The task in a case's id: `t03` of `t03-07`.
fn task_of(id: &str) -> &str {
    id.split_once('-').map_or(id, |(task, _)| task)
}

/// The first `limit` of the cases in the order of a limit, ascending.
fn limited(ids: &[&str], chosen: impl Iterator<Item = usize>, limit: usize) -> Vec<usize> {
    let hash =
        |name: &str| *blake3::hash(format!("memtransfer limit v1/{name}").as_bytes()).as_bytes();
    let mut tasks: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for index in chosen {
        tasks.entry(task_of(ids[index])).or_default().push(index);
    }
    let mut order = Vec::new();
    for (task, mut cases) in tasks {
        cases.sort_by_key(|&index| hash(ids[index]));
        let of_task = hash(task);
        order.extend(cases.into_iter().enumerate().map(|(rank, index)| (rank, of_task, index)));
    }
    order.sort_unstable();
    let mut first: Vec<usize> = order.into_iter().take(limit).map(|(.., index)| index).collect();
    first.sort_unstable();
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDS: [&str; 6] = ["t01-01", "t01-02", "t02-01", "t02-02", "t03-01", "t03-02"];

    fn select(list: &str, limit: Option<u32>) -> Result<Vec<usize>, String> {
        let selectors: Result<Vec<CaseSelector>, _> = list.split(',').map(str::parse).collect();
        let selectors = selectors.map_err(|error| error.to_string())?;
        select_cases(&IDS, &selectors, limit).map_err(|error| error.to_string())
    }

    #[test]
    fn cases_are_chosen_by_id_task_number_and_range() {
        for (list, limit, expected) in [
            ("all", None, &[0, 1, 2, 3, 4, 5][..]),
            ("t02-01", None, &[2]),
            ("t02", None, &[2, 3]),
            ("1", None, &[0]),
            ("2-4,3", None, &[1, 2, 3]),
            ("t01-02..t02-02,6", None, &[1, 2, 3, 5]),
            ("all", Some(9), &[0, 1, 2, 3, 4, 5]),
            ("t02", Some(0), &[]),
        ] {
            assert_eq!(select(list, limit).as_deref(), Ok(expected), "{list} {limit:?}");
        }
    }

    #[test]
    fn limits_are_nested_and_balanced_over_the_tasks() {
        let ids: Vec<String> =
            (0..100).map(|n| format!("t{:02}-{:02}", n / 10 + 1, n % 10 + 1)).collect();
        let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
        let limited = |n| select_cases(&ids, &[CaseSelector::All], Some(n)).unwrap();
        for n in 0..100 {
            let (smaller, larger) = (limited(n), limited(n + 1));
            assert_eq!(smaller.len(), n as usize);
            assert!(smaller.iter().all(|index| larger.contains(index)), "{n}");
            let mut counts = [0; 10];
            smaller.iter().for_each(|index| counts[index / 10] += 1);
            let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
            assert!(most - least <= 1, "{n}: {counts:?}");
        }
        let shown: Vec<&str> = limited(10).into_iter().map(|index| ids[index]).collect();
        insta::assert_snapshot!(shown.join(" "));
    }

    #[test]
    fn cases_that_do_not_exist_are_named() {
        insta::assert_snapshot!(select("t02-1", None).unwrap_err(), @"unknown case `t02-1`: did you mean `t02-01`? (known: t01-01, t01-02, t02-01, t02-02, t03-01, t03-02, t01, t02, t03)");
        insta::assert_snapshot!(select("5-7", None).unwrap_err(), @"unknown case `5-7` (known: 1-6)");
    }
}
