"""Why a calibration was refused."""

from __future__ import annotations


class CalibrationError(Exception):
    """A measurement or a record that cannot be used; the message says what to do."""
