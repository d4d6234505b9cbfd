"""Calibration, and cameras that differ from their drawing."""

from __future__ import annotations

from benchmarks.tables.table import Figures, Grid
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.sensor.readout import photon_snr_db
from veilcam_server.devices.imx477 import HALF

SERVED: Figures = {
    f"served_{when}": ("daemon-calibration", f"digits that a daemon reads {words}", "{:.0%}")
    for when, words in {
        "before": "as its camera is drawn",
        "after": "once it was calibrated",
        "again": "after a restart, with the record",
    }.items()
}

CALIBRATED = Grid(
    "daemon-calibration",
    "camera",
    {
        "drawn": "nominal",
        "shift_y_150um": "mask 150 um off",
        "dead_lines": "a row and a column stuck open",
        "everything": "shift, rotation, distance, gamma, floor and a dead row at once",
        "gamma_2.2": "gamma 2.2",
        "leakage_0.2": "filters leak 20 % of the amplitude",
        "stray_0.1": "10 % stray light",
        "warm_up_0.1": "10 % of the light missing at first",
        "noise_30db": "noise of 30 dB, not 40",
    },
    {
        "{}_before": ("digits read, nominal", "{:.1%}"),
        "{}_after": ("digits read, calibrated", "{:.1%}"),
        "{}_before_unexplained": ("error of the scene, nominal", "{:.2f}"),
        "{}_after_unexplained": ("error of the scene, calibrated", "{:.2f}"),
    },
)


def fills() -> str:
    """Raw pixels and photons of an embedding value, by the fill of its box."""
    lines = ["| embedding | raw pixels a value | dB by photons |", "|---|---|---|"]
    for rows, columns in ((24, 32), (6, 8)):
        for fill in (1.0, 0.5, 0.2, 0.1):
            embedding = Embedding(rows, columns, fill)
            pixels = fill**2 * HALF.rows * HALF.columns / embedding.size
            snr_db = photon_snr_db(Camera(), embedding)
            lines.append(f"| `{embedding}` | {pixels:,.0f} | {snr_db:.0f} |")
    return "\n".join(lines) + "\n"
