"""Metrics for Prometheus. No label holds what was seen, nor the name of a mask's showing."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from typing import get_args

from prometheus_client import CollectorRegistry, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from veilcam_client.wire.status import State
from veilcam_server.gate.protocol import Connections, Reason
from veilcam_server.service.service import Service

BUCKETS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Of the time that an answer takes [s]."""
_EVENTS = {
    "capture": ("veilcam_captures", "Embeddings taken."),
    "classification": ("veilcam_classifications", "Embeddings classified."),
    "mask": ("veilcam_masks_shown", "Masks shown."),
}

EXAMPLE = "# TYPE veilcam_captures_total counter\nveilcam_captures_total 1200.0\n"


class Metrics:
    """Metrics of one daemon, in a registry of its own.

    Args:
        service: service whose events are counted.
        connections: connections at the gate; None where there is none.
    """

    def __init__(self, service: Service, connections: Connections | None = None) -> None:
        self._registry = CollectorRegistry()
        self._seconds = Histogram(
            "veilcam_http_request_duration_seconds",
            "Time from a request to the start of its answer.",
            ("method", "route", "status"),
            registry=self._registry,
            buckets=BUCKETS,
        )
        self._registry.register(_Daemon(service))
        if connections is not None:
            self._registry.register(_Gate(connections))
        ProcessCollector(registry=self._registry)

    def observe(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one answer.

        Args:
            method: method of the request.
            route: template of its path.
            status: status of the answer.
            seconds: time from the request to the start of the answer [s].
        """
        self._seconds.labels(method, route, str(status)).observe(seconds)

    def text(self) -> bytes:
        """All of them, in the text format 1.0.0 of Prometheus."""
        return generate_latest(self._registry)


class _Daemon(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        status, history = self._service.status(), self._service.history
        yield InfoMetricFamily(
            "veilcam_build",
            "What runs, in labels; the value is 1.",
            {"version": status.version, "python_version": platform.python_version()},
        )
        age = status.rotation.epoch_age_s
        if age is not None:
            yield GaugeMetricFamily(
                "veilcam_epoch_age_seconds", "Time since the present mask was shown.", value=age
            )
        for kind, (name, what) in _EVENTS.items():
            yield CounterMetricFamily(name, what, value=history.events[kind])
        faults = CounterMetricFamily("veilcam_faults", "Failures.", labels=("code",))
        for code, count in sorted(history.faults.items()):
            faults.add_metric((code,), count)
        yield faults
        states = GaugeMetricFamily("veilcam_state", "1 for the present state.", labels=("state",))
        for state in get_args(State):
            states.add_metric((state,), float(state == status.state))
        yield states
        yield GaugeMetricFamily(
            "veilcam_queued_captures", "Captures that wait.", value=status.queue.waiting
        )
        yield CounterMetricFamily(
            "veilcam_log_entries_missed",
            "Entries of the log that could not be written.",
            value=self._service.log.missed,
        )


class _Gate(Collector):
    def __init__(self, connections: Connections) -> None:
        self._connections = connections

    def collect(self) -> Iterator[Metric]:
        yield GaugeMetricFamily(
            "veilcam_open_connections", "Connections that are open.", value=len(self._connections)
        )
        dropped = CounterMetricFamily(
            "veilcam_connections_dropped", "Connections that the gate ended.", labels=("reason",)
        )
        for reason in get_args(Reason):
            dropped.add_metric((reason,), self._connections.dropped[reason])
        yield dropped
        yield CounterMetricFamily(
            "veilcam_connections_failed",
            "Connections that could not be accepted.",
            value=self._connections.failures,
        )
