"""One capture: what leaves of it in which form, and that it holds its epoch until it is done."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Embedding, SealedEmbedding
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.camera.capture import MaskedCapture
from veilcam_server.camera.epochs import Epoch

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

PER_CAPTURE = EveryCaptures(captures=1)


def captured(bench: Bench, form: Any, *, release: bool = True) -> MaskedCapture:
    """A capture behind a fresh mask, whose embedding is to leave in a form."""
    bench.receivers.add("archive", ReceiverKey.generate().public)
    bench.release = form
    return bench.camera(policy=PER_CAPTURE).capture(release=release)


def test_raw_is_what_was_read(fresh_bench: Bench) -> None:
    embedding = captured(fresh_bench, "raw").release(0.0)
    assert isinstance(embedding, Embedding)
    assert embedding.form == "raw"
    assert np.array_equal(np.asarray(embedding), fresh_bench.sensor.measurement)


def test_sealed_is_a_block(fresh_bench: Bench) -> None:
    assert isinstance(captured(fresh_bench, "sealed").release(0.0), SealedEmbedding)


def test_nothing_leaves_that_was_not_to(fresh_bench: Bench) -> None:
    # Its epoch could seal; this capture was of its label alone.
    capture = captured(fresh_bench, "sealed", release=False)
    assert capture.form is None
    with pytest.raises(ValueError, match="nothing was to leave"):
        capture.release(0.0)
    # And one that was to leave sealed, where nobody receives.
    capture.form, capture.active.sealer = "sealed", None
    with pytest.raises(ValueError, match="nothing was to leave"):
        capture.release(0.0)


def test_capture_holds_its_epoch_until_it_is_done(fresh_bench: Bench) -> None:
    capture = captured(fresh_bench, "raw")
    epoch = capture.active
    epoch.hold()
    epoch.retire()
    capture.done()
    # It let go once, however often it is told: another one still looks behind this mask.
    capture.done()
    assert not epoch.erased
    epoch.let_go()
    assert epoch.erased


def test_capture_shows_neither_its_measurement_nor_its_internals(fresh_bench: Bench) -> None:
    shown = repr(captured(fresh_bench, "raw"))
    assert "measurement" not in shown
    assert "_done" not in shown


@pytest.mark.parametrize("made", [MaskedCapture, Epoch])
def test_capture_number_is_nobody_s_to_give(made: type) -> None:
    own = {field.name: field.init for field in fields(made) if field.name.startswith("_")}
    assert own
    assert not any(own.values())
    assert not {field.name: field.init for field in fields(MaskedCapture)}["replay"]
