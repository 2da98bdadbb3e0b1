//! The words that name actions, and those that take them back.

/// Verbs of turning in place.
pub(super) const TURN: [&str; 16] = [
    "turn",
    "turns",
    "turning",
    "rotate",
    "rotates",
    "rotating",
    "rotation",
    "spin",
    "spins",
    "spinning",
    "pivot",
    "pivots",
    "pivoting",
    "swivel",
    "swivels",
    "swiveling",
];

/// "left turn".
pub(super) const A_TURN: [&str; 2] = ["turn", "rotation"];

/// Verbs of moving that keep the heading: with "left" they mean the sideways move.
pub(super) const MOVE: [&str; 19] = [
    "move",
    "moves",
    "moving",
    "step",
    "steps",
    "stepping",
    "strafe",
    "strafes",
    "strafing",
    "sidestep",
    "sidesteps",
    "slide",
    "slides",
    "sliding",
    "shift",
    "shifts",
    "shifting",
    "sidestepping",
    "translate",
];

/// Verbs of moving that say nothing of the heading: "go left" may be a move or a turn.
pub(super) const GO: [&str; 19] = [
    "go",
    "goes",
    "going",
    "walk",
    "walks",
    "walking",
    "head",
    "heads",
    "heading",
    "proceed",
    "proceeds",
    "proceeding",
    "continue",
    "continues",
    "continuing",
    "advance",
    "drive",
    "travel",
    "keep",
];

/// "make a left".
pub(super) const TAKE: [&str; 6] = ["take", "takes", "taking", "make", "makes", "making"];

/// Words between a verb and its direction that change nothing.
pub(super) const FILLING: [&str; 43] = [
    "to", "the", "my", "your", "its", "by", "a", "an", "of", "in", "on", "place", "spot", "robot",
    "agent", "it", "myself", "yourself", "itself", "one", "1", "single", "exactly", "cell",
    "cells", "square", "squares", "tile", "tiles", "space", "spaces", "unit", "units", "meter",
    "meters", "metre", "metres", "m", "step", "steps", "further", "directly", "quarter",
];

/// Words that make what follows a place and not a way: "to the left", but "to the left rack".
pub(super) const POINTING: [&str; 4] = ["the", "my", "your", "its"];

/// What may follow "to the left" without making it a place.
pub(super) const NO_PLACE: [&str; 22] = [
    "side",
    "by",
    "one",
    "1",
    "and",
    "or",
    "then",
    "now",
    "again",
    "here",
    "to",
    "in",
    "once",
    "direction",
    "at",
    "twice",
    "hand",
    "first",
    "step",
    "cell",
    "next",
    "/",
];

/// Units of an angle.
pub(super) const DEGREES: [&str; 3] = ["degrees", "degree", "deg"];

/// Before a direction: it tells where something is.
pub(super) const DESCRIBING_BEFORE: [&str; 38] = [
    "on",
    "the",
    "my",
    "your",
    "its",
    "to",
    "at",
    "from",
    "of",
    "in",
    "is",
    "are",
    "was",
    "were",
    "far",
    "that's",
    "face",
    "facing",
    "faces",
    "faced",
    "look",
    "looking",
    "looks",
    "lies",
    "stands",
    "way",
    "come",
    "comes",
    "path",
    "aisle",
    "corridor",
    "clear",
    "free",
    "open",
    "further",
    "immediately",
    "moved",
    "turned",
];

/// After a direction, likewise.
pub(super) const DESCRIBING_AFTER: [&str; 14] = [
    "side", "of", "rack", "racks", "shelf", "shelves", "aisle", "corridor", "wall", "hand", "is",
    "are", "has", "shows",
];

/// After "right": it is no direction ("right now").
pub(super) const AFTER_ADVERB: [&str; 9] =
    ["now", "away", "after", "before", "here", "there", "in", "into", "next"];

/// Words that take back, or leave open, all that their clause says.
pub(super) const DOUBTING: [&str; 45] = [
    "not",
    "cannot",
    "dont",
    "cant",
    "wont",
    "isnt",
    "shouldnt",
    "never",
    "no",
    "none",
    "nor",
    "neither",
    "unable",
    "impossible",
    "blocked",
    "blocks",
    "blocking",
    "wrong",
    "mistake",
    "bad",
    "incorrect",
    "useless",
    "pointless",
    "fail",
    "fails",
    "failed",
    "if",
    "unless",
    "whether",
    "could",
    "might",
    "maybe",
    "perhaps",
    "possibly",
    "last",
    "previous",
    "previously",
    "already",
    "earlier",
    "prevent",
    "prevents",
    "refuse",
    "stop",
    "hardly",
    "worse",
];

/// Words that take back what follows them in their clause.
pub(super) const DENYING_AFTER: [&str; 7] =
    ["instead", "rather", "without", "avoid", "avoiding", "avoids", "except"];

/// What a refusal says. "Sorry" alone is one only beside no action at all.
pub(super) const REFUSING: [&str; 25] = [
    "can't help",
    "cannot help",
    "can't assist",
    "cannot assist",
    "unable to help",
    "unable to assist",
    "unable to comply",
    "unable to answer",
    "unable to process",
    "can't comply",
    "cannot comply",
    "can't answer",
    "cannot answer",
    "can't provide",
    "cannot provide",
    "can't view images",
    "cannot view images",
    "can't see images",
    "cannot see images",
    "can't process images",
    "cannot process images",
    "as an ai",
    "as a language model",
    "i refuse",
    "i decline",
];
