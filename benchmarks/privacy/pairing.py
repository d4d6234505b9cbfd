"""Attacks on pairing: lines that must pair nobody, against a whole daemon behind TLS.

    python -m benchmarks.privacy.pairing --figures benchmarks/results/people.json

Each attacker has what a line is, and all but the right secret, the right time or the right role. A
claim that pairs a receiver where none should be paired is won. Each claim stands in the log.
"""

from __future__ import annotations

import secrets
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import httpx
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.relay import certified
from benchmarks.rig import prompt_daemon, work_folder

from veilcam_client import Camera, VeilcamError
from veilcam_client.keys.log import read_line
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.profiles import Profile
from veilcam_client.wire.pairing import MOST_TRIES, OFFER_SECONDS, PairingLine
from veilcam_client.wire.tokens import ROLES, Role, Scope
from veilcam_server.daemon import certificate_digest
from veilcam_server.security.log import FOLDER
from veilcam_server.security.pairing import PairingOffers
from veilcam_server.security.tokens import TokenStore

CLAIM = "/v1/pairing/claim"
KEY = str(ReceiverKey.generate().public)
"""Public key of the attacker."""


class Door:
    """A daemon that pairs, its owner, and the claims of attackers.

    Args:
        url: URL of the daemon.
        state: its state directory.
        client: client that trusts any certificate.
        certificate: SHA-256 of the daemon's certificate, in hexadecimal digits.
    """

    def __init__(self, url: str, state: Path, client: httpx.Client, certificate: str) -> None:
        self.state, self._client, self.certificate = state, client, certificate
        self.place = url.partition("://")[2]
        self.tokens = TokenStore(state)
        self.owner = self.bearer(ROLES["owner"])
        self.refused = self.paired = 0
        """Claims so far."""
        self._count = threading.Lock()

    def bearer(self, scopes: tuple[Scope, ...]) -> Mapping[str, str]:
        """Return the header of a new token."""
        return {"Authorization": f"Bearer {self.tokens.create('attacked', scopes).secret}"}

    def offered(self, role: Role = "viewer", by: Mapping[str, str] | None = None) -> bytes | None:
        """Make an offer, and return its secret; None where it is refused."""
        answer = self._asked("/v1/pairing", {"role": role}, self.owner if by is None else by)
        return PairingLine.parse(answer.json()["line"]).secret if answer.is_success else None

    def offer(self) -> bytes:
        """Make an offer as the owner."""
        made = self.offered()
        assert made is not None
        return made

    def claim(self, secret: bytes) -> bool:
        """Claim an offer, and remove whoever was paired; return whether somebody was."""
        asked = {"label": "attacker", "key": KEY, "secret": secret.hex()}
        answer = self._asked(CLAIM, asked, {})
        with self._count:
            self.refused += answer.is_error
            self.paired += answer.is_success
        if answer.is_success:
            path = f"/v1/receivers/{answer.json()['receiver']['id']}"
            self._client.delete(path, headers=self.owner).raise_for_status()
        return answer.is_success

    def _asked(self, path: str, body: object, headers: Mapping[str, str]) -> httpx.Response:
        while True:
            answer = self._client.post(path, json=body, headers=headers)
            if answer.status_code != httpx.codes.TOO_MANY_REQUESTS:
                return answer
            time.sleep(float(answer.headers["Retry-After"]))

    def logged(self) -> tuple[int, int]:
        """Return the claims in the log: refused, and done."""
        refused = paired = 0
        for path in sorted((self.state / FOLDER).glob("*.jsonl")):
            for line in path.read_bytes().split(b"\n"):
                found = read_line(line)
                facts = {} if found is None else found.facts
                # A flood has a number in the place of records: here claims alone are refused.
                refused += int(facts.get("others", 0)) + int(facts.get("refused", 0))
                if facts.get("action") == f"POST {CLAIM}":
                    refused += "code" in facts
                    paired += "code" not in facts
        return refused, paired


def wrong_lines(door: Door, count: int) -> int:
    """Claim an open offer with wrong secrets, every third one a bit from the right one."""
    won, right = 0, bytes(16)
    for number in range(count):
        if number % MOST_TRIES == 0:
            right = door.offer()
        near = bytearray(right)
        near[secrets.randbelow(16)] ^= 1 << secrets.randbelow(8)
        guesses = bytes(near), secrets.token_bytes(16), right[::-1]
        won += door.claim(guesses[number % MOST_TRIES])
    return won


def second_use(door: Door, count: int) -> int:
    """Claim an offer that was used."""
    won = 0
    for _ in range(count):
        line = door.offer()
        if not door.claim(line):
            raise typer.BadParameter("the right line pairs nobody: nothing was attacked")
        won += door.claim(line)
    return won


def expired(door: Door, count: int) -> int:
    """Claim an offer that 'veilcamd pair' made five minutes ago."""
    before = PairingOffers(
        door.state, certificate=bytes(32), now=lambda: time.monotonic() - OFFER_SECONDS
    )
    lines = (PairingLine.parse(before.make(door.place, "viewer").line) for _ in range(count))
    return sum(door.claim(line.secret) for line in lines)


def replaced(door: Door, count: int) -> int:
    """Claim an offer after another one was made."""
    won = 0
    for _ in range(count):
        line = door.offer()
        door.offer()
        won += door.claim(line)
    return won


def guessed(door: Door, count: int) -> int:
    """Claim an offer with the right secret after three wrong claims."""
    won = 0
    for _ in range(count):
        line = door.offer()
        won += sum(door.claim(secrets.token_bytes(16)) for _ in range(MOST_TRIES))
        won += door.claim(line)
    return won


def at_once(door: Door, count: int) -> int:
    """Claim an offer twice at the same moment; one of the two is right."""
    won = 0
    with ThreadPoolExecutor(2) as pool:
        for _ in range(count):
            line, both = door.offer(), threading.Barrier(2)

            def claim(line: bytes = line, both: threading.Barrier = both) -> bool:
                both.wait(10)
                return door.claim(line)

            won += sum(each.result() for each in [pool.submit(claim) for _ in range(2)]) - 1
    return won


def ended_maker(door: Door, count: int) -> int:
    """Claim an offer whose maker's token was revoked."""
    won = 0
    for _ in range(count):
        made = door.tokens.create("revoked", ROLES["owner"])
        line = door.offered(by={"Authorization": f"Bearer {made.secret}"})
        door.tokens.revoke(made.id)
        won += line is not None and door.claim(line)
    return won


def escalation(door: Door, count: int) -> int:
    """Offer a role with scopes that the caller lacks."""
    callers = door.bearer(ROLES["operator"]), door.bearer(("admin:receivers", "admin:tokens"))
    roles: tuple[Role, ...] = ("viewer", "operator", "owner")
    return sum(
        door.offered(role, by) is not None for _ in range(count) for by in callers for role in roles
    )


class Impostor:
    """A machine with another certificate in the camera's place, and what clients tell it.

    Args:
        folder: folder of its certificate.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        certificate, key = certified(folder)
        self._context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        self._context.load_cert_chain(certificate, key)
        self.certificate = certificate_digest(certificate).hex()
        self.server = socket.create_server(("127.0.0.1", 0))
        self.url = f"https://127.0.0.1:{self.server.getsockname()[1]}"

    def _hear(self) -> bytes:
        """Take one connection, and return what it says once it is encrypted."""
        one, _ = self.server.accept()
        with one, suppress(OSError), self._context.wrap_socket(one, server_side=True) as talk:
            talk.settimeout(10)
            return talk.recv(65536)
        return b""

    def told(self, certificate: str, secret: bytes) -> bool:
        """Return whether a client tells it anything that has a line with this certificate."""
        with ThreadPoolExecutor(1) as pool, suppress(VeilcamError):
            heard = pool.submit(self._hear)
            with Camera(profile=Profile(self.url, certificate=certificate), max_retries=0) as one:
                one.receivers.claim(secret.hex(), "deceived", KEY)
        return heard.result() != b""


def wrong_certificate(door: Door, count: int) -> int:
    """Show a client whose line is the camera's another certificate."""
    with work_folder() as folder, (impostor := Impostor(folder / "impostor")).server:
        if not impostor.told(impostor.certificate, bytes(16)):
            raise typer.BadParameter("a line with its own certificate tells it nothing, either")
        return sum(impostor.told(door.certificate, door.offer()) for _ in range(count))


ATTACKS: Mapping[str, tuple[Callable[[Door, int], int], int]] = {
    "wrong line": (wrong_lines, 1000),
    "wrong certificate": (wrong_certificate, 20),
    "second use": (second_use, 20),
    "expired": (expired, 20),
    "replaced": (replaced, 20),
    "after three wrong ones": (guessed, 20),
    "two at once": (at_once, 20),
    "revoked maker": (ended_maker, 20),
    "escalation": (escalation, 20),
}
"""Attacks, with the number of times that each is tried."""


@contextmanager
def opened(folder: Path) -> Iterator[Door]:
    """Yield a daemon behind TLS, with tokens."""
    certificate, key = certified(folder)
    tls = ("--tls-certificate", str(certificate), "--tls-key", str(key))
    trust = ssl.create_default_context()
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    with (
        prompt_daemon(folder, "--auth", "tokens", *tls) as url,
        httpx.Client(base_url=url, verify=trust, timeout=60) as client,
    ):
        yield Door(url, folder / "state", client, certificate_digest(certificate).hex())


def main(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="A few times each.")] = False,
    figures: FiguresOption = None,
) -> None:
    """Attack pairing, count the attacks that were won, and look for each claim in the log."""
    won = 0
    with work_folder() as folder:
        with opened(folder) as door:
            for name, (attack, count) in ATTACKS.items():
                times = min(count, 4) if quick else count
                found = attack(door, times)
                print(f"{name:24}{times:6} times, {found} won")
                won += found
        claims, logged = (door.refused, door.paired), door.logged()
    print(f"claims refused and done: {claims}, in the log: {logged}")
    if claims != logged:
        raise typer.Exit(1)
    record(figures, {"pairing_attacks_won": won})


if __name__ == "__main__":
    typer.run(main)
