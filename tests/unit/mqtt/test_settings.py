"""Where a bridge finds what it brings together."""

from __future__ import annotations

from pathlib import Path

import pytest

from veilcam_mqtt.settings import Broker, Names


@pytest.mark.parametrize(
    ("url", "host", "port"),
    [
        ("mqtt://127.0.0.1", "127.0.0.1", 1883),
        ("mqtt://localhost:1999", "localhost", 1999),
        ("mqtt://[::1]/", "::1", 1883),
        ("mqtts://broker.example", "broker.example", 8883),
    ],
)
def test_broker_address_is_read(url: str, host: str, port: int) -> None:
    broker = Broker(url)
    assert (broker.host, broker.port) == (host, port)
    assert (broker.tls() is None) == url.startswith("mqtt:")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"url": "broker"}, "use mqtt://HOST"),
        ({"url": "http://broker"}, "use mqtt://HOST"),
        ({"url": "mqtts://"}, "use mqtt://HOST"),
        ({"url": "mqtts://a:0"}, "use mqtt://HOST"),
        ({"url": "mqtts://a:99999"}, "use mqtt://HOST"),
        ({"url": "mqtts://a/path"}, "use mqtt://HOST"),
        ({"url": "mqtts://me:hidden@a"}, "use --username"),
        ({"url": "mqtts://a", "password": "hidden"}, "give --username"),
        ({"url": "mqtts://a", "key": Path("k")}, "give both"),
        ({"url": "mqtt://127.0.0.1", "ca_file": Path("c")}, "for mqtts://"),
        ({"url": "mqtt://127.0.0.1", "certificate": Path("c"), "key": Path("k")}, "for mqtts://"),
        ({"url": "mqtt://broker.example"}, "--allow-plain"),
        ({"url": "mqtt://192.0.2.1"}, "--allow-plain"),
    ],
)
def test_invalid_broker_is_refused_without_its_password(
    arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        Broker(**arguments)  # type: ignore[arg-type]
    assert "hidden" not in str(refused.value)


def test_plain_broker_elsewhere_is_allowed_where_wanted_and_shows_no_password() -> None:
    broker = Broker("mqtt://broker.example", "me", "hidden", allow_plain=True)
    assert broker.tls() is None
    assert "hidden" not in repr(broker)


def test_authority_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no certificate")
    for name in ("none", "text"):
        with pytest.raises(ValueError, match="cannot be used"):
            Broker("mqtts://a", ca_file=tmp_path / name).tls()


def test_names_make_topics() -> None:
    names = Names("hall", "cameras", "ha")
    assert names.topic("label") == "cameras/hall/label"
    assert (names.config, names.birth) == ("ha/device/hall/config", "ha/status")


@pytest.mark.parametrize("name", ["", "a/b", "a b", "+", "#", "ä", "a\n"])
def test_name_that_cannot_stand_in_a_topic_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no level of a topic"):
        Names(base=name)
    if name:
        with pytest.raises(ValueError, match="no level of a topic"):
            Names(name)
