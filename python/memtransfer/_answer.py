"""The action in what a model writes: the rules of `policy-proc/src/prompt/answer`, which says why each is.

1. Reasoning between `<think>` and `</think>` is no part of the answer.
2. A JSON object that has a field `action` (or another word of `ANNOUNCING`) means what this field says. Else a
   marker (`Action:`) rules out what stands before the first one.
3. In what is left, every phrase that names an action counts, unless it is denied, doubted, or part of a
   question. A word that could be part of a description ("on the left") does not count; a direction that
   stands by itself ("left") stands for every action it could mean.
4. There is an action when all that counts agrees on exactly one. Nothing is ever guessed.
5. A text that was cut off has to say it in its first whole line or sentence.

A test puts the same texts to both.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

from memtransfer import _answer_words as words_
from memtransfer._wire import Action, Outcome

ANNOUNCING = ("action", "answer", "decision", "choice", "command", "response", "output")
"""Words that announce the answer, before a colon or as the last word of a field's name (`next_action`)."""

_REASONING = (("<think>", "</think>"), ("<thinking>", "</thinking>"))
_JOINTS = frozenset(
    "but so therefore thus hence because since while where until however as for which that".split()
)
_COLON, _SLASH = ":", "/"
_INVISIBLE = frozenset("\u200b\u200c\u200d\u2060\ufeff\u00ad")
_APOSTROPHES = frozenset("'’ʼ")
_FULL_STOPS = frozenset(".!。！…\n\r")
_COMMAS = frozenset(",;()>→&+–—，；、")
_LONGEST = 9
_STRAIGHT_TO = ("to", "the", "my", "your")

_Actions = frozenset[Action]
_NONE: _Actions = frozenset()
_ALL: _Actions = frozenset(Action)
_TURN_AROUND: _Actions = frozenset({Action.TURN_AROUND})
_LEFTWARD: _Actions = frozenset({Action.LEFT, Action.TURN_LEFT})
_RIGHTWARD: _Actions = frozenset({Action.RIGHT, Action.TURN_RIGHT})
_BACK: _Actions = frozenset({Action.BACKWARD, Action.TURN_AROUND})
_SIDEWAYS_TURN: _Actions = frozenset({Action.TURN_LEFT, Action.TURN_RIGHT})
_IN_ONE_WORD = {
    "uturn": Action.TURN_AROUND,
    **{action.words.replace(" ", ""): action for action in Action},
}

_Words = list[str]
_Found = tuple[int, _Actions]
"""Where a phrase ends, and what it can mean: nothing, if it is something that cannot be done."""


def read_answer(text: str, cut_off: bool = False) -> Action | Outcome:
    """The one action that an answer names, or why there is none: EMPTY, REFUSED or UNREADABLE.

    `cut_off`: the answer is the beginning of one that ran out of tokens.
    """
    answer = _without_reasoning(text)
    if answer is None:
        return Outcome.UNREADABLE
    if cut_off:
        return _read_cut_off(answer)
    value = _field(answer)
    if value is not None:
        return _read(value, _sentences(value))
    return _read(answer, _after_marker(_sentences(answer)))


def _read_cut_off(text: str) -> Action | Outcome:
    if not text.strip():
        return Outcome.EMPTY
    sentences = _after_marker(_sentences(text))
    if not sentences or not sentences[0].ended:
        return Outcome.UNREADABLE
    alone, within = _read(text, sentences[:1]), _read(text, sentences)
    both = isinstance(alone, Action) and isinstance(within, Action)
    return within if both else Outcome.UNREADABLE


def _read(text: str, sentences: list[_Sentence]) -> Action | Outcome:
    """The action in `sentences`, which are those of `text` that count."""
    if not text.strip():
        return Outcome.EMPTY
    flat = [word for sentence in sentences for clause in sentence.clauses for word in clause]
    if len(flat) == 1:
        letters = {"f": Action.FORWARD, "b": Action.BACKWARD, "u": Action.TURN_AROUND}
        if flat[0] in letters:
            return letters[flat[0]]
        if flat[0] in ("l", "r"):
            return Outcome.UNREADABLE
    mentions = _mentions(sentences)
    counted = [actions for actions, doubted in mentions if not doubted]
    if counted:
        common = _ALL.intersection(*counted)
        return next(iter(common)) if len(common) == 1 else Outcome.UNREADABLE
    refused = _is_refusal(flat, doubts_some=bool(mentions))
    return Outcome.REFUSED if refused else Outcome.UNREADABLE


def _is_refusal(flat: _Words, doubts_some: bool) -> bool:
    if "sorry" in flat and not doubts_some:
        return True
    text = f" {' '.join(flat)} "
    return any(f" {refusing} " in text for refusing in words_.REFUSING)


# What of a text is the answer.


def _without_reasoning(text: str) -> str | None:
    """`text` without reasoning; `None` when there is nothing but the beginning of some."""
    for begin, end in _REASONING:
        while (start := _find(text, begin)) >= 0:
            length = _find(text[start:], end)
            if length < 0:
                break
            text = text[:start] + "\n" + text[start + length + len(end) :]
        # One that was begun before the answer, by the server's template, or only mentioned at its end.
        while (at := _find(text, end)) >= 0:
            before, after = text[:at], text[at + len(end) :]
            text = after if after.strip() else before
        if (at := _find(text, begin)) >= 0:
            text = text[:at]
            if not text.strip():
                return None
    return text


def _find(text: str, what: str) -> int:
    # Small letters of ASCII alone keep every position.
    return text.translate(_ASCII_LOWER).find(what)


_ASCII_LOWER = {letter: letter + 32 for letter in range(ord("A"), ord("Z") + 1)}


class _Fields(dict[str, Any]):
    """A JSON object that knows every field, each as often as it stands there."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self.pairs = pairs


def _no_number(name: str) -> Any:
    raise ValueError(f"{name} is no JSON")


def _field(text: str) -> str | None:
    """What the JSON object in `text` says in the field that announces the answer; `None` without one."""
    start, end = text.find("{"), text.rfind("}")
    if start < 0 or end < start:
        return None
    try:
        found = json.loads(
            text[start : end + 1], object_pairs_hook=_Fields, parse_constant=_no_number
        )
    except (ValueError, RecursionError):
        return None
    announced = [value for name, value in found.pairs if _announces(name)]
    if not announced:
        return None
    values = "\n".join(value if isinstance(value, str) else _as_json(value) for value in announced)
    directions = [
        value
        for name, value in found.pairs
        if isinstance(value, str) and name.translate(_ASCII_LOWER) == "direction"
    ]
    # {"action": "move", "direction": "left"}
    return f"{values} {directions[0]}" if len(announced) == 1 and directions else values


def _as_json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _announces(name: str) -> bool:
    sentences = _sentences(name)
    return bool(sentences) and sentences[-1].clauses[-1][-1] in ANNOUNCING


def _after_marker(sentences: list[_Sentence]) -> list[_Sentence]:
    """What follows the first marker, where something does; all of it without one."""
    for s, sentence in enumerate(sentences):
        for c, clause in enumerate(sentence.clauses):
            for at, (word, next) in enumerate(zip(clause, clause[1:])):
                if word in ANNOUNCING and next == _COLON:
                    rest = [clause[at + 2 :], *sentence.clauses[c + 1 :]]
                    first = _Sentence([it for it in rest if it], sentence.asks, sentence.ended)
                    return [it for it in (first, *sentences[s + 1 :]) if it.clauses]
    return sentences


# A text as sentences, clauses and words, whatever it is written in: markdown, `snake_case`, `CamelCase`.


@dataclass
class _Sentence:
    """A sentence or a line: clauses of words in small letters. Colon and slash are words of their own."""

    clauses: list[_Words]
    asks: bool
    """It ends in a question mark."""
    ended: bool
    """Something ended it: a full stop, a new line. Without, the text ended."""


@dataclass
class _Reader:
    sentences: list[_Sentence] = field(default_factory=list)
    clauses: list[_Words] = field(default_factory=list)
    clause: _Words = field(default_factory=list)
    word: str = ""

    def sign(self, sign: str, before: str) -> None:
        if sign in _INVISIBLE:
            return
        if sign in _APOSTROPHES:
            self.word += "'"
        elif sign in "°º":
            self.end_word()
            self.clause.append("degrees")
        elif sign.isalnum():
            # A new word begins in `moveForward` and `90degrees`.
            if (before.islower() and sign.isupper()) or (before in "0123456789" and sign.isalpha()):
                self.end_word()
            self.word += sign.lower()
        elif sign in _FULL_STOPS:
            self.end_sentence(False, True)
        elif sign in "?？":
            self.end_sentence(True, True)
        elif sign in _COMMAS:
            self.end_clause()
        elif sign in ":：=":
            self.end_word()
            self.clause.append(_COLON)
        elif sign in "/|":
            self.end_word()
            self.clause.append(_SLASH)
        else:
            self.end_word()

    def end_word(self) -> None:
        word, self.word = self.word.strip("'"), ""
        if not word:
            return
        if word in _JOINTS:
            self.end_clause()
        self.clause.append(word)

    def end_clause(self) -> None:
        self.end_word()
        if self.clause:
            self.clauses.append(self.clause)
            self.clause = []

    def end_sentence(self, asks: bool, ended: bool) -> None:
        self.end_clause()
        if self.clauses:
            self.sentences.append(_Sentence(self.clauses, asks, ended))
            self.clauses = []


def _sentences(text: str) -> list[_Sentence]:
    """The sentences of `text`. One without a word is left out."""
    reader = _Reader()
    before = " "
    for sign in text:
        reader.sign(sign, before)
        before = sign
    reader.end_sentence(False, False)
    return reader.sentences


# The phrases of a text that name actions.


def _mentions(sentences: list[_Sentence]) -> list[tuple[_Actions, bool]]:
    """What every phrase can mean, in order, and whether it is denied, in doubt, or part of a question."""
    found = []
    for sentence in sentences:
        for words in sentence.clauses:
            doubted = sentence.asks or any(
                word in words_.DOUBTING or word.endswith("n't") for word in words
            )
            denying = (at for at, word in enumerate(words) if word in words_.DENYING_AFTER)
            denied_from = next(denying, len(words))
            at = before = 0
            while at < len(words):
                phrase = _phrase(words, before, at)
                if phrase is None:
                    at += 1
                    continue
                found.append((phrase[1], doubted or denied_from < at))
                at = before = phrase[0]
    return found


def _word(words: _Words, at: int) -> str:
    return words[at] if at < len(words) else ""


_WAYS = {
    **dict.fromkeys(("forward", "forwards", "ahead", "straight"), "forward"),
    **dict.fromkeys(("backward", "backwards"), "backward"),
    "back": "back",
    **dict.fromkeys(("left", "leftward", "leftwards"), "left"),
    **dict.fromkeys(("right", "rightward", "rightwards"), "right"),
    "clockwise": "clockwise",
    **dict.fromkeys(("counterclockwise", "anticlockwise"), "anticlockwise"),
    **dict.fromkeys(("around", "round"), "around"),
}


def _way(words: _Words, at: int) -> tuple[int, str] | None:
    """The way that `words[at]` tells, and how many words that takes. "back" is less clear than "backward"."""
    word, next = _word(words, at), _word(words, at + 1)
    if word == "back" and next in ("ward", "wards", "up"):
        return 2, "backward"
    if word in ("counter", "anti") and next == "clockwise":
        return 2, "anticlockwise"
    return (1, _WAYS[word]) if word in _WAYS else None


def _phrase(words: _Words, before: int, at: int) -> _Found | None:
    """The phrase that begins at `at`, after one that ended at `before`."""
    word, next = words[at], _word(words, at + 1)
    if word in _IN_ONE_WORD:
        return at + 1, frozenset({_IN_ONE_WORD[word]})
    if (word, next) in (("u", "turn"), ("about", "face"), ("about", "turn")):
        return at + 2, _TURN_AROUND
    if word == "reverse":
        return at + 1, _BACK
    if word in words_.DEGREES:
        # By how many is not understood.
        return at + 1, _NONE
    if word in words_.TURN:
        return _turn(words, at + 1, True)
    # "left turn", "90 degrees to the right", "half turn".
    angle = _angle(words, at)
    if (angle is not None and angle[0] > at + 1) or (
        word in ("left", "right") and next in words_.A_TURN
    ):
        return _turn(words, at, False)
    if word in words_.TAKE:
        return _take(words, at + 1)
    if word in words_.MOVE or word in words_.GO:
        return _moved(words, at, word in words_.MOVE)
    return _bare(words, before, at)


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit()


def _angle(words: _Words, at: int) -> tuple[int, int] | None:
    """An angle: its end, and how many degrees. An unusual number is one only with its unit."""
    word, next = _word(words, at), _word(words, at + 1)
    if word in ("quarter", "half"):
        degrees = 90 if word == "quarter" else 180
        return (at + 2, degrees) if next in words_.A_TURN else None
    if not _is_number(word) or int(word) >= 1 << 32:
        return None
    unit = next in words_.DEGREES
    usual = int(word) in (45, 90, 180, 270, 360)
    return (at + 1 + unit, int(word)) if unit or usual else None


def _turn(words: _Words, start: int, verb_first: bool) -> _Found | None:
    """What a turn leads to, if it says: its verb stands before `start`, or follows ("left turn")."""
    has_verb, unclear = verb_first, False
    at, end = start, -1
    to: str | None = None
    by: int | None = None
    while at < min(len(words), start + _LONGEST):
        if has_verb and not verb_first and by == 180:
            # A half turn is the same both ways.
            break
        angle, way = _angle(words, at), _way(words, at)
        if angle is not None and by is None:
            at, by = angle
            end = at
            # "half turn"
            has_verb |= words[at - 1] in words_.A_TURN
        elif way is not None and (to is None or way[1] == "around"):
            # "turn right around" is clear, "left turn all the way around" is not.
            unclear |= to is not None and not (end == at and verb_first)
            to = way[1]
            at += way[0]
            end = at
        elif words[at] in words_.A_TURN and not has_verb:
            has_verb = True
            at += 1
            end = at
        elif words[at] in words_.FILLING or words[at] in _ALL_THE_WAY:
            at += 1
        else:
            break
    if end < 0:
        return None
    next = _word(words, end)
    if unclear or next[:1].isnumeric():
        # "turn left 2 times": by how much is not understood.
        return end, _NONE
    place = next in ("the", "a", "an", "this", "that", "corner")
    can_be = _NONE
    if to is None:
        can_be = _SIDEWAYS_TURN | _TURN_AROUND
    elif to in ("left", "anticlockwise"):
        can_be = frozenset({Action.TURN_LEFT})
    elif to in ("right", "clockwise"):
        can_be = frozenset({Action.TURN_RIGHT})
    elif to in ("back", "backward") or (to == "around" and not place):
        # Not "turn around the corner".
        can_be = _TURN_AROUND
    if by is None:
        return end, can_be
    if by == 90:
        return end, can_be & _SIDEWAYS_TURN
    # Half a turn ends in the same heading both ways round.
    return end, _TURN_AROUND if by == 180 and can_be else _NONE


_ALL_THE_WAY = (_COLON, "all", "way", "fully", "completely", "full")


def _take(words: _Words, start: int) -> _Found | None:
    """ "make a left": what stands after the verb. "take the left aisle" is none of the actions."""
    at = start + (_word(words, start) in ("a", "the"))
    turns = {"left": Action.TURN_LEFT, "right": Action.TURN_RIGHT}
    if _word(words, at) not in turns:
        return None
    next = _word(words, at + 1)
    if next in ("", "at", "here", "now", "and", "then", "into"):
        return at + 1, frozenset({turns[words[at]]})
    if next in words_.A_TURN:
        return _turn(words, at, False)
    return at + 1, _NONE


def _moved(words: _Words, verb: int, keeps_heading: bool) -> _Found | None:
    """What a move leads to whose verb is `words[verb]`, if it says. With `keeps_heading` "left" is the move."""
    at, points = verb + 1, False
    found: tuple[int, str] | None = None
    while at < min(len(words), verb + _LONGEST):
        word, way = words[at], _way(words, at)
        if way is not None:
            if way[1] == "around":
                break
            at += way[0]
            found = at, way[1]
            if word == "straight":
                filled = 0
                while _word(words, at + filled) in _STRAIGHT_TO:
                    filled += 1
                further = _way(words, at + filled)
                if further is not None and further[1] == "forward":
                    found = at + filled + further[0], way[1]
                elif further is not None:
                    # "straight to the left"
                    return at + filled + 1, _NONE
            break
        if word in (_COLON, "is", "should", "be", "would"):
            # In "next move: left" and "the move is left" the verb is none.
            keeps_heading = False
        elif word in words_.POINTING:
            points = True
        elif not (word in words_.FILLING or _is_number(word)):
            break
        at += 1
    if found is None:
        return None
    end, to = found
    place = points and end < len(words) and words[end] not in words_.NO_PLACE
    if place and keeps_heading:
        # "move to the left rack"
        return end, _NONE
    if to == "back":
        return end, frozenset({Action.BACKWARD}) if keeps_heading else _BACK
    if to in ("left", "right") and keeps_heading:
        return end, frozenset({Action.LEFT if to == "left" else Action.RIGHT})
    return end, _DIRECTIONS.get(to, _NONE)


_DIRECTIONS: dict[str, _Actions] = {
    "forward": frozenset({Action.FORWARD}),
    "backward": frozenset({Action.BACKWARD}),
    "back": _BACK,
    "left": _LEFTWARD,
    "right": _RIGHTWARD,
}


def _bare(words: _Words, before: int, at: int) -> _Found | None:
    """A direction without a verb, unless it tells where something is."""
    way = _way(words, at)
    if way is None:
        return None
    end = at + way[0]
    after = _word(words, end)
    described = at > before and words[at - 1] in words_.DESCRIBING_BEFORE
    if (
        described
        or after in words_.DESCRIBING_AFTER
        or (words[at] == "right" and after in words_.AFTER_ADVERB)
        # It is a preposition more often than not.
        or way[1] == "around"
    ):
        return None
    # "clockwise" is of a turn that was not understood.
    return end, _DIRECTIONS.get(way[1], _NONE)
