"""All checks, in the order in which one would put right what they find."""

from __future__ import annotations

import re
import stat
from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from veilcam_server.devices.driver import DisplayDriver
from veilcam_server.devices.registry import drivers
from veilcam_server.doctor.finding import Finding, halves
from veilcam_server.doctor.hardware import (
    check_answers,
    check_camera,
    check_clock_of_bus,
    check_frame_memory,
    check_lines,
    check_model,
    check_need,
    check_package,
    check_release,
    check_spi,
)
from veilcam_server.doctor.machine import Machine
from veilcam_server.environment import PREFIX, unknown_names
from veilcam_server.errors import BundleRefusedError, StartError
from veilcam_server.settings import Settings
from veilcam_server.system.state_folder import require_readable
from veilcam_server.wiring import DoctorSettings, Wiring

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle

LEAST_SYSTEMD = 248
"""The first that keeps a service from running what it wrote (``NoExecPaths=``)."""
LEAST_ROOM = 200 * 2**20
"""On the disk of the state directory [bytes]."""


Probe = tuple[str, Callable[[], Iterable[Finding]]]


def examine(machine: Machine, settings: DoctorSettings) -> Iterator[Finding]:
    """Yield a finding for every check; nothing is changed, and no mask is shown.

    Raises:
        DeviceMissingError: there is no driver for the panel or the sensor of the settings.
    """
    display, sensor = drivers(settings)
    # Once: a compiled package that failed may do worse when it is imported again.
    packages = {
        name: check_package(machine, name) for name in (*display.packages, *sensor.packages)
    }
    usable = {name for name, finding in packages.items() if finding.outcome == "ok"}
    probes: tuple[Probe, ...] = (
        ("board", lambda: [check_model(machine)]),
        ("release", lambda: check_release(machine)),
        ("packages", packages.values),
        *_panel_bus(machine, settings, display, usable),
        (
            "panel",
            lambda: [check_need(settings, name, what) for name, what in display.needs.items()],
        ),
        ("panel answers", lambda: check_answers(settings, display, usable)),
        ("frame memory", lambda: [check_frame_memory(machine)]),
        ("camera", lambda: [check_camera(machine, settings, sensor, usable)]),
        ("environment", lambda: [_environment()]),
        ("state directory", lambda: [_state_dir(machine, settings.state_dir)]),
        ("disk", lambda: [_room(machine, settings.state_dir)]),
        ("bundle", lambda: _bundle(settings)),
        ("wall clock", lambda: [_wall_clock(machine, settings)]),
        ("systemd", lambda: [_systemd(machine)]),
    )
    for name, probe in probes:
        yield from _guarded(name, probe)


def examine_beside(machine: Machine, settings: Settings) -> Iterator[Finding]:
    """Yield a finding for every check that needs neither panel nor camera: a daemon holds them.

    What is named of the machine's own paths is the setting: who may ask a daemon how it is need not
    know where its files are.

    Args:
        machine: machine of the daemon.
        settings: settings of the daemon.
    """
    told = DoctorSettings(**{name: getattr(settings, name) for name in DoctorSettings.model_fields})
    real: tuple[Probe, ...] = (
        ("board", lambda: [check_model(machine)]),
        ("release", lambda: check_release(machine)),
        ("frame memory", lambda: [check_frame_memory(machine)]),
        ("wall clock", lambda: [_wall_clock(machine, told)]),
        ("systemd", lambda: [_systemd(machine)]),
    )
    recorded = settings.replay is not None
    probes: tuple[Probe, ...] = (
        ("environment", lambda: [_environment()]),
        ("state directory", lambda: [_state_dir(machine, told.state_dir)]),
        ("disk", lambda: [_room(machine, told.state_dir)]),
        *(() if recorded else (("bundle", lambda: _bundle(told)),)),
        *(real if settings.device == "pi" and not recorded else ()),
    )
    for name, probe in probes:
        for finding in _guarded(name, probe):
            yield _without_paths(finding, told)


def _without_paths(finding: Finding, settings: DoctorSettings) -> Finding:
    paths = {
        str(value): f"${PREFIX}{name.upper()}"
        for name in DoctorSettings.model_fields
        if isinstance(value := getattr(settings, name), Path) and name not in Wiring.model_fields
    }

    def told(text: str) -> str:
        # One may lie in another.
        for path in sorted(paths, key=len, reverse=True):
            text = text.replace(path, paths[path])
        return text

    remedy = None if finding.remedy is None else told(finding.remedy)
    return replace(finding, found=told(finding.found), remedy=remedy)


def _panel_bus(
    machine: Machine, wiring: Wiring, display: DisplayDriver, usable: Set[str]
) -> tuple[Probe, ...]:
    """For a panel on SPI and two lines."""
    fastest = display.fastest
    if fastest is None:
        return ()
    return (
        ("panel bus", lambda: [check_spi(machine, wiring)]),
        ("bus clock", lambda: [check_clock_of_bus(wiring, fastest)]),
        ("GPIO chip", lambda: check_lines(machine, wiring, usable)),
    )


def _guarded(name: str, probe: Callable[[], Iterable[Finding]]) -> list[Finding]:
    """Run a probe; one that fails, as the drivers' libraries may, keeps back no other."""
    try:
        return list(probe())
    except Exception as error:
        found = " ".join(f"{type(error).__name__}: {error}".split())
        remedy = "put right what the error names"
        return [Finding(name, "bad", f"the check failed, {found}", remedy)]


def _environment() -> Finding:
    unknown = unknown_names(Settings.model_fields)
    if not unknown:
        return Finding("environment", "ok", "every VEILCAM_... is known")
    found = f"{', '.join(unknown)}: no setting"
    return Finding("environment", "bad", found, " ".join(unknown.values()))


def _state_dir(machine: Machine, directory: Path) -> Finding:
    name, path = "state directory", machine.path(directory)
    if not path.exists():
        if machine.may_write(_nearest(path)):
            return Finding(name, "ok", f"{directory}, made at the first start")
        remedy = f"sudo install -d -m 700 -o $USER {directory}, or give another --state-dir"
        return Finding(name, "bad", f"there is no {directory}, and you may not make it", remedy)
    if not (path.is_dir() and machine.may_write(path)):
        remedy = f"sudo chown -R $USER: {directory}, or give another --state-dir"
        return Finding(name, "bad", f"{directory} cannot be written", remedy)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        found = f"{directory}: others may look ({mode:04o})"
        return Finding(name, "bad", found, f"chmod 700 {directory}")
    try:
        require_readable(path)
    except StartError as error:
        return Finding(name, "bad", *halves(error))
    return Finding(name, "ok", str(directory))


def _room(machine: Machine, directory: Path) -> Finding:
    free = machine.free(_nearest(machine.path(directory)))
    found = f"{free / 2**20:,.0f} MiB free"
    if free < LEAST_ROOM:
        return Finding("disk", "bad", found, "make room: without it no change is made")
    return Finding("disk", "ok", found)


def _bundle(settings: DoctorSettings) -> Iterator[Finding]:
    if settings.bundle is None:
        yield Finding("bundle", "bad", "none named", "give --bundle, or VEILCAM_BUNDLE")
        yield _without_bundle()
        return
    # Late: without a bundle nobody need wait for torch.
    from veilcam_training.bundle import BundleError, read_bundle  # noqa: PLC0415

    try:
        bundle = read_bundle(settings.bundle)
    except BundleError as error:
        found, remedy = halves(error, settings.bundle)
        yield Finding("bundle", "bad", f"{settings.bundle}: {found}", remedy)
        yield _without_bundle()
        return
    yield Finding("bundle", "ok", f"{settings.bundle}: {bundle.task}, {bundle.mode}")
    yield _owner(settings, bundle)


def _without_bundle() -> Finding:
    return Finding("owner", "skipped", "needs the bundle")


def _owner(settings: DoctorSettings, bundle: Bundle) -> Finding:
    from veilcam_server.bundles.owners import Owners  # noqa: PLC0415 - late, as above

    try:
        Owners.open(settings.owner_keys).check(bundle)
    except (StartError, BundleRefusedError) as error:
        return Finding("owner", "bad", *halves(error))
    if bundle.owner is None:
        return Finding("owner", "ok", "any: no --owner-keys are given")
    return Finding("owner", "ok", f"version {bundle.version}, signed by {bundle.owner.short}")


def _wall_clock(machine: Machine, wiring: Wiring) -> Finding:
    clock = machine.clock()
    found = f"{clock.zone}, {'' if clock.synchronised else 'not '}synchronised"
    if clock.synchronised or wiring.trust_clock:
        return Finding("wall clock", "ok", found)
    return Finding(
        "wall clock",
        "bad",
        found,
        "sudo timedatectl set-ntp true, or --trust-clock where it is right without; captures are "
        "dated by it, tokens end by it, and quiet hours go by it",
    )


def _systemd(machine: Machine) -> Finding:
    told = re.match(r"systemd (\d+)", machine.run("systemctl", "--version") or "")
    if told is None:
        remedy = "use a system with systemd, or start the daemon by other means"
        return Finding("systemd", "bad", "not there", remedy)
    if int(told[1]) < LEAST_SYSTEMD:
        return Finding("systemd", "bad", told[1], f"update the system: {LEAST_SYSTEMD} or later")
    return Finding("systemd", "ok", told[1])


def _nearest(path: Path) -> Path:
    """Return the path, or the nearest directory above it that exists."""
    while not path.exists():
        path = path.parent
    return path
