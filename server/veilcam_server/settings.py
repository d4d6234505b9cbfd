"""Settings of a daemon: of the command line first, then ``VEILCAM_...`` in the environment."""

from __future__ import annotations

import ipaddress
import json
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, JsonValue, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, PydanticBaseSettingsSource

from veilcam_client.arguments import masked
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationPolicy
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.watch import (
    OnRequest,
    Watching,
    WatchOff,
    WatchPolicy,
    parse_hours,
    parse_rate,
)
from veilcam_server.demo_data import BUNDLE
from veilcam_server.environment import default_state_dir, option_of, unknown_names
from veilcam_server.limits import CallerLimits
from veilcam_server.wiring import Wiring, require_wires_apart

DEFAULT_PORT = 8787
SCENE_NAME = "scene.npy"
"""Of the scene file in the state directory, where no other is given."""

MANY = 10
"""Captures behind one stored mask, unless another policy is given; behind a fresh one it is one."""
CAPTURE_TIMEOUT = 5.0
"""Longest wait for a measurement [s], unless the longest exposure needs more."""
SELF_TEST_EVERY = 600.0
"""Longest time between two self tests of the panel [s], unless they take longer themselves."""
SELF_TEST = 9
"""Measurements of a self test."""
_FRAME = 0.025
"""Shortest frame of a sensor [s]."""
_LONGEST = 10.0
"""Longest exposure [s]."""
_SHORTEST = 6e-5
"""Shortest exposure of a sensor [s]: four lines of an IMX477."""
_HOST = r"(\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z_]([0-9A-Za-z._-]*[0-9A-Za-z_])?)(:[0-9]{1,5})?"
"""Name or address, and perhaps a port."""

_WORDS = frozenset(("auth", "beat", "device", "log_level", "release", "watch", "quiet_hours"))
"""Settings that are one of a few words, a rate or times of day."""

_REPLAYED = frozenset(
    (
        *("replay", "host", "port", "socket", "state_dir", "auth", "tls_certificate", "tls_key"),
        *("callers", "log_level", "hosts", "frame_ancestors", "root_path"),
        "full_scores",
    )
)
"""Settings that a recording has too; all others are of a camera."""
_OPTIONS = {"device": "simulate", "rotation": "every-seconds, --every-captures and --rotation-off"}
"""Options of another name than their setting's."""


class Settings(CallerLimits, Wiring):
    """Everything that ``veilcamd serve`` can be told."""

    bundle: Path
    """Masks and classifiers, a *.veilcam file. With --simulate, the demo's by default."""
    owner_keys: Path | None = None
    """Take bundles of these owners alone, and of rising version: a file of public keys, one line
    each, of 'veilcam-train bundle keygen'."""
    allow_older: bool = False
    """Start with a bundle of an older version than the one that was in use."""
    allow_visible: bool = False
    """Take bundles whose masks show pictures of the scene."""
    device: Literal["pi", "simulated"] = "pi"
    """Use a simulated panel and sensor instead of a Raspberry Pi's."""
    scenes: Annotated[tuple[str, ...], NoDecode] = ()
    """What the simulated camera sees: a picture (.npy, PNG, JPEG, WebP, BMP, TIFF, GIF), a folder
    of pictures, or a data set as mnist:FOLDER or mnist:FOLDER:test. Give several, and each capture
    sees the next. Default: what 'veilcamd show' writes."""
    skip_damaged: bool = False
    """Leave out pictures of --scenes that cannot be read, instead of refusing to start."""
    scene_api: bool = False
    """Let callers set the scene before the simulated camera, and break it, for tests."""
    replay: Path | None = None
    """Answer with what 'veilcam record' wrote to this file, instead of a camera."""
    host: str = "127.0.0.1"
    """Address to listen on; others than loopback need TLS."""
    port: int = Field(default=DEFAULT_PORT, ge=0, le=65_535)
    """Port; 0 takes a free one."""
    socket: Path | None = None
    """Listen on a unix socket instead."""
    hosts: Annotated[tuple[str, ...], NoDecode] = ()
    """Further name that it answers to, as camera.example or with :PORT: that of a reverse proxy, or
    of this machine. Give several, if need be."""
    frame_ancestors: Annotated[tuple[str, ...], NoDecode] = ()
    """Origin whose pages may show this daemon's in a frame, as https://home.example. Give several,
    if need be. Default: none may."""
    root_path: str = Field(default="", pattern=r"^(/[A-Za-z0-9._~-]+)*$", max_length=200)
    """Path under which a reverse proxy shows this daemon, as /camera, whether the proxy cuts it off
    or not. Default: none."""
    state_dir: Path = Field(default_factory=default_state_dir)
    """Where the device's key, its receivers, tokens and bundles are recorded."""
    rotation: RotationPolicy | None = None
    """When masks change; by default after every capture for fresh masks, after ten for pairs."""
    watch: str | None = None
    """Look without being asked, so often: 2/s, 30/min or 6/h; or off, and the panel is opaque until
    a caller says otherwise. Default: it looks when it is asked to."""
    quiet_hours: str | None = None
    """From when to when it never looks, by the clock on the wall, as in 22-7 or 22:30-7: the panel
    is opaque then."""
    watch_threshold: float = Field(default=0.6, ge=0.5, le=0.95)
    """Probability from which the watch says that a thing is there."""
    beat: Literal["on", "off"] = "on"
    """on: while it looks by itself, each event stream gets the whole state at the time of each
    look. off, for metered lines: changes alone, so that a listener sees when things come and go."""
    calibration: Path | None = None
    """Record of 'veilcamd calibrate'; by default the one in the state directory, if there is
    one."""
    release: Release | None = None
    """How embeddings leave: none, sealed or raw. Default: sealed as soon as a receiver is paired,
    and before that none."""
    raw_budget: int = Field(default=0, ge=0, le=1_000_000_000)
    """Embeddings that may leave raw behind one mask, over its whole life; --release raw needs 1 or
    more."""
    full_scores: bool = False
    """Tell scores in full to tokens with read:scores, and not in tenths: they name the scene."""
    settle: float = Field(default=0.1, ge=0, le=60, allow_inf_nan=False)
    """Seconds for the panel to settle, never less than was measured."""
    exposure: float = Field(default=0.01, ge=0, le=10, allow_inf_nan=False)
    """Exposure in seconds."""
    exposure_factor: float = Field(default=1.0, ge=1, le=1000, allow_inf_nan=False)
    """The camera may expose so many times shorter or longer; 1 for a fixed exposure."""
    snr_db: float = Field(default=40.0, ge=-100)
    """Simulated signal-to-noise ratio in dB."""
    imperfections: Path | None = None
    """How the simulated camera departs from a nominal one: a JSON file (docs/calibration.md)."""
    guard: float = Field(default=10.0, ge=0, le=600, allow_inf_nan=False)
    """Longest age in seconds of the opaque frame that vouches for an answer, where masks serve more
    than one capture; 0 for one with each answer."""
    auth: Literal["tokens", "none"] = "tokens"
    """tokens, or none: whoever reaches the daemon may use it; by default none when simulated."""
    tls_certificate: Path | None = None
    """Serve TLS with this certificate, a PEM file."""
    tls_key: Path | None = None
    """Its private key, a PEM file."""
    callers: int = Field(default=16, ge=1, le=1024)
    """Programs that use the camera at the same time. Limits of connections, event streams, requests
    and waiting captures follow."""
    wrong_classifier: bool = False
    """Experiment: read every mask as if it were another one."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """debug, info, warning or error."""

    @field_validator("scenes", "hosts", "frame_ancestors", mode="before")
    @classmethod
    def _one_or_a_list(cls, given: object) -> object:
        """In the environment: one, or a JSON list of several."""
        if not isinstance(given, str):
            return given
        return json.loads(given) if given.startswith("[") else (given,)

    @field_validator("hosts")
    @classmethod
    def _host_names(cls, hosts: tuple[str, ...]) -> tuple[str, ...]:
        for host in hosts:
            if not re.fullmatch(_HOST, host):
                raise ValueError(
                    f"{masked(host)!r} is no host name: use camera.example, or with :PORT"
                )
        return tuple(host.lower() for host in hosts)

    @field_validator("frame_ancestors")
    @classmethod
    def _origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            if not re.fullmatch(f"https?://{_HOST}", origin):
                raise ValueError(
                    f"{masked(origin)!r} is no origin: use https://home.example, or with :PORT"
                )
        return origins

    @field_validator("watch")
    @classmethod
    def _a_rate(cls, given: str | None) -> str | None:
        if given not in (None, "off"):
            parse_rate(given)
        return given

    @field_validator("quiet_hours")
    @classmethod
    def _hours(cls, given: str | None) -> str | None:
        if given is not None:
            parse_hours(given)
        return given

    @field_validator("host")
    @classmethod
    def _an_address(cls, host: str) -> str:
        if host == "localhost":
            return "127.0.0.1"
        try:
            ipaddress.ip_address(host)
        except ValueError:
            raise ValueError(f"{host!r} is no IP address: use 127.0.0.1 or ::1") from None
        return host

    @model_validator(mode="before")
    @classmethod
    def _no_unknown_name(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Refuse a setting that is misspelled: it would be left out silently."""
        unknown = unknown_names(Settings.model_fields)
        if unknown:
            lines = (
                f"{name} in the environment is no setting: {unknown[name]}" for name in unknown
            )
            raise ValueError("; ".join(lines))
        return given

    @model_validator(mode="before")
    @classmethod
    def _tokens_unless_simulated(cls, given: dict[str, Any]) -> dict[str, Any]:
        return {"auth": "none" if given.get("device") == "simulated" else "tokens", **given}

    @model_validator(mode="before")
    @classmethod
    def _demo_bundle(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Let a simulated camera do without a bundle of its own."""
        if given.get("device") == "simulated":
            return {"bundle": BUNDLE, **given}
        return given

    @model_validator(mode="before")
    @classmethod
    def _no_camera_where_a_recording_is(cls, given: dict[str, Any]) -> dict[str, Any]:
        if given.get("replay") is None:
            return given
        for name in given:
            if name not in _REPLAYED:
                option = option_of(_OPTIONS.get(name, name))
                raise ValueError(f"--replay plays a recording as it is: leave out {option}")
        # A recording needs no bundle, and nothing reads this one.
        return {"bundle": given["replay"], **given}

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if self.device != "simulated" and self.scenes:
            raise ValueError("only a simulated camera has --scenes: add --simulate")
        if self.skip_damaged and not self.scenes:
            raise ValueError("--skip-damaged is for --scenes: add them, or leave it out")
        if self.device != "simulated" and self.scene_api:
            raise ValueError("--scene-api is for a simulated camera: add --simulate")
        if self.device != "simulated" and self.imperfections is not None:
            raise ValueError("only a simulated camera is given --imperfections: add --simulate")
        if self.allow_older and self.owner_keys is not None:
            raise ValueError("with --owner-keys no older bundle is taken: leave out --allow-older")
        if self.watch == "off" and self.quiet_hours is not None:
            raise ValueError("with --watch off the panel is always opaque: leave out --quiet-hours")
        default = type(self).model_fields["snr_db"].default
        if self.device != "simulated" and self.snr_db != default:
            raise ValueError("only a simulated camera has --snr-db: add --simulate")
        if self.wrong_classifier and self.device != "simulated":
            raise ValueError("--wrong-classifier is an experiment: it needs --simulate")
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("--tls-certificate and --tls-key go together: give both")
        if self.tls_certificate is not None and self.socket is not None:
            raise ValueError("a unix socket needs no TLS: leave --tls-certificate out")
        loopback = ipaddress.ip_address(self.host).is_loopback
        if self.socket is None and not loopback and not self.serves_others:
            raise ValueError(
                f"--host {self.host}: other machines are served with TLS and tokens only: give "
                "--tls-certificate, --tls-key and --auth tokens, or use 127.0.0.1, ::1 or --socket"
            )
        return self

    @model_validator(mode="after")
    def _wires_are_apart(self) -> Self:
        require_wires_apart(self)
        return self

    @model_validator(mode="after")
    def _times_fit(self) -> Self:
        """Refuse times of which one never fits into the other."""
        if self.exposure * self.exposure_factor > _LONGEST:
            raise ValueError(
                f"--exposure {self.exposure:g} s times --exposure-factor {self.exposure_factor:g} "
                f"is longer than {_LONGEST:g} s: give a shorter exposure"
            )
        if self.device != "simulated" and self.exposure / self.exposure_factor < _SHORTEST:
            raise ValueError(
                f"--exposure {self.exposure:g} s over --exposure-factor {self.exposure_factor:g} "
                f"is shorter than a sensor can expose: stay above {_SHORTEST:g} s"
            )
        one = self.settle + self.exposure
        policy = self.rotation
        if isinstance(policy, EverySeconds) and policy.seconds - policy.jitter < one:
            raise ValueError(
                f"--every-seconds {policy.seconds:g} less --jitter {policy.jitter:g} is shorter "
                f"than --settle {self.settle:g} s and --exposure {self.exposure:g} s: no capture "
                "fits between two masks"
            )
        if self.watch not in (None, "off"):
            captures = policy.captures if isinstance(policy, EveryCaptures) else MANY
            if parse_rate(self.watch) * (self.exposure + self.settle / captures) > 1:
                raise ValueError(
                    f"--watch {self.watch} is faster than --exposure {self.exposure:g} s and "
                    f"--settle {self.settle:g} s let it look: give a lower rate"
                )
        return self

    def redacted(self) -> dict[str, JsonValue]:
        """Every setting; ``"given"`` stands for what is no number, switch, policy or known word."""
        shown: dict[str, JsonValue] = {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, BaseModel):
                shown[name] = value.model_dump()
            elif value == ():
                shown[name] = None
            elif isinstance(value, float) and not math.isfinite(value):
                shown[name] = str(value)  # JSON has no such number
            elif value is None or isinstance(value, (bool, int, float)) or name in _WORDS:
                shown[name] = value
            else:
                shown[name] = "given"
        return shown

    @property
    def watch_policy(self) -> WatchPolicy:
        """Policy of the watch, unless a caller set another."""
        quiet = None if self.quiet_hours is None else parse_hours(self.quiet_hours)
        if self.watch == "off":
            return WatchOff()
        if self.watch is None:
            return OnRequest(quiet=quiet)
        return Watching(rate_hz=parse_rate(self.watch), quiet=quiet)

    @property
    def capture_timeout(self) -> float:
        """Longest wait for a measurement [s]: twice two frames of the longest exposure or more."""
        longest = self.exposure * self.exposure_factor
        # One frame may have begun too early, and the lines of the next are read after its exposure.
        return max(CAPTURE_TIMEOUT, 2 * (longest + max(_FRAME, longest) + _FRAME))

    @property
    def self_test_every(self) -> float:
        """Longest time between two self tests of the panel [s]."""
        return max(SELF_TEST_EVERY, 2 * SELF_TEST * (self.settle + self.exposure))

    @property
    def serves_others(self) -> bool:
        """Return whether the daemon listens where other machines reach it."""
        return self.tls_certificate is not None and self.auth == "tokens"

    @property
    def scene_file(self) -> Path:
        """Path that 'veilcamd show' writes, and a simulated camera without --scenes sees."""
        return self.state_dir / SCENE_NAME


class GivenSettings(Settings):
    """Settings that come from nowhere else: the environment has no part in them."""

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],  # noqa: ARG003 - the signature is pydantic's
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return the settings that were given, and nothing else."""
        return (init_settings,)
