"""Watch policy: its store, and the hours in which the camera rests."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from veilcam_client.wire.watch import WatchOff, WatchPolicy
from veilcam_server.errors import StorageError
from veilcam_server.system.state_file import Report, StateStore, log_fault


class _SetPolicy(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    policy: WatchPolicy
    given: WatchPolicy
    """Policy of the daemon's settings at the time."""


class WatchStore:
    """Store of the watch policy, which holds until a start with another setting.

    Args:
        directory: state directory of the daemon.
        given: watch policy of its settings.
        report: function that takes damage of the file.
    """

    def __init__(self, directory: Path, given: WatchPolicy, report: Report = log_fault) -> None:
        self._given = given
        self._file = StateStore(
            directory / "watch.json",
            _SetPolicy,
            lost="the camera does not look; say anew when it does",
            report=report,
        )

    def at_start(self) -> WatchPolicy:
        """Return the policy of this start; off where the stored one was lost.

        So a broken disk switches no camera on that was switched off.
        """
        record = self._file.read()
        if record is None:
            return WatchOff() if self._file.lost else self._given
        return record.policy if record.given == self._given else self._given

    def set(self, policy: WatchPolicy) -> None:
        """Keep a policy over restarts; raises :class:`StorageError`."""
        record = _SetPolicy(policy=policy, given=self._given)
        try:
            self._file.change(lambda _: record)
        except StorageError as error:
            if not isinstance(policy, WatchOff):
                raise
            # A full disk keeps nobody from switching a camera off.
            raise StorageError(f"the camera is off until a restart: {error}") from None


def resting(policy: WatchPolicy, now: datetime, *, sure: bool = True) -> str | None:
    """Return the reason for an opaque panel at a local time; None if there is no reason.

    An hour that comes twice in autumn is quiet both times, and an hour that spring skips never is.

    Args:
        policy: policy of the watch.
        now: local time.
        sure: True where the clock is synchronised or trusted.
    """
    if isinstance(policy, WatchOff):
        return "the camera is switched off"
    quiet = policy.quiet
    if quiet is None:
        return None
    if not sure:
        return (
            "the clock is not synchronised yet, and quiet hours go by it: switch on network time "
            "(sudo timedatectl set-ntp true), or give --trust-clock where the clock is right"
        )
    if not quiet.include(now.time()):
        return None
    return f"the camera does not look between {quiet.begin} and {quiet.end}"
