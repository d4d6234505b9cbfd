"""The key of a device: made once, its owner's alone, and never silently another."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from tests.unit.server.damage import DAMAGES

from veilcam_server.errors import ProblemError, StartError
from veilcam_server.sealing.identity import KEY_NAME, DeviceKey, _Seed
from veilcam_server.system.state_file import StateStore


@pytest.fixture
def key(tmp_path: Path) -> DeviceKey:
    return DeviceKey.open(tmp_path)


def test_key_is_made_at_the_first_start_and_stays(tmp_path: Path) -> None:
    state_dir = tmp_path / "state"
    faults: list[ProblemError] = []
    key = DeviceKey.open(state_dir, faults.append)
    assert state_dir.stat().st_mode & 0o777 == 0o700
    assert {each.name for each in state_dir.iterdir()} == {
        f"{KEY_NAME}{end}" for end in ("", ".copy", ".lock")
    }
    assert all(each.stat().st_mode & 0o777 == 0o600 for each in state_dir.iterdir())
    assert DeviceKey.open(state_dir, faults.append).public == key.public
    assert DeviceKey.open(tmp_path / "other").public != key.public
    assert not faults


def test_signature_is_checked_with_the_public_half(key: DeviceKey) -> None:
    public = Ed25519PublicKey.from_public_bytes(bytes.fromhex(key.public))
    signature = bytes.fromhex(key.sign(b"message"))
    public.verify(signature, b"message")
    with pytest.raises(InvalidSignature):
        public.verify(signature, b"another")


def test_key_is_shown_nowhere(tmp_path: Path, key: DeviceKey) -> None:
    seed = json.loads((tmp_path / KEY_NAME).read_text().splitlines()[1])["seed"]
    assert repr(key) == f"DeviceKey(public={key.public})"
    assert seed not in repr(key)
    assert seed not in repr(_Seed(seed=seed))
    with pytest.raises(TypeError, match="not pickled: it stays in its state directory"):
        pickle.dumps(key)


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_key_is_put_right_and_another_one_is_told(
    tmp_path: Path, key: DeviceKey, damage: Callable[[Path], None]
) -> None:
    faults: list[ProblemError] = []
    damage(tmp_path / KEY_NAME)
    assert DeviceKey.open(tmp_path, faults.append).public == key.public
    assert [fault.code for fault in faults] == ["state_damaged"]
    faults.clear()
    for name in (KEY_NAME, f"{KEY_NAME}.copy"):
        damage(tmp_path / name)
    other = DeviceKey.open(tmp_path, faults.append)
    assert other.public != key.public
    assert [fault.code for fault in faults] == ["state_lost"]
    assert "another key from now on: tell its receivers, and run 'veilcamd calibrate' again" in str(
        faults[0]
    )
    assert DeviceKey.open(tmp_path, faults.append).public == other.public
    assert len(faults) == 1


def test_place_that_takes_no_key_is_said(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    with pytest.raises(StartError, match=r"device-key\.json cannot be read \(Not a directory\)"):
        DeviceKey.open(blocked)
    (tmp_path / f"{KEY_NAME}.lock").mkdir()
    with pytest.raises(StartError, match=r"device-key\.json cannot be written \(Is a directory\)"):
        DeviceKey.open(tmp_path)


def test_of_two_who_make_it_at_once_both_have_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody calibrates while the daemon starts."""
    first = DeviceKey.open(tmp_path)
    read = iter([None])
    monkeypatch.setattr(StateStore, "read", lambda _: next(read))
    assert DeviceKey.open(tmp_path).public == first.public
