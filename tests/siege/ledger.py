"""Ledger of what a daemon acknowledged, which its next life must know of."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tests.siege.client import Address, Reply
from tests.siege.ground import tokens_of
from tests.siege.witness import Life
from tests.unit.server.logs import events

from veilcam_client.wire.captures import Capture

ADVANCE = "/v1/rotation/advance"


@dataclass
class Ledger:
    policy: list[object]
    active: list[object]
    valid: set[str] = field(default_factory=set)
    revoked: set[str] = field(default_factory=set)
    key: dict[str, str] | None = None
    installed: dict[str, bool | None] = field(default_factory=dict)
    paired: dict[str, bool | None] = field(default_factory=dict)
    noted: set[str] = field(default_factory=set)
    lost: list[str] = field(default_factory=list)

    async def compare(self, address: Address, state: Path, life: Life) -> None:
        rotation = await address.get("rotation")
        bundles = (await address.get("bundles"))["bundles"]
        paired = {each["id"] for each in (await address.get("receivers"))["receivers"]}
        valid = {token for token, is_valid in (await tokens_of(address)).items() if is_valid}
        [active] = [each["digest"] for each in bundles if each["active"]]
        life.told.append(rotation["epoch"])
        self._keep("policy", rotation["policy"] in self.policy)
        self._keep("bundle", active in self.active)
        there = {each["digest"] for each in bundles if each["bundle"] is not None}
        self.installed = self._compared("upload", self.installed, there)
        self.paired = self._compared("receiver", self.paired, paired)
        self._keep("token", self.valid <= valid)
        self._keep("revocation", not self.revoked & valid)
        self._keep("entry", self.noted <= {each.get("request") for each in events(state)})
        if self.key is not None:
            repeated = await address.ask("POST", ADVANCE, headers=self.key)
            known = repeated.status == 409 and repeated.json()["code"] == "answer_lost"
            self._keep("idempotency key", known)
        self._keep("receivers of an epoch", await self._sealed_to(address, life) in (None, paired))
        # What was under way when it was killed either holds now, or never will.
        self.policy, self.active = [rotation["policy"]], [active]

    def copied(self) -> Ledger:
        return replace(copy.deepcopy(self), lost=self.lost)

    def note(self, reply: Reply) -> Reply:
        if 200 <= reply.status < 300:
            self.noted.add(reply.headers.get("x-request-id", ""))
        return reply

    def _compared(
        self, what: str, known: dict[str, bool | None], there: set[Any]
    ) -> dict[str, bool | None]:
        for name, was_there in known.items():
            self._keep(what, was_there in (None, name in there))
        return {name: name in there for name in known}

    async def _sealed_to(self, address: Address, life: Life) -> set[str] | None:
        reply = await address.ask("POST", "/v1/captures")
        if reply.status != 200:
            return None
        taken = Capture.model_validate_json(reply.body)
        life.taken.append(taken)
        envelope = getattr(taken.embedding, "envelope", None)
        return set() if envelope is None else {each.receiver for each in envelope.keys}

    def _keep(self, what: str, kept: bool) -> None:
        if not kept:
            self.lost.append(what)
