//! When to ask again, and after which pause. Pure: the jitter and the clock are arguments.

use std::time::{Duration, SystemTime};

/// The pause before the first retry, without jitter; each further one is twice as long.
pub(super) const FIRST_PAUSE: Duration = Duration::from_millis(500);

/// The longest pause that is not the server's own wish.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// The longest pause that a server may ask for; with a longer one it is given up.
pub(super) const LONGEST_WISH: Duration = Duration::from_secs(600);

/// Whether a status says that the same request may do better later.
pub(super) fn is_passing(status: u16) -> bool {
    status == 429 || (500..=599).contains(&status)
}

/// The pause before retry `retry` (from 0): what the server wished for, else twice the one before it, less up
/// to a half of it. `jitter` is from 0 to 1 and keeps many clients from coming back at one moment.
pub(super) fn pause(retry: u32, wish: Option<Duration>, jitter: f64) -> Duration {
    let jitter = jitter.clamp(0.0, 1.0);
    match wish {
        Some(wish) => wish + FIRST_PAUSE.mul_f64(jitter),
        None => {
            let doubled = FIRST_PAUSE.saturating_mul(2u32.saturating_pow(retry)).min(LONGEST_PAUSE);
            doubled.mul_f64(1.0 - jitter / 2.0)
        }
    }
}

/// The pause that a `Retry-After` header asks for: seconds, or a date, which is compared with the server's own
/// `Date` where there is one, since clocks differ. `None` when it says neither.
pub(super) fn wish(retry_after: &str, date: Option<&str>, now: SystemTime) -> Option<Duration> {
    let retry_after = retry_after.trim();
    if let Ok(seconds) = retry_after.parse::<f64>() {
        return Duration::try_from_secs_f64(seconds).ok();
    }
    let then = httpdate::parse_http_date(retry_after).ok()?;
    let now = date.and_then(|date| httpdate::parse_http_date(date).ok()).unwrap_or(now);
    Some(then.duration_since(now).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn which_statuses_pass() {
        let passing: Vec<u16> = (100..600).filter(|&status| is_passing(status)).collect();
        assert_eq!(passing.len(), 101);
        assert!(passing.contains(&429) && passing.contains(&500) && passing.contains(&599));
    }

    #[test]
    fn pauses_double_up_to_a_bound_and_a_wish_goes_first() {
        let ms = Duration::from_millis;
        for (retry, wish, jitter, expected) in [
            (0, None, 0.0, ms(500)),
            (1, None, 0.0, ms(1000)),
            (1, None, 1.0, ms(500)),
            (3, None, 0.5, ms(3000)),
            (40, None, 0.0, ms(60_000)),
            (5, Some(ms(0)), 0.0, ms(0)),
            (0, Some(ms(7000)), 0.5, ms(7250)),
        ] {
            assert_eq!(pause(retry, wish, jitter), expected, "{retry} {wish:?} {jitter}");
        }
    }

    #[test]
    fn retry_after_in_seconds_or_as_a_date() {
        let now = httpdate::parse_http_date("Sun, 06 Nov 1994 08:49:37 GMT").unwrap();
        let (later, server) = ("Sun, 06 Nov 1994 08:50:07 GMT", "Sun, 06 Nov 1994 08:49:47 GMT");
        for (retry_after, date, expected) in [
            ("7", None, Some(7.0)),
            (" 0.5 ", None, Some(0.5)),
            (later, None, Some(30.0)),
            (later, Some(server), Some(20.0)),
            (later, Some("noon"), Some(30.0)),
            ("Sun, 06 Nov 1994 08:00:00 GMT", None, Some(0.0)),
            ("-3", None, None),
            ("NaN", None, None),
            ("soon", None, None),
        ] {
            let expected = expected.map(Duration::from_secs_f64);
            assert_eq!(wish(retry_after, date, now), expected, "{retry_after}");
        }
    }
}
