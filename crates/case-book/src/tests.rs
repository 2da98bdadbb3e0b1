//! Books by hand: sets, orders, and what is refused.

use std::collections::BTreeMap;

use domain::{
    ActionCode, DemonstrationKind, Demonstrations, FeedbackCode, Mismatch, State, StreamOrder,
};

use super::*;
use crate::declaration::tests::doors;

/// A turn on the spot.
fn demonstration(case: u32, kind: DemonstrationKind) -> Demonstration {
    Demonstration {
        case,
        kind,
        variant: 0,
        instruction: "Find a cone.".to_owned(),
        states: [0.0, 1.0].map(|heading| State::new(&[1.0, heading]).unwrap()).to_vec(),
        feedback: vec![FeedbackCode::START, FeedbackCode(1)],
        sub_goals: vec![1],
        actions: vec![ActionCode(1)],
        views: vec![0, 1],
    }
}

/// Two cases with four demonstrations each; the first has one after an event.
fn book() -> DemonstrationBook {
    let own = |case| DemonstrationKind::OWN.map(|kind| demonstration(case, kind));
    let mut demonstrations: Vec<_> = (0..2).flat_map(own).collect();
    demonstrations.push(demonstration(0, DemonstrationKind::After));
    let case = |own: [u32; 4], others: [u32; 2], after| CaseDemonstrations {
        own: own.into(),
        irrelevant: others.into(),
        confusable: [others[1], others[0]].into(),
        after,
        ..CaseDemonstrations::default()
    };
    DemonstrationBook {
        world: doors(),
        demonstrations,
        cases: vec![case([0, 1, 2, 3], [6, 5], Some(8)), case([4, 5, 6, 7], [2, 1], None)],
        bank_order: vec![5, 0, 7, 1, 2, 6, 4, 3],
        ..DemonstrationBook::default()
    }
}

#[test]
fn a_set_names_demonstrations_in_its_order() {
    let book = book();
    for (set, first, second) in [
        ("none", Some(vec![]), Some(vec![])),
        ("4", Some(vec![0, 1, 2, 3]), Some(vec![4, 5, 6, 7])),
        ("distant+opposite", Some(vec![1, 3]), Some(vec![5, 7])),
        ("irrelevant", Some(vec![0, 1, 6, 5]), Some(vec![4, 5, 2, 1])),
        ("confusable", Some(vec![0, 1, 5, 6]), Some(vec![4, 5, 1, 2])),
        ("after", Some(vec![8]), None),
        ("before-after", Some(vec![0, 8]), None),
        ("after-before", Some(vec![8, 0]), None),
        ("elsewhere", None, None),
        // The own original demonstration takes the last place if it is not among the first ones.
        ("bank-1", Some(vec![0]), Some(vec![4])),
        ("bank-3", Some(vec![5, 0, 7]), Some(vec![5, 0, 4])),
        ("bank-8", Some(book.bank_order.clone()), Some(book.bank_order.clone())),
        ("bank-9", None, None),
    ] {
        let set: Demonstrations = set.parse().unwrap();
        assert_eq!([0, 1].map(|case| book.of_case(case, set)), [first, second], "{set}");
        assert_eq!(book.of_case(2, set), None);
    }
    let all = |set: &str| book.of_all_cases(set.parse().unwrap());
    assert_eq!(all("irrelevant"), Some(vec![0, 1, 6, 5, 4, 2]));
    assert_eq!(all("bank-3"), Some(vec![5, 0, 7, 4]));
    assert_eq!(all("after"), None);
    assert_eq!(book.find(1, DemonstrationKind::Nearby, 0), Some(6));
    assert_eq!(book.find(1, DemonstrationKind::Nearby, 1), None);
}

#[test]
fn orders_of_a_stream_are_of_its_blocks() {
    let block = |case| StreamBlock { world: 0, cases: vec![case, 1] };
    let stream = StreamFacts { blocks: [2, 0, 2].map(block).into(), shuffled: vec![1, 2, 0] };
    let orders = StreamOrder::ALL.map(|order| stream.order(order));
    assert_eq!(orders, [[0, 1, 2], [2, 1, 0], [1, 2, 0]]);
    assert!(stream.cases().into_iter().eq(0..=2));
}

#[test]
fn a_demonstration_s_lists_belong_together() {
    let sound = demonstration(0, DemonstrationKind::Original);
    assert_eq!((sound.stages(), sound.problem()), (vec![0, 1], None));
    let changes: [fn(&mut Demonstration); 6] = [
        |of| of.states.clear(),
        |of| of.states.truncate(1),
        |of| of.feedback.push(FeedbackCode(1)),
        |of| of.views.truncate(1),
        |of| of.actions.push(ActionCode(0)),
        |of| of.sub_goals.push(2),
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut broken = sound.clone();
        change(&mut broken);
        assert!(broken.problem().is_some(), "change {number}");
    }
}

#[test]
fn a_book_that_names_what_it_lacks_is_refused() {
    let good = BookFile::new(book()).unwrap();
    let read = |text: String| BookFile::<DemonstrationBook>::parse(text, "here");
    assert_eq!(read(good.text.clone()).unwrap(), good);
    for (from, to, expected) in [
        ("\"after\":8", "\"after\":9", "a set names a demonstration that is not among 9"),
        ("\"bank_order\":[5", "\"bank_order\":[10", "a set names a demonstration"),
        ("\"case\":1", "\"case\":2", "a demonstration is of a case that is not among 2"),
        ("\"actions\":[1]", "\"actions\":[2]", "demonstration: 2 is not an action of this world"),
        ("\"actions\":[1]", "\"actions\":[1,0]", "a demonstration has 2 states"),
        ("\"feedback\":[0,1]", "\"feedback\":[0,3]", "3 is not a feedback of this world"),
        ("[1.0,1.0]", "[1.0,2.0]", "no state of the world doors: heading is 2, not one of 0 to 1"),
        ("\"name\":\"doors\"", "\"name\":\"Doors\"", "its \"name\" is not"),
        ("\"views\"", "\"wievs\"", "unknown field `wievs`"),
        ("{\"world\"", "\"world\"", "is not part of a case book"),
    ] {
        let error = read(good.text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.starts_with("here is not part of a case book: "), "{error}");
        assert!(error.contains(expected), "{error}");
    }
    let missing = BookFile::<DemonstrationBook>::read(std::path::Path::new("/no/such/file"));
    assert_eq!(missing.unwrap_err().to_string(), "cannot read /no/such/file");
}

/// A longer one would be cut on its way to policies and memories.
#[test]
fn an_instruction_that_does_not_fit_is_refused() {
    let parsed_with = |bytes: usize| {
        let case = CaseFacts {
            id: "a".to_owned(),
            task: 1,
            instruction: "x".repeat(bytes),
            paraphrase: None,
            references: Vec::new(),
            invalidated_when_blocked: false,
        };
        let world = WorldFacts { declaration: doors(), ..WorldFacts::default() };
        let (streams, stale) = (None, BTreeMap::new());
        let book = BookFile::new(CaseBook { world, cases: vec![case], streams, stale }).unwrap();
        BookFile::<CaseBook>::parse(book.text, "here").map(drop).map_err(|error| error.to_string())
    };
    let refused = "the instruction of case a has 233 bytes, and at most 232 fit";
    assert!(parsed_with(233).unwrap_err().ends_with(refused));
    assert!(!parsed_with(232).is_err_and(|error| error.contains("instruction")));
}

#[test]
fn other_words_are_offered_for_every_case_or_not() {
    let parsed_with = |paraphrase: Option<String>| {
        let case = CaseFacts {
            id: "a".to_owned(),
            task: 1,
            instruction: "x".to_owned(),
            paraphrase,
            references: Vec::new(),
            invalidated_when_blocked: false,
        };
        let world = WorldFacts {
            declaration: doors(),
            failures: crate::HARNESS_FAILURES.map(crate::FailureKind::new).into(),
            mismatches: vec![Mismatch::Wording],
            ..WorldFacts::default()
        };
        let (streams, stale) = (None, BTreeMap::new());
        let book = BookFile::new(CaseBook { world, cases: vec![case], streams, stale }).unwrap();
        BookFile::<CaseBook>::parse(book.text, "here").map(drop).map_err(|error| error.to_string())
    };
    assert_eq!(parsed_with(Some("y".to_owned())), Ok(()));
    for (paraphrase, expected) in [
        (None, "it offers the mismatch wording, and case a has no paraphrase"),
        (Some("y".repeat(300)), "the instruction of case a has 300 bytes, and at most 232 fit"),
    ] {
        let error = parsed_with(paraphrase).unwrap_err();
        assert_eq!(error, format!("here is not part of a case book: {expected}"));
    }
}
