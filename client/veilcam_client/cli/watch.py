"""``veilcam watch``: the camera looks by itself."""

from typing import Annotated

import typer

from veilcam_client.cli.format import activity_in_words, sure_in_words
from veilcam_client.cli.terminal import USAGE, Ask, asking, fail
from veilcam_client.wire.watch import (
    OnRequest,
    Watch,
    Watching,
    WatchOff,
    WatchPolicy,
    parse_hours,
    parse_rate,
)


@asking()
def watch(
    ask: Ask,
    *,
    rate: Annotated[
        str | None, typer.Option(help="Look by itself so often: 2/s, 30/min or 6/h.")
    ] = None,
    on_request: Annotated[
        bool, typer.Option("--on-request", help="Look when somebody asks, and then alone.")
    ] = False,
    off: Annotated[
        bool, typer.Option("--off", help="Do not look: the panel is opaque until told otherwise.")
    ] = False,
    quiet_hours: Annotated[
        str | None,
        typer.Option(help="With --rate or --on-request: the panel is opaque then, as in 22-7."),
    ] = None,
) -> None:
    """Show the belief of the camera about the scene, or say when it looks by itself."""
    if sum((off, on_request, rate is not None)) > 1:
        fail("give one of --rate, --on-request and --off", USAGE)
    if quiet_hours is not None and rate is None and not on_request:
        fail("--quiet-hours goes with --rate or --on-request", USAGE)
    policy: WatchPolicy | None = None
    try:
        quiet = None if quiet_hours is None else parse_hours(quiet_hours)
        if off:
            policy = WatchOff()
        elif on_request:
            policy = OnRequest(quiet=quiet)
        elif rate is not None:
            policy = Watching(rate_hz=parse_rate(rate), quiet=quiet)
    except ValueError as error:
        fail(str(error), USAGE)
    ask(
        lambda camera: camera.watch.get() if policy is None else camera.watch.set(policy),
        watch_in_words,
    )


def watch_in_words(found: Watch) -> str:
    """Print the policy, the belief and the sightings of the camera, a line each."""
    lines = [activity_in_words(found.policy, found.activity, found.detail)]
    if found.belief is not None:
        label = "nothing" if found.belief.label is None else found.belief.label
        sure = sure_in_words(found.belief.confidence)
        lines.append(f"now  {label}{sure}  for {found.belief.duration_s:.1f} s")
    lines += [
        f"{each.seen_at:%Y-%m-%d %H:%M:%S}  {each.label}{sure_in_words(each.confidence)}"
        f"  {each.duration_s:.1f} s{'' if each.gone_at else ', and still there'}"
        for each in found.history
    ]
    return "\n".join(lines)
