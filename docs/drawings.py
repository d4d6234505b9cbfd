"""Two drawings for whoever builds the camera: the stack with its dimensions, and the wires.

``python docs/drawings.py`` writes both again. They are made from the camera's constants and the
daemon's settings; a test compares them with these.
"""

from __future__ import annotations

from pathlib import Path

from veilcam_optics.camera.geometry import Camera
from veilcam_server.settings import Settings

FOLDER = Path(__file__).resolve().parent / "images"
INK, SOFT, ACCENT = "#222222", "#8a8a8a", "#00796b"
HOOD = 40.0
"""Length and width of the hood [mm], see deploy/README.md."""


def _svg(width: int, height: int, title: str, parts: list[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'font-family="sans-serif" font-size="14" fill="{INK}">\n<title>{title}</title>\n'
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _text(x: float, y: float, text: str, *, anchor: str = "start", fill: str = INK) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{fill}">{text}</text>'


def _line(  # noqa: PLR0917 - two points
    x1: float, y1: float, x2: float, y2: float, colour: str = INK, width: float = 1
) -> str:
    return (
        f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="{colour}" '
        f'stroke-width="{width:g}"/>'
    )


def _box(x: float, y: float, width: float, height: float, fill: str) -> str:
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="{fill}" '
        f'stroke="{INK}"/>'
    )


def _span(x1: float, x2: float, y: float, text: str) -> str:
    """A horizontal dimension with its ends."""
    ends = "".join(_line(x, y - 5, x, y + 5, ACCENT) for x in (x1, x2))
    return (
        _line(x1, y, x2, y, ACCENT)
        + ends
        + _text((x1 + x2) / 2, y - 8, text, anchor="middle", fill=ACCENT)
    )


def _height(x: float, y1: float, y2: float, text: str) -> str:
    """A vertical dimension with its ends."""
    ends = "".join(_line(x - 5, y, x + 5, y, ACCENT) for y in (y1, y2))
    said = _text(x - 10, (y1 + y2) / 2 + 22, text, anchor="end", fill=ACCENT)
    return _line(x, y1, x, y2, ACCENT) + ends + said


def stack(camera: Camera) -> str:
    """Section from above through hood, panel and sensor; the light comes from the left."""
    scale = 40.0  # units for a millimetre, but for the hood, which is broken off
    gap = 1e3 * camera.distance
    sensor = 1e3 * camera.sensor.columns * camera.sensor.pixel
    tall = 1e3 * camera.sensor.rows * camera.sensor.pixel
    window = 1e3 * camera.window.columns * camera.panel.pitch_x
    rows = 1e3 * camera.window.rows * camera.panel.pitch_y
    middle, panel = 260.0, 330.0
    chip = panel + scale * gap
    parts = [
        _text(40, 180, "light", fill=SOFT),
        *(
            _line(40, y, 140, y, SOFT) + f'<path d="M140 {y - 4} l8 4 l-8 4 z" fill="{SOFT}"/>'
            for y in (200, 260, 320)
        ),
        # The hood, broken off.
        _box(180, middle - 170, panel - 190, 8, "#444444"),
        _box(180, middle + 162, panel - 190, 8, "#444444"),
        _text(
            180, middle - 182, f"hood, black inside: {HOOD:g} mm long, {HOOD:g} mm wide; optional"
        ),
        # The panel, its window open.
        _box(panel, middle - 150, 14, 300, "#cfd8dc"),
        _box(panel, middle - scale * window / 2, 14, scale * window, "#80cbc4"),
        _text(
            panel - 6, middle + 192, "panel without its backlight; polarisers stay", anchor="end"
        ),
        _line(panel + 7, middle + 150, panel - 4, middle + 180, SOFT),
        # What closes the gap.
        _box(panel + 14, middle - 128, scale * gap - 14, 10, "#444444"),
        _box(panel + 14, middle + 118, scale * gap - 14, 10, "#444444"),
        _line(chip - 60, middle - 123, chip + 36, middle - 130, SOFT),
        _text(chip + 40, middle - 125, "black card: no light"),
        _text(chip + 40, middle - 107, "comes past the panel"),
        # The sensor.
        _box(chip, middle - scale * sensor / 2, 16, scale * sensor, "#ffcc80"),
        _box(chip + 16, middle - 170, 12, 340, "#a5d6a7"),
        _text(chip + 40, middle - 5, "IMX477, its lens removed"),
        _text(chip + 40, middle + 15, f"{sensor:.2f} x {tall:.2f} mm", fill=ACCENT),
        _text(chip + 40, middle + 160, "HQ camera's board"),
        _span(
            panel,
            chip,
            middle + 232,
            f"{gap:g} mm, front of the sensor to the panel's liquid crystal",
        ),
        _height(
            panel - 16,
            middle - scale * window / 2,
            middle + scale * window / 2,
            f"window {window:.2f} x {rows:.2f} mm",
        ),
    ]
    return _svg(760, 520, "Section through hood, panel and sensor", parts)


def wires(settings: dict[str, object]) -> str:
    """Panel to header: names of the panel, GPIO numbers and pins of the 40-pin header."""
    # Pins of the header: https://pinout.xyz; SPI0 is fixed, the two lines are settings.
    pins = {8: 24, 9: 21, 10: 19, 11: 23, 24: 18, 25: 22}
    data, reset = int(str(settings["data_line"])), int(str(settings["reset_line"]))
    rows = [
        ("VCC", "3.3 V", "pin 1", "#c62828"),
        ("GND", "ground", "pin 6", "#222222"),
        ("SCK", "GPIO 11, SPI0 SCLK", f"pin {pins[11]}", "#1565c0"),
        ("SDA", "GPIO 10, SPI0 MOSI", f"pin {pins[10]}", "#1565c0"),
        ("CS", "GPIO 8, SPI0 CE0", f"pin {pins[8]}", "#1565c0"),
        ("A0 (D/C)", f"GPIO {data}", f"pin {pins[data]}" if data in pins else "", "#6a1b9a"),
        ("RESET", f"GPIO {reset}", f"pin {pins[reset]}" if reset in pins else "", "#6a1b9a"),
    ]
    parts = [
        _box(40, 50, 150, 330, "#eceff1"),
        _text(115, 38, "panel ST7735R", anchor="middle"),
        _box(470, 50, 250, 330, "#e8f5e9"),
        _text(595, 38, "Raspberry Pi, 40-pin header", anchor="middle"),
    ]
    for number, (name, line, pin, colour) in enumerate(rows):
        y = 86 + 38 * number
        parts += [
            _text(180, y + 5, name, anchor="end"),
            _line(190, y, 470, y, colour, 3),
            _text(480, y + 5, line),
            _text(710, y + 5, pin, anchor="end", fill=SOFT),
        ]
    y = 86 + 38 * len(rows)
    parts += [
        _text(180, y + 5, "SDA", anchor="end", fill=SOFT),
        _line(190, y, 470, y, SOFT, 2).replace("/>", ' stroke-dasharray="6 5"/>'),
        _text(480, y + 5, "GPIO 9, SPI0 MISO", fill=SOFT),
        _text(710, y + 5, f"pin {pins[9]}", anchor="end", fill=SOFT),
        _text(330, y + 24, "optional, to ask the panel; see the page", anchor="middle", fill=SOFT),
    ]
    return _svg(760, 420, "Wires from the panel to the Raspberry Pi", parts)


def drawings() -> dict[str, str]:
    """Both, by the names of their files."""
    defaults = {name: Settings.model_fields[name].default for name in ("data_line", "reset_line")}
    return {"stack.svg": stack(Camera()), "wires.svg": wires(defaults)}


if __name__ == "__main__":
    for name, drawing in drawings().items():
        (FOLDER / name).write_text(drawing)
