"""What the SDK promises to the outside."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import veilcam_client
from veilcam_client import AsyncCamera, Camera, VeilcamError
from veilcam_client.cli.terminal import EXIT_CODES

PACKAGE = Path(veilcam_client.__file__).parent


def test_the_public_names_are_these() -> None:
    assert veilcam_client.__all__ == [
        "DEFAULT_URL",
        "ApiError",
        "AsyncCamera",
        "BundleChanged",
        "BusyError",
        "CalibrationChanged",
        "CalibrationRecord",
        "CalibrationRun",
        "CalibrationStatus",
        "Camera",
        "Capture",
        "CaptureTaken",
        "Classification",
        "Classified",
        "ConnectError",
        "DeviceError",
        "Diagnostics",
        "Embedding",
        "Event",
        "EveryCaptures",
        "EverySeconds",
        "Fault",
        "Faults",
        "ForbiddenError",
        "Gap",
        "HeldScene",
        "InstalledBundle",
        "InvalidRequestError",
        "KeyFileError",
        "Lease",
        "LeasedError",
        "LogFileError",
        "LogHead",
        "LogRecord",
        "LogRecords",
        "MaskChanged",
        "NewLease",
        "NewToken",
        "Notes",
        "PairedReceiver",
        "PanelFaults",
        "ProtocolError",
        "Receivers",
        "Recording",
        "RecordingError",
        "RequestTimeoutError",
        "Rotation",
        "RotationChanged",
        "RotationOff",
        "RotationPolicy",
        "SceneDecoder",
        "Scope",
        "SealedEmbedding",
        "SealedError",
        "SensorFaults",
        "ServerError",
        "SignedCalibration",
        "StateChanged",
        "Status",
        "Token",
        "UnauthorizedError",
        "VeilcamError",
        "__version__",
        "fetch_log",
        "read_recording",
        "record",
        "verify_log",
    ]
    for name in veilcam_client.__all__:
        assert hasattr(veilcam_client, name)


def test_sync_and_async_have_the_same_surface() -> None:
    def surface(kind: type) -> dict[str, list[str]]:
        return {
            name: [
                f"{each.name}:{each.kind}:{each.default}"
                for each in inspect.signature(member).parameters.values()
            ]
            for name, member in inspect.getmembers(kind, inspect.isfunction)
            if not name.startswith("_") or name == "__init__"
        }

    assert surface(Camera) == surface(AsyncCamera)
    assert set(surface(Camera)) == {
        "__init__",
        "activate_bundle",
        "add_receiver",
        "break_lease",
        "calibration",
        "cancel_calibration",
        "capture",
        "classify",
        "close",
        "confirm_scene",
        "create_token",
        "diagnostics",
        "events",
        "hold_scene",
        "install_bundle",
        "bundles",
        "lease",
        "lease_state",
        "log",
        "log_head",
        "receivers",
        "release_lease",
        "remove_bundle",
        "remove_receiver",
        "revoke_token",
        "rotate",
        "rotation",
        "set_faults",
        "set_rotation",
        "start_calibration",
        "status",
        "take_lease",
        "tokens",
    }


def test_httpx_is_known_to_one_module() -> None:
    importers = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            if any(name.split(".")[0] == "httpx" for name in names):
                importers.add(path.name)
    assert importers == {"transport.py"}


def test_the_sdk_needs_no_torch_and_loads_no_cryptography_before_it_opens() -> None:
    script = (
        "import sys, veilcam_client, veilcam_client.cli.main\n"
        "loaded = {name.split('.')[0] for name in sys.modules}\n"
        "assert not loaded & {'torch', 'cryptography', 'fastapi', 'scipy', 'matplotlib',"
        " 'veilcam_server', 'veilcam_optics', 'veilcam_training'}, loaded\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_every_concrete_error_has_an_exit_code_of_its_own() -> None:
    def leaves(kind: type[VeilcamError]) -> set[type[VeilcamError]]:
        below = kind.__subclasses__()
        return set().union(*(leaves(each) for each in below)) if below else {kind}

    assert leaves(VeilcamError) == {kind for kind, _ in EXIT_CODES}
    assert len({code for _, code in EXIT_CODES}) == len(EXIT_CODES)


def test_it_is_typed() -> None:
    assert (PACKAGE / "py.typed").exists()
