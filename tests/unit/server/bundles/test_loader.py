"""Terms and rotation of a bundle that the settings say nothing about."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import EveryCaptures, EverySeconds, RotationOff
from veilcam_server.bundles.loader import release_terms, rotation_policy
from veilcam_server.errors import StartError
from veilcam_server.masks.source import Terms
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle


@pytest.mark.parametrize(
    ("given", "form", "paired"),
    [
        (None, "none", "sealed"),
        ("raw", "raw", "raw"),
        ("sealed", "sealed", "sealed"),
        ("none", "none", "none"),
    ],
)
def test_embeddings_leave_in_the_form_of_setting_and_receivers(
    tmp_path: Path, given: str | None, form: str, paired: str
) -> None:
    made = Settings.model_validate({"bundle": "x", "release": given, "raw_budget": 1})
    store = ReceiverStore(tmp_path)
    terms = release_terms(made, store)
    assert terms() == Terms(form)  # type: ignore[arg-type]
    receiver = ReceiverKey.generate().public
    added = store.add("archive", receiver)
    assert terms() == Terms(paired, (receiver,))  # type: ignore[arg-type]
    store.remove(added.id)
    assert terms().form == form


def test_embeddings_stay_sealed_where_the_receivers_are_lost(tmp_path: Path) -> None:
    """A fault of the disk must not let them out in another form."""
    ReceiverStore(tmp_path).add("archive", ReceiverKey.generate().public)
    for end in ("", ".copy"):
        (tmp_path / f"receivers.json{end}").write_bytes(b"")
    terms = release_terms(Settings(bundle=Path("x")), ReceiverStore(tmp_path))
    assert terms() == Terms("sealed")


def test_masks_change_by_setting_or_mode(bundle: Bundle, fresh_bundle: Bundle) -> None:
    made = Settings(bundle=Path("x"))
    assert rotation_policy(made, bundle) == EveryCaptures(captures=10)
    assert rotation_policy(made, fresh_bundle) == EveryCaptures(captures=1)
    often = made.model_copy(update={"rotation": EverySeconds(seconds=3)})
    assert rotation_policy(often, fresh_bundle) == EverySeconds(seconds=3)


def test_lone_mask_is_not_served_unasked(bundle: Bundle) -> None:
    lone = dataclasses.replace(bundle, pairs=bundle.pairs[:1])
    made = Settings(bundle=Path("x"))
    with pytest.raises(StartError, match=r"one mask only, which never changes: .* --rotation-off"):
        rotation_policy(made, lone)
    asked = made.model_copy(update={"rotation": RotationOff()})
    assert rotation_policy(asked, lone) == RotationOff()
    simulated = made.model_copy(update={"device": "simulated"})
    assert rotation_policy(simulated, lone) == RotationOff()
