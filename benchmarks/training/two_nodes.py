"""A table on a Ray cluster of two nodes, one of which is lost half-way, beside the table made here.

    sudo .venv/bin/python -m benchmarks.training.two_nodes --data data/mnist

The nodes are two network namespaces of this machine, joined by one cable. When a cell of the table
is finished, the cable is pulled and the second node is killed, with the cell that it was at. The
table has to end all the same, with the numbers of a table that this machine made alone. Needs root,
for the namespaces, and the command ``ip``.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.paper.results import BUNDLE, RESULT, load_results
from benchmarks.rig import work_folder

from veilcam_training.bundle import read_bundle

NODES = {"veilcam-one": "10.199.77.1", "veilcam-two": "10.199.77.2"}
"""Network namespaces, and their addresses: private, and of no network but theirs."""
CABLE = ("veilcam-1", "veilcam-2")
PORT = 6379
PATIENCE = 600.0
"""No node takes so long to start, and no cell to be finished [s]."""
FIRST, SECOND = NODES
SCRIPTS = Path(sys.executable).parent
COMMAND = [sys.executable, "-m", "benchmarks.paper", "mnist"]
PART = (
    *("--encoders", "lens,learned"),
    *("--classifiers", "LR,FC800"),
    *("--embeddings", "3x4,6x8"),
    *("--binnings", "area"),
)


def ip(*arguments: str) -> None:
    """Run ``ip``."""
    subprocess.run(("ip", *arguments), check=True, capture_output=True, text=True)


def within(node: str, command: Sequence[str]) -> list[str]:
    """The command that runs ``command`` on a node."""
    return ["ip", "netns", "exec", node, *command]


def cells(work: Path) -> list[dict[str, object]]:
    """Return the numbers of every finished cell."""
    return [result.numbers() for result in load_results(work)]


def bundles(first: Path, second: Path) -> bool:
    """Return whether both have the same masks and weights."""
    paths = [sorted(work.glob(f"*/{BUNDLE}")) for work in (first, second)]
    if [path.parent.name for path in paths[0]] != [path.parent.name for path in paths[1]]:
        return False
    for one, other in zip(*paths, strict=True):
        pairs = [read_bundle(path).pairs[0] for path in (one, other)]
        if (pairs[0].levels != pairs[1].levels).any():
            return False
        if any(
            not np.array_equal(pairs[0].weights[k], pairs[1].weights[k]) for k in pairs[0].weights
        ):
            return False
    return True


@contextmanager
def network() -> Iterator[None]:
    """Two nodes that reach each other and nothing else."""
    with ExitStack() as ends:
        for node in NODES:
            # One that a killed run has left.
            subprocess.run(("ip", "netns", "delete", node), check=False, capture_output=True)
            ip("netns", "add", node)
            ends.callback(ip, "netns", "delete", node)
        ip("link", "add", CABLE[0], "type", "veth", "peer", "name", CABLE[1])
        for (node, address), end in zip(NODES.items(), CABLE, strict=True):
            ip("link", "set", end, "netns", node)
            ip("-n", node, "address", "add", f"{address}/24", "dev", end)
            ip("-n", node, "link", "set", end, "up")
            ip("-n", node, "link", "set", "lo", "up")
        yield


@contextmanager
def ray_node(node: str, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """One core of a Ray cluster, on a node; killed at the end."""
    started = [
        str(SCRIPTS / "ray"),
        "start",
        "--block",
        "--num-cpus=1",
        "--object-store-memory=100000000",
        "--disable-usage-stats",
        f"--node-ip-address={NODES[node]}",
        *options,
    ]
    with subprocess.Popen(
        within(node, started), stdout=subprocess.DEVNULL, start_new_session=True
    ) as process:
        try:
            yield process
        finally:
            kill(process)


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a node and all that it started."""
    # Workers have sessions of their own, but stay in the namespace.
    node = next(name for name in NODES if name in process.args)  # type: ignore[operator]
    inside = subprocess.run(
        ("ip", "netns", "pids", node), check=False, capture_output=True, text=True
    )
    for number in {*map(int, inside.stdout.split()), process.pid}:
        try:
            os.kill(number, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    epochs: Annotated[int, typer.Option(min=1)] = 2,
    figures: FiguresOption = None,
) -> None:
    """Make it both ways and compare."""
    if os.geteuid() or shutil.which("ip") is None:
        raise SystemExit("network namespaces need root and the command ip: run this with sudo")
    # Ray would write a token into the home, and put its workers behind all other processes.
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": os.urandom(32).hex()}
    os.environ |= {**token, "RAY_worker_niceness": "0"}
    with work_folder() as folder:
        spread, alone = folder / "spread", folder / "alone"
        part = [*PART, "--data", str(data), "--epochs", str(epochs)]
        subprocess.run([*COMMAND, *part, "--work", str(alone)], check=True)
        lost = make_on_two_nodes([*part, "--work", str(spread)], spread)
        same = cells(spread) == cells(alone) and bundles(spread, alone)
        count = len(cells(alone))
        verdict = "the same" if same else "DIFFERENT"
        print(f"node lost with {lost} of {count} cells finished: {verdict}")
    record(figures, {"two_node_table": float(same), "two_node_cells_before_loss": lost})


def make_on_two_nodes(options: Sequence[str], work: Path) -> int:
    """Make a table, and lose a node on the way.

    Returns:
        How many cells were finished when the node was lost.
    """
    address = f"{NODES[FIRST]}:{PORT}"
    with (
        network(),
        ray_node(FIRST, "--head", f"--port={PORT}", "--include-dashboard=false"),
        ray_node(SECOND, f"--address={address}") as second,
    ):
        wait_for_nodes(address)
        making = subprocess.Popen(within(FIRST, [*COMMAND, *options, "--ray", address]))
        try:
            begun = time.monotonic()
            while not (lost := len(list(work.glob(f"*/{RESULT}")))):
                if making.poll() is not None or time.monotonic() - begun > PATIENCE:
                    raise SystemExit("no cell was finished: nothing was tried")
                time.sleep(0.05)
            ip("-n", SECOND, "link", "set", CABLE[1], "down")
            kill(second)
            if making.wait(PATIENCE):
                raise SystemExit(f"the table ended with exit status {making.returncode}")
        finally:
            making.kill()
    return lost


def wait_for_nodes(address: str) -> None:
    """Until both nodes are of the cluster."""
    begun = time.monotonic()
    program = (
        f"import ray; ray.init(address={address!r}, log_to_driver=False); "
        "print(sum(node['Alive'] for node in ray.nodes()))"
    )
    while True:
        asked = subprocess.run(
            within(FIRST, [sys.executable, "-c", program]),
            check=False,
            capture_output=True,
            text=True,
        )
        if asked.stdout.split()[-1:] == [str(len(NODES))]:
            return
        if time.monotonic() - begun > PATIENCE:
            raise SystemExit(f"the cluster did not come up: {asked.stderr}")
        time.sleep(1)


if __name__ == "__main__":
    typer.run(main)
