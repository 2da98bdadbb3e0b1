//! A run's figures as a file of published figures, for others to set theirs beside.

use run_log::RunLog;
use scores::{GroupScore, Scores};
use toml::Value;

use super::configuration::{CASES, RUNS, facts};
use super::figures::{FIGURES, OwnFigure, of_group};
use super::group_key;

/// The file of the run `log` with these `scores`; `None` where no condition has an episode. Figures are not rounded.
pub(crate) fn of_run(log: &RunLog, scores: &Scores) -> Option<String> {
    let mut text = format!(
        "# Figures of a run of memtransfer. `memtransfer report RUN --against FILE` sets those of another run beside them.\n\n\
         title = {}\npolicy = {}\n\n[configuration]\n",
        quoted(&format!("run {}", log.name)),
        quoted(&log.manifest.policy_label().to_string()),
    );
    for (name, value) in facts(log) {
        text += &format!("{name} = {}\n", quoted(&value));
    }
    for score in &scores.conditions {
        text += &format!("\n[[condition]]\nname = {}\n", quoted(&score.condition.to_string()));
        text += &format!("{RUNS} = {}\n{CASES} = {}\n", score.runs, score.cases);
        for kind in &FIGURES {
            if let Some(figure) = (kind.ours)(score) {
                text += &format!("{} = {}\n", kind.key, number(figure));
            }
        }
        let of_group = |group: &GroupScore| {
            let key = group_key(&group.group);
            let figure = of_group(score, &key)?;
            Some(format!("{} = {}", key_text(&key), number(figure)))
        };
        let of_groups: Vec<String> = score.groups.iter().filter_map(of_group).collect();
        if !of_groups.is_empty() {
            text += &format!("groups = {{ {} }}\n", of_groups.join(", "));
        }
    }
    (!scores.conditions.is_empty()).then_some(text)
}

/// A key as TOML writes it.
fn key_text(key: &str) -> String {
    let is_bare = key.chars().all(|c| c.is_ascii_alphanumeric() || ['-', '_'].contains(&c));
    if is_bare && !key.is_empty() { key.to_owned() } else { quoted(key) }
}

/// A text as TOML writes it.
fn quoted(text: &str) -> String {
    Value::from(text).to_string()
}

/// A figure as it stands in a file, exactly.
fn number(OwnFigure { value, std, .. }: OwnFigure) -> String {
    match std {
        Some(std) => format!("{{ mean = {value:?}, std = {std:?} }}"),
        None => format!("{value:?}"),
    }
}
