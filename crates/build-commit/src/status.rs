//! Reads what `git status` prints. A part of the build script; the crate has it for its tests.

/// The commit in what `git status --porcelain=v2 --branch` printed, with a `+` if it lists changes; `None` without a commit.
pub(crate) fn commit(status: &str) -> Option<String> {
    let hash = status.lines().find_map(|line| line.strip_prefix("# branch.oid "))?;
    let is_hash = !hash.is_empty() && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
    let is_changed = status.lines().any(|line| !line.starts_with('#'));
    is_hash.then(|| format!("{hash}{}", if is_changed { "+" } else { "" }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkout_with_changes_is_marked() {
        let clean = "# branch.oid 514c55f\n# branch.head main\n";
        assert_eq!(commit(clean).as_deref(), Some("514c55f"));
        let changed = format!("{clean}1 .M N... 100644 100644 100644 1f 1f README.md\n");
        assert_eq!(commit(&changed).as_deref(), Some("514c55f+"));
        for none in ["", "# branch.oid (initial)\n"] {
            assert_eq!(commit(none), None);
        }
    }
}
