"""The watch policy that was set over the API: it outlives the daemon, and so does ``off``."""

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
    """Of the daemon's settings at the time."""


class WatchStore:
    """``DIRECTORY/watch.json``: what was set holds until a start with another setting.

    Args:
        directory: the daemon's state directory.
        given: watch policy of its settings.
        report: takes what was damaged.
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
        """Read the policy from now on; off, where the setting was lost.

        Nobody who switched a camera off shall find that a broken disk switched it on.
        """
        record = self._file.read()
        if record is None:
            return WatchOff() if self._file.lost else self._given
        return record.policy if record.given == self._given else self._given

    def set(self, policy: WatchPolicy) -> None:
        """Make a policy hold after a restart, too; raises :class:`StorageError`."""
        record = _SetPolicy(policy=policy, given=self._given)
        try:
            self._file.change(lambda _: record)
        except StorageError as error:
            if not isinstance(policy, WatchOff):
                raise
            # A full disk keeps nobody from switching a camera off.
            raise StorageError(f"the camera is off until a restart: {error}") from None


def resting(policy: WatchPolicy, now: datetime, *, sure: bool = True) -> str | None:
    """Return why the panel is opaque at a time by the clock on the wall; None: it need not be.

    Each moment is judged by what that clock shows: an hour that comes twice in a night of autumn is
    quiet both times if it is, and one that spring leaves out is none.

    Args:
        policy: policy of the watch.
        now: time of day.
        sure: True where quiet hours may go by the clock.
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
