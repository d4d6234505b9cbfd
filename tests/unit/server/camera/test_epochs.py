"""Epochs: a key and a name each, never twice, and nothing left of them once nobody uses them."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest

from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.commitments import mask_commitment
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, SealedEmbedding
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_optics.keys.masks import draw_levels
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import MaskedCapture
from veilcam_server.camera.epochs import Epoch, Preparation
from veilcam_server.devices import DisplayError, SensorError
from veilcam_server.errors import (
    ProblemError,
    SelfTestError,
    StorageError,
)
from veilcam_server.masks.fresh import FreshReader, FreshSource
from veilcam_server.masks.pairs import PairSource, load_pairs
from veilcam_server.masks.source import Mask

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

    from veilcam_training.bundle import Bundle

pytestmark = pytest.mark.numerical

PER_CAPTURE = EveryCaptures(captures=1)
RECEIVER = ReceiverKey.generate()


def pair_with(bench: Bench, key: ReceiverKey = RECEIVER) -> str:
    """Have epochs sealed to a receiver; gives its id."""
    return bench.receivers.add("archive", key.public).id


def pieces(mask: Mask) -> list[np.ndarray]:
    """All arrays that hold something of a mask."""
    reader = mask.reader
    assert isinstance(reader, FreshReader)
    decoder = reader.decoder
    arrays = (decoder.mean_measurement, decoder.estimator, decoder.noise, decoder.response)
    return [mask.levels, *arrays]


def is_whole(epoch: Epoch) -> bool:
    """Whether nothing of an epoch was overwritten."""
    return not epoch.erased and all(array.any() for array in pieces(epoch.mask))


def is_gone(epoch: Epoch) -> bool:
    """Whether nothing is left of it."""
    sealer = epoch.sealer
    return (
        epoch.erased
        and not any(array.any() for array in pieces(epoch.mask))
        and (sealer is None or not any(sealer._key))
    )


@pytest.fixture
def sealed_bench(fresh_bench: Bench) -> Bench:
    """Fresh masks, whose embeddings leave sealed to one receiver."""
    pair_with(fresh_bench)
    fresh_bench.release = "sealed"
    return fresh_bench


@pytest.fixture(params=["raw", "sealed"])
def either(request: pytest.FixtureRequest, fresh_bench: Bench) -> Bench:
    """Fresh masks, whose embeddings leave raw, or sealed to one receiver."""
    if request.param == "sealed":
        pair_with(fresh_bench)
    fresh_bench.release = request.param
    return fresh_bench


@pytest.fixture
def shown(either: Bench) -> Iterator[list[Epoch]]:
    """Every epoch that a source's preparation made, in their order."""
    made: list[Epoch] = []
    prepare = Preparation._epoch

    def noted(preparation: Preparation, *arguments: object) -> Epoch:
        made.append(prepare(preparation, *arguments))  # type: ignore[arg-type]
        return made[-1]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Preparation, "_epoch", noted)
        yield made


def active(camera: MaskedCamera) -> Epoch:
    """The epoch on the panel."""
    assert camera._panel.active is not None
    return camera._panel.active.epoch


def test_names_keys_and_masks_never_repeat(sealed_bench: Bench) -> None:
    with closing(sealed_bench.preparation()) as preparation:
        epochs = [preparation.take() for _ in range(30)]
    assert len({epoch.name for epoch in epochs}) == 30
    assert all(len(bytes.fromhex(epoch.name)) == 16 for epoch in epochs)
    assert len({epoch.mask.levels.tobytes() for epoch in epochs}) == 30
    assert len({bytes(epoch.sealer._key) for epoch in epochs if epoch.sealer}) == 30
    # A second daemon on a copy of this one's state draws others.
    with closing(sealed_bench.preparation()) as preparation:
        assert preparation.take().name not in {epoch.name for epoch in epochs}


def test_epoch_that_nobody_took_is_erased_at_the_end(sealed_bench: Bench) -> None:
    preparation = sealed_bench.preparation()
    preparation.begin()
    preparation.wait()
    waiting = preparation._next
    assert waiting is not None
    epoch = waiting.result()
    assert is_whole(epoch)
    preparation.close()
    assert is_gone(epoch)


def test_receiver_opens_the_key_and_finds_the_mask(
    sealed_bench: Bench, fresh_bundle: Bundle
) -> None:
    camera = sealed_bench.camera(policy=PER_CAPTURE)
    captured = camera.capture(release=True)
    assert captured.form == "sealed"
    embedding = captured.release(0.25)
    assert isinstance(embedding, SealedEmbedding)
    key = open_key(embedding.envelope, RECEIVER, device=sealed_bench.key.public)
    assert embedding.envelope.epoch == captured.epoch
    assert embedding.envelope.bundle == fresh_bundle.digest
    assert fresh_bundle.fresh is not None
    levels = draw_levels(
        key.levels(), camera=fresh_bundle.camera, distribution=fresh_bundle.fresh.distribution
    )
    assert np.array_equal(levels, sealed_bench.display.shown[-1])
    assert captured.provenance.mask == mask_commitment(key, levels)
    answer = Capture(
        id="c0ffee00c0ffee00",
        epoch=captured.epoch,
        number=captured.number,
        taken_at=captured.taken_at,
        embedding=embedding,
    )
    opened = Opener(RECEIVER, sealed_bench.key.public).open(answer)
    assert np.array_equal(np.asarray(opened), sealed_bench.sensor.measurement)
    assert opened.notes is not None
    assert opened.notes.timing.queue_s == 0.25
    assert opened.notes.exposure == captured.exposure
    captured.done()
    camera.stop()


def test_key_is_gone_before_its_mask_is_shown(
    sealed_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[EpochKey, bytes]] = []
    make = FreshSource.make

    def noted(source: FreshSource, key: EpochKey, *more: object) -> Mask:
        mask = make(source, key, *more)  # type: ignore[arg-type]
        drawn.append((key, bytes(key.reveal())))
        return mask

    monkeypatch.setattr(FreshSource, "make", noted)
    with closing(sealed_bench.preparation()) as preparation:
        preparation.take()
        ((key, value),) = drawn
        assert any(value)
        assert not any(key._value)
        with pytest.raises(ValueError, match="was erased"):
            key.reveal()


@pytest.mark.parametrize("step", ["make", "seal"])
def test_preparation_that_fails_leaves_no_key_and_no_mask(
    sealed_bench: Bench, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    keys: list[EpochKey] = []
    masks: list[Mask] = []
    make = FreshSource.make

    def noted(source: FreshSource, key: EpochKey, *more: object) -> Mask:
        keys.append(key)
        if step == "make":
            raise ZeroDivisionError
        masks.append(make(source, key, *more))  # type: ignore[arg-type]
        return masks[-1]

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(FreshSource, "make", noted)
    if step == "seal":
        monkeypatch.setattr("veilcam_server.camera.epochs.seal_key", fail)
    with closing(sealed_bench.preparation()) as preparation, pytest.raises(ZeroDivisionError):
        preparation.take()
    assert not any(keys[0]._value)
    assert all(is_gone_mask(mask) for mask in masks)
    assert len(masks) == (step != "make")


def is_gone_mask(mask: Mask) -> bool:
    """Whether nothing is left of a mask."""
    return not any(array.any() for array in pieces(mask))


def test_epoch_is_erased_once_it_is_retired_and_nobody_uses_it(sealed_bench: Bench) -> None:
    with closing(sealed_bench.preparation()) as preparation:
        epoch, other = preparation.take(), preparation.take()
        epoch.hold()
        epoch.hold()
        epoch.retire()
        epoch.let_go()
        assert is_whole(epoch)
        epoch.let_go()
        assert is_gone(epoch)
        epoch.retire()  # twice does no harm
        other.hold()
        other.let_go()
        assert is_whole(other)
        other.retire()
        assert is_gone(other)


def test_stored_mask_outlives_its_epochs(bench: Bench) -> None:
    with closing(bench.preparation()) as preparation:
        epoch = preparation.take()
    levels = epoch.mask.levels.copy()
    epoch.retire()
    assert epoch.erased
    assert levels.any()
    assert np.array_equal(epoch.mask.levels, levels)


def test_mask_before_is_erased_when_another_is_shown(either: Bench, shown: list[Epoch]) -> None:
    camera = either.camera()
    for number in range(1, 4):
        assert active(camera) is shown[number - 1]
        assert is_whole(shown[number - 1])
        camera.rotate()
        assert is_gone(shown[number - 1])
        assert is_whole(active(camera))
    camera.stop()
    assert all(is_gone(epoch) for epoch in shown)  # the one prepared in advance, too


def test_capture_in_flight_is_read_by_its_own_reader_and_then_its_mask_goes(
    either: Bench, shown: list[Epoch]
) -> None:
    camera = either.camera()
    captured = camera.capture(release=True)
    expected = shown[0].mask.reader.classify(captured.measurement)
    for _ in range(3):
        camera.rotate()
    assert is_whole(shown[0])
    assert is_gone(shown[1])
    assert captured.classify() == expected
    embedding = captured.release(0.0)
    assert embedding.form == either.release
    captured.done()
    assert is_gone(shown[0])
    captured.done()  # twice does no harm, and lets go of nobody else's use
    assert shown[0]._uses == 0
    camera.stop()


def test_exposure_that_fails_lets_go_of_its_mask(either: Bench, shown: list[Epoch]) -> None:
    camera = either.camera()

    def fail() -> None:
        raise SensorError("no frame")

    either.sensor.before = fail
    with pytest.raises(SensorError):
        camera.capture(release=False)
    assert is_whole(shown[0])
    with pytest.raises(SensorError):  # the second one in a row: the sensor is given up
        camera.capture(release=False)
    assert is_gone(shown[0])
    camera.stop()


def test_mask_that_is_put_back_is_whole_and_the_one_that_failed_is_gone(
    either: Bench, shown: list[Epoch], display_fault: DisplayError
) -> None:
    camera = either.camera()
    either.display.faults = [display_fault]
    with pytest.raises(DisplayError):
        camera.rotate()
    assert active(camera) is shown[0]
    assert is_whole(shown[0])
    assert is_gone(shown[1])
    camera.capture(release=False).classify()
    either.display.resets += 1  # it is tested, and put back once more
    camera.test_if_due()
    assert active(camera) is shown[0]
    assert is_whole(shown[0])
    camera.stop()


@pytest.mark.parametrize("faults", [2, 3])
def test_mask_that_cannot_be_put_back_is_gone(
    either: Bench, shown: list[Epoch], faults: int
) -> None:
    camera = either.camera()
    either.display.faults = [DisplayError("no answer")] * faults
    with pytest.raises(DisplayError):
        camera.rotate()
    assert is_gone(shown[0])
    assert is_gone(shown[1])
    camera.stop()


@pytest.mark.parametrize("by", ["rotation", "test"])
def test_panel_that_fails_its_test_loses_its_mask(
    either: Bench, shown: list[Epoch], by: str
) -> None:
    camera = either.camera()
    either.display.resets += 1
    either.test.faults = [SelfTestError("it lets light through")]
    with pytest.raises(SelfTestError):
        camera.rotate() if by == "rotation" else camera.test_if_due()
    assert is_gone(shown[0])
    camera.rotate()
    assert is_whole(active(camera))
    camera.stop()


def test_camera_that_is_lent_has_no_mask_left(either: Bench, shown: list[Epoch]) -> None:
    camera = either.camera()
    with camera.exclusive():
        assert is_gone(shown[0])
    assert is_whole(active(camera))
    camera.stop()


def test_another_bundle_takes_all_masks_of_the_one_before_along(
    either: Bench, shown: list[Epoch], fresh_bundle: Bundle
) -> None:
    camera = either.camera()
    camera.await_next()
    other = FreshSource(fresh_bundle)
    first = camera.first_of(other)
    camera.change_source(other, first)
    assert active(camera) is first
    assert is_whole(first)
    assert is_gone(shown[0])
    assert is_gone(shown[1])
    # One that cannot be shown is gone, too.
    third = camera.first_of(other)
    either.display.faults = [DisplayError("no answer")]
    with pytest.raises(DisplayError):
        camera.change_source(other, third)
    assert is_gone(third)
    assert is_whole(first)
    camera.stop()
    assert is_gone(first)


def test_first_epoch_that_is_refused_is_gone(either: Bench, shown: list[Epoch]) -> None:
    camera = either.camera()
    first = camera.first_of(either.source)
    camera.stop()
    with suppress(Exception):
        camera.change_source(either.source, first)
    assert is_gone(first)
    assert shown


def test_receivers_hold_from_the_next_mask_on(sealed_bench: Bench) -> None:
    camera = sealed_bench.camera()
    camera.await_next()
    other = ReceiverKey.generate()
    added = pair_with(sealed_bench, other)
    prepared = camera.preparation._next
    assert prepared is not None
    camera.renew()
    assert is_gone(prepared.result())
    assert receivers(camera) == {RECEIVER.public.id}
    camera.rotate()
    assert receivers(camera) == {RECEIVER.public.id, added}
    sealed_bench.receivers.remove(RECEIVER.public.id)
    camera.renew()
    camera.rotate()
    assert receivers(camera) == {added}
    camera.stop()


def test_first_epoch_of_another_bundle_is_not_shown_to_who_was_removed_meanwhile(
    sealed_bench: Bench, fresh_bundle: Bundle
) -> None:
    camera = sealed_bench.camera()
    other = FreshSource(fresh_bundle)
    first = camera.first_of(other)
    kept = pair_with(sealed_bench, ReceiverKey.generate())
    sealed_bench.receivers.remove(RECEIVER.public.id)
    camera.renew()
    camera.change_source(other, first)
    assert is_gone(first)
    assert is_whole(active(camera))
    assert receivers(camera) == {kept}
    camera.stop()


def test_removed_receiver_gets_nothing_more_behind_a_mask_that_stays(
    sealed_bench: Bench,
) -> None:
    camera = sealed_bench.camera()
    before = active(camera)
    camera.capture(release=True).done()
    assert active(camera) is before
    kept = pair_with(sealed_bench, ReceiverKey.generate())
    sealed_bench.receivers.remove(RECEIVER.public.id)
    camera.renew()
    # A label leaves behind the same mask; what is sealed does not.
    camera.capture(release=False).done()
    assert active(camera) is before
    camera.capture(release=True).done()
    assert receivers(camera) == {kept}
    assert is_gone(before)
    after = active(camera)
    camera.capture(release=True).done()
    assert active(camera) is after
    camera.stop()


def receivers(camera: MaskedCamera) -> set[str]:
    """To whom the epoch on the panel is sealed."""
    sealer = active(camera).sealer
    assert sealer is not None
    return {each.receiver for each in sealer._envelope.keys}


def test_one_that_is_being_prepared_when_it_is_discarded_is_gone_when_it_is_ready(
    sealed_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside, go_on = threading.Event(), threading.Event()
    make = FreshSource.make

    def slow(source: FreshSource, *arguments: object) -> Mask:
        inside.set()
        assert go_on.wait(200)
        return make(source, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(FreshSource, "make", slow)
    with closing(sealed_bench.preparation()) as preparation:
        future = preparation.begin()
        assert inside.wait(200)
        preparation.discard()
        go_on.set()
        after = preparation.take()
        assert is_gone(future.result())
        assert is_whole(after)


def test_numbers_count_every_exposure_and_no_pair_comes_twice(sealed_bench: Bench) -> None:
    camera = sealed_bench.camera()
    seen: list[tuple[str, int]] = []

    def take() -> MaskedCapture:
        captured = camera.capture(release=True)
        seen.append((captured.epoch, captured.number))
        return captured

    assert [take().number for _ in range(2)] == [0, 1]
    sealed_bench.sensor.early = 1e-4
    with suppress(Exception):
        camera.capture(release=True)
    sealed_bench.sensor.early = 0.0
    assert take().number == 3

    def fail() -> None:
        raise SensorError("no frame")

    sealed_bench.sensor.before = fail
    with pytest.raises(SensorError):
        camera.capture(release=True)
    sealed_bench.sensor.before = lambda: None
    assert take().number == 5
    sealed_bench.display.faults = [DisplayError("no answer")]
    with pytest.raises(DisplayError):
        camera.rotate()
    assert take().number == 6  # the mask that was put back goes on counting
    camera.rotate()
    assert take().number == 0
    assert len(set(seen)) == len(seen)
    camera.stop()


def test_captures_are_timed_to_the_second(sealed_bench: Bench) -> None:
    camera = sealed_bench.camera()
    before = datetime.now(UTC)
    taken = camera.capture(release=False).taken_at
    assert taken.microsecond == 0
    assert taken.tzinfo is UTC
    assert -1 < (taken - before).total_seconds() <= 1
    camera.stop()


def test_embedding_that_was_not_to_leave_does_not(either: Bench) -> None:
    camera = either.camera()
    captured = camera.capture(release=False)
    assert captured.form is None
    with pytest.raises(ValueError, match="nothing was to leave"):
        captured.release(0.0)
    captured.classify()
    camera.stop()


def test_budget_of_one_changes_the_mask_for_every_embedding_and_labels_are_free(
    fresh_bench: Bench,
) -> None:
    """Whatever the policy: here masks do not rotate by themselves."""
    camera = fresh_bench.camera()
    epochs = []
    for _ in range(4):
        captured = camera.capture(release=True)
        assert np.asarray(captured.release(0.0)).shape == fresh_bench.bundle.embedding.shape
        epochs.append(captured.epoch)
        # Labels behind the mask that is spent: as many as one likes.
        assert {camera.capture(release=False).epoch for _ in range(3)} == {captured.epoch}
    assert len(set(epochs)) == 4
    camera.stop()


def test_reuse_does_not_stretch_a_budget(
    fresh_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = fresh_bench.camera(policy=EveryCaptures(captures=1, reuse=100))
    camera.await_next()
    gate, make = threading.Event(), FreshSource.make

    def slow(source: FreshSource, *arguments: object) -> Mask:
        assert gate.wait(200)
        return make(source, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(FreshSource, "make", slow)
    first = [camera.capture(release=True).epoch for _ in range(2)]
    # The third mask is not ready: a label may have the second one again, an embedding may not.
    assert camera.capture(release=False).epoch == first[1]
    taken: list[str] = []
    waiting = threading.Thread(target=lambda: taken.append(camera.capture(release=True).epoch))
    waiting.start()
    waiting.join(0.05)
    assert waiting.is_alive()
    gate.set()
    waiting.join(200)
    assert taken
    assert taken[0] not in first
    camera.stop()


def test_stored_masks_release_as_much_as_they_may_and_then_nothing_more(bench: Bench) -> None:
    bench.raw_budget = 2
    camera = bench.camera()
    behind: dict[int | None, int] = {}
    for _ in range(6):
        camera.capture(release=True).release(0.0)
        behind[bench.pair_shown()] = behind.get(bench.pair_shown(), 0) + 1
    assert behind == {0: 2, 1: 2, 2: 2}
    exposures, masks = bench.sensor.captures, len(bench.epochs)
    for _ in range(3):
        with pytest.raises(ProblemError, match="install another bundle"):
            camera.capture(release=True)
    assert (bench.sensor.captures, len(bench.epochs)) == (exposures, masks)
    for _ in range(5):  # labels go on, and masks change
        camera.capture(release=False).classify()
        before = bench.pair_shown()
        camera.rotate()
        assert bench.pair_shown() != before
    camera.stop()
    # Also after a restart, and for whoever says that more may leave.
    camera = bench.camera()
    with pytest.raises(ProblemError):
        camera.capture(release=True)
    camera.stop()
    bench.raw_budget = 3
    camera = bench.camera()
    for _ in range(3):
        camera.capture(release=True)
    with pytest.raises(ProblemError):
        camera.capture(release=True)
    camera.stop()


def test_while_any_mask_may_release_something_those_that_are_spent_wait(bench: Bench) -> None:
    bench.raw_budget = 1
    with closing(bench.preparation()) as preparation:
        spent = [mask for mask in bench.source._masks if not preparation.spent][:2]  # type: ignore[attr-defined]
        for mask in spent:
            preparation.budget.spend(mask, "raw")
        assert {preparation.take().mask.mark for _ in range(20)} == bench.source.marks - {
            mask.mark for mask in spent
        }
        assert not preparation.spent
        (last,) = bench.source.marks - {mask.mark for mask in spent}
        preparation.last_mark = last  # it is shown: another one comes all the same
        assert {preparation.take().mask.mark for _ in range(20)} == {mask.mark for mask in spent}
        preparation.budget.spend(Mask(np.ones(1, np.uint8), None, last), "raw")  # type: ignore[arg-type]
        assert preparation.spent


def test_embedding_whose_count_cannot_be_written_stays(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.raw_budget = 1
    camera = bench.camera()

    def full(*_: object) -> None:
        raise StorageError("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(ReleaseBudget, "_record", full)
        with pytest.raises(StorageError):
            camera.capture(release=True)
    assert active(camera)._uses == 0
    assert camera.capture(release=True).form == "raw"
    camera.stop()


@pytest.mark.parametrize("broken", ["early", "light"])
def test_exposure_of_which_nothing_leaves_costs_no_budget(bench: Bench, broken: str) -> None:
    bench.raw_budget = 1
    camera = bench.camera()
    if broken == "early":
        bench.sensor.early = 1e-4
    else:
        bench.sensor.measurement = np.full_like(bench.sensor.measurement, math.nan)
    with suppress(Exception):
        camera.capture(release=True)
    assert not (bench.state_dir / "released.json").exists()
    camera.stop()


def test_nothing_leaves_where_nothing_is_released_or_nobody_receives(fresh_bench: Bench) -> None:
    fresh_bench.release = "none"
    camera = fresh_bench.camera()
    with pytest.raises(ProblemError, match="--release"):
        camera.capture(release=True)
    fresh_bench.release = "sealed"
    camera.renew()
    with pytest.raises(ProblemError, match="veilcam receiver add"):
        camera.capture(release=True)
    assert fresh_bench.sensor.captures == 0
    # As soon as somebody receives, a mask is shown that is sealed to them.
    added = pair_with(fresh_bench)
    camera.renew()
    captured = camera.capture(release=True)
    assert isinstance(captured.release(0.0), SealedEmbedding)
    assert receivers(camera) == {added}
    camera.stop()


def test_lone_mask_has_a_new_epoch_where_other_terms_hold(lone_bench: Bench) -> None:
    lone_bench.release = "none"
    camera = lone_bench.camera()
    first = camera.present[0]
    pair_with(lone_bench)
    lone_bench.release = "sealed"
    camera.renew()
    captured = camera.capture(release=True)
    assert captured.epoch != first
    assert lone_bench.pair_shown() == 0
    assert isinstance(captured.release(0.0), SealedEmbedding)
    camera.stop()


def test_form_of_an_epoch_is_that_of_its_preparation(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    camera.await_next()
    pair_with(fresh_bench)
    fresh_bench.release = "sealed"
    # The first of the two was prepared before.
    assert [camera.capture(release=True).form for _ in range(2)] == ["raw", "sealed"]
    camera.stop()


def test_marks_are_kept_of_stored_masks_alone(fresh_bench: Bench, bundle: Bundle) -> None:
    assert fresh_bench.source.marks == frozenset()
    source = load_pairs(bundle)
    assert isinstance(source, PairSource)
    assert len(source.marks) == len(bundle.pairs)
    with closing(fresh_bench.preparation()) as preparation:
        assert not preparation.spent
