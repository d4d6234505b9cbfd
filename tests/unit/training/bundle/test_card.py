"""A card travels with the bundle that it is of, is covered as all parts are, refuses nothing."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.unit.training.bundle.conftest import edit_manifest, refuse, replace_part, unpack
from tests.unit.training.bundle.test_archive import make_bundle

from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import (
    Bundle,
    BundleError,
    CardRow,
    Outcome,
    PrivacyCard,
    add_card,
    read_bundle,
    sign_bundle,
    write_bundle,
)

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))


def row(threat: str, outcome: Outcome) -> CardRow:
    texts = {"title": "a title", "given": "what leaves", "attack": "a network", "metric": "digits"}
    numbers = {"figure": 0.2, "end": 0.8, "chance": 0.0, "threshold": 1.0}
    counts = {"samples": 1000, "masks": 100}
    more = {"threat": threat, "unit": "points", "reason": "because", "outcome": outcome}
    return CardRow.model_validate({**texts, **numbers, **counts, **more})


def card_of(bundle: Bundle, *rows: CardRow) -> PrivacyCard:
    return PrivacyCard(
        subject=bundle.subject,
        mode="fresh",
        form="sealed",
        quick=True,
        data="digits",
        seed=1,
        made_at=datetime(2026, 1, 2, tzinfo=UTC),
        minutes=2.5,
        rows=rows or (row("T0", "PASS"), row("T1", "PASS")),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    result = tmp_path / "a.veilcam"
    write_bundle(result, make_bundle())
    return result


@pytest.mark.slow
def test_card_travels_with_its_bundle_and_changes_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "shipped.veilcam"
    path.write_bytes(FRESH.read_bytes())
    before = read_bundle(path)
    assert before.card is None
    card = card_of(before)
    add_card(path, card)
    after = read_bundle(path)
    assert after.card == card
    assert after.subject == before.subject
    assert after.digest != before.digest
    again = card_of(before, row("T0", "FAIL"))
    add_card(path, again)
    assert read_bundle(path).card == again
    # What was there but the card is there byte for byte, also what no version writes any more.
    manifest = json.loads(unpack(path)["bundle.json"])
    del manifest["parts"]["card.json"]
    assert manifest == json.loads(unpack(FRESH)["bundle.json"])


def test_bundle_is_written_with_its_card(path: Path) -> None:
    card = card_of(read_bundle(path))
    add_card(path, card)
    content = path.read_bytes()
    write_bundle(path, read_bundle(path))
    assert path.read_bytes() == content
    assert read_bundle(path).card == card


def test_card_is_covered_by_digest_and_signature(path: Path) -> None:
    add_card(path, card_of(read_bundle(path)))
    sign_bundle(path, 3, KEY)
    assert read_bundle(path).card is not None
    with pytest.raises(BundleError, match="before its owner signs"):
        add_card(path, card_of(read_bundle(path)))
    better = unpack(path)["card.json"].replace(b"0.8", b"0.1")
    replace_part(path, "card.json", better)
    refuse(path, "changed after its owner signed")


def test_version_without_a_signature_stays(path: Path) -> None:
    sign_bundle(path, 3, None)
    add_card(path, card_of(read_bundle(path)))
    assert read_bundle(path).version == 3


def test_damaged_card_is_a_damaged_bundle(path: Path) -> None:
    add_card(path, card_of(read_bundle(path)))
    edit_manifest(path, lambda manifest: manifest["parts"].update({"card.json": "0" * 64}))
    refuse(path, "card.json is not what bundle.json says")
    edit_manifest(path, lambda manifest: manifest["parts"].pop("card.json"))
    refuse(path, "lacks the digest")


@pytest.mark.parametrize(
    "content", [b"", b"no json", b"{}", b'{"format": "veilcam-card", "version": 2}', b"\xff"]
)
def test_file_that_is_no_card_is_not_shown_and_refuses_nothing(path: Path, content: bytes) -> None:
    add_card(path, card_of(read_bundle(path)))
    replace_part(path, "card.json", content)
    assert read_bundle(path).card is None


def test_card_of_other_masks_is_neither_taken_nor_shown(path: Path) -> None:
    bundle = read_bundle(path)
    other = card_of(bundle).model_copy(update={"subject": "ab" * 32})
    with pytest.raises(BundleError, match="is not what this card is of"):
        add_card(path, other)
    add_card(path, card_of(bundle))
    # Other masks under the same card: whoever edits the bundle leaves the card behind.
    edit_manifest(path, lambda manifest: manifest.update(task="other"))
    assert read_bundle(path).card is None
    assert read_bundle(path).subject != bundle.subject


@pytest.mark.parametrize(
    ("outcomes", "wanted"),
    [
        ({"T0": "PASS", "T1": "PASS", "T6": "NOT CLAIMED"}, "PASS"),
        ({"T0": "PASS", "T1": "FAIL"}, "FAIL"),
        ({"T0": "FAIL", "T1": "PASS"}, "VOID"),
        ({"T1": "PASS"}, "VOID"),
        ({"T0": "PASS", "T1": "NOT CLAIMED"}, "NOT CLAIMED"),
    ],
)
def test_card_without_a_key_that_opens_is_void(outcomes: dict[str, Outcome], wanted: str) -> None:
    card = card_of(read_bundle(FRESH), *(row(*each) for each in outcomes.items()))
    assert card.outcome == wanted
