"""The rotation policy that was set over the API: it outlives the daemon."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from veilcam_client.wire.rotation import RotationOff, RotationPolicy
from veilcam_server.errors import RotationImpossibleError
from veilcam_server.system.state_file import Report, StateStore, log_fault


class _SetPolicy(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    policy: RotationPolicy
    given: RotationPolicy | None
    """Setting of the daemon at the time."""


class PolicyStore:
    """``DIRECTORY/rotation.json``: what was set holds until a start with another setting.

    Args:
        directory: the daemon's state directory.
        given: rotation policy of its settings; None: they have none.
        report: takes what was damaged, and why a policy is not in use.
    """

    def __init__(
        self, directory: Path, given: RotationPolicy | None, report: Report = log_fault
    ) -> None:
        self._given, self._report = given, report
        self._file = StateStore(
            directory / "rotation.json",
            _SetPolicy,
            lost="masks change as the daemon was told at its start; set it again",
            report=report,
        )

    def at_start(
        self, default: RotationPolicy, *, renewable: bool, configured: bool
    ) -> RotationPolicy:
        """Policy of mask changes from now on.

        Args:
            default: policy where none was set, or the daemon was started with another one since.
            renewable: True where the bundle in use has another mask to change to.
            configured: True where that is the bundle that the daemon was started with.
        """
        record = self._file.read()
        kept = record is not None and record.given == self._given
        policy = record.policy if record is not None and kept else default
        if isinstance(policy, RotationOff) or renewable or (configured and not kept):
            return policy
        # Of settings that do not fit together the start tells; here it is the state's fault.
        self._report(
            RotationImpossibleError(
                "the bundle in use holds one mask only, which stays: activate another bundle, "
                "and set when masks change"
            )
        )
        return RotationOff()

    def set(self, policy: RotationPolicy) -> None:
        """Make a policy hold after a restart, too; raises :class:`StorageError`."""
        record = _SetPolicy(policy=policy, given=self._given)
        self._file.change(lambda _: record)
