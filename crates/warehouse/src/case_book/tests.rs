//! The book against what the set of cases, the dynamics and the streams say.

use std::collections::HashSet;
use std::fs;

use case_book::BookFile;
use domain::{ActionCode, EventKind, StreamRules};

use super::*;

fn request(sets: &[Demonstrations]) -> BookRequest {
    let cases = CaseSet::shipped().cases.into_iter().map(|case| case.id).collect();
    BookRequest { cases, demonstrations: sets.to_vec(), ..BookRequest::default() }
}

fn elsewhere() -> Option<ElsewhereRequest> {
    Some(ElsewhereRequest { assets: None, seed: 1 })
}

/// A stream with a closed passage, a moved item and swapped types.
fn streams() -> StreamsRequest {
    let events = vec![EventKind::Close, EventKind::Move, EventKind::Swap];
    let rules = StreamRules { streams: 2, blocks: 4, cases_per_block: 3, events };
    StreamsRequest { rules, seed: 5, planned: true }
}

fn named_sets() -> Vec<Demonstrations> {
    let own = (0..16).filter_map(Demonstrations::from_bits);
    let named = [
        Demonstrations::IRRELEVANT,
        Demonstrations::CONFUSABLE,
        Demonstrations::AFTER,
        Demonstrations::BEFORE_AFTER,
        Demonstrations::AFTER_BEFORE,
        Demonstrations::ELSEWHERE,
    ];
    own.chain(named).chain([1, 16, 400].map(Demonstrations::bank)).collect()
}

/// The sets of control arms.
const CONTROLS: [Demonstrations; 4] = [
    Demonstrations::NEW_REFERENCE,
    Demonstrations::BLOCKED_REFERENCE,
    Demonstrations::WRONG_1,
    Demonstrations::WRONG_2,
];

fn all_sets() -> Vec<Demonstrations> {
    named_sets().into_iter().chain(CONTROLS).collect()
}

#[test]
fn demonstrations_hold_test_references_only_for_the_arm_oracle() {
    let (warehouse, set) = (Warehouse::shipped(), CaseSet::shipped());
    let references = |sets: &[Demonstrations]| {
        let request = BookRequest { elsewhere: elsewhere(), blocked: true, ..request(sets) };
        let Books { cases, demonstrations: book, .. } = write_books(&request).unwrap();
        let mut found = Vec::new();
        for (number, case) in (0..).zip(&set.cases) {
            for (route, kind) in [
                (Route::Unchanged, TrajectoryKind::Test),
                (Route::Blocked, TrajectoryKind::Blocked),
            ] {
                let test = case.trajectory(kind);
                let begin = State::from(test.start);
                // Whatever it is called.
                let is_it = |of: &&Demonstration| {
                    of.case == number
                        && of.states[0] == begin
                        && of.actions == converted::<_, ActionCode>(&test.actions)
                };
                let held = book.demonstrations.iter().find(is_it);
                let named = book.cases[number as usize].reference(route);
                let named = named.map(|index| &book.demonstrations[index as usize]);
                assert_eq!(held, named);
                if let Some(held) = held {
                    let replay = case.replay(&warehouse, kind);
                    assert_eq!(held.states, converted(&replay.poses));
                    assert_eq!(held.variant, if route == Route::Blocked { 1 + number } else { 0 });
                    let index = book.cases[number as usize].reference(route).unwrap();
                    assert!(!cases.is_stale(held.variant, index));
                    found.push(route);
                }
            }
        }
        [Route::Unchanged, Route::Blocked]
            .map(|route| found.iter().filter(|of| **of == route).count())
    };
    let [new, blocked, wrong, both] = CONTROLS;
    let count = set.cases.len();
    assert_eq!(references(&[named_sets(), vec![wrong, both]].concat()), [0, 0]);
    assert_eq!(references(&[new]), [count, 0]);
    assert_eq!(references(&[blocked]), [0, count]);
    assert_eq!(references(&[new, blocked]), [count, count]);
}

/// What the demonstrations of the set of cases are in the book.
fn history_of(book: &DemonstrationBook, index: u32) -> History {
    let Demonstration { case, kind, .. } = book.demonstrations[index as usize];
    History { case: case as usize, kind }
}

#[test]
fn sets_name_the_same_demonstrations_as_the_cases() {
    let warehouse = Warehouse::shipped();
    let mut set = CaseSet::shipped();
    let request = BookRequest { elsewhere: elsewhere(), ..request(&all_sets()) };
    let Books { demonstrations: book, elsewhere: text, .. } = write_books(&request).unwrap();
    set.elsewhere = Some(Elsewhere::generate(&warehouse, &set, 1).unwrap());
    assert_eq!(text, set.elsewhere.as_ref().map(Elsewhere::to_text));
    for (case, sets) in (0..set.cases.len()).map(|case| (case, all_sets())) {
        for demonstrations in sets {
            let of = book.of_case(case as u32, demonstrations).unwrap();
            let of: Vec<History> = of.into_iter().map(|index| history_of(&book, index)).collect();
            assert_eq!(of, set.histories(case, demonstrations), "case {case}, {demonstrations}");
        }
    }
    for demonstrations in all_sets() {
        let all = book.of_all_cases(demonstrations).unwrap();
        let all: Vec<History> = all.into_iter().map(|index| history_of(&book, index)).collect();
        let mut known = HashSet::new();
        let each = (0..set.cases.len()).flat_map(|case| set.histories(case, demonstrations));
        let each: Vec<History> = each.filter(|history| known.insert(*history)).collect();
        assert_eq!(all, each, "{demonstrations}");
    }
    assert_eq!(book.of_case(0, Demonstrations::bank(401)), None);
    assert_eq!(book.of_case(set.cases.len() as u32, Demonstrations::ALL), None);
    for index in 0..book.demonstrations.len() as u32 {
        let found = &book.demonstrations[index as usize];
        let of = set.demonstrated(&warehouse, history_of(&book, index)).unwrap();
        let replay = of.replay();
        assert_eq!(
            (&found.instruction, found.variant, &found.actions),
            (&of.instruction(), of.variant, &converted(&of.trajectory.actions))
        );
        assert_eq!(
            (&found.states, &found.feedback),
            (&converted(&replay.poses), &converted(&replay.feedback))
        );
        assert_eq!((&found.sub_goals, found.stages()), (&replay.goal_steps, replay.stages));
        assert_eq!(found.problem(), None);
    }
}

#[test]
fn views_are_equal_where_variant_and_pose_are() {
    let request = BookRequest { elsewhere: elsewhere(), ..request(&all_sets()) };
    let Books { demonstrations: book, .. } = write_books(&request).unwrap();
    let mut number_of = HashMap::new();
    let mut seen_from: HashMap<u32, (bool, State)> = HashMap::new();
    for of in &book.demonstrations {
        for (&pose, &view) in of.states.iter().zip(&of.views) {
            assert_eq!(*number_of.entry((of.variant, pose)).or_insert(view), view);
            // Other halls and poses look different.
            let from = (of.variant == ELSEWHERE_VARIANT, pose);
            assert_eq!(*seen_from.entry(view).or_insert(from), from);
        }
        assert!(book.variants.contains_key(&of.variant));
    }
    let numbers: BTreeSet<u32> = seen_from.keys().copied().collect();
    assert!(numbers.into_iter().eq(0..seen_from.len() as u32));
    let shipped = CaseSet::shipped();
    for (case, variant) in shipped.cases.iter().zip(1..) {
        for (other, number) in shipped.cases.iter().zip(1..) {
            let are_equal = book.variants[&variant] == book.variants[&number];
            assert_eq!(are_equal, case.barricade == other.barricade);
        }
        assert_ne!(book.variants[&variant], book.variants[&0]);
    }
    assert_ne!(book.variants[&0], book.variants[&ELSEWHERE_VARIANT]);
}

#[test]
fn references_and_facts_of_cases_are_those_of_the_set() {
    let (warehouse, set) = (Warehouse::shipped(), CaseSet::shipped());
    let Books { cases: book, streams, elsewhere, .. } = write_books(&request(&[])).unwrap();
    assert_eq!((streams, elsewhere), (None, None));
    assert!(book.stale.is_empty() && book.streams.is_none());
    let free = warehouse.layout.free_cells().count() as u32;
    assert_eq!((book.world.views, book.world.elsewhere_views), (4 * free, 0));
    for (found, case) in book.cases.iter().zip(&set.cases) {
        assert_eq!(book.index(&case.id), set.index(&case.id));
        assert_eq!(found.task, case.task.task_type().number());
        for (start, route) in [
            (Start::Original, Route::Unchanged),
            (Start::New, Route::Unchanged),
            (Start::Original, Route::Blocked),
            (Start::New, Route::Blocked),
        ] {
            let kind = TrajectoryKind::reference(start, route);
            let (found, trajectory) =
                (found.reference(start, route).unwrap(), case.trajectory(kind));
            assert_eq!(
                (found.begin, &found.actions),
                (trajectory.start.into(), &converted(&trajectory.actions))
            );
            assert_eq!(Some(found.length), case.replay(&warehouse, kind).length);
        }
        let closed = Variant::closing(case.barricade.iter().copied());
        let replay = case.original.replay(&warehouse, &case.task, &closed);
        assert_eq!(found.invalidated_when_blocked, replay.length.is_none());
    }
    assert!(book.cases.iter().any(|case| case.invalidated_when_blocked));
}

/// Whether a demonstration completes its task in `state`, by replay.
fn completes(set: &CaseSet, of: &Demonstration, warehouse: &Warehouse, variant: &Variant) -> bool {
    let trajectory = trajectory_of(of).unwrap();
    let task = &set.cases[of.case as usize].task;
    trajectory.replay(warehouse, task, variant).length.is_some()
}

#[test]
fn staleness_on_blocked_routes_is_that_of_a_replay() {
    let (warehouse, set) = (Warehouse::shipped(), CaseSet::shipped());
    let sets: Vec<Demonstrations> =
        named_sets().into_iter().filter(|set| !set.take_place_elsewhere()).collect();
    let request = BookRequest { blocked: true, ..request(&sets) };
    let Books { cases: book, demonstrations, .. } = write_books(&request).unwrap();
    assert!(book.stale.keys().copied().eq(1..=set.cases.len() as u32));
    let mut count = 0;
    for (index, case) in set.cases.iter().enumerate() {
        let closed = Variant::closing(case.barricade.iter().copied());
        // The bank of 400 holds all; of those after an event only the own one can be retrieved.
        for (number, of) in (0..).zip(&demonstrations.demonstrations) {
            let is_retrieved = of.variant == 0 || of.case as usize == index;
            let expected = is_retrieved && !completes(&set, of, &warehouse, &closed);
            assert_eq!(book.is_stale(1 + index as u32, number), expected);
            count += u32::from(expected);
        }
    }
    assert!(count > 100, "{count}");
}

#[test]
fn only_what_can_be_retrieved_is_listed_as_stale() {
    let set = CaseSet::shipped();
    let request = BookRequest {
        blocked: true,
        ..request(&[Demonstrations::ORIGINAL, Demonstrations::IRRELEVANT])
    };
    let request = BookRequest { cases: vec![set.cases[7].id.clone()], ..request };
    let Books { cases: book, demonstrations, .. } = write_books(&request).unwrap();
    assert!(book.stale.keys().eq([&8]));
    let listed = demonstrations.of_case(7, Demonstrations::IRRELEVANT).unwrap();
    assert!(book.stale[&8].iter().all(|of| listed.contains(of)));
    let unblocked = BookRequest { blocked: false, ..request };
    assert!(write_books(&unblocked).unwrap().cases.stale.is_empty());
}

#[test]
fn streams_are_those_that_are_drawn() {
    let (warehouse, set) = (Warehouse::shipped(), CaseSet::shipped());
    let asked = streams();
    let sets = [Demonstrations::ALL, Demonstrations::CONFUSABLE, Demonstrations::BEFORE_AFTER];
    let request = BookRequest { streams: Some(asked.clone()), ..request(&sets) };
    let Books { cases: book, demonstrations, streams: text, .. } = write_books(&request).unwrap();
    let all: Vec<usize> = (0..set.cases.len()).collect();
    let drawn = StreamSet::draw(&warehouse, &set, &all, asked.seed, &asked.rules).unwrap();
    let text = text.unwrap();
    assert_eq!(text, drawn.to_text());
    let facts = book.streams.as_ref().unwrap();
    assert_eq!(facts.hash, blake3::hash(text.as_bytes()).to_hex().to_string());
    let states = drawn.states(&warehouse).unwrap();
    let count = set.cases.len();
    for (number, (found, stream)) in (0..).zip(facts.streams.iter().zip(&drawn.streams)) {
        for order in StreamOrder::ALL {
            assert_eq!(found.order(order), drawn.order(number, order));
        }
        assert!(found.cases().into_iter().eq(stream.cases()));
        let of = &demonstrations.streams[number as usize];
        assert_eq!(of.cases, stream.cases());
        for (at, (found, block)) in found.blocks.iter().zip(&stream.blocks).enumerate() {
            assert_eq!((found.world, &found.cases), (block.world, &block.cases));
            let variant = facts.variant(block.world).unwrap();
            assert_eq!(variant, drawn.variant(block.world, count));
            let state = &states[block.world as usize];
            let expert = state.expert();
            for &number in &block.cases {
                let case = &set.cases[number as usize];
                let found = facts.case(block.world, number).unwrap();
                let (reference, length) =
                    state.reference(&expert, &case.task, case.test.start).unwrap();
                assert_eq!(
                    (found.begin, &found.actions),
                    (reference.start.into(), &converted(&reference.actions))
                );
                assert_eq!(found.length, length);
                assert_eq!(found.invalidated, !state.completes(&case.original, &case.task));
            }
            // By an expert who knows the world of the block, from where the cases' own begin.
            let begins = of.cases.iter().flat_map(|&number| {
                let case = &set.cases[number as usize];
                TrajectoryKind::DEMONSTRATIONS.map(|kind| (case, case.trajectory(kind).start))
            });
            let open = begins.filter(|(_, start)| !state.variant.is_closed(start.cell));
            let planned: Vec<Trajectory> =
                open.filter_map(|(case, start)| expert.plan(start, &case.task)).collect();
            assert_eq!(of.planned[at].len(), planned.len());
            for (&found, planned) in of.planned[at].iter().zip(&planned) {
                let found = &demonstrations.demonstrations[found as usize];
                assert_eq!((found.variant, found.states[0]), (variant, planned.start.into()));
                assert_eq!(found.actions, converted(&planned.actions));
                let task = &set.cases[found.case as usize].task;
                let replay = planned.replay(&state.warehouse, task, &state.variant);
                assert_eq!(
                    (&found.states, &found.feedback),
                    (&converted(&replay.poses), &converted(&replay.feedback))
                );
                assert_eq!(found.sub_goals, replay.goal_steps);
                assert!(!book.is_stale(variant, of.planned[at][0]));
            }
            let mut known = vec![false; demonstrations.demonstrations.len()];
            for &case in &of.cases {
                let own = sets.iter().flat_map(|&set| demonstrations.of_case(case, set).unwrap());
                let others = demonstrations.cases[case as usize].irrelevant.iter().copied();
                own.chain(others).for_each(|of| known[of as usize] = true);
            }
            for (number, of) in (0..).zip(&demonstrations.demonstrations) {
                let is_valid = completes(&set, of, &state.warehouse, &state.variant);
                if known[number as usize] {
                    assert_eq!(book.is_stale(variant, number), !is_valid, "{variant}: {number}");
                }
            }
        }
    }
    assert!(facts.variants.contains(&0) && book.stale.contains_key(&0));
    assert!(book.stale.values().any(|stale| !stale.is_empty()));
    let unplanned = StreamsRequest { planned: false, ..asked };
    let request = BookRequest { streams: Some(unplanned), ..request };
    let books = write_books(&request).unwrap();
    assert!(books.demonstrations.streams.iter().all(|stream| stream.planned.is_empty()));
    assert_eq!(books.streams, Some(text));
}

#[test]
fn memory_is_told_nothing_of_a_test() {
    let set = CaseSet::shipped();
    let request = BookRequest { elsewhere: elsewhere(), ..request(&named_sets()) };
    let request = BookRequest { streams: Some(streams()), blocked: true, ..request };
    let Books { demonstrations: book, .. } = write_books(&request).unwrap();
    for of in &book.demonstrations {
        let case = &set.cases[of.case as usize];
        if of.variant == ELSEWHERE_VARIANT {
            continue;
        }
        assert_ne!(of.states[0], State::from(case.test.start), "{}", case.id);
        let begins =
            TrajectoryKind::DEMONSTRATIONS.map(|kind| State::from(case.trajectory(kind).start));
        assert!(begins.contains(&of.states[0]));
        for reference in [&case.test, &case.blocked] {
            assert_ne!(
                (of.states[0], &of.actions),
                (reference.start.into(), &converted(&reference.actions))
            );
        }
    }
}

#[test]
fn books_are_read_as_they_were_written_and_the_same_request_gives_the_same_text() {
    let request = BookRequest { elsewhere: elsewhere(), blocked: true, ..request(&named_sets()) };
    let request = BookRequest { streams: Some(streams()), ..request };
    let [one, other] = [(); 2].map(|()| write_books(&request).unwrap());
    let (cases, demonstrations) =
        (BookFile::new(one.cases).unwrap(), BookFile::new(one.demonstrations).unwrap());
    assert_eq!(cases.text, BookFile::new(other.cases).unwrap().text);
    assert_eq!(demonstrations.text, BookFile::new(other.demonstrations).unwrap().text);
    assert_eq!((one.streams, one.elsewhere), (other.streams, other.elsewhere));
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    fs::write(&first, &cases.text).unwrap();
    fs::write(&second, &demonstrations.text).unwrap();
    assert_eq!(BookFile::<CaseBook>::read(&first).unwrap(), cases);
    assert_eq!(BookFile::<DemonstrationBook>::read(&second).unwrap(), demonstrations);
    assert!(BookFile::<DemonstrationBook>::read(&first).is_err());
    let reversed = request.cases.iter().rev().cloned().collect();
    let reversed = write_books(&BookRequest { cases: reversed, ..request }).unwrap();
    assert_eq!(reversed.cases, cases.book);
}

#[test]
fn a_copy_of_the_built_in_assets_gives_the_same_book() {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    let built_in = write_books(&request(&[Demonstrations::ALL])).unwrap();
    let read = BookRequest { assets: Some(assets), ..request(&[Demonstrations::ALL]) };
    assert_eq!(write_books(&read).unwrap(), built_in);
    let names = ["cases", "catalogue", "layout", "models"];
    assert!(built_in.cases.world.hashes.keys().eq(&names));
}

#[test]
fn what_cannot_be_written_is_named() {
    let error = |request: BookRequest| write_books(&request).unwrap_err().to_string();
    let unknown = BookRequest { cases: vec!["t01-0l".to_owned()], ..BookRequest::default() };
    assert_eq!(error(unknown), "unknown case `t01-0l`: did you mean `t01-01`?");
    let none = BookRequest { assets: Some("/no/such/folder".into()), ..BookRequest::default() };
    assert!(error(none).starts_with("cannot read /no/such/folder/layout.toml"));
    assert_eq!(
        error(request(&[Demonstrations::bank(401)])),
        "the cases have 400 demonstrations, too few for bank-401"
    );
    assert_eq!(
        error(request(&[Demonstrations::ELSEWHERE])),
        "the demonstrations `elsewhere` need another world, and the request names none"
    );
    let mut few = request(&[]);
    few.cases.truncate(1);
    let few = error(BookRequest { streams: Some(streams()), ..few });
    assert!(few.starts_with("no stream 0 found for seed 5 among 1 cases"), "{few}");
}
