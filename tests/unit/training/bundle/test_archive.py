"""A bundle comes back as it was written, and a bad one is refused whole, with the reason."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import math
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tests.unit.training.bundle.conftest import (
    edit_manifest,
    edit_tensors,
    pack,
    refuse,
    replace_part,
    unpack,
)

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle import (
    Accuracy,
    Bundle,
    BundleError,
    LightPlan,
    Pair,
    TransferError,
    archive,
    read_bundle,
    write_bundle,
)
from veilcam_training.bundle.classifier import count_operations
from veilcam_training.bundle.layers import (
    GELU,
    BatchNorm,
    Conv2d,
    Flatten,
    LayerRecord,
    Linear,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.models.network import build_classifier, build_untrained, weights_of


def make_pair(seed: int) -> Pair:
    generator = torch.Generator().manual_seed(seed)
    layers: tuple[LayerRecord, ...] = (
        BatchNorm(features=12),
        ReLU(),
        Linear(inputs=12, outputs=10),
    )
    weights = {
        name: torch.rand(array.shape, generator=generator).numpy() if array.ndim else array
        for name, array in weights_of(build_untrained(layers)).items()
    }
    levels = torch.randint(0, 64, Camera().mask_shape, generator=generator, dtype=torch.uint8)
    error = TransferError(1e-3 * seed, 5e-4 * seed, 2e-3 * seed, 0.9)
    return Pair(levels=levels.numpy(), layers=layers, weights=weights, transfer_error=error)


def make_bundle() -> Bundle:
    return Bundle(
        task="mnist",
        labels=tuple("0123456789"),
        camera=Camera(panel=Panel(filter_leakage=0.05)),
        scene=Scene(),
        embedding=Embedding(3, 4, fill=0.2),
        mode="pairs",
        pairs=(make_pair(1), make_pair(2)),
        provenance={"seed": 1, "recipe": {"epochs": 2, "rates": [0.1, None]}},
        accuracy=Accuracy(0.9, "MNIST", 10_000),
        light=LightPlan(3e-3, 1.3e-3, True, "transfer", True, Reach(0, 1), 2, 1.7e-6, "float32"),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    result = tmp_path / "a.veilcam"
    write_bundle(result, make_bundle())
    return result


def test_bundle_comes_back_as_it_was_written(path: Path) -> None:
    written, read = make_bundle(), read_bundle(path)
    assert read.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert dataclasses.replace(read, pairs=(), digest="", subject="") == dataclasses.replace(
        written, pairs=()
    )
    for before, after in zip(written.pairs, read.pairs, strict=True):
        np.testing.assert_array_equal(before.levels, after.levels)
        assert before.layers == after.layers
        assert before.transfer_error == after.transfer_error
        assert before.weights.keys() == after.weights.keys()
        for name, array in before.weights.items():
            np.testing.assert_array_equal(array, after.weights[name], strict=True)


def test_same_bundle_gives_the_same_bytes_readable_by_the_owner_alone(path: Path) -> None:
    first = path.read_bytes()
    write_bundle(path, make_bundle())
    assert path.read_bytes() == first
    assert path.stat().st_mode & 0o077 == 0
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_error_of_a_bundle_is_its_worst_pair_s() -> None:
    bundle = make_bundle()
    assert bundle.transfer_error == bundle.pairs[1].transfer_error
    assert str(bundle.transfer_error) == "0.002 (0.001 to 0.004 with a confidence of 90 %)"
    unknown = dataclasses.replace(bundle.pairs[0], transfer_error=None)
    mixed = dataclasses.replace(bundle, pairs=(unknown, bundle.pairs[1]))
    assert mixed.transfer_error is None


def test_bundle_whose_errors_are_unknown_is_as_it_was_before_they_were_measured(
    path: Path,
) -> None:
    bundle = make_bundle()
    pairs = tuple(dataclasses.replace(pair, transfer_error=None) for pair in bundle.pairs)
    write_bundle(path, dataclasses.replace(bundle, pairs=pairs, light=None))
    told = json.loads(unpack(path)["bundle.json"])
    assert "light" not in told
    assert [set(pair) for pair in told["pairs"]] == 2 * [{"layers"}]
    assert [pair.transfer_error for pair in read_bundle(path).pairs] == [None, None]
    assert read_bundle(path).light is None


def test_classifier_is_the_module_that_was_trained() -> None:
    torch.manual_seed(0)
    pair = make_pair(3)
    module = build_untrained(pair.layers)
    module.load_state_dict({n: torch.from_numpy(a.copy()) for n, a in pair.weights.items()})
    x = torch.rand(5, 12)
    built = build_classifier(pair.layers, pair.weights)
    assert not built.training
    torch.testing.assert_close(built(x), module.eval()(x), rtol=0, atol=0)
    pair.weights["2.bias"][...] += 1  # the classifier holds a copy
    torch.testing.assert_close(built(x), module(x), rtol=0, atol=0)


def test_secrets_are_not_in_the_repr(path: Path) -> None:
    shown = repr(read_bundle(path))
    assert "array" not in shown
    assert "tensor" not in shown


def test_missing_file(tmp_path: Path) -> None:
    refuse(tmp_path / "none.veilcam", "no such file: check the path")
    refuse(tmp_path, "cannot be read")


@pytest.mark.parametrize("name", ["masks.safetensors", "weights.safetensors"])
def test_tampered_part(path: Path, name: str) -> None:
    parts = unpack(path)
    pack(path, {**parts, name: parts[name][:-1] + bytes([parts[name][-1] ^ 1])})
    refuse(path, f"{name} is not what bundle.json says")


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.9, 0.999])
def test_truncated(path: Path, kept: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    refuse(path, "not a whole bundle")


def test_every_flipped_byte_is_noticed_or_harmless(path: Path) -> None:
    data, reference = path.read_bytes(), read_bundle(path)
    for place in range(0, len(data), 97):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            bundle = read_bundle(path)
        except BundleError:
            continue
        # A byte of the archive's own bookkeeping (a time, say): the content is untouched.
        assert bundle.digest != reference.digest
        for before, after in zip(reference.pairs, bundle.pairs, strict=True):
            np.testing.assert_array_equal(before.levels, after.levels)


@pytest.mark.parametrize(
    ("part", "change", "reason"),
    [
        (
            "weights",
            lambda t: t["pair.1.2.weight"][3].fill_(math.nan),
            "pair 1: .*'2.weight' holds",
        ),
        ("weights", lambda t: t["pair.1.2.weight"][3].fill_(math.inf), "NaN or infinity"),
        ("weights", lambda t: t["pair.0.0.running_var"][0].fill_(-1), "negative variance"),
        ("weights", lambda t: t.pop("pair.0.2.bias"), "pair 0: weights lack '2.bias'"),
        ("weights", lambda t: t.update({"pair.0.9.bias": torch.ones(1)}), "unknown '9.bias'"),
        ("weights", lambda t: t.update({"pair.7.2.bias": torch.ones(1)}), "there are 2 pairs"),
        ("weights", lambda t: t.update({"../evil": torch.ones(1)}), "unknown '../evil'"),
        ("weights", lambda t: t.update({"pair.0.2.bias": torch.ones(9)}), r"use float32 \(10,\)"),
        ("weights", lambda t: t.update({"pair.0.2.bias": torch.ones(10).double()}), "use float32"),
        ("masks", lambda t: t["pair.1.levels"].fill_(64), "pair 1: mask.*what the panel can show"),
        ("masks", lambda t: t.update({"pair.1.levels": t["pair.1.levels"][:22]}), "use uint8"),
        ("masks", lambda t: t.update({"pair.1.levels": t["pair.1.levels"].float()}), "use uint8"),
        ("masks", lambda t: t.pop("pair.1.levels"), "one mask for each of 2 pairs"),
    ],
)
def test_tensors_that_do_not_fit(
    path: Path, part: str, change: Callable[[dict[str, torch.Tensor]], object], reason: str
) -> None:
    edit_tensors(path, part, change)
    refuse(path, reason)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"pickle", "not a safetensors file"),
        # Of a small file, which unpacks to much.
        (bytes(17 * 2**20), "weights.safetensors has .* bytes: use at most"),
    ],
)
def test_part_that_is_no_safetensors(path: Path, data: bytes, reason: str) -> None:
    replace_part(path, "weights.safetensors", data)
    refuse(path, reason)


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda m: m.update(version=2), "version 2 is unknown: this Veilcam reads version 1"),
        (lambda m: m.update(version=True), "version True is unknown"),
        (lambda m: m.update(format="other"), "is this a Veilcam bundle"),
        (lambda m: m.update(surprise=1), "surprise"),
        (lambda m: m["camera"]["panel"].update(colour="red"), "camera.panel.colour: Unexpected"),
        (lambda m: m["camera"].update(distance=-1.0), "camera.distance"),
        (lambda m: m["camera"].update(distance="4 mm"), "camera.distance"),
        (lambda m: m["embedding"].update(rows=0), "embedding.rows"),
        (lambda m: m["embedding"].update(fill=0.0), "embedding.fill"),
        (lambda m: m["embedding"].update(rows=4), "layer 0 .batch_norm. gets shape .16,."),
        (lambda m: m.update(mode="fresh"), "mode"),
        (lambda m: m.update(labels=["a", "b"]), r"shape \(10,\) .* for 2 labels"),
        (lambda m: m.update(labels=["a", "a"]), "different names"),
        (lambda m: m.update(pairs=[]), "0 pairs|one mask for each of 0"),
        (lambda m: m["parts"].pop("masks.safetensors"), "lacks the digest"),
        (lambda m: m["parts"].update({"scene_stats.safetensors": 64 * "0"}), "lacks the digest"),
        (lambda m: m["accuracy"].update(value=93.0), "accuracy.value"),
        (lambda m: m["pairs"][0]["transfer_error"].update(low=2.0), "transfer_error"),
        (lambda m: m["pairs"][0]["transfer_error"].update(high=1e-4), "transfer_error"),
        (lambda m: m["pairs"][0]["transfer_error"].update(confidence=90.0), "transfer_error"),
        (lambda m: m["pairs"][0]["transfer_error"].update(mask=[1]), "transfer_error"),
        (lambda m: m["light"].update(tolerance=1.0), "light"),
        (lambda m: m["light"].update(error=-1e-3), "light"),
        (lambda m: m["light"].update(method="grid"), "light.method"),
        (lambda m: m["light"]["reach"].update(rows=-1), "light"),
        (lambda m: m["pairs"][0]["layers"][1].update(kind="pickle"), "pickle"),
        (lambda m: m["pairs"][0]["layers"][2].update(outputs=10**9), "outputs"),
        (lambda m: m["pairs"][0]["layers"][2].update(outputs=11), "11,"),
        (lambda m: m["pairs"][0]["layers"][2].update(hook="os.system"), "hook"),
        (lambda m: m["pairs"][0].update(layers=[]), "0 layers"),
    ],
)
def test_bad_manifests(path: Path, edit: Callable[[dict[str, Any]], None], reason: str) -> None:
    edit_manifest(path, edit)
    refuse(path, reason)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"format": NaN}', '{"format": 1, "format": 2}', "[" * 9**5]
)
def test_manifests_that_are_no_json(path: Path, text: str) -> None:
    pack(path, {**unpack(path), "bundle.json": text.encode()})
    refuse(path, "bundle.json is not")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *((name, "unknown part") for name in ("../../etc/cron.d/x", "/etc/passwd", "code.py")),
        *((name, "unknown part") for name in ("masks.npy", "x\n" * 9000)),
        ("scene_stats.safetensors", "has the parts masks.safetensors, weights.safetensors only"),
    ],
)
def test_parts_that_a_bundle_does_not_have(path: Path, name: str, reason: str) -> None:
    pack(path, {**unpack(path), name: b"x"})
    refuse(path, reason)
    with pytest.raises(BundleError) as caught:
        read_bundle(path)
    assert len(str(caught.value)) < 500


def test_part_twice_and_a_part_too_few(path: Path) -> None:
    parts = unpack(path)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as file:
        file.writestr("bundle.json", parts["bundle.json"])
    refuse(path, "once each")
    pack(path, {"bundle.json": parts["bundle.json"]})
    refuse(path, "once each")


def test_oversized_parts_and_files(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, size = unpack(path), path.stat().st_size
    # A bomb: it unpacks to far more than the archive is long.
    pack(path, {**parts, "bundle.json": b" " * (archive.MAX_PART["bundle.json"] + 1)})
    assert path.stat().st_size < 100_000
    refuse(path, "use at most")
    write_bundle(path, make_bundle())
    monkeypatch.setattr(archive, "MAX_FILE", size)
    read_bundle(path)
    monkeypatch.setattr(archive, "MAX_FILE", size - 1)
    refuse(path, f"has {size} bytes: a bundle has at most {size - 1}")


def test_bad_bundle_is_not_written_and_the_old_one_stays(path: Path) -> None:
    before = path.read_bytes()
    bad = dataclasses.replace(make_bundle(), labels=("a", "b"))
    with pytest.raises(BundleError, match="for 2 labels"):
        write_bundle(path, bad)
    with pytest.raises(BundleError, match="cannot be written"):
        write_bundle(path, dataclasses.replace(make_bundle(), provenance={"loss": float("nan")}))
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_figures_that_cannot_be() -> None:
    with pytest.raises(BundleError, match="use 0 to 1"):
        Accuracy(93.0, "MNIST", 10)
    with pytest.raises(BundleError, match="at least 1"):
        Accuracy(0.93, "MNIST", 0)
    with pytest.raises(BundleError, match="transfer_error"):
        TransferError(0.1, 0.05, math.inf, 0.9)


def heavy(*layers: LayerRecord) -> Bundle:
    """A bundle whose classifiers begin with ``layers`` on an image of 3 x 4."""
    around = (Reshape(shape=(1, 3, 4)), *layers, Flatten(), Linear(inputs=12, outputs=10))
    weights = {
        f"{index}.{name}": np.zeros(shape, dtype)
        for index, layer in enumerate(around)
        for name, (shape, dtype) in layer.parameters.items()
    }
    pair = dataclasses.replace(make_pair(1), layers=around, weights=weights)
    return dataclasses.replace(make_bundle(), pairs=(pair,))


@pytest.mark.parametrize(
    ("layers", "fitting", "too_many", "reason"),
    [
        (
            (*(Resize(rows=2048, columns=4096), GELU()) * 5, Resize(rows=3, columns=4)),
            *(1, 8, r"together take .* products: use at most"),
        ),
        ((ReLU(),) * 120, 0, 140, "too many layers: use 16384"),
        (
            (
                Resize(rows=256, columns=256),
                Conv2d(inputs=1, outputs=1, kernel=17, padding=8),
                Resize(rows=3, columns=4),
            ),
            *(0, 1, "numbers under its kernels"),
        ),
    ],
)
def test_classifiers_that_take_too_much_work(
    tmp_path: Path, layers: tuple[LayerRecord, ...], fitting: int, too_many: int, reason: str
) -> None:
    bundle = heavy(*layers)
    if fitting:
        write_bundle(tmp_path / "a.veilcam", bundle)
    with pytest.raises(BundleError, match=reason):
        write_bundle(
            tmp_path / "b.veilcam", dataclasses.replace(bundle, pairs=bundle.pairs * too_many)
        )


def test_products_are_counted() -> None:
    layers = (
        Reshape(shape=(1, 3, 4)),
        Residual(layers=(Conv2d(inputs=1, outputs=1),)),
        Flatten(),
        Linear(inputs=12, outputs=10),
    )
    values = 12 + (12 + 12) + 12 + 10
    assert count_operations(layers, 12) == 16 * values + 12 * 9 + 12 * 10


def test_limits_are_those_of_the_format() -> None:
    """As docs/bundle.md and the parts' table have them."""
    assert archive.MAX_FILE == 2**30
    assert {name: size / 2**20 for name, size in archive.MAX_PART.items()} == {
        "bundle.json": 8,
        "owner.json": 2**-8,
        "masks.safetensors": 256,
        "weights.safetensors": 1024,
        "scene_stats.safetensors": 256,
        "card.json": 1,
    }
    assert (archive.FREE, archive.RATIO) == (2**24, 4)


@pytest.mark.parametrize("name", ["bundle.json", "masks.safetensors", "weights.safetensors"])
def test_part_may_reach_its_limit(path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    size = len(unpack(path)[name])
    monkeypatch.setitem(archive.MAX_PART, name, size)
    assert read_bundle(path).labels == make_bundle().labels
    write_bundle(path, make_bundle())
    before = path.read_bytes()
    monkeypatch.setitem(archive.MAX_PART, name, size - 1)
    refuse(path, f"{name} has {size} bytes: use at most {size - 1}")
    with pytest.raises(BundleError, match=f"{name} has {size} bytes: use at most {size - 1}"):
        write_bundle(path, make_bundle())
    assert path.read_bytes() == before


def test_parts_together_may_unpack_to_so_much(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    together = sum(map(len, unpack(path).values()))
    monkeypatch.setattr(archive, "FREE", together - 4 * path.stat().st_size)
    read_bundle(path)
    monkeypatch.setattr(archive, "FREE", together - 4 * path.stat().st_size - 1)
    refuse(path, "use at most")


def test_part_that_is_longer_than_it_says_is_refused(path: Path) -> None:
    """Its size in the archive's directory is what somebody wrote there."""
    parts = unpack(path)
    parts["bundle.json"] += bytes(archive.MAX_PART["bundle.json"])
    pack(path, parts)
    size = len(parts["bundle.json"])
    data = path.read_bytes()
    directory = data.rindex(b"PK\x01\x02", 0, data.rindex(b"bundle.json"))
    place = data.index(size.to_bytes(4, "little"), directory)
    path.write_bytes(data[:place] + (100).to_bytes(4, "little") + data[place + 4 :])
    refuse(path, "not a whole bundle")


@pytest.mark.parametrize(
    ("method", "taken"),
    [
        *((zipfile.ZIP_STORED, True), (zipfile.ZIP_DEFLATED, True)),
        *((zipfile.ZIP_BZIP2, False), (zipfile.ZIP_LZMA, False)),
    ],
)
def test_parts_may_be_stored_or_deflated(path: Path, method: int, *, taken: bool) -> None:
    parts = unpack(path)
    with zipfile.ZipFile(path) as file:
        assert {entry.compress_type for entry in file.infolist()} == {zipfile.ZIP_DEFLATED}
    with zipfile.ZipFile(path, "w", method) as file:
        for name, data in parts.items():
            file.writestr(name, data)
    if taken:
        assert read_bundle(path).labels == make_bundle().labels
    else:
        refuse(path, "bundle.json is encrypted or oddly compressed")


def test_encrypted_part_is_refused(path: Path) -> None:
    data = bytearray(path.read_bytes())
    # The flags of the first entry, in its own header and in the archive's directory.
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(bytes(data))
    refuse(path, "bundle.json is encrypted")


def end_of(count: int, size: int, offset: int = 0) -> bytes:
    """An end of central directory record."""
    return struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, size, offset, 0)


def crowd(count: int, told: int | None = None) -> bytes:
    """An archive of so many empty parts, which tells of another number."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made:
        for number in range(count):
            made.writestr(zipfile.ZipInfo(f"{number}"), b"")
    whole = buffer.getvalue()
    return (
        whole if told is None else whole[:-22] + end_of(told, *struct.unpack("<2L", whole[-10:-2]))
    )


@pytest.mark.parametrize(
    "content",
    [
        *(crowd(7), crowd(1000), crowd(7, 3), crowd(1000, 6), crowd(30, 0), end_of(7, 0)),
        *(crowd(66_000), end_of(3, 2**32 - 1), end_of(65_535, 0)),
        pytest.param(crowd(3)[:-2] + b"\x04\x00more", id="comment"),
    ],
    ids=lambda content: f"{len(content)} bytes" if isinstance(content, bytes) else None,
)
def test_entries_are_counted_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    path = tmp_path / "crowd.veilcam"
    path.write_bytes(content)
    monkeypatch.setattr(zipfile, "ZipFile", Mock(side_effect=AssertionError("the archive is read")))
    with pytest.raises(BundleError, match=r"more entries than the 6|not a whole bundle"):
        read_bundle(path)


@pytest.mark.parametrize("length", [300, 301])
def test_reason_has_300_letters(path: Path, monkeypatch: pytest.MonkeyPatch, length: int) -> None:
    monkeypatch.setattr(archive, "_read", Mock(side_effect=BundleError("x" * length)))
    with pytest.raises(BundleError) as caught:
        read_bundle(path)
    assert str(caught.value) == f"{path}: {'x' * 300}{'...' if length > 300 else ''}"
