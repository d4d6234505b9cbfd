"""The paper's tables by name, and ours of the same kind."""

from __future__ import annotations

from collections.abc import Mapping

from veilcam_training.errors import TrainingError
from veilcam_training.tables.table import Table

GRAY_SIZES = ("24x32", "12x16", "6x8", "3x4")

_TABLES = (
    Table("mnist", "Handwritten digits (MNIST)", ("mnist",), ("LR", "FC800"), GRAY_SIZES),
    Table("fashion", "Clothes (Fashion-MNIST)", ("fashion",), ("LR", "FC800"), GRAY_SIZES),
    Table(
        "robust",
        "Digits that are moved, scaled, turned and tilted (MNIST)",
        ("mnist",),
        ("FC800",),
        ("24x32",),
        changes=("none", "shift", "rescale", "rotate", "perspective"),
    ),
    Table(
        "faces",
        "Drawn faces",
        ("faces-gender", "faces-smiling", "faces-glasses"),
        ("FC800",),
        ("24x32", "3x4"),
    ),
    Table(
        "celeba",
        "Photographs of faces (CelebA)",
        ("celeba-gender", "celeba-smiling"),
        ("FC800",),
        ("24x32", "3x4"),
    ),
    Table(
        "cifar10",
        "Photographs of objects in colour (CIFAR-10)",
        ("cifar10",),
        ("VGG11",),
        ("27x36", "13x17", "6x8", "3x4"),
    ),
)
TABLES: Mapping[str, Table] = {table.name: table for table in _TABLES}


def find_table(name: str) -> Table:
    """Table ``name``.

    Raises:
        TrainingError: an unknown name.
    """
    if name not in TABLES:
        raise TrainingError(f"table {name!r} is unknown: use one of {', '.join(TABLES)}")
    return TABLES[name]
