"""Rows of faults around a daemon: its disk, its log, the clock, camera and panel."""

from __future__ import annotations

import asyncio
from pathlib import Path

from tests.siege.daemon import FORKS, Circumstances, Daemon, NoDiskError, fill
from tests.siege.ground import (
    Ground,
    Judgement,
    epochs,
    goes_on,
    is_ready,
    make_tokens,
    standing_still,
)

from veilcam_server.errors import StartError

ROOM = 2 << 20  # [bytes]
BACK = 90.0
"""Longest way back to ``ready`` once a cause is gone [s]: growing pauses end at a minute."""
FAULTS = "/v1/simulation/faults"
YEAR = 365 * 86_400.0


async def full_disk(ground: Ground, judgement: Judgement, *, at_start: bool) -> None:
    settings = ground.settings(f"full-disk-{at_start}")
    [token] = make_tokens(settings, ("owner",))
    # It has been there before: what a first start needs is made.
    with ground.start(settings):
        pass
    files = [path for path in settings.state_dir.parent.rglob("*") if path.is_file()]
    # Files take whole pages.
    size = ROOM + sum(path.stat().st_size // 4096 * 4096 + 8192 for path in files)
    refused = 0
    try:
        with ground.start(settings, token, Circumstances(disk=size, full=at_start)) as daemon:
            if not at_start:
                await goes_on(judgement, daemon.address, "before: ")
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
    settings = ground.settings("full-log")
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token, Circumstances(log=Path("/dev/full"))) as daemon:
        for _ in range(3):
            await goes_on(judgement, daemon.address)
        judgement.holds("it is ready", true=await is_ready(daemon.address, 1.0))


async def clock_back(ground: Ground, judgement: Judgement) -> None:
    settings = ground.settings("clock")
    [token] = make_tokens(settings, ("owner",))
    clock = FORKS.Value("d", 0.0)
    seen: list[str] = []
    for life, jump in enumerate((-YEAR, 0.0, -YEAR)):
        with ground.start(settings, token, Circumstances(clock=clock)) as daemon:
            for offset in (clock.value, jump):
                clock.value = offset
                when = f"life {life + 1}, clock {offset / YEAR:+.0f} years: "
                await goes_on(judgement, daemon.address, when)
                seen += await epochs(daemon.address, 3)
            judgement.holds(f"life {life + 1}: ready", true=await is_ready(daemon.address, BACK))
    again = len(seen) - len(set(seen))
    judgement.at_most(f"again of {len(seen)} epochs", again, 0, figure="epochs_repeated")


async def device_gone(ground: Ground, judgement: Judgement) -> None:
    settings = ground.settings("device-gone", scene_api=True)
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token) as daemon:
        for part in ("sensor", "panel"):
            broken = await daemon.address.ask("PUT", FAULTS, {part: {"gone": True}})
            judgement.holds(f"{part} unplugged ({broken.status})", true=broken.status == 200)
            await asyncio.sleep(ground.extent.gone)
            await _endure(judgement, daemon, f"while the {part} is gone", bearable=False)
            await daemon.address.ask("PUT", FAULTS, {})
            await _recovers(judgement, daemon)


async def _endure(judgement: Judgement, daemon: Daemon, when: str, *, bearable: bool) -> None:
    """Use a daemon in trouble: it may refuse, with a remedy, but not end, or say it is well."""
    for _ in range(5):
        await daemon.address.ask("POST", "/v1/classifications", {})
        await daemon.address.ask("POST", "/v1/rotation/advance")
        await asyncio.sleep(1.0)
    status = await daemon.address.ask("GET", "/v1/status")
    judgement.holds(f"status is answered {when} ({status.status})", true=status.status == 200)
    if status.status == 200:
        state, remedy = status.json()["state"], status.json().get("remedy")
        well = bearable and state == "ready" and not await standing_still(daemon.address)
        judgement.holds(f"{when}: {state}, remedy {remedy}", true=well or remedy is not None)


async def _recovers(judgement: Judgement, daemon: Daemon) -> None:
    judgement.holds("ready again without a person", true=await is_ready(daemon.address, BACK))
    await goes_on(judgement, daemon.address)
