"""Rotation of masks: when the present one is due, and what is told of it."""

from __future__ import annotations

import math
import time

from veilcam_client.wire.rotation import Preparation as PreparationStatus
from veilcam_client.wire.rotation import Rotation, RotationOff, RotationPolicy
from veilcam_server.camera.capture import Lateness, due_in, reusable
from veilcam_server.camera.epochs import Preparation
from veilcam_server.camera.panel import MaskedPanel
from veilcam_server.errors import RotationImpossibleError


class MaskRotation:
    """Policy of mask changes, and the mask that is shown by it.

    Args:
        panel: panel with the mask.
        preparation: makes epochs ready.
        policy: policy of mask changes.

    Raises:
        RotationImpossibleError: the policy needs another mask, and there is none.
    """

    def __init__(
        self, panel: MaskedPanel, preparation: Preparation, policy: RotationPolicy
    ) -> None:
        self._panel, self._preparation = panel, preparation
        self.lateness = Lateness()
        self.policy = policy

    @property
    def policy(self) -> RotationPolicy:
        """Policy of mask changes."""
        return self._policy

    @policy.setter
    def policy(self, policy: RotationPolicy) -> None:
        if not isinstance(policy, RotationOff):
            self.require_another()
        self._policy = policy

    @property
    def present(self) -> tuple[str | None, int]:
        """Name of the epoch shown (None: no mask) and the captures taken under it."""
        active = self._panel.active
        return (None, 0) if active is None else (active.epoch.name, active.captures)

    def due_in(self) -> float:
        """Seconds until the mask must change; inf when nothing is planned."""
        active = self._panel.active
        if active is None:
            return math.inf
        return due_in(
            self._policy,
            shown_for=time.monotonic() - active.since,
            captures=active.captures,
            chance=active.chance,
        )

    def may_reuse(self) -> bool:
        """Return whether a mask that is due may serve one more capture, too; that is counted."""
        active = self._panel.active
        if active is None or not self._preparation.under_way:
            return False
        return active.reuse(reusable(self._policy), self.lateness)

    def require_another(self) -> None:
        """Raise :class:`RotationImpossibleError` where there is no other mask."""
        if not self._preparation.renewable:
            raise RotationImpossibleError(
                "the bundle holds one pair only: serve a bundle with two or more to change masks"
            )

    def status(self) -> Rotation:
        """Return the policy, the present epoch, and whether the next one is ready."""
        active, preparation = self._panel.active, self._preparation
        epoch, captures = self.present
        return Rotation(
            policy=self._policy,
            epoch=epoch,
            epoch_age_s=None if active is None else time.monotonic() - active.since,
            captures=captures,
            preparation=PreparationStatus(
                ready=preparation.ready,
                prepared=preparation.count,
                last_s=preparation.took,
                late=self.lateness.late,
                reused=self.lateness.reused,
            ),
        )
