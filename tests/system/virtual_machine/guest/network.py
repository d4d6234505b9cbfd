"""A daemon that other machines reach, made by the drop-ins of deploy/README.md."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ADDRESS = "192.0.2.1"
"""Of this machine, but not its loopback's (TEST-NET-1, RFC 5737)."""
CERTIFICATE = Path("/etc/veilcam/certificate.pem")
UNITS = Path("/etc/systemd/system")


def open_to_others(readme: str) -> None:
    _run("busybox", "ip", "address", "add", f"{ADDRESS}/32", "dev", "lo")
    _run(
        *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
        *("-nodes", "-days", "1", "-subj", "/CN=camera", "-addext", f"subjectAltName=IP:{ADDRESS}"),
        *("-out", str(CERTIFICATE), "-keyout", str(CERTIFICATE.with_name("key.pem"))),
    )
    drop_ins = dict(re.findall(r"```\n\[(Service|Socket)\]\n(.*?)```", readme, re.DOTALL))
    if len(drop_ins) != 2:
        raise ValueError(f"deploy/README.md has drop-ins of {sorted(drop_ins)} only")
    for section, settings in drop_ins.items():
        # Where 'systemctl edit' writes.
        folder = UNITS / f"veilcamd.{section.lower()}.d"
        folder.mkdir(exist_ok=True)
        (folder / "override.conf").write_text(f"[{section}]\n{settings}")
    _run("systemctl", "daemon-reload")
    _run("systemctl", "restart", "veilcamd.socket", "veilcamd.service")


def _run(*command: str) -> None:
    subprocess.run(command, check=True)
