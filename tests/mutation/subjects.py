"""The modules that are mutated, and the tests of their room that must notice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Subject:
    """One noun of the product. All paths are relative to the repository."""

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]


SUBJECTS = (
    Subject(
        "fence",
        ("server/veilcam_server/camera/capture.py",),
        (
            "tests/server/camera/test_fence.py",
            "tests/server/camera/test_rotation.py",
            "tests/server/camera/test_camera.py",
            "tests/server/camera/test_masked_capture.py",
        ),
    ),
    Subject(
        "rotation",
        ("server/veilcam_server/camera/capture.py",),
        (
            "tests/server/camera/test_rotation.py",
            "tests/server/camera/test_fence.py",
            "tests/server/camera/test_camera.py",
            "tests/server/camera/test_masked_capture.py",
        ),
    ),
    Subject(
        "panel",
        ("server/veilcam_server/camera/panel.py",),
        (
            "tests/server/camera/test_panel.py",
            "tests/server/camera/test_camera.py",
            "tests/server/camera/test_guard.py",
        ),
    ),
    Subject(
        "guard",
        ("server/veilcam_server/camera/guard.py",),
        ("tests/server/camera/test_guard.py",),
    ),
    Subject(
        "epochs",
        ("server/veilcam_server/camera/epochs.py",),
        (
            "tests/server/camera/test_epochs.py",
            "tests/server/camera/test_preparation.py",
            "tests/server/camera/test_masked_capture.py",
        ),
    ),
    Subject(
        "tokens",
        ("server/veilcam_server/security/tokens.py",),
        ("tests/server/security/test_tokens.py",),
    ),
    Subject(
        "panel driver",
        ("server/veilcam_server/devices/st7735r.py",),
        ("tests/server/devices/test_st7735r.py",),
    ),
    Subject(
        "transfer",
        ("optics/veilcam_optics/transfer/operator.py",),
        ("tests/optics/transfer/test_operator.py",),
    ),
    Subject(
        "decoder",
        ("optics/veilcam_optics/decoding/decoder.py",),
        ("tests/optics/decoding/test_decoder.py",),
    ),
    Subject(
        "bundle archive",
        ("training/veilcam_training/bundle/archive.py",),
        (
            "tests/training/bundle/test_archive.py",
            "tests/training/bundle/test_fresh.py",
            "tests/training/bundle/test_signature.py",
        ),
    ),
)


def check_subjects(root: Path, subjects: tuple[Subject, ...] = SUBJECTS) -> None:
    """Refuse a table that names a file which is not there.

    Raises:
        FileNotFoundError: it was moved; the message names it.
    """
    for subject in subjects:
        for name in (*subject.sources, *subject.tests):
            if not (root / name).exists():
                raise FileNotFoundError(f"{subject.name}: there is no {name}: correct the table")
