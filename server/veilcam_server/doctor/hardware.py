"""Checks of the board, the panel and the camera."""

from __future__ import annotations

import re
from collections.abc import Iterator, Set

from veilcam_server.devices.driver import DisplayDriver, SensorDriver
from veilcam_server.devices.errors import DeviceError
from veilcam_server.devices.spi import GPIO_CHIPS
from veilcam_server.doctor.finding import Finding, halves
from veilcam_server.doctor.machine import Machine
from veilcam_server.wiring import Wiring


def check_model(machine: Machine) -> Finding:
    """Return whether the board is a Raspberry Pi."""
    model = machine.text("/proc/device-tree/model")
    if model is not None and model.startswith("Raspberry Pi"):
        return Finding("board", "ok", model)
    remedy = "run the daemon on a Raspberry Pi, or try it here with 'veilcamd serve --simulate'"
    return Finding("board", "bad", model or "no Raspberry Pi", remedy)


def check_release(machine: Machine) -> Iterator[Finding]:
    """Return whether it came as a Debian package."""
    installed = machine.text("/usr/lib/veilcam/unpacked/RELEASE")
    if installed is None:
        return
    running = machine.path("/var/lib/veilcam-release/current").readlink().name
    if running == installed:
        yield Finding("release", "ok", running)
    else:
        found = f"{installed} did not start, so {running} runs, which was there before"
        remedy = "see why with journalctl -u veilcamd, and install one that starts"
        yield Finding("release", "bad", found, remedy)


def check_package(machine: Machine, name: str) -> Finding:
    """Return whether a package is installed."""
    try:
        machine.load(name)
    except DeviceError as error:
        return Finding(name, "bad", *halves(error))
    return Finding(name, "ok", "installed")


def check_spi(machine: Machine, wiring: Wiring) -> Finding:
    """Return whether the bus of the panel can be used."""
    node = machine.path(wiring.spi)
    if not node.exists():
        texts = (machine.text(f"/boot{folder}/config.txt") or "" for folder in ("/firmware", ""))
        remedy = "sudo raspi-config nonint do_spi 0, then restart"
        if any(re.search(r"^\s*dtparam=spi=on\s*$", text, re.MULTILINE) for text in texts):
            remedy = "SPI is switched on in config.txt: restart, or give another --spi"
        return Finding("panel bus", "bad", f"there is no {wiring.spi}", remedy)
    if not machine.may_write(node):
        return Finding("panel bus", "bad", f"{wiring.spi} is not yours to open", _join("spi"))
    return Finding("panel bus", "ok", str(wiring.spi))


def check_clock_of_bus(wiring: Wiring, fastest: int) -> Finding:
    """Return whether the panel takes the clock of the bus."""
    found = f"{wiring.spi_hz:,} Hz"
    if wiring.spi_hz > fastest:
        remedy = f"give --spi-hz {fastest} or less"
        return Finding("bus clock", "bad", f"{found}, too fast for the panel", remedy)
    return Finding("bus clock", "ok", found)


def check_need(wiring: Wiring, name: str, what: str) -> Finding:
    """Check a setting without which the panel cannot be opened."""
    words, value = name.replace("_", " "), getattr(wiring, name)
    if value is None:
        option, variable = f"--{name.replace('_', '-')}", f"VEILCAM_{name.upper()}"
        return Finding(words, "bad", "not known", f"give {option} (or {variable}) {what}")
    return Finding(words, "ok", str(value))


def check_lines(machine: Machine, wiring: Wiring, usable: Set[str]) -> Iterator[Finding]:
    """Yield whether the panel's lines can be used."""
    lines = (("line of D/C", wiring.data_line), ("line of RESET", wiring.reset_line))
    names = ["GPIO chip", *(name for name, _ in lines)]
    if "gpiod" not in usable:
        yield from (Finding(name, "skipped", "needs gpiod") for name in names)
        return
    chips = machine.chips()
    wanted = GPIO_CHIPS if wiring.gpio_chip is None else (wiring.gpio_chip,)
    label = next((label for label in wanted if label in chips), None)
    if label is None:
        found = f"no {' or '.join(wanted)}; there is {', '.join(chips) or 'none that you may open'}"
        remedy = "give --gpio-chip the label of yours" if chips else _join("gpio")
        yield Finding("GPIO chip", "bad", found, remedy)
        yield from (Finding(name, "skipped", "needs the GPIO chip") for name in names[1:])
        return
    yield Finding("GPIO chip", "ok", f"{label}, {chips[label]}")
    for name, line in lines:
        try:
            user = machine.line_user(chips[label], line)
        except DeviceError as error:
            yield Finding(name, "bad", *halves(error))
            continue
        if user is None:
            yield Finding(name, "ok", f"{line}, free")
        else:
            remedy = (
                "end what uses it (a running veilcamd, or an overlay in config.txt), or wire "
                "another line"
            )
            yield Finding(name, "bad", f"{line}, used by {user}", remedy)


def check_answers(wiring: Wiring, display: DisplayDriver, usable: Set[str]) -> Iterator[Finding]:
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
            yield Finding(name, "bad", *halves(error))


def check_frame_memory(machine: Machine) -> Finding:
    """Return whether there is memory for frames."""
    heaps = sorted(machine.path("/dev/dma_heap").glob("*"))
    if not heaps:
        return Finding(
            "frame memory", "bad", "there is no /dev/dma_heap", "use a current Raspberry Pi OS"
        )
    if not any(machine.may_write(heap) for heap in heaps):
        return Finding("frame memory", "bad", "/dev/dma_heap is not yours to open", _join("video"))
    return Finding("frame memory", "ok", "/dev/dma_heap")


def check_camera(
    machine: Machine, wiring: Wiring, sensor: SensorDriver, usable: Set[str]
) -> Finding:
    """Return whether the camera is found."""
    if not set(sensor.packages) <= usable:
        return Finding("camera", "skipped", f"needs {' and '.join(sensor.packages)}")
    try:
        camera = machine.open_camera(wiring.camera_number)
    except DeviceError as error:
        return Finding("camera", "bad", *halves(error))
    try:
        model = str(camera.camera_properties.get("Model", "unknown"))
    finally:
        camera.close()
    if sensor.model not in model:
        return Finding("camera", "bad", model, f"connect {sensor.product}")
    return Finding("camera", "ok", f"{model}, number {wiring.camera_number}")


def _join(group: str) -> str:
    return f"sudo usermod -aG {group} $USER, then log in again"
