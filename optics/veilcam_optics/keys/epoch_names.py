"""Names of epochs that only a key can tell apart from chance.

The name of an epoch is its counter, enciphered: names look random and never repeat, and whoever has
the secret finds the counter again, which is what it takes to decode an embedding elsewhere.
"""

import re
import struct

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

from veilcam_optics.errors import invalid
from veilcam_optics.keys.masks import Secret, derived_key

CONTEXT = b"veilcam epoch names, version 1"


class EpochNames:
    """AES-256 on one block, the counter and eight zero bytes, under a key of its own.

    Args:
        secret: of the masks; the key is derived from it and tells nothing of theirs.
        device: label of the device.
    """

    def __init__(self, secret: Secret, device: str) -> None:
        info = CONTEXT + struct.pack(">B", len(device.encode())) + device.encode()
        key = derived_key(secret.reveal(), info)
        # One block, never the same twice: the mode that has no other use is the right one here.
        self._cipher = Cipher(algorithms.AES(key), modes.ECB())  # noqa: S305

    def name(self, counter: int) -> str:
        """Return the name of epoch ``counter``, 32 hexadecimal digits."""
        return self._cipher.encryptor().update(struct.pack(">QQ", counter, 0)).hex()

    def counter(self, name: str) -> int:
        """Return the epoch of ``name``; with another secret, some other number.

        Raises:
            OpticsError: not 32 hexadecimal digits.
        """
        if re.fullmatch(r"[0-9a-f]{32}", name) is None:
            raise invalid("epoch", repr(name[:40]), "", "32 hexadecimal digits, as sent")
        counter: int = struct.unpack(">QQ", self._cipher.decryptor().update(bytes.fromhex(name)))[0]
        return counter
