"""The command line ``veilcam-mqtt``: from options to a bridge."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from veilcam_client import AsyncCamera
from veilcam_client.cli.profiles import URL, environment
from veilcam_client.cli.terminal import (
    EXIT_CODES_HELP,
    ProfileOption,
    TokenFileOption,
    UrlOption,
    camera_of,
    errors,
    fail,
    version_option,
)
from veilcam_client.http.credentials import read_secret
from veilcam_mqtt import logs
from veilcam_mqtt.bridge import Bridge, CameraChangedError
from veilcam_mqtt.settings import Broker, Names
from veilcam_mqtt.webhooks import Webhook

SOCKET = "unix:///run/veilcam/api.sock"
"""Where a daemon listens that systemd started."""
COMMAND = "veilcam-mqtt"

log = logging.getLogger("veilcam.mqtt")

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    epilog=f"Each option may stand in the environment instead. {EXIT_CODES_HELP}",
)


@app.command()
def run(
    *,
    url: UrlOption = None,
    profile: ProfileOption = None,
    token_file: TokenFileOption = None,
    broker: Annotated[
        str,
        typer.Option(envvar="VEILCAM_MQTT_BROKER", help="mqtts://HOST:PORT, or mqtt://HOST:PORT."),
    ] = "mqtt://127.0.0.1",
    username: Annotated[
        str | None, typer.Option(envvar="VEILCAM_MQTT_USERNAME", help="Where the broker wants one.")
    ] = None,
    password_file: Annotated[
        Path | None,
        typer.Option(envvar="VEILCAM_MQTT_PASSWORD_FILE", help="File of the password."),
    ] = None,
    ca_file: Annotated[
        Path | None,
        typer.Option(
            envvar="VEILCAM_MQTT_CA_FILE",
            help="Authority that vouches for the broker, a PEM file; the system's by default.",
        ),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option(
            envvar="VEILCAM_MQTT_CERTIFICATE",
            help="Certificate to show to the broker, a PEM file.",
        ),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option(envvar="VEILCAM_MQTT_KEY", help="Its private key, a PEM file."),
    ] = None,
    allow_plain: Annotated[
        bool,
        typer.Option(
            "--allow-plain",
            envvar="VEILCAM_MQTT_ALLOW_PLAIN",
            help="Reach a broker on another machine without TLS: who listens reads labels and "
            "password.",
        ),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            envvar="VEILCAM_MQTT_NAME",
            help="Name in the house; veilcam_ and the first digits of the camera's key by default.",
        ),
    ] = None,
    base: Annotated[
        str, typer.Option(envvar="VEILCAM_MQTT_BASE", help="First level of its topics.")
    ] = "veilcam",
    discovery: Annotated[
        str,
        typer.Option(
            envvar="VEILCAM_MQTT_DISCOVERY", help="Prefix under which Home Assistant looks."
        ),
    ] = "homeassistant",
    webhook: Annotated[
        list[str] | None,
        typer.Option(
            envvar="VEILCAM_MQTT_WEBHOOK",
            help="Also post what is seen and what fails there; several times for several.",
        ),
    ] = None,
    webhook_secret_file: Annotated[
        Path | None,
        typer.Option(
            envvar="VEILCAM_MQTT_WEBHOOK_SECRET_FILE",
            help="File of what webhooks are signed with: whsec_ and 24 to 64 bytes as base64.",
        ),
    ] = None,
    log_level: Annotated[
        str,
        typer.Option(envvar="VEILCAM_MQTT_LOG_LEVEL", help="debug, info, warning or error."),
    ] = "info",
    json: Annotated[
        bool, typer.Option("--json", help="Log JSON lines, also on a terminal.")
    ] = False,
    _: version_option("veilcam-mqtt") = False,  # type: ignore[valid-type]
) -> None:
    """Tell a house what a Veilcam camera sees, over MQTT, as Home Assistant has it.

    Its token needs read:status, classify, read:scores and mask:rotate. Where no camera is given, it
    is the one that systemd runs on this machine.
    """
    with errors(COMMAND):
        if log_level not in ("debug", "info", "warning", "error"):
            raise ValueError("--log-level is one of debug, info, warning and error")
        logs.configure(log_level, json=json or not sys.stderr.isatty())
        if webhook and webhook_secret_file is None:
            raise ValueError("webhooks are signed: give --webhook-secret-file")
        secret = "" if webhook_secret_file is None else read_secret(webhook_secret_file)
        password = None if password_file is None else read_secret(password_file)
        reached = Broker(broker, username, password, ca_file, certificate, key, allow_plain)
        reached.tls()
        Names(name or "veilcam", base, discovery)
        hooks = [Webhook(address, secret) for address in webhook or ()]
        with environment({URL: SOCKET, **camera_of(url, profile, token_file)}):
            # Repeated by the bridge itself, which tells the house meanwhile that nobody answers.
            camera = AsyncCamera(max_retries=0)

    bridge = _bridged(camera, reached, hooks, name=name, base=base, discovery=discovery)
    try:
        asyncio.run(bridge)
    except CameraChangedError as error:
        fail(str(error), 1, COMMAND)
    except (KeyboardInterrupt, asyncio.CancelledError):
        pass


async def _bridged(
    camera: AsyncCamera,
    broker: Broker,
    hooks: Sequence[Webhook],
    *,
    name: str | None,
    base: str,
    discovery: str,
) -> None:
    """Run until SIGTERM: then the broker is told that nobody tells it more."""
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - a coroutine runs in one
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, task.cancel)
    loop.set_exception_handler(_log_forgotten)
    async with camera:
        await Bridge(camera, broker, hooks, node=name, base=base, discovery=discovery).run()


def _log_forgotten(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Ignore the error that paho-mqtt leaves, with nobody to wait for it, when a broker goes."""
    error = context.get("exception")
    log.debug("not awaited: %s", context["message"] if error is None else type(error).__name__)


def main() -> None:
    """Run ``veilcam-mqtt``."""
    app(prog_name="veilcam-mqtt")
