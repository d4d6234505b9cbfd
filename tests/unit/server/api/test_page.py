"""Files of the page: what they may load, what they say, and that all of it comes along."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, get_args
from urllib.parse import urljoin

import numpy as np
import pytest
from PIL import Image
from tests.unit.server.api.conftest import bearer

from veilcam_client.wire.events import EVENT_KINDS
from veilcam_client.wire.status import Remedy, State
from veilcam_client.wire.tokens import ROLES, SCOPES
from veilcam_server.api.routes.page import FOLDER, PATHS
from veilcam_server.demo_data import load_digits
from veilcam_server.security.admission import Admission
from veilcam_server.security.sessions import SessionStore
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio

DOCS = Path(__file__).parents[4] / "docs"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; require-trusted-types-for 'script'; trusted-types 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
WORDS = (FOLDER / "words.js").read_text()
FILES = [path for path in sorted(FOLDER.iterdir()) if path.suffix in (".html", ".js", ".css")]


def table(name: str) -> dict[str, str]:
    """An object of words.js, by its keys."""
    (body,) = re.findall(rf"export const {name} = \{{(.*?)\n\}};", WORDS, re.DOTALL)
    rows: list[tuple[str, str, str]] = re.findall(r'^  (?:"([^"]+)"|(\w+)):\s+"(.*)",$', body, re.M)
    return {quoted or plain: text for quoted, plain, text in rows}


async def test_everybody_may_have_them_and_they_load_from_the_daemon_alone(
    running: Running, store: TokenStore
) -> None:
    async with running(admission=Admission(store)) as client:
        for path in PATHS:
            answer = await client.get(path)
            assert answer.status_code == 200, path
            is_page = path in ("/", "/docs")
            assert (answer.headers["content-security-policy"] == POLICY) is is_page, path
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["cache-control"] == "private, no-cache"
            kept = {"If-None-Match": answer.headers["etag"]}
            again = await client.get(path, headers=kept)
            assert (again.status_code, again.content) == (304, b"")
        assert (await client.get("/page/nothing.js")).status_code == 401
        assert (await client.get("/page/..%2fapp.py")).status_code == 401
        assert (await client.get("/v1/status")).status_code == 401


async def test_page_has_no_other_file(running: Running) -> None:
    async with running() as client:
        for name in ("nothing.js", "..%2fapp.py", "__init__.py"):
            assert (await client.get(f"/page/{name}")).json()["code"] == "not_found"


@pytest.mark.parametrize("cut", [True, False])
async def test_page_behind_a_path_of_a_proxy_works(
    running: Running, store: TokenStore, tmp_path: Path, cut: bool
) -> None:
    """The proxy cuts the path off, or leaves that to the daemon."""
    sessions = SessionStore(tmp_path / "tokens", store)
    site = Site(root_path="/a/camera")
    token = bearer(store, "read:status")

    def asked(path: str) -> str:
        return path.removeprefix("/a/camera") if cut else path

    async with running(admission=Admission(store, site, sessions=sessions)) as client:
        for page in ("/a/camera/", "/a/camera/docs"):
            answer = await client.get(asked(page))
            links = re.findall(r'(?:href|src)="([^#"]+)"', answer.text)
            assert len(links) > 4
            for link in links:
                found = urljoin(page, link)
                assert found.startswith("/a/camera/")
                assert (await client.get(asked(found))).status_code == 200, link
        moved = await client.get("/a/camera")
        assert (moved.status_code, moved.headers["location"]) == (308, "/a/camera/")
        assert (await client.get("/a/cameras", headers=token)).status_code == 404
        api = (await client.get(asked("/a/camera/v1/openapi.json"), headers=token)).json()
        assert api["servers"][0]["url"] == "/a/camera"
        begun = await client.post(asked("/a/camera/v1/session"), headers=token)
        assert "; path=/a/camera/v1;" in begun.headers["set-cookie"].lower()
        # An upload and a path without a token are told by their paths, too.
        assert (await client.post(asked("/a/camera/v1/bundles"), headers=token)).status_code == 415
        assert (await client.get(asked("/a/camera/healthz"))).status_code == 200


async def test_page_says_who_may_show_it_in_a_frame(running: Running) -> None:
    admission = Admission(site=Site(frame_ancestors=("https://home.example",)))
    async with running(admission=admission) as client:
        for path in ("/", "/docs"):
            policy = (await client.get(path)).headers["content-security-policy"]
            assert policy.endswith("frame-ancestors https://home.example")


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_no_file_names_another_place_or_makes_markup_of_text(path: Path) -> None:
    text = path.read_text()
    assert not re.findall(r"(?:https?:)?//[\w.-]+\.\w+/", text)
    for unsafe in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert unsafe not in text
    if path.suffix == ".html":
        assert not re.findall(r"<style|<script>|style=|\son\w+=", text)


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_all_that_a_file_names_is_there(path: Path) -> None:
    text = path.read_text()
    named = [*re.findall(r'from "\./([^"]+)"', text), *re.findall(r'"page/([^"]+)"', text)]
    assert path.suffix != ".html" or len(named) > 3
    # What begins at the root is not found behind a proxy's path.
    assert not re.findall(r'(?:href|src)[=:] ?"/', text)
    assert all((FOLDER / name).is_file() for name in named), named


def test_page_words_are_those_of_the_api() -> None:
    told = (DOCS / "api.md").read_text()
    (remedies,) = re.findall(r"^\| remedy \| what to do \|\n(.*?)\n\n", told, re.M | re.DOTALL)
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", remedies, re.M))
    assert table("REMEDIES") == {
        remedy: rows[remedy].replace("`", "") for remedy in get_args(Remedy)
    }
    assert set(table("STATES")) == set(get_args(State))
    assert set(table("SCOPES")) == set(SCOPES)
    assert list(table("ROLES")) == list(ROLES)
    (events,) = re.findall(r"^const EVENTS = \{\n(.*?)\n\};", WORDS, re.M | re.DOTALL)
    assert set(re.findall(r"^  (\w+): ", events, re.M)) == EVENT_KINDS
    card = (DOCS / "privacy-card.md").read_text()
    names = dict(re.findall(r"^\| (T\d) ([^|]+) \|", card, re.M))
    assert table("THREATS") == names


def test_page_digits_are_of_the_sample() -> None:
    sheet = np.asarray(Image.open(FOLDER / "digits.png"))
    digits = load_digits()
    rows, columns = sheet.shape[0] // 28, sheet.shape[1] // 28
    assert columns == 10
    for label in range(columns):
        held = digits.images[digits.labels == label]
        for row in range(rows):
            drawn = sheet[28 * row : 28 * row + 28, 28 * label : 28 * label + 28]
            assert (held == drawn).all(axis=(1, 2)).any(), (label, row)
