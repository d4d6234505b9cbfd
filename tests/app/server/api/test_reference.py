"""The page of operations is that of the API as it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.docs.api_reference import PAGE, page

from veilcam_server.api.app import create_app
from veilcam_server.api.openapi import document

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


def test_reference_is_that_of_the_document(bench: Bench) -> None:
    made = page(document(create_app(bench.service(bench.camera()))))
    assert PAGE.read_text() == made, "write it anew: python -m tests.docs.api_reference"
