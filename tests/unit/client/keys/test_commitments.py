"""Commitments to answers, masks and calibrations: what each is bound to, and what it hides."""

from __future__ import annotations

import hmac
from datetime import timedelta
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.unit.client.logs import event, signed
from tests.unit.client.sealing import AT, BUNDLE, NOTES, Device

from veilcam_client.keys.commitments import (
    ID_DIGITS,
    answer_digest,
    calibration_digest,
    logged_mask,
    mask_commitment,
)
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire import calibration
from veilcam_client.wire.captures import Capture, Classification, Embedding

ID = "c0ffee00" * 6
LEVELS: npt.NDArray[np.uint8] = np.arange(12, dtype=np.uint8).reshape(3, 4)
SAID: dict[str, Any] = {"id": ID, "epoch": "9f" * 16, "number": 3, "taken_at": AT}


def classification(**others: Any) -> Classification:
    return Classification(**{**SAID, "label": "7", **others})


def test_answer_is_known_again_and_every_part_of_it_counts() -> None:
    embedding = Embedding.from_array(np.arange(6, dtype=np.float32).reshape(2, 3))
    answer = classification(scores={"7": 0.5, "1": 0.5}, confidence=0.5, embedding=embedding)
    digest = answer_digest(answer)
    assert digest == answer_digest(Classification.model_validate_json(answer.model_dump_json()))
    values = np.array([0.0, 1.0, 2.0, 3.0, 4.0, np.nextafter(np.float32(5), 6)], np.float32)
    other_values = Embedding.from_array(values.reshape(2, 3))
    changed = [
        answer.model_copy(update=change)
        for change in (
            {"id": "c0ffee01" * 6},
            {"epoch": "9e" * 16},
            {"number": 4},
            {"taken_at": AT + timedelta(seconds=1)},
            {"label": "1"},
            {"confidence": None},
            {"scores": {"7": 0.4, "1": 0.6}},
            {"embedding": None},
            {"embedding": other_values},
            {"embedding": embedding.model_copy(update={"shape": (3, 2)})},
        )
    ]
    assert len({digest, *map(answer_digest, changed)}) == 11
    capture = Capture(**SAID, embedding=embedding)
    assert answer_digest(capture) != answer_digest(classification(embedding=embedding))


def test_answer_is_hidden_by_an_id_that_stands_nowhere() -> None:
    """Ten labels are soon tried: what is not known is the id alone."""
    digest = answer_digest(classification())
    guesses = {answer_digest(classification(label=str(label), id="0" * 48)) for label in range(10)}
    assert digest not in guesses
    assert 4 * (ID_DIGITS - 16) == 128  # beyond what events tell of an id
    with pytest.raises(ValueError, match="hides nothing"):
        answer_digest(classification(id=ID[:16]))
    with pytest.raises(ValueError, match="was opened"):
        answer_digest(classification(notes=NOTES))


def test_calibration_is_named_by_all_that_it_says() -> None:
    [signed] = [each.signed for each in calibration.examples() if hasattr(each, "signed")]
    assert signed is not None
    again = signed.model_validate_json(signed.model_dump_json())
    other = signed.model_copy(update={"signature": "0" * 128})
    assert calibration_digest(signed) == calibration_digest(again) != calibration_digest(other)


def test_commitment_is_the_hmac_of_the_levels_under_the_epochs_own_key() -> None:
    key = EpochKey(bytes(range(32)), device="d7" * 32, bundle=BUNDLE)
    expected = hmac.digest(key.commitment(), bytes(range(12)), "sha256").hex()
    assert mask_commitment(key, LEVELS) == expected
    assert mask_commitment(key, np.asfortranarray(LEVELS)) == expected
    with pytest.raises(ValueError, match="use uint8"):
        mask_commitment(key, LEVELS.astype(np.int64))


def test_logged_mask_is_found_with_the_epochs_key_alone() -> None:
    key, other = (EpochKey.generate(device="d7" * 32, bundle=BUNDLE) for _ in range(2))
    masks = [LEVELS, LEVELS + 1, LEVELS + 2]
    mask = mask_commitment(key, LEVELS + 1)
    entry = signed(Device(), 5, "3c" * 32, event("capture", mask=mask))
    assert logged_mask(entry, key, masks) == 1
    assert logged_mask(entry, key, masks[:1]) is None
    assert logged_mask(entry, other, masks) is None
