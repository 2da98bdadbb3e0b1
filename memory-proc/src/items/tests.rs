//! What becomes of items: references, budgets, kinds, documents.

use domain::Action;
use proptest::prelude::*;
use shm_types::message::NO_ACTION;

use super::*;
use crate::representation::testing::{TestDocuments, demonstration};

const FORWARD: u8 = Action::Forward as u8;

/// Demonstrations of 10, 5 and 61 steps.
fn bank() -> MemoryBank {
    MemoryBank::new(vec![demonstration(0, 5, 9), demonstration(3, 7, 4), demonstration(1, 0, 60)])
}

const AMPLE: Budgets = Budgets { images: 200, text: 200 };

fn source(demonstration: u32, first: u32, count: u32) -> Source {
    Source { demonstration, first, count }
}

fn steps(demonstration: u32, first: u32, count: u32) -> MemoryItem {
    let source = source(demonstration, first, count);
    MemoryItem::Steps { source, views: Views::All, actions: true, distance: Some(0.5) }
}

fn whole(demonstration: u32, count: u32, shown: &[u32]) -> MemoryItem {
    let source = source(demonstration, 0, count);
    let views = Views::Keyframes(shown.to_vec());
    MemoryItem::Steps { source, views, actions: true, distance: None }
}

fn frame(demonstration: u32, step: u32, caption: &str) -> MemoryItem {
    MemoryItem::Frame { demonstration, step, caption: caption.into(), distance: None }
}

fn own(action: Action) -> PlanPart {
    PlanPart::Own(action.into())
}

fn plan(parts: &[PlanPart]) -> MemoryItem {
    MemoryItem::Plan { parts: parts.to_vec() }
}

fn refusal(items: Vec<MemoryItem>) -> String {
    CheckedAnswer::new(items, &bank(), &warehouse::declaration(), AMPLE).unwrap_err()
}

/// The recall of `items`, with frames that are numbered by row.
fn assembled(
    items: Vec<MemoryItem>,
    texts: &mut PublishedTexts,
    documents: &mut TestDocuments,
) -> AssembledRecall {
    let bank = bank();
    let answer = CheckedAnswer::new(items, &bank, &warehouse::declaration(), AMPLE).unwrap();
    let mut assembler = Assembler { bank: &bank, episode: (1, 7), texts, documents };
    let frame = |view_id: ViewId| {
        assert!(answer.view_ids.contains(&view_id), "{view_id:?} was not asked for");
        Some(1000 + u64::from(view_id.step))
    };
    assembler.assemble(&answer, frame).unwrap()
}

#[test]
fn what_is_not_in_the_bank_is_refused_by_name() {
    let distant = |distance| MemoryItem::Steps {
        source: source(0, 0, 2),
        views: Views::All,
        actions: true,
        distance: Some(distance),
    };
    let neither = MemoryItem::Steps {
        source: source(0, 0, 2),
        views: Views::None,
        actions: false,
        distance: None,
    };
    let text =
        MemoryItem::Text { text: "cone".into(), sources: vec![source(0, 0, 2), source(1, 4, 2)] };
    let sources = vec![source(0, 0, 1); 17];
    for (item, expected) in [
        (steps(3, 0, 1), "item 1 names demonstration 3, but the bank has 3 (from 0)"),
        (steps(u32::MAX, 0, 1), "item 1 names demonstration 4294967295, but the bank has 3"),
        (steps(1, 2, 4), "item 1 names 4 steps from step 2 of demonstration 1, which has 5 steps"),
        (steps(1, u32::MAX, u32::MAX), "item 1 names 4294967295 steps from step 4294967295"),
        (steps(1, 2, 0), "item 1 names 0 steps"),
        (frame(1, 5, ""), "item 1 names 1 steps from step 5"),
        (whole(1, 5, &[0, 5]), "item 1 shows step 5, which is not one of its steps 0 to 4"),
        (whole(1, 5, &[3, 1]), "item 1 names its keyframes in no ascending order"),
        (whole(1, 5, &[1, 1]), "item 1 names its keyframes in no ascending order"),
        (neither, "item 1 supplies neither views nor actions"),
        (distant(f32::INFINITY), "item 1 has the distance inf, expected a finite number"),
        (text, "item 1 names 2 steps from step 4 of demonstration 1"),
        (
            MemoryItem::Text { text: "".into(), sources },
            "it has 17 sources, and at most 16 are allowed",
        ),
        (plan(&[PlanPart::Steps(source(3, 0, 1))]), "item 1 names demonstration 3, but the bank"),
        (plan(&[PlanPart::Steps(source(1, 4, 2))]), "item 1 names 2 steps from step 4 of"),
        (
            plan(&[own(Action::Left), PlanPart::Own(ActionCode(7))]),
            "item 1 plans action 7, but the world has 7 actions (from 0)",
        ),
        (plan(&[]), "item 1 is a plan without actions"),
        (plan(&[PlanPart::Steps(source(1, 4, 1))]), "item 1 is a plan without actions"),
        (
            plan(&vec![own(Action::Left); 1025]),
            "item 1 plans 1025 actions, and at most 1024 are allowed",
        ),
        (
            plan(&[PlanPart::Steps(source(0, 0, 1)); 17]),
            "it has 17 sources, and at most 16 are allowed",
        ),
    ] {
        let error = refusal(vec![MemoryItem::text("before"), item]);
        assert!(error.starts_with(expected), "{error}");
    }
    let error = refusal(vec![MemoryItem::text("x"); 9]);
    assert_eq!(error, "it has 9 items, and at most 8 are allowed");
}

#[test]
fn an_item_that_does_not_fit_into_a_budget_is_dropped_whole() {
    let items = vec![
        MemoryItem::text("four"),
        steps(0, 2, 5),
        frame(0, 0, "it"),
        steps(0, 0, 4),
        MemoryItem::text("to"),
        MemoryItem::text("long text"),
    ];
    for (images, text, kept, supplied) in [
        (200, 200, vec![0, 1, 2, 3, 4, 5], (10, 17)),
        (6, 8, vec![0, 1, 2, 4], (6, 8)),
        (5, 8, vec![0, 1, 4], (5, 6)),
        (4, 4, vec![0, 3], (4, 4)),
        (1, 3, vec![2], (1, 2)),
        (0, 0, vec![], (0, 0)),
    ] {
        let budgets = Budgets { images, text };
        let world = warehouse::declaration();
        let answer = CheckedAnswer::new(items.clone(), &bank(), &world, budgets).unwrap();
        let numbers: Vec<usize> = answer.parts.iter().flat_map(|part| part.items.clone()).collect();
        assert_eq!(numbers, kept, "{budgets:?}");
        assert_eq!(answer.asked, Amount { items: 6, images: 10, text: 17 });
        let (images, text) = supplied;
        assert_eq!(answer.supplied, Amount { items: kept.len() as u16, images, text });
    }
}

#[test]
fn a_plan_is_the_actions_of_its_parts_and_has_their_sources() {
    let (mut texts, mut documents) = (PublishedTexts::default(), TestDocuments::default());
    let items = vec![
        whole(2, 61, &[3]),
        plan(&[
            own(Action::TurnLeft),
            own(Action::TurnLeft),
            PlanPart::Steps(source(0, 4, 2)),
            // To its end: the last step has no action.
            PlanPart::Steps(source(1, 3, 2)),
            own(Action::Left),
        ]),
        plan(&[PlanPart::Steps(source(1, 4, 1)), own(Action::Right)]),
    ];
    let recall = assembled(items, &mut texts, &mut documents);
    let [whole, first, second] = recall.items[..recall.items_len as usize] else { panic!() };
    assert_eq!((whole.kind, whole.first_step, whole.steps), (ItemKind::Trajectory as u8, 0, 61));
    for (item, range) in [(first, (61, 6)), (second, (67, 1))] {
        assert_eq!((item.kind, item.whole), (ItemKind::Plan as u8, 0));
        assert_eq!((item.first_step, item.steps), range);
        assert_eq!(item.document, whole.document);
    }
    // An instruction for each part of a demonstration that has actions.
    let instructions = [whole, first, second].map(|of| (of.first_instruction, of.instructions));
    assert_eq!(instructions, [(0, 1), (1, 2), (3, 0)]);
    let sources = &recall.sources[..recall.sources_len as usize];
    let sources = sources.iter().map(|of| (of.item, of.demonstration, of.first, of.steps, of.kind));
    let planned = ItemKind::Plan as u8;
    assert_eq!(
        sources.collect::<Vec<_>>()[1..],
        [(1, 0, 4, 2, planned), (1, 3, 3, 2, planned), (2, 3, 4, 1, planned)]
    );
    let steps = documents.published.iter().find_map(|(_, content)| match content {
        Content::Trajectories(steps) => Some(steps),
        _ => None,
    });
    let told = steps.unwrap()[61..].iter();
    let told: Vec<_> = told.map(|step| (step.trajectory, step.own, step.action)).collect();
    let (turn, left, right) = (Action::TurnLeft as u8, Action::Left as u8, Action::Right as u8);
    assert_eq!(
        told,
        [
            (1, 1, turn),
            (1, 1, turn),
            (2, 0, FORWARD),
            (2, 0, FORWARD),
            (3, 0, FORWARD),
            (4, 1, left),
            (5, 1, right)
        ]
    );
    assert!(steps.unwrap()[61..].iter().all(|step| step.frame == NO_FRAME));
}

#[test]
fn steps_show_what_the_item_asks_for() {
    let with = |views, actions| MemoryItem::Steps {
        source: source(0, 2, 3),
        views,
        actions,
        distance: Some(0.5),
    };
    for (item, expected) in [
        (with(Views::All, true), [(1007, FORWARD), (1008, FORWARD), (1009, NO_ACTION)]),
        (with(Views::All, false), [(1007, NO_ACTION), (1008, NO_ACTION), (1009, NO_ACTION)]),
        (with(Views::None, true), [(0, FORWARD), (0, FORWARD), (0, NO_ACTION)]),
    ] {
        let recall =
            assembled(vec![item], &mut PublishedTexts::default(), &mut TestDocuments::default());
        let item = recall.items[0];
        assert_eq!((recall.items_len, recall.steps_len, item.first_step, item.steps), (1, 3, 0, 3));
        assert_eq!((item.kind, item.whole, item.distance), (ItemKind::Steps as u8, 0, 0.5));
        let shown = recall.steps[..3].iter().map(|step| (step.frame, step.action));
        assert_eq!(shown.collect::<Vec<_>>(), expected);
        let RecalledSource { case, demonstration, first, steps, item, .. } = recall.sources[0];
        assert_eq!(
            (recall.sources_len, case, demonstration, first, steps, item),
            (1, 8, 0, 2, 3, 0)
        );
    }
}

#[test]
fn long_items_and_keyframes_become_documents_and_neighbours_one_item() {
    let (mut texts, mut documents) = (PublishedTexts::default(), TestDocuments::default());
    let long = steps(2, 1, 33);
    let items = vec![
        steps(2, 0, 32),
        whole(0, 10, &[0, 9]),
        whole(1, 5, &[]),
        frame(0, 3, "a cone"),
        long,
        steps(2, 7, 15),
        steps(2, 7, 1),
    ];
    let recall = assembled(items, &mut texts, &mut documents);
    let kinds = recall.items[..recall.items_len as usize].iter().map(|item| item.kind);
    let expected = [ItemKind::Steps, ItemKind::Trajectory, ItemKind::Frame, ItemKind::Trajectory]
        .into_iter()
        .chain([ItemKind::Steps, ItemKind::Trajectory])
        .map(|kind| kind as u8);
    assert_eq!(kinds.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "48 steps fit");
    assert_eq!(recall.steps_len, 48);
    let places = |item: RecalledItem| (item.first_step, item.steps, item.whole, item.document);
    assert_eq!(places(recall.items[1]), (0, 15, 1, 2));
    assert_eq!(places(recall.items[2]), (32, 1, 0, 1));
    assert_eq!(places(recall.items[3]), (15, 33, 0, 2));
    assert_eq!(places(recall.items[5]), (48, 1, 0, 2));
    assert_eq!(documents.published.len(), 2, "a note and the steps of all trajectories");
    assert_eq!(documents.published[0].1, Content::Note("Find a cone.a cone".to_owned()));
    let instructions = recall.items[..6].iter().map(|i| (i.first_instruction, i.instructions));
    let expected = [(0, 1), (1, 2), (3, 1), (4, 1), (5, 1), (6, 1)];
    assert_eq!(instructions.collect::<Vec<_>>(), expected, "one for each demonstration");
    let one = RecalledInstruction { document: 1, first_byte: 0, bytes: 12 };
    assert_eq!(recall.instructions[..recall.instructions_len as usize], [one; 7]);
    let Content::Trajectories(steps) = &documents.published[1].1 else { panic!() };
    assert!(steps.is_sorted_by_key(|step| step.trajectory) && steps.len() == 49);
    let shown = steps[..15].iter().filter(|step| step.frame != NO_FRAME).count();
    assert_eq!((shown, steps[9].action, steps[14].action), (2, NO_ACTION, NO_ACTION));
    let items = recall.sources[..recall.sources_len as usize].iter().map(|source| source.item);
    assert_eq!(items.collect::<Vec<_>>(), [0, 1, 1, 2, 3, 4, 5]);
}

#[test]
fn a_text_is_published_once_in_an_episode() {
    let (mut texts, mut documents) = (PublishedTexts::default(), TestDocuments::default());
    let known =
        documents.consolidated(domain::DocumentKind::Summary, domain::Demonstrations::ALL).unwrap();
    let items = vec![
        MemoryItem::text("a cone"),
        MemoryItem::text("a bärrel"),
        MemoryItem::text("a cone"),
        MemoryItem::Text { text: known, sources: Vec::new() },
    ];
    let first = assembled(items.clone(), &mut texts, &mut documents);
    let places = first.items[..4].iter().map(|i| (i.document, i.first_byte, i.bytes));
    let places = places.collect::<Vec<_>>();
    assert_eq!(places, [(2, 0, 6), (2, 6, 9), (2, 0, 6), (1, 0, 12)]);
    let again = items[1..].iter().cloned().chain([frame(0, 0, "a cone"), frame(0, 0, "new")]);
    let second = assembled(again.collect(), &mut texts, &mut documents);
    let places = second.items[..5].iter().map(|i| (i.document, i.first_byte));
    assert_eq!(places.collect::<Vec<_>>(), [(2, 6), (2, 0), (1, 0), (2, 0), (3, 12)]);
    assert_eq!(documents.published[1].1, Content::Note("a conea bärrel".to_owned()));
    assert_eq!(documents.published[2].1, Content::Note("Find a cone.new".to_owned()));
    let third = assembled(vec![frame(0, 1, ""), steps(1, 0, 2)], &mut texts, &mut documents);
    assert_eq!(third.items[0].document, NO_DOCUMENT, "an empty caption is in no document");
    for recall in [second, third] {
        let one = RecalledInstruction { document: 3, first_byte: 0, bytes: 12 };
        assert_eq!(recall.instructions[..2], [one; 2]);
    }
    assert_eq!(documents.published.len(), 3);
}

fn item() -> impl Strategy<Value = MemoryItem> {
    let source = || {
        (0..4_u32, prop_oneof![0..70_u32, any::<u32>()], prop_oneof![0..70_u32, any::<u32>()])
            .prop_map(|(demonstration, first, count)| source(demonstration, first, count))
    };
    let views = prop_oneof![
        Just(Views::None),
        Just(Views::All),
        prop::collection::btree_set(0..70_u32, 0..9)
            .prop_map(|steps| Views::Keyframes(steps.into_iter().collect())),
    ];
    let distance = || prop_oneof![Just(None), any::<f32>().prop_map(Some)];
    prop_oneof![
        ("[a-zäö]{0,90}", prop::collection::vec(source(), 0..4))
            .prop_map(|(text, sources)| MemoryItem::Text { text: text.into(), sources }),
        (source(), views, any::<bool>(), distance()).prop_map(
            |(source, views, actions, distance)| {
                MemoryItem::Steps { source, views, actions, distance }
            }
        ),
        prop::collection::vec(
            prop_oneof![
                source().prop_map(PlanPart::Steps),
                (0..8_u8).prop_map(|code| PlanPart::Own(ActionCode(code))),
            ],
            0..4
        )
        .prop_map(|parts| MemoryItem::Plan { parts }),
        (source(), "[a-z]{0,9}", distance()).prop_map(|(source, caption, distance)| {
            let Source { demonstration, first: step, .. } = source;
            MemoryItem::Frame { demonstration, step, caption: caption.into(), distance }
        }),
    ]
}

proptest! {
    /// Whatever a memory answers is refused, or keeps within the budgets and the message.
    #[test]
    fn every_answer_is_refused_or_fits(
        items in prop::collection::vec(item(), 0..10),
        (images, text) in (0..150_u32, 0..200_u32),
    ) {
        let bank = bank();
        let budgets = Budgets { images, text };
        let Ok(answer) = CheckedAnswer::new(items, &bank, &warehouse::declaration(), budgets) else {
            return Ok(());
        };
        prop_assert!(answer.supplied.images <= images && answer.supplied.text <= text);
        prop_assert!(answer.supplied.items <= answer.asked.items);
        let (mut texts, mut documents) = (PublishedTexts::default(), TestDocuments::default());
        let (texts, documents) = (&mut texts, &mut documents);
        let mut assembler = Assembler { bank: &bank, episode: (1, 7), texts, documents };
        let recall = assembler.assemble(&answer, |_| Some(5)).unwrap();
        let shown = recall.steps[..recall.steps_len as usize].iter().map(|step| step.frame);
        let in_document = documents.published.iter().filter_map(|(_, content)| match content {
            Content::Trajectories(steps) => Some(steps),
            _ => None,
        });
        let in_document = in_document.flatten().map(|step| step.frame);
        let shown = shown.chain(in_document).filter(|&frame| frame != NO_FRAME).count();
        prop_assert_eq!(shown, answer.supplied.images as usize);
    }
}
