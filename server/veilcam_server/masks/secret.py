"""The secret that masks are derived from: where it lies, and how one is made."""

from __future__ import annotations

import os
from pathlib import Path

from veilcam_optics.errors import OpticsError
from veilcam_optics.files import create_private
from veilcam_optics.keys.masks import Secret
from veilcam_server.errors import StartError

CREDENTIAL = "mask-key"
"""Name of the systemd credential (``LoadCredential=``, ``LoadCredentialEncrypted=``)."""


def find_secret(path: Path | None) -> Secret:
    """Read the secret from ``path``, or else from the credential that systemd passed.

    Raises:
        StartError: there is none, others may read it, or it is none. No message repeats it.
    """
    try:
        if path is not None:
            return Secret.read(path)
        directory = os.environ.get("CREDENTIALS_DIRECTORY")
        if directory:
            credential = Path(directory) / CREDENTIAL
            if credential.exists():
                # Its mode is systemd's affair: the directory is ours alone, and an access list
                # that lets the service in shows as permissions of a group.
                return Secret.from_hex(credential.read_text("ascii", "replace"))
    except OpticsError as error:
        raise StartError(str(error)) from None
    except OSError as error:
        raise StartError(f"credential {CREDENTIAL} cannot be read ({error.strerror})") from None
    raise StartError(
        "fresh masks need a secret: make one with 'veilcamd secret FILE' and give it with "
        f"--mask-secret FILE, or as systemd credential {CREDENTIAL!r}"
    )


def write_secret(path: Path) -> None:
    """Draw a new secret and write it to a new file that its owner alone may read.

    Raises:
        StartError: there is such a file already, or it cannot be written.
    """
    try:
        create_private(path, f"{Secret.generate().reveal().hex()}\n".encode())
    except FileExistsError:
        raise StartError(
            f"{path} exists and was left alone: whoever replaces a secret can decode nothing "
            "that was released under it; move it away first"
        ) from None
    except OSError as error:
        raise StartError(f"{path} cannot be written ({error.strerror}): check it") from None
