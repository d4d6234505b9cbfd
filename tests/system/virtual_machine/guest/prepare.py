"""Before the daemon starts: GPIO lines and the panel's bus."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

LABEL = "pinctrl-rp1"
DATA, RESET = 24, 25
SPI = Path("/dev/spidev0.0")
SHARED = Path("/run/panel")


def main() -> None:
    _make_lines()
    _run("systemctl", "start", "veilcam-spidev.service")
    _wait_for(SPI)
    _run("udevadm", "settle")


def _make_lines() -> None:
    for module in ("gpio-sim", "cuse"):
        _run("modprobe", module)
    config = Path("/sys/kernel/config")
    if not (config / "gpio-sim").exists():
        _run("mount", "-t", "configfs", "none", str(config))
    chip = config / "gpio-sim" / "panel"
    (chip / "bank").mkdir(parents=True)
    (chip / "bank" / "num_lines").write_text("54")
    (chip / "bank" / "label").write_text(LABEL)
    (chip / "live").write_text("1")
    names = ((chip / each).read_text().strip() for each in ("dev_name", "bank/chip_name"))
    lines = Path("/sys/devices/platform").joinpath(*names)
    SHARED.mkdir()
    # Where the bus looks for D/C while bytes pass.
    (SHARED / "data").symlink_to(lines / f"sim_gpio{DATA}" / "value")


def _wait_for(path: Path) -> None:
    end = time.monotonic() + 60
    while not path.exists():
        if time.monotonic() > end:
            raise SystemExit(f"{path} did not appear")
        time.sleep(0.5)


def _run(*command: str) -> None:
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
