//! The queue by itself: stories with a clock of their own.

use proptest::prelude::*;

use super::*;

/// Words that are short.
struct Short;

impl Words for Short {
    fn gave_up(&self, attempts: u32, last: Passing) -> ChatError {
        ChatError::GaveUp { endpoint: "E".into(), attempts, last }
    }

    fn gone(&self, failures: u32, _last: &ChatError) -> String {
        format!("gone after {failures}")
    }

    fn refuses(&self, _error: &ChatError) -> String {
        "refuses".to_owned()
    }
}

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

fn status(status: u16) -> Failure {
    Failure::Passing(Passing::Status { status, message: String::new() }, None)
}

fn sent(task: Option<Task<u32>>) -> Entry<u32> {
    match task {
        Some(Task::Send(entry)) => entry,
        other => panic!("{other:?}"),
    }
}

/// A queue with requests 0 to `requests - 1`, none of them known.
fn queue(max_connections: u32, max_retries: u32, requests: u32) -> Queue<u32> {
    let mut queue = Queue::new(max_connections, 3, max_retries);
    (0..requests).for_each(|request| queue.submit(request, false));
    queue
}

#[test]
fn no_more_in_flight_than_are_allowed_and_a_pause_holds_no_connection() {
    let now = Instant::now();
    let mut queue = queue(2, 5, 4);
    let [first, second] = [(); 2].map(|()| sent(queue.take(now)));
    assert_eq!((first.load, second.load), (0, 1));
    assert!(queue.take(now).is_none());
    assert_eq!(queue.wakes_at(), None, "only when one of the two has ended");
    let verdict = queue.failed(first, status(500), &Short, (now, now), 0.0);
    assert!(matches!(verdict, Verdict::Again(pause) if pause == Duration::from_millis(500)));
    let third = sent(queue.take(now));
    assert_eq!(third.load, 2, "while the first one waits");
    queue.answered();
    assert_eq!(sent(queue.take(now + seconds(1))).load, 0, "those that waited go first");
    queue.answered();
    assert_eq!(sent(queue.take(now + seconds(1))).load, 3);
    assert!(queue.is_empty());
}

#[test]
fn whoever_waits_is_told_until_when() {
    let now = Instant::now();
    let mut queue = queue(1, 5, 1);
    let entry = sent(queue.take(now));
    let wish =
        Failure::Passing(Passing::Status { status: 503, message: String::new() }, Some(seconds(7)));
    drop(queue.failed(entry, wish, &Short, (now, now), 0.0));
    assert_eq!(queue.wakes_at(), Some(now + seconds(7)));
    queue.submit(1, false);
    assert!(queue.take(now + seconds(6)).is_none(), "the server wants to be left alone by all");
    assert_eq!(queue.wakes_at(), Some(now + seconds(7)));
    queue.submit(2, true);
    let known = queue.take(now + seconds(6));
    assert!(matches!(known, Some(Task::LookUp(_))), "a known reply bothers no server");
    assert_eq!(sent(queue.take(now + seconds(7))).load, 0);
    assert_eq!(queue.allowed(), 1);
}

#[test]
fn to_be_told_to_wait_while_others_are_served_uses_up_no_try() {
    let now = Instant::now();
    for (others, expected) in [(true, 9), (false, 2)] {
        let mut queue = queue(1, 1, 1);
        let mut then = now;
        let mut attempts = 0;
        for _ in 0..9 {
            if others {
                // In between, somebody else gets a reply.
                queue.submit(9, false);
                queue.ready.rotate_right(1);
                assert_eq!(sent(queue.take(then)).load, 9);
                queue.answered();
            }
            then += seconds(100);
            let Some(Task::Send(entry)) = queue.take(then) else { break };
            attempts = entry.attempts;
            if let Verdict::Failed(..) = queue.failed(entry, status(429), &Short, (then, then), 0.0)
            {
                break;
            }
        }
        assert_eq!(attempts, expected, "{others}");
    }
}

#[derive(Debug, Clone, Copy)]
enum Step {
    Reply,
    Status(u16),
    Lost,
    Nobody,
    Refused(u16),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => Just(Step::Reply),
        3 => prop::sample::select(vec![429, 500, 503]).prop_map(Step::Status),
        1 => Just(Step::Lost),
        1 => Just(Step::Nobody),
        1 => prop::sample::select(vec![400, 401, 404]).prop_map(Step::Refused),
    ]
}

fn failure(step: Step) -> Option<Failure> {
    Some(match step {
        Step::Reply => return None,
        Step::Status(number) => status(number),
        Step::Lost => Failure::Passing(Passing::Timeout(seconds(1)), Some(seconds(2))),
        Step::Nobody => Failure::Passing(Passing::Unreachable(String::new()), None),
        Step::Refused(status) => Failure::Final(ChatError::Refused {
            endpoint: String::new(),
            status,
            message: String::new(),
            advice: "",
        }),
    })
}

proptest! {
    /// Whatever the server does, every request ends exactly once, and nobody waits for ever.
    #[test]
    fn every_request_ends_once(
        (most, retries, requests) in (1..6_u32, 0..3_u32, 1..12_u32),
        steps in prop::collection::vec((step(), 0..9_usize, 0.0..1.0), 1..60),
    ) {
        let mut now = Instant::now();
        let mut queue = queue(most, retries, requests);
        let mut ended = vec![0; requests as usize];
        let mut in_flight: Vec<(Entry<u32>, Instant)> = Vec::new();
        let mut steps = steps.into_iter().cycle();
        for _ in 0..100_000 {
            match queue.take(now) {
                Some(Task::Send(entry)) => {
                    in_flight.push((entry, now));
                    prop_assert!(in_flight.len() <= most as usize);
                    continue;
                }
                Some(Task::LookUp(entry)) => {
                    queue.missed(entry);
                    continue;
                }
                Some(Task::Refuse(entry, _)) => {
                    ended[entry.load as usize] += 1;
                    continue;
                }
                None => {}
            }
            if in_flight.is_empty() {
                let Some(then) = queue.wakes_at() else { break };
                prop_assert!(then > now, "there would have been something to do");
                now = then;
                continue;
            }
            let (step, which, jitter) = steps.next().unwrap();
            let (entry, sent) = in_flight.swap_remove(which % in_flight.len());
            let load = entry.load as usize;
            match failure(step) {
                None => {
                    queue.answered();
                    ended[load] += 1;
                }
                Some(failure) => {
                    match queue.failed(entry, failure, &Short, (sent, now), jitter) {
                        Verdict::Again(_) => {}
                        Verdict::Failed(..) | Verdict::Gone(..) => ended[load] += 1,
                    }
                }
            }
        }
        prop_assert!(queue.is_empty());
        prop_assert_eq!(ended, vec![1; requests as usize]);
    }
}
