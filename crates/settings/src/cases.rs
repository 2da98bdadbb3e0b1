//! Which cases a run includes: `--cases` and `--limit`.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use case_book::{CaseFacts, WorldFacts};
use conditions::settings::{CaseSelector, RunSettings};
use domain::names::UnknownName;

/// The indices of the cases that a run with `settings` includes of `cases`, ascending, each once.
///
/// A limit takes a prefix of one fixed order of the selected cases: in turn one of every task, the tasks in turn one of every
/// group of tasks, the largest group first. Tasks and the cases of a task are shuffled by a hash of their names. So every
/// prefix is balanced over the tasks, a short one over their groups, and a larger limit includes the cases of a smaller one.
///
/// # Errors
/// For a name or number that no case has.
pub fn cases_of_run(
    world: &WorldFacts,
    cases: &[CaseFacts],
    settings: &RunSettings,
) -> Result<Vec<usize>, UnknownName> {
    let ids: Vec<&str> = cases.iter().map(|case| case.id.as_str()).collect();
    let chosen = select_cases(&ids, &settings.cases)?;
    let group_of = |case: usize| world.group_of(cases[case].task).unwrap_or_default();
    Ok(match settings.limit {
        None => chosen,
        Some(limit) => limited(&ids, group_of, chosen, limit as usize),
    })
}

/// The indices into `ids` that `selectors` choose, ascending, each once.
///
/// # Errors
/// For a name or number that no case has.
pub fn select_cases(ids: &[&str], selectors: &[CaseSelector]) -> Result<Vec<usize>, UnknownName> {
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
    Ok((0..ids.len()).filter(|&index| chosen[index]).collect())
}

/// The task in a case's id: `t03` of `t03-07`.
fn task_of(id: &str) -> &str {
    id.split_once('-').map_or(id, |(task, _)| task)
}

/// The first `limit` of the cases in the order of a limit, ascending.
fn limited<'a>(
    ids: &[&str],
    group_of: impl Fn(usize) -> &'a str,
    chosen: Vec<usize>,
    limit: usize,
) -> Vec<usize> {
    let hash =
        |name: &str| *blake3::hash(format!("memtransfer limit v1/{name}").as_bytes()).as_bytes();
    let mut tasks: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for index in chosen {
        tasks.entry(task_of(ids[index])).or_default().push(index);
    }
    let mut groups: BTreeMap<&str, Vec<_>> = BTreeMap::new();
    for (task, mut cases) in tasks {
        cases.sort_by_key(|&index| hash(ids[index]));
        groups.entry(group_of(cases[0])).or_default().push((hash(task), cases));
    }
    let mut order = Vec::new();
    for mut tasks in groups.into_values() {
        tasks.sort_unstable();
        let of_group = (Reverse(tasks.len()), tasks[0].0);
        for (rank_of_task, (_, cases)) in tasks.into_iter().enumerate() {
            let of_case = |(rank, index)| (rank, rank_of_task, of_group, index);
            order.extend(cases.into_iter().enumerate().map(of_case));
        }
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

    fn select(list: &str) -> Result<Vec<usize>, String> {
        let selectors: Result<Vec<CaseSelector>, _> = list.split(',').map(str::parse).collect();
        let selectors = selectors.map_err(|error| error.to_string())?;
        select_cases(&IDS, &selectors).map_err(|error| error.to_string())
    }

    #[test]
    fn cases_are_chosen_by_id_task_number_and_range() {
        for (list, expected) in [
            ("all", &[0, 1, 2, 3, 4, 5][..]),
            ("t02-01", &[2]),
            ("t02", &[2, 3]),
            ("1", &[0]),
            ("2-4,3", &[1, 2, 3]),
            ("t01-02..t02-02,6", &[1, 2, 3, 5]),
        ] {
            assert_eq!(select(list).as_deref(), Ok(expected), "{list}");
        }
    }

    #[test]
    fn limits_are_nested_and_balanced_over_the_tasks_and_their_groups() {
        let ids: Vec<String> =
            (0..100).map(|n| format!("t{:02}-{:02}", n / 10 + 1, n % 10 + 1)).collect();
        let ids: Vec<&str> = ids.iter().map(String::as_str).collect();
        // As in the warehouse.
        let group_of = |case: usize| match case / 10 + 1 {
            1 | 2 => "basic",
            3..=6 => "multi-object",
            9 => "revisit",
            _ => "return loops",
        };
        let limit = |n| limited(&ids, group_of, (0..100).collect(), n);
        for n in 0..100 {
            let (smaller, larger) = (limit(n), limit(n + 1));
            assert_eq!(smaller.len(), n);
            assert!(smaller.iter().all(|index| larger.contains(index)), "{n}");
            let mut counts = [0; 10];
            smaller.iter().for_each(|index| counts[index / 10] += 1);
            let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
            assert!(most - least <= 1, "{n}: {counts:?}");
            let mut of_group: BTreeMap<&str, usize> = BTreeMap::new();
            smaller.iter().for_each(|&index| *of_group.entry(group_of(index)).or_default() += 1);
            assert_eq!(of_group.len(), n.min(4), "{n}: {of_group:?}");
            assert!(n > 5 || of_group.values().all(|&count| count <= 2), "{n}: {of_group:?}");
        }
        assert_eq!(limit(200).len(), 100);
        let shown = |n| limit(n).iter().map(|&index| ids[index]).collect::<Vec<_>>().join(" ");
        insta::assert_snapshot!(shown(10), @"t01-04 t02-07 t03-02 t04-05 t05-08 t06-07 t07-08 t08-05 t09-04 t10-08");
        insta::assert_snapshot!(shown(5), @"t01-04 t04-05 t05-08 t07-08 t09-04");
        // The cases of one group alone.
        let basic = limited(&ids, group_of, (0..20).collect(), 3);
        insta::assert_snapshot!(basic.iter().map(|&index| ids[index]).collect::<Vec<_>>().join(" "), @"t01-04 t01-08 t02-07");
    }

    #[test]
    fn cases_that_do_not_exist_are_named() {
        insta::assert_snapshot!(select("t02-1").unwrap_err(), @"unknown case `t02-1`: did you mean `t02-01`? (known: t01-01, t01-02, t02-01, t02-02, t03-01, t03-02, t01, t02, t03)");
        insta::assert_snapshot!(select("5-7").unwrap_err(), @"unknown case `5-7` (known: 1-6)");
    }
}
