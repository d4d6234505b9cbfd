"""What rows stand on: judgements, extents, tokens, and how a siege goes on."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from tests.siege import run
from tests.siege.client import PATIENCE, Address, Reply
from tests.siege.daemon import Launcher
from tests.siege.damage import _flipped, _sample, _trials
from tests.siege.ground import (
    SHORT,
    Extent,
    Ground,
    Judgement,
    make_tokens,
    write_small_bundle,
)
from tests.siege.pages import page_requests
from tests.siege.run import Verdict, besiege, figures_of
from tests.siege.starving import p99

from veilcam_client.wire.tokens import SCOPES
from veilcam_server.errors import StartError
from veilcam_server.security.tokens import TokenStore
from veilcam_training.bundle import read_bundle


def test_a_judgement_names_what_missed_its_bar() -> None:
    judgement = Judgement()
    judgement.at_most("p99", 240, 250, " ms", beside="10 ms without", figure="p99_ms")
    judgement.at_least("captures", 99.5, 99, " %")
    judgement.holds("it starts", true=True)
    outcomes = [judgement.outcome]
    judgement.at_most("memory", 51, 50, " MB")
    judgement.at_least("answered", 98, 99)
    judgement.holds("it lives", true=False)
    assert [*outcomes, judgement.outcome] == ["passed", "failed"]
    assert judgement.missed == [
        "memory 51 MB (at most 50)",
        "answered 98 (at least 99)",
        "not so: it lives",
    ]
    assert judgement.found[0] == "p99 240 ms (10 ms without; at most 250)"
    assert judgement.figures == {"p99_ms": 240}


def test_a_row_that_was_not_tried_has_not_passed_but_one_that_failed_has_failed() -> None:
    judgement = Judgement(untried="no disk")
    outcomes = [judgement.outcome]
    judgement.holds("it starts", true=False)
    assert [*outcomes, judgement.outcome] == ["untried", "failed"]


def test_p99_counts_what_was_not_answered_as_the_longest_wait() -> None:
    replies = [Reply(200, seconds=0.001 * number) for number in range(1, 100)]
    assert p99([*replies, Reply(200, seconds=5.0)]) == pytest.approx(99.0)
    assert p99([*replies[1:], Reply(0), Reply(503)]) == 1000 * PATIENCE


def test_figures_are_the_worst_of_measures_and_the_sum_of_counts() -> None:
    verdicts = [
        Verdict("a", Judgement(figures={"siege_status_p99_ms": 7.0, "starts_refused": 1.0}), 0.0),
        Verdict("b", Judgement(figures={"siege_status_p99_ms": 5.0, "starts_refused": 2.0}), 0.0),
    ]
    assert figures_of(verdicts) == {"siege_status_p99_ms": 7.0, "starts_refused": 3.0}


def test_a_row_that_breaks_fails_and_the_next_is_run(monkeypatch: pytest.MonkeyPatch) -> None:
    async def breaks(_: Ground, __: Judgement) -> None:
        raise KeyError("state")

    async def refused(_: Ground, __: Judgement) -> None:
        raise StartError("no port")

    async def fine(ground: Ground, _: Judgement) -> None:
        ground.advance(0.5)

    monkeypatch.setattr(run, "ROWS", {"breaks": breaks, "refused": refused, "fine": fine})
    told: list[tuple[str, float]] = []
    rows = ("breaks", "refused", "fine")
    verdicts = list(besiege("none:serve", SHORT, rows, lambda *each: told.append(each)))
    assert [each.judgement.outcome for each in verdicts] == ["failed", "failed", "passed"]
    assert "KeyError" in verdicts[0].judgement.missed[0]
    assert "no port" in verdicts[1].judgement.missed[0]
    assert told[-1] == ("fine", 0.5)


def test_a_daemon_under_siege_wants_tokens_and_knows_those_made(tmp_path: Path) -> None:
    ground = Ground(Launcher("none:serve", tmp_path), SHORT)
    settings = ground.settings("row", heartbeat=2.0)
    assert (settings.auth, settings.heartbeat) == ("tokens", 2.0)
    assert settings.state_dir.is_relative_to(tmp_path / "row")
    made = make_tokens(settings, ("one", "two"))
    store = TokenStore(settings.state_dir)
    callers = [store.caller(f"Bearer {secret}") for secret in made]
    assert [caller.label for caller in callers] == ["one", "two"]
    assert all(caller.scopes == set(SCOPES) for caller in callers)


def test_small_bundles_of_two_tasks_are_two(tmp_path: Path) -> None:
    first = read_bundle(write_small_bundle(tmp_path / "1", "first"))
    second = read_bundle(write_small_bundle(tmp_path / "2", "second"))
    assert first.digest != second.digest
    assert (first.camera, first.embedding) == (second.camera, second.embedding)


def test_twenty_requests_of_a_page_each_tell_of_it() -> None:
    asked = page_requests(Address("127.0.0.1", 8787), b"bundle")
    assert len(asked) == 20
    assert all({"Origin", "Sec-Fetch-Site"} & set(request.page) for request in asked)
    assert not any({"Origin", "Sec-Fetch-Site"} & set(request.own) for request in asked)


def test_a_flip_changes_one_bit() -> None:
    content = bytes(range(100))
    flipped = _flipped(random.Random(1), content)
    changed = [a ^ b for a, b in zip(content, flipped, strict=True) if a != b]
    assert len(changed) == 1
    assert changed[0].bit_count() == 1
    assert _flipped(random.Random(1), b"") == b""


def test_each_file_is_damaged_alone_and_with_its_copy(tmp_path: Path) -> None:
    (tmp_path / "bundles").mkdir()
    for name in ("bundles/active", "bundles/active.copy", "audit"):
        (tmp_path / name).write_bytes(b"12345678")
    tried = [(trial.name.split()[-1], trial.paths) for trial in _trials(tmp_path, 2)]
    active, copy, audit = Path("bundles/active"), Path("bundles/active.copy"), Path("audit")
    for paths in ((active,), (copy,), (active, copy), (audit,)):
        assert [how for how, damaged in tried if damaged == paths] == [
            *("truncated", "emptied", "flipped", "flipped")
        ]
    assert tried[0] == ("damaged", ())
    assert len(tried) == 17


def test_a_sample_of_damage_begins_with_none(tmp_path: Path) -> None:
    (tmp_path / "state").write_bytes(b"12345678")
    trials = list(_trials(tmp_path, 20))
    few = _sample(trials, Extent(starts=5))
    assert few[0] == trials[0]
    assert len(few) == 5
    assert all(trial in trials for trial in few)
    assert len(_sample(trials, Extent())) == len(trials)
