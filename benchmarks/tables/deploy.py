"""What the package takes on a device, and where it was installed."""

from __future__ import annotations

from benchmarks.tables.table import Figures


def _installed(machine: str, words: str) -> Figures:
    """The figures of one root."""
    return {
        machine: ("deploy", f"{words}: all ten checks passed (1 is yes)", "{:.0f}"),
        f"{machine}_accuracy_pairs": (
            "deploy",
            f"{words}: 250 digits behind stored masks read right",
            "{:.1%}",
        ),
        f"{machine}_accuracy_fresh": (
            "deploy",
            f"{words}: 250 digits behind fresh masks read right",
            "{:.1%}",
        ),
    }


DEPLOYED: Figures = {
    **_installed("amd64_bookworm", "Debian 12, amd64"),
    **_installed("arm64_bookworm", "Debian 12, arm64, emulated"),
    **_installed("arm64_trixie", "Debian 13, arm64, emulated"),
    "vm_arm64": (
        "deploy",
        "Debian 12, arm64, in a virtual machine: all fourteen checks of the unit passed (1 is yes)",
        "{:.0f}",
    ),
    "device_install_mb": ("deploy", "on the disk, beside apt's packages", "{:.0f} MB"),
    "failed_upgrade_back_s": (
        "deploy",
        "after an upgrade that fails, until the release before serves again",
        "{:.0f} s",
    ),
    "rss_fresh_mib": ("deploy", "memory, fresh masks, without HTTP and camera", "{:.0f} MiB"),
    "rss_fresh_torch_mib": ("deploy", "the same in torch", "{:.0f} MiB"),
    "rss_pairs_mib": ("deploy", "memory, stored masks, without HTTP and camera", "{:.0f} MiB"),
    "rss_pairs_torch_mib": ("deploy", "the same in torch", "{:.0f} MiB"),
    "ready_cpu_s": ("deploy", "processor time until the first mask is there", "{:.2f} s"),
    "ready_torch_cpu_s": ("deploy", "the same in torch", "{:.2f} s"),
}

SIMULATED: Figures = {
    "simulate_pairs_mb": ("deploy", "memory at its peak, stored masks", "{:.0f} MB"),
    "simulate_pairs_captures": ("deploy", "over so many captures", "{:.0f}"),
    "simulate_fresh_mb": ("deploy", "memory at its peak, fresh masks", "{:.0f} MB"),
    "simulate_fresh_captures": ("deploy", "over so many captures", "{:.0f}"),
    "container_accuracy": ("deploy", "digits that the container read right, of 20", "{:.0%}"),
    **{
        f"clean_root_{target}": (
            "deploy",
            f"`make {target}` ends well in a root of Debian 13 with Python, venv, git and make "
            "(1 is yes)",
            "{:.0f}",
        )
        for target in ("demo", "test")
    },
    **{
        f"python_{version.replace('.', '_')}": (
            "deploy",
            f"`make demo` and `make test` end well with Python {version} (1 is yes)",
            "{:.0f}",
        )
        for version in ("3.11", "3.12", "3.13")
    },
}
