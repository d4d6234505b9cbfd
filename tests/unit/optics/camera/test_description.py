"""Cameras as files, presets, and what is refused at the door."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from veilcam_optics.camera.description import (
    KEYS,
    MAX_BYTES,
    describe_camera,
    parse_camera,
    read_camera,
)
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.presets import PRESETS, preset
from veilcam_optics.cli.camera import PresetName
from veilcam_optics.cli.main import app
from veilcam_optics.errors import OpticsError

LEAST = """
distance = 5e-3
wavelength = 633e-9
[panel]
rows = 100
columns = 80
pitch_y = 36e-6
pitch_x = 18e-6
fill_factor = 0.64
levels = 256
filter_cycle = []
[window]
rows = 10
columns = 8
[sensor]
rows = 400
columns = 600
pixel = 2e-6
"""
MEASURED = ((0.9, 0.1, 0.0), (0.1, 0.8, 0.1), (0.0, 0.2, 0.7))


@pytest.mark.parametrize(
    "camera",
    [
        *(found.camera for found in PRESETS.values()),
        Camera(panel=Panel(filter_amplitudes=MEASURED), distance=1 / 300),
    ],
)
def test_camera_is_read_as_it_was_written(camera: Camera, tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(describe_camera(camera))
    assert read_camera(path) == camera


def test_every_key_is_written_with_its_unit_or_made_of_others() -> None:
    text = describe_camera(Camera())
    for name, key in KEYS.items():
        lines = re.findall(rf"^{name.rpartition('.')[2]} = .*# (.*)$", text, re.MULTILINE)
        assert lines or name in {"wavelength", "panel.fill_factor"}
        assert not lines or any(line.startswith(f"[{key.unit}] ") for line in lines) or not key.unit


def test_one_wavelength_fill_factor_and_a_centred_window() -> None:
    camera = parse_camera(LEAST)
    assert camera.wavelengths == (633e-9,) * 3
    assert camera.sensor.channel_weights == (0.0, 1.0, 0.0)
    assert camera.panel.aperture_y == pytest.approx(0.8 * 36e-6)
    assert camera.panel.aperture_x == pytest.approx(0.8 * 18e-6)
    assert camera.panel.fill_factor == pytest.approx(0.64)
    assert (camera.window.first_row, camera.window.first_column) == (45, 36)


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        ("pitch_y = 36e-6", "pitch_y = 36", r"panel\.pitch_y = 36.0 m .*use 1e-08 to 0.1"),
        ("pitch_y = 36e-6", "pitch_y = '36 um'", r"panel\.pitch_y = '36 um' m .*a number \[m\]"),
        ("pitch_y = 36e-6", "", r"panel\.pitch_y = nothing m .*1e-08 to 0.1"),
        ("rows = 400", "rows = 4.5", r"sensor\.rows = 4.5 .*an integer"),
        ("rows = 400", "rows = true", r"sensor\.rows = True .*an integer"),
        ("rows = 10\n", "rows = 101\n", r"window\.rows = 101 .*100 panel rows"),
        ("rows = 10\n", f"rows = 1{'0' * 400}\n", r"window = 10+ x 8 numbers .*bytes"),
        ("levels = 256", "level = 256", r"panel\.level is no key of a camera: use distance, "),
        ("filter_cycle = []", "filter_cycle = [3]", r"panel\.filter_cycle = \(3,\).*0 \(R\)"),
        ("filter_cycle = []", "filter_cycle = ['R']", r"panel\.filter_cycle = .*a list: 0 \(R\)"),
        ("filter_cycle = []", "filter_cycle = [[0]]", r"panel\.filter_cycle = .*a list: 0 \(R\)"),
        ("filter_cycle = []", "filter_cycle = [0]", r"panel\.filter_cycle.*none beside wavelength"),
        ("levels = 256", "levels = 256\nfilter_amplitudes = [1, 2, 3]", r"filter_amplitudes.*3 x"),
        ("fill_factor = 0.64", "fill_factor = 1.2", r"panel\.fill_factor = 1.2 .*at most 1"),
        ("fill_factor = 0.64", "", r"panel\.aperture_y = nothing m .*fill_factor alone"),
        ("fill_factor", "aperture_x = 9e-6\nfill_factor", r"panel\.aperture_x = 9e-06 m .*alone"),
        ("wavelength = 633e-9", "wavelength = 550", r"wavelengths\[R\] = 550.0 m .*1e-08 to 0.001"),
        ("wavelength = 633e-9", "", r"wavelengths = None m .*either"),
        ("wavelength = 633e-9", "wavelengths = [5e-7]", r"wavelengths = .*\[R, G, B\]"),
        ("distance = 5e-3", "distance = -1", r"camera\.distance = -1.0 m"),
        ("distance = 5e-3", "distance = ", "no TOML"),
        *(
            ("distance = 5e-3", f"distance = {value}", rf"camera\.distance = {value} m .*: use")
            for value in ("nan", "inf", "0.0")
        ),
        ("pixel = 2e-6", "pixel = 1.55", r"sensor\.pixel = 1.55 m .*: use 1e-08 to 0.1"),
        ("pixel = 2e-6", "pixel = 2e-6\nchannel_weights = [0.5, 0.5]", "channel_weights"),
    ],
)
def test_impossible_cameras_are_refused_by_name(line: str, instead: str, message: str) -> None:
    assert line in LEAST
    with pytest.raises(OpticsError, match=message):
        parse_camera(LEAST.replace(line, instead, 1))


def test_file_that_is_no_camera_is_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    with pytest.raises(OpticsError, match=r"camera\.toml cannot be read"):
        read_camera(path)
    path.write_bytes(b"\xff")
    with pytest.raises(OpticsError, match=r"camera\.toml cannot be read"):
        read_camera(path)
    path.write_text(LEAST + "#" * MAX_BYTES)
    with pytest.raises(OpticsError, match="is this a camera"):
        read_camera(path)
    path.write_text(LEAST.replace("rows = 400", "rows = 0"))
    with pytest.raises(OpticsError, match=r"camera\.toml: sensor\.rows"):
        read_camera(path)


def test_presets_have_sources_and_masks_that_fit() -> None:
    assert {name.value for name in PresetName} == set(PRESETS)
    for name, found in PRESETS.items():
        assert preset(name) is found.camera
        assert "data sheet" in found.source
    assert preset("paper") == Camera()
    assert preset("slm").panel.fill_factor == pytest.approx(0.58)
    assert preset("dmd").panel.fill_factor == pytest.approx(0.92)
    assert preset("dmd").panel.levels == 2
    with pytest.raises(OpticsError, match="'paper' or 'slm' or 'dmd'"):
        preset("lcos")


@pytest.mark.parametrize("share", [0.0, 1.01, math.nan])
def test_fill_factors_are_shares(share: float) -> None:
    with pytest.raises(OpticsError, match="fill_factor"):
        Panel().with_fill_factor(share)


def test_size_that_cannot_fit_is_refused_before_it_is_asked_for() -> None:
    for made in (
        lambda: Window(10**7, 10**7),
        lambda: Scene(10**7, 10**7),
        lambda: Embedding(10**7, 10**7),
    ):
        with pytest.raises(OpticsError, match=r"10000000 x 10000000 numbers .*bytes"):
            made()


def test_monochrome_takes_colours_from_panel_and_sensor() -> None:
    camera = Camera(panel=Panel(filter_leakage=0.1)).monochrome(500e-9)
    assert camera.panel.filter_cycle == ()
    assert camera.panel.filter_leakage == 0
    assert camera.row_amplitudes(1) == (1.0,) * 51
    assert replace(camera, sensor=Sensor()).wavelengths == (500e-9,) * 3


@pytest.mark.slow
def test_command_prints_a_camera_that_it_plans_for(tmp_path: Path) -> None:
    runner, path = CliRunner(), tmp_path / "camera.toml"
    printed = runner.invoke(app, ["camera", "slm"])
    assert printed.exit_code == 0, printed.output
    assert PRESETS["slm"].source in printed.output
    path.write_text(printed.output)
    options = ["--embedding", "3x4", "--scene", "4x4", "--tolerance", "1e-1"]
    by_file = runner.invoke(app, ["plan", "--camera", str(path), *options])
    by_name = runner.invoke(app, ["plan", "--camera", "slm", *options])
    assert by_file.exit_code == 0, by_file.output
    assert by_file.output == by_name.output
    assert "only 58 % of the panel's area" in " ".join(by_name.output.split())
    farther = runner.invoke(app, ["plan", "--camera", "slm", "--distance", "0.02", *options])
    assert farther.output != by_name.output


def test_command_refuses_a_file_with_the_key(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(LEAST.replace("pitch_x = 18e-6", "pitch_x = 18"))
    refused = CliRunner().invoke(app, ["plan", "--camera", str(path)])
    assert refused.exit_code == 2
    assert "panel.pitch_x = 18.0 m is not valid: use 1e-08 to 0.1" in " ".join(
        refused.output.split()
    )


@pytest.mark.parametrize("command", ["plan", "camera", "accuracy"])
def test_every_length_and_angle_has_its_unit_in_the_help(command: str) -> None:
    # Wide enough that no help is broken between words.
    result = CliRunner().invoke(app, [command, "--help"], terminal_width=300)
    shown = result.output
    assert "--help" in shown
    for name in ("distance", "height", "range", "shift", "bandwidth", "error"):
        for line in re.findall(rf"^.*--[a-z-]*{name}[a-z-]* .*$", shown, re.MULTILINE):
            assert "[m]" in line, line
    for line in re.findall(r"^.*--(?:rotation|off-axis) .*$", shown, re.MULTILINE):
        assert "[rad]" in line
