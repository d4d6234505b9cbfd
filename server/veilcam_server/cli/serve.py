"""``veilcamd serve``: from options to a daemon."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from veilcam_server.cli.options import options_of
from veilcam_server.cli.terminal import enter_state, fail, require_software
from veilcam_server.demo_data import Digits, load_digits
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings


@options_of(Settings)
def serve(settings: Settings) -> None:
    """Serve the camera on this machine until interrupted.

    What is not given here is taken from the environment: VEILCAM_BUNDLE, VEILCAM_PORT, ...
    """
    # Imported late: --help need not wait for them.
    from veilcam_server.system import logs  # noqa: PLC0415
    from veilcam_server.system.listeners import require_free  # noqa: PLC0415
    from veilcam_server.system.memory import no_garbage  # noqa: PLC0415

    try:
        require_free(settings)
        # Nor need torch be waited for, to be told that the port is occupied.
        with no_garbage():
            from veilcam_server.daemon import serve as run  # noqa: PLC0415

        # Root could read what the daemon's user cannot, and what it made would be root's.
        enter_state(settings.state_dir)
        require_software()
        logs.configure(settings.log_level)
        simulated = settings.device == "simulated"  # as the environment may say too
        if simulated and not settings.scenes and not settings.scene_file.exists():
            set_scene(settings.scene_file, load_digits(), 0)
        run(settings, _say)
    except StartError as error:
        fail(str(error))
    except KeyboardInterrupt:
        pass


def _say(url: str) -> None:
    # A full disk under standard output, or nobody who reads it, is no reason to end.
    with suppress(OSError):
        print(f"veilcamd listening on {url}", flush=True)  # noqa: T201


def set_scene(scene: Path, digits: Digits, index: int) -> None:
    """Write one digit to the scene file."""
    from veilcam_server.devices.simulated.scenes import write_scene  # noqa: PLC0415 - torch
    from veilcam_server.system.state_file import make_directory  # noqa: PLC0415

    try:
        make_directory(scene.parent)
        write_scene(scene, digits.images[index])
    except OSError as error:
        raise StartError(f"cannot write the scene {scene}: {error.strerror}") from None
