//! How many requests may be in flight: more after replies, fewer when the server says that it is too many.
//!
//! Additive increase, multiplicative decrease: one more for every round of replies, half of it for a round
//! with a status 429. Errors of the server and silence are no reason to ask less at once.

use std::time::Instant;

/// The bound on requests in flight, from 1 to the greatest that is allowed. Pure: the clock is an argument.
#[derive(Debug, Clone)]
pub(super) struct Limit {
    most: u32,
    now: f64,
    /// When it was halved last: requests that were sent before say nothing about the half.
    cut: Option<Instant>,
}

impl Limit {
    /// `most` at once, until the server objects.
    pub(super) fn new(most: u32) -> Self {
        let most = most.max(1);
        Self { most, now: most.into(), cut: None }
    }

    /// How many may be in flight now.
    pub(super) fn allowed(&self) -> usize {
        // At least 1 and at most `most`.
        self.now as usize
    }

    /// A reply came while `in_flight` requests were on their way, itself included. A bound that is far from
    /// being reached says nothing about what the server takes, so it stays.
    pub(super) fn answered(&mut self, in_flight: usize) {
        if in_flight * 2 >= self.allowed() {
            self.now = (self.now + 1.0 / self.now).min(self.most.into());
        }
    }

    /// The request that was sent at `sent` was one too many.
    pub(super) fn throttled(&mut self, sent: Instant, now: Instant) {
        if self.cut.is_none_or(|cut| sent >= cut) {
            self.now = (self.now / 2.0).floor().max(1.0);
            self.cut = Some(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;

    fn rounds(limit: &mut Limit, rounds: u32) {
        for _ in 0..rounds {
            for _ in 0..limit.allowed() {
                limit.answered(limit.allowed());
            }
        }
    }

    #[test]
    fn halved_once_a_round_and_grown_by_one_a_round() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut limit = Limit::new(40);
        assert_eq!(limit.allowed(), 40);
        limit.throttled(at(0), at(1));
        limit.throttled(at(0), at(2));
        assert_eq!(limit.allowed(), 20, "both were sent before the first was refused");
        limit.throttled(at(3), at(4));
        assert_eq!(limit.allowed(), 10);
        rounds(&mut limit, 3);
        assert_eq!(limit.allowed(), 12, "a round is a little longer than it was when it began");
        limit.answered(1);
        assert_eq!(limit.allowed(), 12, "one of twelve says nothing");
        rounds(&mut limit, 100);
        assert_eq!(limit.allowed(), 40);
    }

    proptest! {
        #[test]
        fn never_none_and_never_more_than_allowed(
            most in 0..100_u32,
            steps in prop::collection::vec((any::<bool>(), 0..200_usize, 0..100_u64), 0..300),
        ) {
            let start = Instant::now();
            let mut limit = Limit::new(most);
            for (now, (throttled, in_flight, ago)) in (0..).zip(steps) {
                let before = limit.allowed();
                let now = start + Duration::from_secs(now);
                if throttled {
                    limit.throttled(now.checked_sub(Duration::from_secs(ago)).unwrap_or(now), now);
                    prop_assert!(limit.allowed() <= before);
                } else {
                    limit.answered(in_flight);
                    prop_assert!(limit.allowed() >= before && limit.allowed() <= before + 1);
                }
                prop_assert!((1..=most.max(1) as usize).contains(&limit.allowed()));
            }
        }
    }
}
