//! When a server counts as gone: it has shown no sign of life, and requests have run out of tries.

/// How a server failed, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// There was no connection: nobody is there.
    Unreachable,
    /// Somebody took the request and did not answer it: an error of its own, silence, half an answer. It could
    /// be this one request that the server stumbles over.
    Failing,
}

/// Follows the failures since the server's last sign of life. Pure.
#[derive(Debug, Clone)]
pub(super) struct Breaker {
    most_given_up: u32,
    failed: u32,
    unreachable: u32,
    given_up: u32,
}

impl Breaker {
    /// One that opens when `most_given_up` requests in a row were given up, or when the first was and nobody
    /// was there any time.
    pub(super) const fn new(most_given_up: u32) -> Self {
        Self { most_given_up, failed: 0, unreachable: 0, given_up: 0 }
    }

    /// The server is there: it replied, or refused for a reason.
    pub(super) fn alive(&mut self) {
        *self = Self::new(self.most_given_up);
    }

    /// An attempt failed.
    pub(super) fn failed(&mut self, fault: Fault) {
        self.failed += 1;
        self.unreachable += u32::from(fault == Fault::Unreachable);
    }

    /// A request has failed for the last time. Whether the server is gone.
    #[must_use]
    pub(super) fn gave_up(&mut self) -> bool {
        self.given_up += 1;
        let nobody_there = self.failed > 0 && self.unreachable == self.failed;
        nobody_there || self.given_up >= self.most_given_up
    }

    /// Attempts that failed since the last sign of life.
    pub(super) const fn failures(&self) -> u32 {
        self.failed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What happens to a server: `u` nobody there, `f` failed, `a` alive, `g` a request is given up. Where the
    /// breaker opens.
    fn opens_at(story: &str) -> Option<usize> {
        let mut breaker = Breaker::new(3);
        story.bytes().position(|step| {
            match step {
                b'u' => breaker.failed(Fault::Unreachable),
                b'f' => breaker.failed(Fault::Failing),
                b'a' => breaker.alive(),
                _ => return breaker.gave_up(),
            }
            false
        })
    }

    #[test]
    fn when_a_server_is_gone() {
        for (story, expected) in [
            ("uuuuuuuuuuuu", None),
            ("uuug", Some(3)),
            ("ffug", None),
            ("fffgfffgfffg", Some(11)),
            ("ffgffgaffgffg", None),
            ("ffgffgaffgffgffg", Some(15)),
            ("fffauuug", Some(7)),
            ("uuuaggg", Some(6)),
        ] {
            assert_eq!(opens_at(story), expected, "{story}");
        }
    }
}
