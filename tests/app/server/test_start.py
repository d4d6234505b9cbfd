"""Starts of a daemon in this process, and the reasons not to start."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import safetensors.numpy
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_server.daemon import build_service
from veilcam_server.devices.errors import DisplayError, SensorError
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_training.bundle import OwnerKey, read_bundle, sign_bundle, write_bundle

if TYPE_CHECKING:
    from collections.abc import Callable

    from veilcam_client.wire.captures import Capture
    from veilcam_training.bundle import Bundle


def settings(tmp_path: Path, bundle: Path, *scenes: Path, **more: Any) -> Settings:
    given = {"device": "simulated", "state_dir": tmp_path / "state", "bundle": bundle, **more}
    return Settings.model_validate({**given, "scenes": tuple(map(str, scenes))})


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


def unknown(path: Path) -> None:
    path.write_bytes(b"PNG or anything else")


def hiding_nothing(path: Path) -> None:
    bundle = read_bundle(path)
    pairs = tuple(
        dataclasses.replace(pair, levels=np.full_like(pair.levels, number))
        for number, pair in enumerate(bundle.pairs)
    )
    write_bundle(path, dataclasses.replace(bundle, pairs=pairs))


def not_a_number(path: Path) -> None:
    """Rebuilt with digests that fit, as somebody would who means it."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    weights = {k: v.copy() for k, v in safetensors.numpy.load(parts["weights.safetensors"]).items()}
    weights["pair.1.0.weight"][0, 0] = np.nan
    parts["weights.safetensors"] = safetensors.numpy.save(weights)
    manifest = json.loads(parts["bundle.json"])
    digest = hashlib.sha256(parts["weights.safetensors"]).hexdigest()
    manifest["parts"]["weights.safetensors"] = digest
    parts["bundle.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (truncated, "truncated"),
        (unknown, "not a whole bundle"),
        (Path.unlink, "no such file"),
        (not_a_number, "NaN"),
        (hiding_nothing, "^mask 0 shows pictures of the scene"),
    ],
)
def test_bundle_that_is_bad_is_refused(
    tmp_path: Path, bundle_file: Path, scene_file: Path, damage: Callable[[Path], None], reason: str
) -> None:
    damage(bundle_file)
    with pytest.raises(StartError, match=reason) as caught:
        build_service(settings(tmp_path, bundle_file, scene_file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("pairs", "given", "reason"),
    [
        (1, {"rotation": {"mode": "captures", "captures": 3}}, "one pair only"),
        (1, {"wrong_classifier": True}, "two or more pairs"),
        (3, {"release": "raw"}, "say with --raw-budget N how many"),
        (3, {"panel": "NONE"}, "--panel NONE has no driver: use ST7735R"),
    ],
)
def test_settings_that_the_bundle_cannot_serve_are_refused(
    tmp_path: Path,
    bundle: Bundle,
    scene_file: Path,
    *,
    pairs: int,
    given: dict[str, Any],
    reason: str,
) -> None:
    path = tmp_path / "some.veilcam"
    write_bundle(path, dataclasses.replace(bundle, pairs=bundle.pairs[:pairs]))
    with pytest.raises(StartError, match=reason):
        build_service(settings(tmp_path, path, scene_file, **given))


def test_device_that_is_not_there_is_never_replaced(tmp_path: Path, bundle_file: Path) -> None:
    given = Settings(device="pi", bundle=bundle_file, state_dir=tmp_path / "st")
    with pytest.raises(StartError, match=r"--panel-tab red, black or green, .* --simulate"):
        build_service(given)
    service = build_service(
        given.model_copy(update={"panel_tab": "green", "spi": Path("/dev/spidev9.9")})
    )
    status = service.status()
    assert (status.state, status.remedy, status.device.simulated) == ("safe", "run_doctor", False)
    reason = r"/dev/spidev9.9 cannot be opened|spidev is not installed"
    assert re.search(reason, status.detail or "")
    with pytest.raises(DisplayError, match=reason):
        service.stop()


@pytest.mark.slow
def test_start_that_fails_leaves_nothing_locked(
    tmp_path: Path, bundle_file: Path, scene_file: Path
) -> None:
    for _ in range(2):
        with pytest.raises(StartError, match=r"there is no scene file .* 'veilcamd show'"):
            build_service(settings(tmp_path, bundle_file, tmp_path / "nothing.npy"))
    service = build_service(settings(tmp_path, bundle_file, scene_file, wrong_classifier=True))
    assert service.status().experiment == "wrong-classifier"
    service.stop()


@pytest.mark.slow
def test_bundle_of_another_or_older_than_one_used_is_refused_where_there_are_owners(
    tmp_path: Path, bundle_file: Path, scene_file: Path
) -> None:
    key, owners = Ed25519PrivateKey.generate(), tmp_path / "owners"
    owners.write_text(f"{OwnerKey(key.public_key().public_bytes_raw())}\n")
    made = settings(tmp_path, bundle_file, scene_file, owner_keys=owners)
    with pytest.raises(StartError, match=r"^this bundle is not signed: this camera takes [^\n]*$"):
        build_service(made)
    for version in (2, 5):
        sign_bundle(bundle_file, version, key)
        service = build_service(made)
        try:
            assert service.status().bundle.version == version
        finally:
            service.stop()
    sign_bundle(bundle_file, 4, key)
    with pytest.raises(StartError, match="version 5 was in use already"):
        build_service(made)


@pytest.mark.slow
@pytest.mark.anyio
async def test_captures_each_see_the_next_scene(tmp_path: Path, bundle_file: Path) -> None:
    """And the self test, which takes nine measurements, sees one."""
    dark, light = tmp_path / "a.npy", tmp_path / "b.npy"
    for path, level in ((dark, 60), (light, 240)):
        write_scene(path, np.full((28, 28), level, np.uint8))
    still = {"settle": 0.0, "exposure": 0.0, "snr_db": float("inf"), "release": "raw"}
    made = settings(tmp_path, bundle_file, dark, light, raw_budget=9, **still)
    service = build_service(made)
    async with service.open():
        assert service.status().state == "ready"
        answers: list[Capture] = [await service.capture()]
        content = light.read_bytes()
        light.unlink()
        with pytest.raises(SensorError, match="there is no scene file"):
            await service.capture()
        light.write_bytes(content)
        # The capture that failed passed no scene over.
        answers += [await service.capture() for _ in range(2)]
        # One of which only a label leaves passes a scene over, too.
        await service.classify(include_embedding=False)
        answers.append(await service.capture())
    light_of = np.array([float(np.asarray(answer).mean()) for answer in answers])
    assert light_of / light_of[0] == pytest.approx([1.0, 4.0, 1.0, 1.0], rel=0.02)
