"""The words that name actions, and those that take them back: as in `policy-proc/src/prompt/answer/words.rs`."""

TURN = frozenset(
    """
    turn turns turning rotate rotates rotating rotation spin spins spinning pivot pivots pivoting
    swivel swivels swiveling
    """.split()
)
"""Verbs of turning in place."""

A_TURN = frozenset(
    """
    turn rotation
    """.split()
)
""" "left turn"."""

MOVE = frozenset(
    """
    move moves moving step steps stepping strafe strafes strafing sidestep sidesteps slide slides
    sliding shift shifts shifting sidestepping translate
    """.split()
)
"""Verbs of moving that keep the heading: with "left" they mean the sideways move."""

GO = frozenset(
    """
    go goes going walk walks walking head heads heading proceed proceeds proceeding continue
    continues continuing advance drive travel keep
    """.split()
)
"""Verbs of moving that say nothing of the heading: "go left" may be a move or a turn."""

TAKE = frozenset(
    """
    take takes taking make makes making
    """.split()
)
""" "make a left"."""

FILLING = frozenset(
    """
    to the my your its by a an of in on place spot robot agent it myself yourself itself one 1
    single exactly cell cells square squares tile tiles space spaces unit units meter meters metre
    metres m step steps further directly quarter
    """.split()
)
"""Words between a verb and its direction that change nothing."""

POINTING = frozenset(
    """
    the my your its
    """.split()
)
"""Words that make what follows a place and not a way: "to the left", but "to the left rack"."""

NO_PLACE = frozenset(
    """
    side by one 1 and or then now again here to in once direction at twice hand first step cell next
    /
    """.split()
)
"""What may follow "to the left" without making it a place."""

DEGREES = frozenset(
    """
    degrees degree deg
    """.split()
)
"""Units of an angle."""

DESCRIBING_BEFORE = frozenset(
    """
    on the my your its to at from of in is are was were far that's face facing faces faced look
    looking looks lies stands way come comes path aisle corridor clear free open further immediately
    moved turned
    """.split()
)
"""Before a direction: it tells where something is."""

DESCRIBING_AFTER = frozenset(
    """
    side of rack racks shelf shelves aisle corridor wall hand is are has shows
    """.split()
)
"""After a direction, likewise."""

AFTER_ADVERB = frozenset(
    """
    now away after before here there in into next
    """.split()
)
"""After "right": it is no direction ("right now")."""

DOUBTING = frozenset(
    """
    not cannot dont cant wont isnt shouldnt never no none nor neither unable impossible blocked
    blocks blocking wrong mistake bad incorrect useless pointless fail fails failed if unless
    whether could might maybe perhaps possibly last previous previously already earlier prevent
    prevents refuse stop hardly worse
    """.split()
)
"""Words that take back, or leave open, all that their clause says."""

DENYING_AFTER = frozenset(
    """
    instead rather without avoid avoiding avoids except
    """.split()
)
"""Words that take back what follows them in their clause."""

REFUSING = tuple(
    " ".join(phrase.split())
    for phrase in """
    can't help; cannot help; can't assist; cannot assist; unable to help; unable to assist; unable
    to comply; unable to answer; unable to process; can't comply; cannot comply; can't answer;
    cannot answer; can't provide; cannot provide; can't view images; cannot view images; can't see
    images; cannot see images; can't process images; cannot process images; as an ai; as a language
    model; i refuse; i decline
    """.split(";")
)
"""What a refusal says. "Sorry" alone is one only beside no action at all."""
