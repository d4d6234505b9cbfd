"""The command line ``veilcam-mqtt``: from options to a bridge."""

from __future__ import annotations

import asyncio
import json as encoder
import logging
import signal
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from veilcam_client import AsyncCamera
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


def _option(name: str, text: str, *names: str) -> Any:
    return typer.Option(*names, envvar=f"VEILCAM_MQTT_{name}", help=text)


@app.command()
def run(
    *,
    url: UrlOption = None,
    profile: ProfileOption = None,
    token_file: TokenFileOption = None,
    broker: Annotated[
        str, _option("BROKER", "mqtts://HOST:PORT, or mqtt://HOST:PORT.")
    ] = "mqtt://127.0.0.1",
    username: Annotated[str | None, _option("USERNAME", "Where the broker wants one.")] = None,
    password_file: Annotated[Path | None, _option("PASSWORD_FILE", "File of the password.")] = None,
    ca_file: Annotated[
        Path | None,
        _option("CA_FILE", "Authority of the broker, a PEM file; the system's by default."),
    ] = None,
    certificate: Annotated[
        Path | None, _option("CERTIFICATE", "Certificate to show to the broker, a PEM file.")
    ] = None,
    key: Annotated[Path | None, _option("KEY", "Its private key, a PEM file.")] = None,
    allow_plain: Annotated[
        bool,
        _option(
            "ALLOW_PLAIN",
            "Reach a broker on another machine without TLS: labels and password can be read.",
            "--allow-plain",
        ),
    ] = False,
    name: Annotated[
        str | None,
        _option("NAME", "Name in the house; veilcam_ and the camera's first digits by default."),
    ] = None,
    base: Annotated[str, _option("BASE", "First level of its topics.")] = "veilcam",
    discovery: Annotated[
        str, _option("DISCOVERY", "Prefix under which Home Assistant looks.")
    ] = "homeassistant",
    webhook: Annotated[
        list[str] | None,
        _option("WEBHOOK", "Also post sights and faults there; several times for several."),
    ] = None,
    webhook_secret_file: Annotated[
        Path | None,
        _option(
            "WEBHOOK_SECRET_FILE",
            "File of the secret that signs webhooks: whsec_ and 24 to 64 bytes as base64.",
        ),
    ] = None,
    log_level: Annotated[str, _option("LOG_LEVEL", "debug, info, warning or error.")] = "info",
    json: Annotated[
        bool, typer.Option("--json", help="Log JSON lines, also on a terminal.")
    ] = False,
    _: Annotated[bool, version_option(COMMAND)] = False,
) -> None:
    """Tell a house what a Veilcam camera sees, over MQTT, as Home Assistant has it.

    Its token needs read:status, classify and mask:rotate, and read:scores for the confidence. Where
    no camera is given, it is the one that systemd runs on this machine.
    """
    with errors(COMMAND):
        if log_level not in ("debug", "info", "warning", "error"):
            raise ValueError("--log-level is one of debug, info, warning and error")
        configure_logs(log_level, json=json or not sys.stderr.isatty())
        if webhook and webhook_secret_file is None:
            raise ValueError("webhooks are signed: give --webhook-secret-file")
        secret = "" if webhook_secret_file is None else read_secret(webhook_secret_file)
        password = None if password_file is None else read_secret(password_file)
        reached = Broker(broker, username, password, ca_file, certificate, key, allow_plain)
        reached.tls()
        names = Names(name or "", base, discovery)
        hooks = [Webhook(address, secret) for address in webhook or ()]
        found = camera_of(url, profile, token_file, local=SOCKET)
        # Repeated by the bridge itself, which tells the house meanwhile that nobody answers.
        camera = AsyncCamera(profile=found, max_retries=0)

    try:
        asyncio.run(_bridged(camera, reached, hooks, names))
    except CameraChangedError as error:
        fail(str(error), 1, COMMAND)
    except (KeyboardInterrupt, asyncio.CancelledError):
        pass


async def _bridged(
    camera: AsyncCamera, broker: Broker, hooks: Sequence[Webhook], names: Names
) -> None:
    """Run until SIGTERM: then the broker is told that nobody tells it more."""
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - a coroutine runs in one
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, task.cancel)
    loop.set_exception_handler(_log_forgotten)
    async with camera:
        await Bridge(camera, broker, hooks, names).run()


def _log_forgotten(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Ignore the error that paho-mqtt leaves, with nobody to wait for it, when a broker goes."""
    error = context.get("exception")
    log.debug("not awaited: %s", context["message"] if error is None else type(error).__name__)


class JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; of an error that was raised, its kind, and not its text."""
        entry = {
            "event": record.getMessage(),
            "level": record.levelname.lower(),
            "timestamp": datetime.fromtimestamp(record.created, UTC).isoformat(),
        }
        if record.exc_info and record.exc_info[0] is not None:
            entry["error"] = record.exc_info[0].__name__
        return encoder.dumps(entry)


def configure_logs(level: str, *, json: bool) -> None:
    """Log everything of at least ``level`` (``debug``, ``info``, ``warning``, ``error``)."""
    handler = logging.StreamHandler(sys.stderr)
    words = logging.Formatter("%(asctime)s  %(levelname)-7s  %(message)s")
    handler.setFormatter(JsonFormatter() if json else words)
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.getLogger("veilcam").setLevel(level.upper())


def main() -> None:
    """Run ``veilcam-mqtt``."""
    app(prog_name="veilcam-mqtt")
