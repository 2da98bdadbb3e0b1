use domain::Action::{self, Backward, Forward, Left, Right, TurnAround, TurnLeft, TurnRight};
use proptest::prelude::*;

use super::*;

/// What models write, by the action that it means.
const FORMS: [(Action, &[&str]); 7] = [
    (
        Forward,
        &[
            "forward",
            "Forward.",
            "straight",
            "ahead",
            "go forward",
            "go straight",
            "go straight ahead",
            "keep going straight",
            "move ahead",
            "move one cell forward",
            "move forward by 1 cell",
            "move forward 3 cells",
            "move the robot forward",
            "take a step forward",
            "step forward",
            "walk forwards",
            "continue forward",
            "continue moving forward",
            "proceed straight",
            "advance forward",
            "The best next move is forward.",
            "Step 3: move forward",
            "I will move forward to the left aisle.",
        ],
    ),
    (
        Backward,
        &[
            "backward",
            "backwards",
            "move back",
            "move backwards",
            "step back",
            "back up",
            "go backward",
            "move one cell back",
            "take two steps back",
        ],
    ),
    (
        Left,
        &[
            "strafe left",
            "step left",
            "step to the left",
            "sidestep left",
            "slide left",
            "move to the left",
            "move to my left",
            "move one cell to the left",
            "shift to the left side",
        ],
    ),
    (
        Right,
        &[
            "strafe right",
            "step right",
            "sidestep to the right",
            "move to the right",
            "move one cell right",
            "move rightward",
        ],
    ),
    (
        TurnLeft,
        &[
            "rotate left",
            "turn to the left",
            "left turn",
            "make a left turn",
            "make a left",
            "take a left",
            "turn 90 degrees left",
            "turn left 90°",
            "turn left by 90 degrees",
            "rotate 90 degrees to the left",
            "rotate 90° counter-clockwise",
            "turn counterclockwise",
            "turn anticlockwise",
            "quarter turn to the left",
            "spin left",
            "pivot to your left",
            "turn: left",
            "I will turn left to face the rack on my left.",
        ],
    ),
    (
        TurnRight,
        &[
            "rotate right",
            "turn rightwards",
            "right turn",
            "make a right turn",
            "turn clockwise",
            "rotate by 90 degrees clockwise",
            "a 90 degree right turn",
            "turn right at the corner",
        ],
    ),
    (
        TurnAround,
        &[
            "u-turn",
            "U turn",
            "make a U-turn",
            "do a uturn",
            "about-face",
            "turn back",
            "turn all the way around",
            "turn completely around",
            "half turn",
            "rotate 180 degrees",
            "turn 180",
            "turn left 180 degrees",
            "make a 180 degree turn",
            "180° turn",
            "spin around",
        ],
    ),
];

/// Every form of every action, the plain words in many spellings among them.
fn forms() -> Vec<(Action, String)> {
    let listed = FORMS
        .iter()
        .flat_map(|&(action, forms)| forms.iter().map(move |form| (action, (*form).to_owned())));
    let spelled = Action::ALL.into_iter().flat_map(|action| {
        let words = action.words();
        let [first, second] = words.split(' ').collect::<Vec<_>>()[..] else { panic!("{words}") };
        let capital = |word: &str| word[..1].to_uppercase() + &word[1..];
        [
            words.to_owned(),
            words.to_uppercase(),
            format!("{}.", capital(words)),
            format!("{first}_{second}"),
            format!("{first}-{second}").to_uppercase(),
            format!("{first}{second}"),
            format!("{first}{}", capital(second)),
            format!("{}{}", capital(first), capital(second)),
            format!("**{words}**"),
            format!("`{first}_{second}`"),
            format!("\"{words}\""),
            format!("  {words}!\n\n"),
            format!("- {words}"),
            format!("\\boxed{{{words}}}"),
            format!("<answer>{words}</answer>"),
            format!("I will {words}."),
            format!("I'll {words} now"),
            format!("The robot should {words}."),
            format!("Next, I {first}s {second}."),
            format!("My next action is to {words}"),
            format!("Action: {words}"),
            format!("**Action:** {words}"),
            format!("Final answer: {words}."),
            format!("Answer = {first}_{second}"),
            format!("next_action: {first}_{second}"),
            format!("{{\"action\": \"{first}_{second}\"}}"),
            format!("```json\n{{\n  \"action\": \"{words}\"\n}}\n```"),
            format!(
                "{{\"thought\": \"I could move left or turn right\", \"action\": \"{words}\"}}"
            ),
            format!("{{\"nextAction\": \"{words}\", \"reason\": \"turn left is blocked\"}}"),
            format!("{{\"action\": \"{first}\", \"direction\": \"{second}\"}}"),
            format!("[\"{words}\"]"),
            format!("<think>\n\n</think>\n\n{words}"),
            format!("<think>turn left? no, turn right</think>{words}"),
            format!("{words}<think></think>"),
            format!("{words}</think>"),
            format!("so move left</think>\n{words}"),
            format!("{words}<think>but"),
            format!("I cannot reach it from here, so I {words}."),
            format!("The rack on my left has it. {}.", capital(words)),
            format!("The last action was move left. Now {words}."),
            format!("Should I turn right? No. {words}"),
            format!("I moved forward and turned left. Action: {words}"),
            format!("Turn left or move forward?\nAnswer: {words}"),
            format!("{words}, {words}, {words}"),
        ]
        .map(|text| (action, text))
    });
    listed.chain(spelled).collect()
}

#[test]
fn every_action_is_read_in_every_form() {
    for (action, text) in forms() {
        assert_eq!(read_answer(&text), Ok(action), "{text:?}");
    }
    for (letter, action) in [("f", Forward), ("F.", Forward), ("b", Backward), ("U", TurnAround)] {
        assert_eq!(read_answer(letter), Ok(action));
    }
}

#[test]
fn what_cannot_be_read_says_why() {
    let told: Vec<_> = [
        "",
        " \n",
        "\u{feff}",
        "<think></think>",
        "<think>I see a rack",
        "...",
        "42",
        "The barrel is blue.",
        "I am at the blue barrel.",
        "north",
        "turn",
        "turn north",
        "Stop.",
        "I moved forward.",
        "{\"action\": null}",
        "{\"action\": \"\"}",
        "left",
        "Right.",
        "l",
        "R",
        "go left",
        "walk to the right",
        "Next move: left",
        "{\"move\": \"left\"}",
        "move to the left rack",
        "take the left aisle",
        "back",
        "go back",
        "reverse",
        "rotate 90 degrees",
        "turn 45 degrees left",
        "move straight to the left",
        "turn left 2 times",
        "turn slightly left",
        "turn around the corner",
        "turn left or right",
        "turn left/right",
        "move forward and left",
        "move forward, then turn left",
        "turn left, move forward",
        "Left, then move forward.",
        "Either is fine: turn left. turn right.",
        "move forward\nturn left",
        "move forward|turn around",
        "move forward, move backward, move left, move right, turn left, turn right, turn around",
        "Action: move forward\nFeedback: You moved.\nAction: turn left",
        "Action: turn left. Then move forward.",
        "{\"action\": [\"move forward\", \"turn left\"]}",
        "{\"action\": \"move forward\", \"action\": \"turn left\"}",
        "turn left 90 degrees, then 180 degrees",
        "do not move forward",
        "I can't turn left.",
        "Moving forward is not possible.",
        "Turning left would be a mistake",
        "Should I turn left?",
        "maybe turn left",
        "I could move forward",
        "If the way is free, move forward, else turn left",
        "if possible move forward",
        "either turn left or turn right",
        "anything except turn left",
        "I'm sorry, but I can't assist with that.",
        "As an AI, I cannot see images.",
        "I refuse.",
        "I'm sorry, I cannot move forward.",
    ]
    .iter()
    .map(|text| match read_answer(text) {
        Ok(action) => panic!("{text:?} is {action:?}"),
        Err(why) => format!("{text:?}: {why}"),
    })
    .collect();
    insta::assert_snapshot!(told.join("\n"));
}

#[test]
fn a_sentence_around_an_action_is_no_other_action() {
    for (text, action) in [
        ("Do not turn left. Move forward.", Forward),
        ("Turn left, not right.", TurnLeft),
        ("Turn left instead of moving forward.", TurnLeft),
        ("Instead of left, turn right? Answer: turn right", TurnRight),
        ("The barrel is on the left, so I turn left.", TurnLeft),
        ("The path ahead is blocked, turn around.", TurnAround),
        ("There is a rack to my right and the aisle is clear. move forward", Forward),
        ("I can see the label \"blue barrel\" on the right side; turn right", TurnRight),
        ("go left: turn left", TurnLeft),
        ("turn right around", TurnAround),
        ("turn right now", TurnRight),
        ("turn left right now", TurnLeft),
        ("Maybe turn left. No, move forward.", Forward),
        ("I turned left before. Now I go straight", Forward),
        ("move forward because turning left would be wrong", Forward),
    ] {
        assert_eq!(read_answer(text), Ok(action), "{text:?}");
    }
}

#[test]
fn a_text_that_was_cut_off_has_to_begin_with_its_answer() {
    use Unread::{CutOff, Empty};
    for (text, expected) in [
        ("turn left\n\nThe barrel is on the le", Ok(TurnLeft)),
        ("Turn left. I see a blue barrel at the end of the", Ok(TurnLeft)),
        ("I see.\nAction: turn left.\nThis is bec", Ok(TurnLeft)),
        ("turn left", Err(CutOff)),
        ("Turn left or", Err(CutOff)),
        ("Turn left. Then move forward. Then", Err(CutOff)),
        ("I see a barrel. I will turn left. The", Err(CutOff)),
        ("The image shows a warehouse with", Err(CutOff)),
        ("I could move forward. But", Err(CutOff)),
        ("<think>I should turn left.\n", Err(CutOff)),
        ("", Err(Empty)),
        ("\n", Err(Empty)),
    ] {
        assert_eq!(read_cut_off(text), expected, "{text:?}");
    }
}

#[test]
fn two_different_actions_are_never_read_as_one() {
    let forms = forms();
    // Those without marker, JSON and doubts, which are about what stands beside them.
    let about_others =
        |text: &str| text.contains([':', '=', '{', '<', '?']) || text.contains("cannot");
    let plain: Vec<_> =
        forms.iter().filter(|(_, text)| !about_others(text) && !text.contains("last")).collect();
    assert!(plain.len() > 150);
    for (one, first) in &plain {
        for (other, second) in plain.iter().filter(|(other, _)| other != one) {
            for joint in [" ", " or ", " and ", ", ", ", then ", "\n", "/", ". ", " -> ", " & "] {
                // "rotate left" and "half turn" make another turn when nothing parts them.
                let angle = ["half", "quarter", "90", "180"]
                    .iter()
                    .any(|by| first.contains(by) || second.contains(by));
                if joint == " " && angle {
                    continue;
                }
                let text = format!("{first}{joint}{second}");
                assert!(read_answer(&text).is_err(), "{text:?}: {one:?} and {other:?}");
            }
        }
    }
}

fn vocabulary() -> impl Strategy<Value = String> {
    let words: Vec<&str> = [
        &words::TURN[..],
        &words::MOVE,
        &words::GO,
        &words::TAKE,
        &words::FILLING,
        &words::DOUBTING,
        &words::DENYING_AFTER,
        &words::DEGREES,
        &words::DESCRIBING_AFTER,
        &words::AFTER_ADVERB,
        &["left", "right", "forward", "back", "around", "straight", "90", "180", "45", "half", "u"],
        &[",", ".", "?", "\n", ":", "/", "{", "}", "\"", "action", "<think>", "</think>", "°"],
    ]
    .concat();
    let word = proptest::sample::select(words);
    proptest::collection::vec(word, 0..14).prop_map(|words| words.join(" "))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn nothing_makes_it_panic(text in any::<String>(), words in vocabulary()) {
        for text in [&text, &words] {
            drop((read_answer(text), read_cut_off(text)));
        }
    }

    #[test]
    fn what_is_read_of_a_text_that_was_cut_off_is_read_of_all_of_it(words in vocabulary()) {
        if let Ok(action) = read_cut_off(&words) {
            prop_assert_eq!(read_answer(&words), Ok(action));
        }
    }

    #[test]
    fn junk_never_turns_one_action_into_another(
        form in proptest::sample::select(forms()),
        // Without digits, which can make another angle of an angle, without letters that are answers, and
        // without what can make a tag of half a tag.
        junk in "[^0-9fFbBuU<>]{1,12}",
        at in any::<proptest::sample::Index>(),
    ) {
        let (action, mut text) = form;
        let places: Vec<usize> = text.char_indices().map(|(at, _)| at).chain([text.len()]).collect();
        text.insert_str(*at.get(&places), &junk);
        if let Ok(read) = read_answer(&text) {
            prop_assert_eq!(read, action, "{:?}", text);
        }
    }
}
