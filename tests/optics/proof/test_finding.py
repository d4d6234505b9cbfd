"""What scores come to."""

from __future__ import annotations

from veilcam_optics.proof.finding import (
    AGAINST,
    AROUND,
    BARE,
    CLEAR,
    CLEAR_OF_INVERTED,
    FOR,
    OPEN,
    Alternative,
    Finding,
    Rival,
    judged,
)


def _judged(score: float, *rivals: Rival, unevenness: float = 1.0) -> Finding:
    return judged(score, rivals, unevenness=unevenness, departure=0.5, light=2.0)


def _rival(score: float, behind: float, name: Alternative = "before") -> Rival:
    return Rival(name, score, behind)


def test_a_mask_is_seen_where_it_scores_and_is_clear_of_its_rivals() -> None:
    assert _judged(FOR, _rival(0, CLEAR)).verdict == "seen"
    assert _judged(FOR - 0.1, _rival(-9, CLEAR)).verdict == "undecided"
    assert _judged(FOR, _rival(0, CLEAR - 0.1)).verdict == "undecided"
    assert _judged(9, _rival(0, 9), _rival(8.9, 0.1, "inverted")).verdict == "undecided"


def test_a_mask_is_seen_where_it_is_further_ahead_of_its_inversion() -> None:
    clear, close = CLEAR_OF_INVERTED, CLEAR_OF_INVERTED - 0.1
    assert _judged(9, _rival(0, 9), _rival(3, clear, "inverted")).verdict == "seen"
    assert _judged(9, _rival(0, 9), _rival(3, close, "inverted")).verdict == "undecided"
    # Also where another rival is nearer.
    assert _judged(9, _rival(0, CLEAR), _rival(3, close, "inverted")).verdict == "undecided"


def test_a_rival_is_convicted_where_it_scores_and_is_well_ahead() -> None:
    assert _judged(0, _rival(AGAINST, -4)).verdict == "not seen"
    assert _judged(0, _rival(AGAINST - 0.1, -4)).verdict == "undecided"


def test_a_rival_that_may_be_ahead_by_a_camera_s_errors_is_not_convicted() -> None:
    assert _judged(9, _rival(9.1, -CLEAR)).verdict == "not seen"
    assert _judged(9, _rival(12, -CLEAR + 0.1)).verdict == "undecided"


def test_an_open_window_needs_less() -> None:
    assert _judged(0, _rival(OPEN, -3, "transparent")).verdict == "not seen"
    assert _judged(0, _rival(OPEN, -3)).verdict == "undecided"
    # Of an open window more is asked than of a mask.
    assert _judged(0, _rival(OPEN, -2, "transparent")).verdict == "undecided"
    assert _judged(0, _rival(AGAINST, -2)).verdict == "not seen"
    assert _judged(0, _rival(OPEN - 0.1, -3, "transparent")).verdict == "undecided"


def test_light_that_no_window_leaves_convicts_unless_the_mask_is_there() -> None:
    even = BARE - 0.01
    found = _judged(AGAINST - 0.1, _rival(0, 14), unevenness=even)
    assert (found.verdict, found.nearest) == ("not seen", "transparent")
    assert found.margin < 0
    assert _judged(0, _rival(0, 0), unevenness=BARE).verdict == "undecided"
    assert _judged(AGAINST, _rival(0, 14), unevenness=even).verdict == "undecided"


def test_in_such_light_a_mask_is_not_there_that_is_not_clear_of_its_inversion() -> None:
    for behind, verdict in (
        (CLEAR_OF_INVERTED, "undecided"),
        (CLEAR_OF_INVERTED - 0.1, "not seen"),
    ):
        inverted = _rival(9, behind, "inverted")
        assert _judged(9, _rival(0, 9), inverted, unevenness=BARE - 0.01).verdict == verdict


def test_light_that_may_pass_around_the_window_leaves_no_mask_seen() -> None:
    assert _judged(20, _rival(0, 14), unevenness=AROUND).verdict == "seen"
    assert _judged(20, _rival(0, 14), unevenness=AROUND - 0.01).verdict == "undecided"


def test_an_inverted_panel_lets_light_pass_around_the_window() -> None:
    ahead = _rival(FOR, -0.1, "inverted")
    assert _judged(FOR - 0.1, ahead, unevenness=AROUND - 0.01).verdict == "not seen"
    for rival, unevenness in (
        (ahead, AROUND),
        (_rival(FOR - 0.1, -0.1, "inverted"), BARE),
        (_rival(FOR, 0.0, "inverted"), BARE),
        (_rival(FOR, -0.1), BARE),
    ):
        assert _judged(FOR - 0.1, rival, unevenness=unevenness).verdict == "undecided"


def test_the_nearest_is_the_one_that_is_least_behind() -> None:
    found = _judged(9, _rival(1, 5.0), _rival(3, 4.0, "inverted"), _rival(0, 6.0, "transparent"))
    assert (found.nearest, found.margin) == ("inverted", 4.0)
    assert (found.departure, found.light) == (0.5, 2.0)
