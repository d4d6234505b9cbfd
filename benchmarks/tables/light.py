"""Plans, the operator of light, and what training needs of both."""

from __future__ import annotations

from benchmarks.tables.table import Figures

HONESTY: Figures = {
    "oracle_jobs": ("optics", "random cameras, scenes and conditions", "{:.0f}"),
    "oracle_honest_fraction": (
        "optics",
        "of those judged: true error at most twice the predicted one",
        "{:.3f}",
    ),
    "oracle_worst_reached_ratio": (
        "optics",
        'worst plan that says "reached": true error over the predicted one, or tolerance / 10',
        "{:.1f}",
    ),
    "oracle_sharpness_median": ("optics", "predicted over true error, median", "{:.1f}"),
    "oracle_sharpness_95": ("optics", "predicted over true error, 95 % below", "{:.0f}"),
    "oracle_reached_fraction": (
        "optics",
        'plans that say "reached", of those that the finest setting reaches',
        "{:.3f}",
    ),
    "oracle_unjudged_fraction": ("optics", "refused, or the oracle is not sure", "{:.3f}"),
    "oracle_worst_time_over_best": (
        "optics",
        "a plan's predicted time over that of the fastest honest setting, at worst",
        "{:.2f} x",
    ),
    "default_scene_exact_error": (
        "optics",
        "default camera and scene, tolerance 1e-2: true error",
        "{:.1e}",
    ),
    "default_scene_exact_error_half_interval": (
        "optics",
        "half of the interval of that error, nine draws in ten",
        "{:.1e}",
    ),
    "exact_honest_fraction": ("optics", "100 everyday cameras: honest", "{:.3f}"),
    "plan_cpu_ms": ("optics", "planning the default job, fresh process, CPU", "{:.0f} ms"),
}

LIMIT: Figures = {
    "transfer_over_matmul": (
        "optics",
        "a mask's transfer over the largest of its products of matrices",
        "{:.2f} x",
    ),
    "mask_batch_speedup": ("optics", "64 masks at once over one by one, 3 x 4", "{:.1f} x"),
    **{
        f"mask_batch_speedup_{size}": (
            "optics",
            f"64 masks at once over one by one, {size.replace('x', ' x ')}",
            "{:.1f} x",
        )
        for size in ("6x8", "12x16", "24x32")
    },
    "transfer_tables_mb": ("optics", "tables of the default job", "{:.2f} MB"),
    "transfer_peak_mb": ("optics", "memory beside them, one mask", "{:.1f} MB"),
    "transfer_peak_mb_64": ("optics", "memory beside them, 64 masks at once", "{:.0f} MB"),
    **{
        f"plan_cpu_ms_{tolerance}": (
            "optics",
            f"first plan of a process, tolerance {tolerance}, CPU",
            "{:.0f} ms",
        )
        for tolerance in ("1e-1", "1e-2", "1e-3", "1e-4")
    },
    "numpy_torch_max_difference": (
        "optics",
        "NumPy against torch: transfers and decoded scenes, relative",
        "{:.1e}",
    ),
}

TOLERANCE: Figures = {
    f"tolerance_{kind}_{way}": ("optics", f"{kind} mask, light in a fit: {words}", "{:.1f} %")
    for kind in ("learned", "fixed")
    for way, words in {
        "shadows_of_whole_cells_gray": "shadows of whole cells, gray",
        "shadows_without_dead_space": "shadows without dead space",
        "shadows": "shadows",
        "all_but_interference": "all but interference",
        "nearest_interference": "nearest interference",
        "all": "all",
        "all_but_interference_all_at_the_end": "all in the last quarter alone",
    }.items()
}
