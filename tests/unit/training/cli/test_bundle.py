"""``veilcam-train bundle`` end to end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import BUNDLE
from veilcam_training.bundle import (
    BundleError,
    LightPlan,
    OwnerKey,
    TransferError,
    read_bundle,
    write_bundle,
)
from veilcam_training.cli.main import app


def run(*words: str | Path) -> str:
    result = CliRunner().invoke(app, ["bundle", *map(str, words)])
    if result.exception is not None:
        raise result.exception
    return result.output


def test_key_is_made_and_a_bundle_signed(tmp_path: Path) -> None:
    key, file = tmp_path / "owner.pem", tmp_path / "a.veilcam"
    file.write_bytes(BUNDLE.read_bytes())
    line = run("keygen", key).splitlines()[-1]
    owner = OwnerKey.parse(line.split()[0])
    assert line.split()[1] == owner.short
    said = run("sign", file, "--key", key, "--version", "3")
    bundle = read_bundle(file)
    assert (bundle.version, bundle.owner) == (3, owner)
    assert f"version 3, {bundle.digest[:12]}, signed by" in said
    assert line in said
    secret = key.read_text().splitlines()[1]
    assert secret not in said
    assert "version 4" in run("version", file, "--version", "4")
    assert (read_bundle(file).version, read_bundle(file).owner) == (4, None)


def test_bundle_that_cannot_be_signed_is_named(tmp_path: Path) -> None:
    key, file = tmp_path / "owner.pem", tmp_path / "a.veilcam"
    run("keygen", key)
    with pytest.raises(BundleError, match="there is no such file"):
        run("sign", file, "--key", key, "--version", "1")
    file.write_bytes(BUNDLE.read_bytes())
    with pytest.raises(BundleError, match="was left alone"):
        run("keygen", key)
    with pytest.raises(SystemExit):
        run("sign", file, "--key", key, "--version", "0")


def test_bundle_is_shown(tmp_path: Path) -> None:
    file, key = tmp_path / "a.veilcam", tmp_path / "owner.pem"
    bundle = read_bundle(BUNDLE)
    assert bundle.accuracy is not None
    error = TransferError(6.2e-4, 4.1e-4, 9.3e-4, 0.9)
    pairs = tuple(replace(pair, transfer_error=error) for pair in bundle.pairs)
    light = LightPlan(3e-3, 1.7e-3, True, "transfer", True, Reach(0, 1), 1, 1.7e-6, "float32")
    write_bundle(file, replace(bundle, pairs=pairs, light=light))
    said = run("show", file)
    rows, columns = bundle.embedding.shape
    assert f"{bundle.task}, {rows}x{columns}, mode pairs, {len(pairs)} masks" in said
    assert f"version 0, {read_bundle(file).digest[:12]}\nnot signed\n" in said
    assert f"accuracy {100 * bundle.accuracy.value:.2f} % on {bundle.accuracy.test_set}" in said
    planned = "light: planned to 3.0e-03, predicted error 1.7e-03 (reached), 1 zone, "
    assert f"{planned}reach 0 rows 1 columns; worst mask by check: error {error}\n" in said
    bare = tuple(replace(pair, transfer_error=None) for pair in bundle.pairs)
    write_bundle(file, replace(bundle, pairs=bare, light=None, hiding=None))
    assert "light: not planned\nhiding: not measured\n" in run("show", file)
    owner = run("keygen", key).splitlines()[-1]
    run("sign", file, "--key", key, "--version", "3")
    assert f"version 3, {read_bundle(file).digest[:12]}\n{owner}\n" in run("show", file)
