"""Names of a daemon, and pages that may ask it."""

from __future__ import annotations

import pytest
from starlette.datastructures import Headers

from veilcam_server.errors import ProblemError
from veilcam_server.security.admission import open_admission
from veilcam_server.security.site import Site
from veilcam_server.settings import Settings

LINK = {"host": "localhost", "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
LOCAL = Site()
OTHERS = Site(addresses=True)
PROXIED = Site(hosts=("camera.example", "door.example:8443"))


def refusal(site: Site, **headers: str) -> type[ProblemError] | None:
    named = Headers({name.replace("_", "-"): value for name, value in headers.items()})
    try:
        site.require("POST", "/v1/captures", named)
    except ProblemError as error:
        return type(error)
    return None


@pytest.mark.parametrize(
    ("site", "served", "refused"),
    [
        (
            LOCAL,
            ("localhost", "LOCALHOST:8787", "127.0.0.1:1", "127.8.9.1", "[::1]:80", "[::1]"),
            ("192.168.1.5", "[fe80::1]:80", "camera.example", "0.0.0.0", "localhost.example"),
        ),
        (
            OTHERS,
            ("localhost:8787", "192.168.1.5", "192.168.1.5:8787", "[fe80::1]:80"),
            # A name can be made to lead here, an address cannot.
            ("page.example", "192.168.1.5.page.example", "192.168.1", "3232235781", "[page]"),
        ),
        (
            PROXIED,
            ("localhost", "camera.example", "CAMERA.example:8787", "door.example"),
            ("page.example", "camera.example.page.example", "x.camera.example", "192.168.1.5"),
        ),
        (
            LOCAL,
            (),
            ("", "localhost:", "localhost:x", "localhost.", "::1", "a@localhost", "localhost/x"),
        ),
    ],
)
def test_host_is_a_name_of_this_daemon(
    site: Site, served: tuple[str, ...], refused: tuple[str, ...]
) -> None:
    for host in served:
        assert refusal(site, host=host) is None, host
    for host in refused:
        assert refusal(site, host=host) is ProblemError, host


@pytest.mark.parametrize(
    ("origin", "host", "wanted"),
    [
        ("https://camera.example", "camera.example", None),
        ("http://camera.example", "camera.example:80", None),
        ("http://camera.example:443", "camera.example", ProblemError),
        # A proxy that asks under the name that it was told.
        ("https://camera.example", "localhost:8787", None),
        ("https://door.example:8443", "localhost:8787", None),
        ("https://camera.example:9999", "camera.example", ProblemError),
        ("https://door.example", "localhost:8787", ProblemError),
        ("https://page.example", "camera.example", ProblemError),
        ("https://camera.example.page.example", "camera.example", ProblemError),
        ("camera.example", "camera.example", ProblemError),
        # The name that a page has made to lead here: its origin is its host, and no name of ours.
        ("http://page.example:8787", "page.example:8787", ProblemError),
        ("https://camera.example", "page.example", ProblemError),
    ],
)
def test_origin_is_a_name_of_this_daemon(
    origin: str, host: str, wanted: type[ProblemError] | None
) -> None:
    assert refusal(PROXIED, origin=origin, host=host) is wanted
    if wanted is None:
        assert refusal(LOCAL, origin=origin, host="localhost:8787") is ProblemError
        assert refusal(PROXIED, origin=origin, host=host, sec_fetch_site="same-site") is (
            ProblemError
        )


def test_two_modes_of_one_request_are_none() -> None:
    raw = Headers({**LINK, "sec-fetch-dest": "document"}).raw
    LOCAL.require("GET", "/", Headers(raw=raw))
    with pytest.raises(ProblemError):
        LOCAL.require("GET", "/", Headers(raw=[*raw, (b"sec-fetch-mode", b"cors")]))


@pytest.mark.parametrize(
    ("ancestors", "opened"),
    [((), ("document",)), (("https://home.example",), ("document", "iframe"))],
)
def test_link_and_a_frame_that_is_allowed_lead_to_a_page(
    ancestors: tuple[str, ...], opened: tuple[str, ...]
) -> None:
    site = Site(frame_ancestors=ancestors)
    for destination in ("document", "iframe", "frame", "image", "empty", ""):
        headers = Headers({**LINK, "sec-fetch-dest": destination})
        for path in ("/", "/docs"):
            if destination in opened:
                site.require("GET", path, headers)
                continue
            with pytest.raises(ProblemError):
                site.require("GET", path, headers)


@pytest.mark.parametrize("tls", [False, True])
def test_names_are_set(tls: bool, tmp_path: object) -> None:
    secured = {"tls_certificate": "c.pem", "tls_key": "k.pem", "host": "0.0.0.0"} if tls else {}
    settings = Settings.model_validate(
        {
            "bundle": "b.veilcam",
            "state_dir": tmp_path,
            "hosts": ("Camera.example",),
            "frame_ancestors": ("https://home.example",),
            **secured,
        }
    )
    with open_admission(settings) as admission:
        assert admission.site == Site(("camera.example",), tls, ("https://home.example",))
