"""One certificate that a camera must show."""

from __future__ import annotations

import ssl
from pathlib import Path

import pytest
from tests.unit.client.certificates import Certificate, listening
from tests.unit.client.conftest import Daemon, camera_of, handler_of, result, serving

from veilcam_client.errors import ArgumentError, ConnectError
from veilcam_client.profiles import Profile

pytestmark = pytest.mark.anyio
TOKEN = "vc_0123456789ab_" + 64 * "5"


@pytest.fixture(scope="module")
def pinned() -> Certificate:
    return Certificate.made()


@pytest.mark.parametrize("signed", ["by itself", "by another"])
async def test_pinned_certificate_needs_no_authority_no_name_and_no_time(
    daemon: Daemon, kind: type, signed: str, tmp_path: Path
) -> None:
    shown = Certificate.made(Certificate.made() if signed == "by another" else None)
    with serving(handler_of(daemon), shown.context(tmp_path)) as url:
        camera = kind(profile=Profile(url, TOKEN, certificate=shown.digest))
        assert (await result(camera.status())).state == "ready"
        await result(camera.close())
    assert daemon.requests[0].headers["authorization"] == f"Bearer {TOKEN}"


@pytest.mark.parametrize("signed", ["by itself", "by the pinned one"])
@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
async def test_other_certificate_is_told_nothing(
    pinned: Certificate, kind: type, signed: str, version: str, tmp_path: Path
) -> None:
    shown = Certificate.made(pinned if signed == "by the pinned one" else None)
    context = shown.context(tmp_path)
    context.minimum_version = context.maximum_version = ssl.TLSVersion[version]
    with listening(context) as (place, told):
        own = Profile(f"https://{place}", TOKEN, certificate=pinned.digest)
        camera = kind(profile=own, max_retries=0)
        with pytest.raises(ConnectError, match="certificate is not the one that it was paired"):
            await result(camera.status())
        await result(camera.close())
    assert told == [b""]


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "unix:///run/veilcam/api.sock"])
async def test_camera_that_shows_no_certificate_is_no_pinned_one(url: str, kind: type) -> None:
    with pytest.raises(ArgumentError, match="shows no certificate: use https"):
        kind(profile=Profile(url, certificate="ab" * 32))


async def test_client_of_the_caller_is_no_pinned_one(daemon: Daemon, kind: type) -> None:
    own = Profile("https://camera.local", certificate="ab" * 32)
    with pytest.raises(ArgumentError, match="http_client checks no certificate"):
        camera_of(kind, daemon, profile=own)


async def test_certificate_of_an_authority_is_no_pinned_one(
    pinned: Certificate, kind: type, tmp_path: Path
) -> None:
    authority = Certificate.made(days=100_000)
    (tmp_path / "ca.pem").write_bytes(authority.pem)
    with listening(Certificate.made(authority, days=100_000).context(tmp_path)) as (place, told):
        for certificate in (None, pinned.digest):
            own = Profile(
                f"https://localhost:{place.rpartition(':')[2]}", TOKEN, certificate=certificate
            )
            camera = kind(profile=own, ca_file=tmp_path / "ca.pem", max_retries=0)
            with pytest.raises(ConnectError):
                await result(camera.status())
            await result(camera.close())
    # The authority vouches for it, and the pin does not.
    assert [heard[:4] for heard in told] == [b"GET ", b""]
