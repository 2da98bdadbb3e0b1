//! `policy-proc cache`: the cached replies. `memtransfer cache` starts it.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use anyhow::Context;
use clap::{Args, Subcommand};
use llm::{CacheListing, CacheSize, ModelReplies, Pruned, ReplyCache};
use serde::Serialize;

use super::print;

#[derive(Args)]
#[command(after_help = "\
Examples:
  memtransfer cache ls
  memtransfer cache prune --older-than 30d
  memtransfer cache prune --max-bytes 500M
  memtransfer cache prune --unusable --dry-run
  memtransfer cache clear")]
pub(crate) struct CacheArguments {
    #[command(subcommand)]
    verb: CacheVerb,
    /// The folder of replies [default: responses in the cache folder]
    #[arg(long, value_name = "DIR", global = true)]
    response_cache: Option<PathBuf>,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum CacheVerb {
    /// List the cached replies by model
    Ls,
    /// Remove old replies, the oldest until the rest is small enough, or those that are not used
    #[command(group = clap::ArgGroup::new("what").required(true).multiple(true))]
    Prune {
        /// Remove replies older than this: a number with s, m, h, d or w
        #[arg(long, value_name = "AGE", value_parser = age, group = "what")]
        older_than: Option<Duration>,
        /// Keep at most this many bytes: a number, with K, M or G for KiB, MiB or GiB
        #[arg(long, value_name = "SIZE", value_parser = size, group = "what")]
        max_bytes: Option<u64>,
        /// Remove replies that are not used: those that cannot be read, and failures of a server that earlier versions stored
        /// as answers of the model
        #[arg(long, group = "what", conflicts_with_all = ["older_than", "max_bytes"])]
        unusable: bool,
        /// With --unusable: count them and remove none
        #[arg(long, requires = "unusable")]
        dry_run: bool,
    },
    /// Remove all cached replies
    Clear,
}

pub(crate) fn run(arguments: &CacheArguments) -> anyhow::Result<()> {
    let CacheArguments { verb, response_cache, json } = arguments;
    let cache = match response_cache {
        Some(folder) => ReplyCache::at(folder),
        None => ReplyCache::from_environment()?,
    };
    let context = || format!("the replies in {}", cache.folder().display());
    match verb {
        CacheVerb::Ls => {
            let listing = cache.list().with_context(context)?;
            show(&listing, *json, list)
        }
        CacheVerb::Prune { older_than, max_bytes, unusable, dry_run } => {
            let pruned = if *unusable {
                cache.prune_unusable(*dry_run)
            } else {
                cache.prune(*older_than, *max_bytes, SystemTime::now())
            };
            let verb = if *dry_run { "would remove" } else { "removed" };
            show(&pruned.with_context(context)?, *json, |Pruned { removed, left }| {
                format!("{verb} {}; left {}", describe(removed), describe(left))
            })
        }
        CacheVerb::Clear => {
            let removed = cache.clear().with_context(context)?;
            show(&removed, *json, |removed| format!("removed {}", describe(removed)))
        }
    }
}

fn show<T: Serialize>(value: &T, json: bool, plain: impl Fn(&T) -> String) -> anyhow::Result<()> {
    print(&if json { serde_json::to_string_pretty(value)? } else { plain(value) })
}

fn list(listing: &CacheListing) -> String {
    let CacheListing { folder, entries, bytes, broken, failures, models } = listing;
    let all = describe(&CacheSize { entries: *entries, bytes: *bytes });
    let mut lines = format!("{}: {all}\n", folder.display());
    for ModelReplies { model, entries, bytes, oldest, newest } in models {
        let size = describe(&CacheSize { entries: *entries, bytes: *bytes });
        lines += &format!("  {model}: {size}, from {} to {}\n", day(*oldest), day(*newest));
    }
    if *broken > 0 {
        lines +=
            &format!("  cannot be read: {broken}; these requests are sent again when needed\n");
    }
    if *failures > 0 {
        lines += &format!(
            "  failures of a server, stored as answers by an earlier version: {failures}; they are not used, and `memtransfer \
             cache prune --unusable` removes them\n"
        );
    }
    lines
}

fn describe(CacheSize { entries, bytes }: &CacheSize) -> String {
    let noun = if *entries == 1 { "reply" } else { "replies" };
    format!("{entries} {noun} ({})", human(*bytes))
}

fn human(bytes: u64) -> String {
    let units = [("GiB", 1_u64 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];
    match units.into_iter().find(|(_, unit)| bytes >= *unit) {
        Some((name, unit)) => format!("{:.1} {name}", bytes as f64 / unit as f64),
        None => format!("{bytes} B"),
    }
}

/// The date of a time in seconds since 1970, in UTC.
fn day(seconds: u64) -> String {
    /// The last second of the year 9999: later dates have another form.
    const LAST: u64 = 253_402_300_799;
    // An HTTP date reads `Sun, 06 Nov 1994 08:49:37 GMT`.
    let moment = SystemTime::UNIX_EPOCH + Duration::from_secs(seconds.min(LAST));
    httpdate::fmt_http_date(moment).get(5..16).unwrap_or_default().to_owned()
}

fn age(text: &str) -> Result<Duration, String> {
    const UNITS: [(char, u64); 5] =
        [('s', 1), ('m', 60), ('h', 3600), ('d', 86_400), ('w', 604_800)];
    let unit = UNITS.into_iter().find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)));
    let (number, unit) = unit.ok_or("an age is a number with s, m, h, d or w, such as 30d")?;
    scaled(number, unit).map(Duration::from_secs)
}

fn size(text: &str) -> Result<u64, String> {
    const UNITS: [(char, u64); 3] = [('K', 1 << 10), ('M', 1 << 20), ('G', 1 << 30)];
    let unit = UNITS.into_iter().find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)));
    let (number, unit) = unit.unwrap_or((text, 1));
    scaled(number, unit)
}

fn scaled(number: &str, unit: u64) -> Result<u64, String> {
    let number: u64 = number.parse().map_err(|_| format!("{number:?} is not a whole number"))?;
    number.checked_mul(unit).ok_or_else(|| format!("{number} is too large"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_and_sizes() {
        for (text, expected) in
            [("90s", Some(90)), ("2m", Some(120)), ("30d", Some(2_592_000)), ("1w", Some(604_800))]
        {
            assert_eq!(age(text).ok().map(|age| age.as_secs()), expected);
        }
        for text in ["30", "d", "-1d", "1.5h", "99999999999999999w"] {
            assert!(age(text).is_err(), "{text}");
        }
        for (text, expected) in [("7", 7), ("2K", 2048), ("500M", 500 << 20), ("1G", 1 << 30)] {
            assert_eq!(size(text), Ok(expected));
        }
        assert!(size("much").is_err() && size("99999999999999G").is_err());
    }

    #[test]
    fn sizes_and_dates_in_words() {
        assert_eq!(human(1023), "1023 B");
        assert_eq!(human(1536), "1.5 KiB");
        assert_eq!(day(784_111_777), "06 Nov 1994");
        assert_eq!(day(u64::MAX), "31 Dec 9999");
        assert_eq!(describe(&CacheSize { entries: 1, bytes: 7 }), "1 reply (7 B)");
    }
}
