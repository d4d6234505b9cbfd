"""Alert rules: of metrics that there are, and each rings when it should and not otherwise."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, get_args

import pytest

from veilcam_client.wire.status import State

ROOT = Path(__file__).resolve().parents[2]
RULES = ROOT / "deploy" / "prometheus" / "veilcam.rules.yml"
PROMTOOL = shutil.which("promtool")


def test_rules_are_of_metrics_and_states_that_there_are_each_with_its_trouble() -> None:
    page = (ROOT / "docs" / "api.md").read_text()
    known = set(re.findall(r"`(veilcam_[a-z_]+)`", page))
    assert list(TROUBLE) == re.findall(r"- alert: (\w+)", RULES.read_text())
    asked = {
        re.sub(r"_bucket$", "", name)
        for line in RULES.read_text().splitlines()
        if not line.strip().startswith("#")
        for name in re.findall(r"\bveilcam_[a-z_]+", line)
    }
    assert asked
    assert asked <= known
    named = re.findall(r'state=~"([a-z|-]+)"', RULES.read_text())
    assert named
    assert set("|".join(named).split("|")) <= set(get_args(State))


CAMERA = 'job="veilcam", instance="camera"'
SECONDS = f'veilcam_http_request_duration_seconds_bucket{{{CAMERA}, route="/v1/status"'
FIRING = 'count by (alertname) (ALERTS{alertstate="firing"})'
QUIET = {
    f"up{{{CAMERA}}}": "1x180",
    f'veilcam_state{{{CAMERA}, state="ready"}}': "1x180",
    f'veilcam_state{{{CAMERA}, state="safe"}}': "0x180",
    f"veilcam_epoch_age_seconds{{{CAMERA}}}": "30x180",
    f'veilcam_faults_total{{{CAMERA}, code="sensor_failed"}}': "3x180",
    f"veilcam_log_entries_missed_total{{{CAMERA}}}": "0x180",
    f'veilcam_connections_dropped_total{{{CAMERA}, reason="header"}}': "0+30x180",
    **{f'{SECONDS}, le="{bound}"}}': "0+60x180" for bound in ("1.0", "2.5", "+Inf")},
}
"""A healthy camera for three hours, a value a minute; half a connection is dropped a second."""
TROUBLE: dict[str, tuple[str, str]] = {
    "VeilcamDown": (f"up{{{CAMERA}}}", "0x180"),
    "VeilcamSafe": (f'veilcam_state{{{CAMERA}, state="safe"}}', "1x180"),
    "VeilcamMaskOld": (f"veilcam_epoch_age_seconds{{{CAMERA}}}", "86500+60x180"),
    "VeilcamFaults": (f'veilcam_faults_total{{{CAMERA}, code="sensor_failed"}}', "0+1x180"),
    "VeilcamLogMissed": (f"veilcam_log_entries_missed_total{{{CAMERA}}}", "0+1x180"),
    "VeilcamUnderSiege": (
        f'veilcam_connections_dropped_total{{{CAMERA}, reason="header"}}',
        "0+90x180",
    ),
    "VeilcamSlow": (f'{SECONDS}, le="1.0"}}', "0+30x180"),
}
"""The one series in which each trouble differs from that."""


@pytest.mark.skipif(PROMTOOL is None, reason="no promtool: apt install prometheus has it")
def test_each_alert_rings_in_its_trouble_alone(tmp_path: Path) -> None:
    assert PROMTOOL is not None
    cases: list[dict[str, Any]] = []
    for trouble in (None, *TROUBLE):
        series = QUIET | dict([TROUBLE[trouble]] if trouble else [])
        rings = [{"labels": f'{{alertname="{trouble}"}}', "value": 1}] if trouble else []
        given = [{"series": name, "values": values} for name, values in series.items()]
        asked = {"expr": FIRING, "eval_time": "2h", "exp_samples": rings}
        cases.append({"interval": "1m", "input_series": given, "promql_expr_test": [asked]})
    # JSON is YAML.
    file = tmp_path / "tests.yml"
    tests = {"rule_files": [str(RULES)], "evaluation_interval": "1m", "tests": cases}
    file.write_text(json.dumps(tests))
    for command in (("check", "rules", str(RULES)), ("test", "rules", str(file))):
        done = subprocess.run([PROMTOOL, *command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
