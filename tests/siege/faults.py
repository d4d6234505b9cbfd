"""Rows of what fails around a daemon: its disk, its log, the clock, camera and panel."""

from __future__ import annotations

import asyncio
from pathlib import Path

from tests.siege.client import ask
from tests.siege.daemon import Circumstances, Daemon, NoDiskError, fill
from tests.siege.ground import (
    Ground,
    Judgement,
    epochs,
    is_ready,
    make_tokens,
    standing_still,
)

from veilcam_server.errors import StartError

ROOM = 2 << 20
"""Free on a disk of one's own before it is filled [bytes]."""
BACK = 90.0
"""Longest way back to ``ready`` once a cause is gone [s]: growing pauses end at a minute."""
FAULTS = "/v1/simulation/faults"
YEAR = 365 * 86_400.0


async def full_at_start(ground: Ground, judgement: Judgement) -> None:
    """A disk that is full, under the state and under the log, when the daemon starts."""
    await _full(ground, judgement, at_start=True)


async def full_later(ground: Ground, judgement: Judgement) -> None:
    """A disk that becomes full, under the state and under the log."""
    await _full(ground, judgement, at_start=False)


async def _full(ground: Ground, judgement: Judgement, *, at_start: bool) -> None:
    settings = ground.settings("full-disk")
    [token] = make_tokens(settings, ("owner",))
    # It has been there before: what a first start needs is made.
    with ground.start(settings):
        pass
    size = _size(settings.state_dir.parent) + ROOM
    refused = 0
    try:
        with ground.start(settings, token, Circumstances(disk=size, full=at_start)) as daemon:
            if not at_start:
                judgement.holds("lively before", true=not await standing_still(daemon.address))
                fill(daemon.state.parent)
            await _endure(judgement, daemon, "while the disk is full", bearable=True)
            (daemon.state.parent / "ballast").unlink()
            await _recovers(judgement, daemon)
    except NoDiskError as error:
        judgement.untried = str(error)
        return
    except StartError as error:
        judgement.holds(f"it starts: {error}", true=False)
        refused = 1
    judgement.figures |= {"state_faults_tried": 1, "starts_refused": refused}


async def full_log(ground: Ground, judgement: Judgement) -> None:
    """A log that takes nothing from the start on."""
    settings = ground.settings("full-log")
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token, Circumstances(log=Path("/dev/full"))) as daemon:
        for _ in range(3):
            still = await standing_still(daemon.address)
            judgement.holds(f"every task goes on {still or ''}", true=not still)
        judgement.holds("it is ready", true=await is_ready(daemon.address, 1.0))


async def clock_back(ground: Ground, judgement: Judgement) -> None:
    """A clock that is set back by a year while the daemon runs, and stands there at a start."""
    settings = ground.settings("clock")
    [token] = make_tokens(settings, ("owner",))
    clock = ground.launcher.clock()
    seen: list[str] = []
    for life, jump in enumerate((-YEAR, 0.0, -YEAR)):
        with ground.start(settings, token, Circumstances(clock=clock)) as daemon:
            for offset in (clock.value, jump):
                clock.value = offset
                still = await standing_still(daemon.address)
                where = f"life {life + 1}, clock {offset / YEAR:+.0f} years"
                judgement.holds(f"{where}: every task goes on {still or ''}", true=not still)
                seen += await epochs(daemon.address, 3)
            judgement.holds(f"life {life + 1}: ready", true=await is_ready(daemon.address, BACK))
    judgement.at_most(f"again of {len(seen)} epochs", len(seen) - len(set(seen)), 0)
    judgement.figures["epochs_repeated"] = len(seen) - len(set(seen))


async def device_gone(ground: Ground, judgement: Judgement) -> None:
    """Camera and panel that are unplugged for a while, one after the other."""
    settings = ground.settings("device-gone", scene_api=True)
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token) as daemon:
        for part in ("sensor", "panel"):
            broken = await ask(daemon.address, "PUT", FAULTS, body={part: {"gone": True}})
            judgement.holds(f"{part} unplugged ({broken.status})", true=broken.status == 200)
            await asyncio.sleep(ground.extent.gone)
            await _endure(judgement, daemon, f"while the {part} is gone", bearable=False)
            await ask(daemon.address, "PUT", FAULTS, body={})
            await _recovers(judgement, daemon)


async def _endure(judgement: Judgement, daemon: Daemon, when: str, *, bearable: bool) -> None:
    """Use a daemon in trouble: it may refuse, with a remedy, but not end, or say it is well.

    Where a trouble is ``bearable``, it may be well indeed.
    """
    for _ in range(5):
        await ask(daemon.address, "POST", "/v1/classifications", body={})
        await ask(daemon.address, "POST", "/v1/rotation/advance")
        await asyncio.sleep(1.0)
    status = await ask(daemon.address, "GET", "/v1/status")
    judgement.holds(f"status is answered {when} ({status.status})", true=status.status == 200)
    if status.status == 200:
        state, remedy = status.json()["state"], status.json().get("remedy")
        well = bearable and state == "ready" and not await standing_still(daemon.address)
        judgement.holds(f"{when}: {state}, remedy {remedy}", true=well or remedy is not None)


async def _recovers(judgement: Judgement, daemon: Daemon) -> None:
    """Whether a daemon is well again by itself."""
    judgement.holds("ready again without a person", true=await is_ready(daemon.address, BACK))
    still = await standing_still(daemon.address)
    judgement.holds(f"every task goes on {still or ''}", true=not still)


def _size(folder: Path) -> int:
    """Room that the files of a folder take on a disk of pages [bytes]."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return sum(path.stat().st_size // 4096 * 4096 + 8192 for path in files)
