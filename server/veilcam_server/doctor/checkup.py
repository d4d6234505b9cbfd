"""All checks, in the order in which one would put right what they find."""

from __future__ import annotations

import re
import stat
from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from veilcam_server.devices.driver import DisplayDriver, SensorDriver
from veilcam_server.devices.errors import DeviceError
from veilcam_server.devices.registry import drivers
from veilcam_server.devices.spi import GPIO_CHIPS
from veilcam_server.doctor.machine import Machine
from veilcam_server.errors import BundleRefusedError, StartError
from veilcam_server.settings import PREFIX, DoctorSettings, Settings, Wiring, unknown_names
from veilcam_server.system.state_folder import require_readable

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle

LEAST_SYSTEMD = 248
"""The first that keeps a service from running what it wrote (``NoExecPaths=``)."""
LEAST_ROOM = 200 * 2**20
"""On the disk of the state directory [bytes]."""


Outcome = Literal["ok", "bad", "skipped"]
"""All is well; the daemon cannot serve as it should; or something else must be well first."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of the doctor, and its remedy where something is wrong."""

    name: str
    outcome: Outcome
    found: str
    remedy: str | None = None


Probe = tuple[str, Callable[[], Iterable[Finding]]]


def examine(machine: Machine, settings: DoctorSettings) -> Iterator[Finding]:
    """Yield a finding for every check; nothing is changed, and no mask is shown.

    Raises:
        DeviceMissingError: there is no driver for the panel or the sensor of the settings.
    """
    display, sensor = drivers(settings)
    # Once: a compiled package that failed may do worse when it is imported again.
    packages = {name: _package(machine, name) for name in (*display.packages, *sensor.packages)}
    usable = {name for name, finding in packages.items() if finding.outcome == "ok"}
    probes: tuple[Probe, ...] = (
        ("board", lambda: [_model(machine)]),
        ("release", lambda: _release(machine)),
        ("packages", packages.values),
        *_panel_bus(machine, settings, display, usable),
        ("panel", lambda: [_needed(settings, name, what) for name, what in display.needs.items()]),
        ("panel answers", lambda: _answers(settings, display, usable)),
        ("frame memory", lambda: [_frame_memory(machine)]),
        ("camera", lambda: [_camera(machine, settings, sensor, usable)]),
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
        ("board", lambda: [_model(machine)]),
        ("release", lambda: _release(machine)),
        ("frame memory", lambda: [_frame_memory(machine)]),
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
        ("panel bus", lambda: [_spi(machine, wiring)]),
        ("bus clock", lambda: [_clock_of_bus(wiring, fastest)]),
        ("GPIO chip", lambda: _lines(machine, wiring, usable)),
    )


def _guarded(name: str, probe: Callable[[], Iterable[Finding]]) -> list[Finding]:
    """Run a probe; one that fails, as the drivers' libraries may, keeps back no other."""
    try:
        return list(probe())
    except Exception as error:
        found = " ".join(f"{type(error).__name__}: {error}".split())
        return [
            Finding(name, "bad", f"the check failed, {found}", "put right what the error names")
        ]


def _model(machine: Machine) -> Finding:
    model = machine.text("/proc/device-tree/model")
    if model is not None and model.startswith("Raspberry Pi"):
        return Finding("board", "ok", model)
    return Finding(
        "board",
        "bad",
        model or "no Raspberry Pi",
        "run the daemon on a Raspberry Pi, or try it here with 'veilcamd serve --simulate'",
    )


def _release(machine: Machine) -> Iterator[Finding]:
    """Return whether it came as a Debian package."""
    installed = machine.text("/usr/lib/veilcam/unpacked/RELEASE")
    if installed is None:
        return
    running = machine.path("/var/lib/veilcam-release/current").readlink().name
    if running == installed:
        yield Finding("release", "ok", running)
    else:
        yield Finding(
            "release",
            "bad",
            f"{installed} did not start, so {running} runs, which was there before",
            "see why with journalctl -u veilcamd, and install one that starts",
        )


def _package(machine: Machine, name: str) -> Finding:
    try:
        machine.load(name)
    except DeviceError as error:
        return Finding(name, "bad", *_halves(error))
    return Finding(name, "ok", "installed")


def _spi(machine: Machine, wiring: Wiring) -> Finding:
    node = machine.path(wiring.spi)
    if not node.exists():
        texts = (machine.text(f"/boot{folder}/config.txt") or "" for folder in ("/firmware", ""))
        on = any(re.search(r"^\s*dtparam=spi=on\s*$", text, re.MULTILINE) for text in texts)
        return Finding(
            "panel bus",
            "bad",
            f"there is no {wiring.spi}",
            "SPI is switched on in config.txt: restart, or give another --spi"
            if on
            else "sudo raspi-config nonint do_spi 0, then restart",
        )
    if not machine.may_write(node):
        return Finding("panel bus", "bad", f"{wiring.spi} is not yours to open", _join("spi"))
    return Finding("panel bus", "ok", str(wiring.spi))


def _clock_of_bus(wiring: Wiring, fastest: int) -> Finding:
    found = f"{wiring.spi_hz:,} Hz"
    if wiring.spi_hz > fastest and not wiring.allow_fast_spi:
        return Finding(
            "bus clock",
            "bad",
            f"{found}, too fast for the panel",
            f"give --spi-hz {fastest} or less, or --allow-fast-spi",
        )
    return Finding("bus clock", "ok", found)


def _needed(wiring: Wiring, name: str, what: str) -> Finding:
    """Check a setting without which the panel cannot be opened."""
    words, value = name.replace("_", " "), getattr(wiring, name)
    if value is None:
        option, variable = f"--{name.replace('_', '-')}", f"VEILCAM_{name.upper()}"
        return Finding(words, "bad", "not known", f"give {option} (or {variable}) {what}")
    return Finding(words, "ok", str(value))


def _lines(machine: Machine, wiring: Wiring, usable: Set[str]) -> Iterator[Finding]:
    lines = (("line of D/C", wiring.data_line), ("line of RESET", wiring.reset_line))
    names = ["GPIO chip", *(name for name, _ in lines)]
    if "gpiod" not in usable:
        yield from (Finding(name, "skipped", "needs gpiod") for name in names)
        return
    chips = machine.chips()
    wanted = GPIO_CHIPS if wiring.gpio_chip is None else (wiring.gpio_chip,)
    label = next((label for label in wanted if label in chips), None)
    if label is None:
        yield Finding(
            "GPIO chip",
            "bad",
            f"no {' or '.join(wanted)}; there is {', '.join(chips) or 'none that you may open'}",
            "give --gpio-chip the label of yours" if chips else _join("gpio"),
        )
        yield from (Finding(name, "skipped", "needs the GPIO chip") for name in names[1:])
        return
    yield Finding("GPIO chip", "ok", f"{label}, {chips[label]}")
    for name, line in lines:
        try:
            user = machine.line_user(chips[label], line)
        except DeviceError as error:
            yield Finding(name, "bad", *_halves(error))
            continue
        if user is None:
            yield Finding(name, "ok", f"{line}, free")
        else:
            yield Finding(
                name,
                "bad",
                f"{line}, used by {user}",
                "end what uses it (a running veilcamd, or an overlay in config.txt), or wire "
                "another line",
            )


def _answers(wiring: Wiring, display: DisplayDriver, usable: Set[str]) -> Iterator[Finding]:
    """Return whether the panel is asked after each mask."""
    name = "panel answers"
    if wiring.panel_read_back is None:
        return
    if display.identify is None:
        remedy = "leave out --panel-read-back"
        yield Finding(name, "bad", f"{display.name} cannot be asked", remedy)
    elif not set(display.packages) <= usable:
        yield Finding(name, "skipped", f"needs {' and '.join(display.packages)}")
    else:
        try:
            yield Finding(name, "ok", display.identify(wiring))
        except DeviceError as error:
            yield Finding(name, "bad", *_halves(error))


def _frame_memory(machine: Machine) -> Finding:
    heaps = sorted(machine.path("/dev/dma_heap").glob("*"))
    if not heaps:
        return Finding(
            "frame memory", "bad", "there is no /dev/dma_heap", "use a current Raspberry Pi OS"
        )
    if not any(machine.may_write(heap) for heap in heaps):
        return Finding("frame memory", "bad", "/dev/dma_heap is not yours to open", _join("video"))
    return Finding("frame memory", "ok", "/dev/dma_heap")


def _camera(machine: Machine, wiring: Wiring, sensor: SensorDriver, usable: Set[str]) -> Finding:
    if not set(sensor.packages) <= usable:
        return Finding("camera", "skipped", f"needs {' and '.join(sensor.packages)}")
    try:
        camera = machine.open_camera(wiring.camera_number)
    except DeviceError as error:
        return Finding("camera", "bad", *_halves(error))
    try:
        model = str(camera.camera_properties.get("Model", "unknown"))
    finally:
        camera.close()
    if sensor.model not in model:
        return Finding("camera", "bad", model, f"connect {sensor.product}")
    return Finding("camera", "ok", f"{model}, number {wiring.camera_number}")


def _environment() -> Finding:
    unknown = unknown_names()
    if not unknown:
        return Finding("environment", "ok", "every VEILCAM_... is known")
    found = f"{', '.join(unknown)}: no setting"
    return Finding("environment", "bad", found, " ".join(unknown.values()))


def _state_dir(machine: Machine, directory: Path) -> Finding:
    path = machine.path(directory)
    if not path.exists():
        if machine.may_write(_nearest(path)):
            return Finding("state directory", "ok", f"{directory}, made at the first start")
        return Finding(
            "state directory",
            "bad",
            f"there is no {directory}, and you may not make it",
            f"sudo install -d -m 700 -o $USER {directory}, or give another --state-dir",
        )
    if not (path.is_dir() and machine.may_write(path)):
        return Finding(
            "state directory",
            "bad",
            f"{directory} cannot be written",
            f"sudo chown -R $USER: {directory}, or give another --state-dir",
        )
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        return Finding(
            "state directory",
            "bad",
            f"{directory}: others may look ({mode:04o})",
            f"chmod 700 {directory}",
        )
    try:
        require_readable(path)
    except StartError as error:
        return Finding("state directory", "bad", *_halves(error))
    return Finding("state directory", "ok", str(directory))


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
        found, remedy = _halves(error, settings.bundle)
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
        return Finding("owner", "bad", *_halves(error))
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
        return Finding(
            "systemd",
            "bad",
            "not there",
            "use a system with systemd, or start the daemon by other means",
        )
    if int(told[1]) < LEAST_SYSTEMD:
        return Finding("systemd", "bad", told[1], f"update the system: {LEAST_SYSTEMD} or later")
    return Finding("systemd", "ok", told[1])


def _halves(error: Exception, path: Path | None = None) -> tuple[str, str]:
    """Split an error of ours into what is wrong, without ``path``, and what to do."""
    found, _, remedy = str(error).removeprefix(f"{path}: ").rpartition(": ")
    return (found, remedy) if found else (remedy, "export or copy it again")


def _nearest(path: Path) -> Path:
    """Return the path, or the nearest directory above it that exists."""
    while not path.exists():
        path = path.parent
    return path


def _join(group: str) -> str:
    return f"sudo usermod -aG {group} $USER, then log in again"
