"""A device's key, and a receiver."""

from __future__ import annotations

import pytest
from tests.unit.client.sealing import Device

from veilcam_client.keys.receivers import ReceiverKey


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture(scope="session")
def receiver() -> ReceiverKey:
    return ReceiverKey.generate()
