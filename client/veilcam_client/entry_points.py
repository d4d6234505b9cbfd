"""Entry points of the commands; those that need an extra say which where it is not installed."""

import os
import sys
from importlib import import_module

_PACKAGES = (
    "veilcam_client",
    "veilcam_mqtt",
    "veilcam_optics",
    "veilcam_training",
    "veilcam_server",
)


def veilcam() -> None:
    """Run ``veilcam``, which needs no extra."""
    _compute_on_one_thread()
    import_module("veilcam_client.cli.main").main()


def veilcam_optics() -> None:
    """Run ``veilcam-optics``."""
    _run("veilcam-optics", "veilcam_optics.cli.main", "optics")


def veilcam_train() -> None:
    """Run ``veilcam-train``."""
    _run("veilcam-train", "veilcam_training.cli.main", "training")


def veilcam_mqtt() -> None:
    """Run ``veilcam-mqtt``."""
    _run("veilcam-mqtt", "veilcam_mqtt.cli", "mqtt")


def veilcamd() -> None:
    """Run ``veilcamd``."""
    _run("veilcamd", "veilcam_server.cli.main", "server")


def _run(command: str, module: str, extra: str) -> None:
    """Run ``main`` of a module, found by its name: the client imports none of the other packages.

    What a command imports late is looked for as well. A module that is missing of ours or of
    Python's own is a defect, which no extra puts right.
    """
    _compute_on_one_thread()
    try:
        import_module(module).main()
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if not missing or missing in _PACKAGES or missing in sys.stdlib_module_names:
            raise
        sys.exit(
            f"{command} needs the extra '{extra}' ({missing} is not installed): "
            f"run pip install -e '.[{extra}]' in the checkout"
        )


def _compute_on_one_thread() -> None:
    """Let libraries compute on one thread, unless the user chose; before any of them is loaded.

    Pools of several libraries that fight over the cores make a simulated camera many times slower.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
