"""Labels that no bundle may hold, written or read; and masks that are all the same."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from tests.unit.server.conftest import make_bundle
from tests.unit.training.bundle.conftest import edit_manifest, refuse

from veilcam_training.bundle import BundleError, read_bundle, write_bundle


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("caf\udce9", "is not valid UTF-8"),
        ("a\x1b[2J", "control characters"),
        ("a\u2028b", "control characters"),
        ("a\u202eb", "direction of writing"),
        ("\u2067a", "direction of writing"),
        ("x" * 65, "has 65 characters"),
        ("", "is empty"),
        ("  ", "is empty"),
        *((word, "is the word") for word in ("nothing", "None", "UNKNOWN", "unavailable")),
    ],
)
def test_label_that_nobody_can_use_is_refused(tmp_path: Path, label: str, said: str) -> None:
    bundle, path = make_bundle(), tmp_path / "a.veilcam"
    write_bundle(path, bundle)
    with pytest.raises(BundleError, match=said) as caught:
        write_bundle(
            tmp_path / "b.veilcam", dataclasses.replace(bundle, labels=(label, *"123456789"))
        )
    assert str(caught.value).isascii()
    edit_manifest(path, lambda manifest: manifest.update(labels=[label, *"123456789"]))
    # JSON itself has no lone surrogates, and is refused before its labels are.
    refuse(path, "JSON|surrogate" if "\udce9" in label else said)


def test_label_of_any_language_is_taken(tmp_path: Path) -> None:
    foreign = ("café", "猫", "می\u200cخواهم", "👩\u200d🚀", "ß")
    names = (*foreign, "no one", "x" * 64, "none of them", "a b", "1")
    write_bundle(tmp_path / "a.veilcam", dataclasses.replace(make_bundle(), labels=names))
    assert read_bundle(tmp_path / "a.veilcam").labels == names


def test_labels_that_are_one_in_composed_form_are_refused(tmp_path: Path) -> None:
    twice = dataclasses.replace(make_bundle(), labels=("café", "cafe\u0301", *"23456789"))
    with pytest.raises(BundleError, match="twice: use different names"):
        write_bundle(tmp_path / "a.veilcam", twice)


def test_masks_that_are_all_the_same_are_refused(tmp_path: Path) -> None:
    bundle = make_bundle(3)
    same = dataclasses.replace(bundle, pairs=(bundle.pairs[0],) * 3)
    with pytest.raises(BundleError, match="all 3 masks are the same"):
        write_bundle(tmp_path / "a.veilcam", same)
    for fitting in (bundle.pairs[:1], (*bundle.pairs, bundle.pairs[0])):
        write_bundle(tmp_path / "a.veilcam", dataclasses.replace(bundle, pairs=fitting))
