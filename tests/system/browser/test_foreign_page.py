"""A page of another site in Chromium makes every kind of request, and nothing comes of any."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import pytest
from tests.system.browser.asks import Ask, asks
from tests.system.browser.foreign_page import Watched, browser
from tests.system.browser.trials import TRIALS, daemon, try_page, try_program

pytestmark = pytest.mark.slow

Daemons = Callable[[str], Watched]


@pytest.fixture(scope="module")
def program() -> str:
    found = browser()
    if found is None:
        pytest.skip("no Chromium: on Debian, apt install chromium")
    return found


@pytest.fixture(scope="module")
def daemons(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemons]:
    with ExitStack() as stack:

        @cache
        def started(auth: str) -> Watched:
            folder = tmp_path_factory.mktemp("daemon") / auth
            return stack.enter_context(daemon(folder, auth))

        yield started


@pytest.mark.thorough
@pytest.mark.parametrize("name", TRIALS)
def test_no_page_of_another_site_drives_the_daemon(
    program: str, daemons: Daemons, tmp_path: Path, name: str
) -> None:
    trial = TRIALS[name]
    result = try_page(program, tmp_path, trial, asks(), daemons(trial.auth))
    assert list(result.learned) == list(asks())
    assert result.acted == []
    # The requests did come to the daemon, and the page's site is why nothing came of them. What a
    # picture, a script, a frame, a link or 'fetch' reads without Sec-Fetch-Site is let in, unread.
    assert set(result.refused) <= {"cross_site", "host_refused"}
    unread = 5 if name == "no Sec-Fetch-Site" else 0
    assert len(result.refused) >= len(asks()) - unread


def test_a_link_leads_to_the_page_of_the_daemon_and_a_frame_does_not(
    program: str, daemons: Daemons, tmp_path: Path
) -> None:
    trial = TRIALS["another site"]
    for way, refused in (("window", []), ("frame", ["cross_site"])):
        ask = Ask(way, "GET", "/")
        # What a link opens is the page, in a window of its own: nobody else reads it.
        opened = [ask.name] if way == "window" else []
        result = try_page(program, tmp_path / way, trial, {ask.name: ask}, daemons(trial.auth))
        assert result.acted == opened
        assert result.refused == refused


@pytest.mark.thorough
@pytest.mark.parametrize("auth", ["none", "tokens"])
def test_the_same_requests_of_a_program_do_what_they_say(daemons: Daemons, auth: str) -> None:
    assert len(asks()) == 21
    assert try_program(asks(), daemons(auth)) == []
