//! The cases that `--cases` and `--limit` select.

use results::names::UnknownName;
use results::settings::CaseSelector;

/// The indices into `ids` that `selectors` and `limit` leave, ascending, each once.
///
/// A limit takes evenly spaced cases: they are ordered by task, and the first few would be all of one.
///
/// # Errors
/// For a name or number that no case has.
pub fn select_cases(
    ids: &[&str],
    selectors: &[CaseSelector],
    limit: Option<u32>,
) -> Result<Vec<usize>, UnknownName> {
    let unknown = |given: &str| {
        let mut tasks: Vec<&str> =
            ids.iter().filter_map(|id| Some(id.split_once('-')?.0)).collect();
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
                let of_task = format!("{name}-");
                let named = |id: &str| id == name || id.starts_with(&of_task);
                if !ids.iter().any(|id| named(id)) {
                    return Err(unknown(name));
                }
                chosen.iter_mut().zip(ids).for_each(|(chosen, id)| *chosen |= named(id));
            }
            CaseSelector::Names(first, last) => {
                let (first, last) = (position(first)?, position(last)?);
                chosen[first.min(last)..=first.max(last)].fill(true);
            }
        }
    }
    let chosen: Vec<usize> = (0..ids.len()).filter(|&index| chosen[index]).collect();
    let count = limit.map_or(chosen.len(), |limit| chosen.len().min(limit as usize));
    Ok((0..count).map(|i| chosen[i * chosen.len() / count]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDS: [&str; 6] = ["t01-01", "t01-02", "t02-01", "t02-02", "t03-01", "t03-02"];

    fn select(list: &str, limit: Option<u32>) -> Result<Vec<usize>, String> {
        let selectors: Result<Vec<CaseSelector>, _> = list.split(',').map(str::parse).collect();
        let selectors = selectors.map_err(|error| error.to_string())?;
        for selector in &selectors {
            assert_eq!(selector.to_string().parse().as_ref(), Ok(selector));
        }
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
            ("all", Some(3), &[0, 2, 4]),
            ("all", Some(9), &[0, 1, 2, 3, 4, 5]),
            ("t02", Some(0), &[]),
        ] {
            assert_eq!(select(list, limit).as_deref(), Ok(expected), "{list} {limit:?}");
        }
    }

    #[test]
    fn cases_that_do_not_exist_are_named() {
        insta::assert_snapshot!(select("t02-1", None).unwrap_err(), @"unknown case `t02-1`: did you mean `t02-01`? (known: t01-01, t01-02, t02-01, t02-02, t03-01, t03-02, t01, t02, t03)");
        insta::assert_snapshot!(select("5-7", None).unwrap_err(), @"unknown case `5-7` (known: 1-6)");
        insta::assert_snapshot!(select("0", None).unwrap_err(), @"`0` is not a case (t03-07), a task (t03), a number (37) or a range (1-10, t03-01..t04-10)");
        assert!(
            select("7-5", None).is_err()
                && select("..", None).is_err()
                && select("", None).is_err()
        );
    }
}
