"""What the package offers by name."""

from __future__ import annotations

import veilcam_optics


def test_public_names() -> None:
    assert veilcam_optics.__all__ == sorted(veilcam_optics.__all__)
    for name in veilcam_optics.__all__:
        assert getattr(veilcam_optics, name).__doc__, f"{name} has no docstring"
