"""The result of `svrgs bench` as text for a terminal."""

from __future__ import annotations

MEGA, KILO = 1e6, 1e3


def as_text(result: dict) -> str:
    """The whole result as tables."""
    if "stress" in result:
        return _stress(result["stress"])
    parts = [_machine(result["machine"]), *(_case(case) for case in result["cases"])]
    for name, show in (
        ("knobs", _knobs),
        ("skips", _skips),
        ("scaling", _scaling),
        ("cores", _cores),
        ("interactive", _interactive),
        ("viewport", _viewport),
    ):
        if result.get(name):
            parts.append(show(result[name]))
    return "\n\n".join(parts)


def table(rows: list[tuple[str, ...]], left: int = 1) -> str:
    """Rows as aligned columns: the first `left` columns to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row[:left], widths, strict=False)]
        cells += [cell.rjust(width) for cell, width in zip(row[left:], widths[left:], strict=True)]
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)


def _count(value: float) -> str:
    for unit, suffix in ((MEGA, " M"), (KILO, " k")):
        if value >= unit:
            return f"{value / unit:.3g}{suffix}"
    return f"{value:g}"


def _stress(entries: list[dict]) -> str:
    rows: list[tuple[str, ...]] = [("stress", "image", "gradient", "crossed", "not finite")]
    for e in entries:
        errors = f"{e['image_max']:.1e}", f"{e['grad_rel_l2']:.1e}"
        rows.append((e["title"], *errors, f"{e['crossed']:.2%}", str(e["nonfinite"])))
    return f"Worst errors against float64:\n{table(rows)}"


def _machine(machine: dict) -> str:
    rows: list[tuple[str, ...]] = [("threads", "FMA GFLOP/s", "read GB/s", "update GB/s")]
    rows += [
        (threads, *(f"{peak[name] / 1e9:.1f}" for name in ("fma", "read", "update")))
        for threads, peak in machine["peaks"].items()
    ]
    return (
        f"{machine['cores']} cores, SIMD levels {', '.join(machine['simd_levels'])}; peaks with"
        f" {machine['simd']}:\n{table(rows, 0)}"
    )


def _case(case: dict) -> str:
    threads = f"{case['threads']} thread{'s' * (case['threads'] > 1)}"
    title = (
        "{scene}, {count:,} Gaussians, SH {sh_degree}, {width} x {height}, ".format(**case)
        + f"{threads}, {case['simd']}"
    )
    rows: list[tuple[str, ...]] = [("stage", "ms", "spread", "floor", "x floor")]
    for name, stage in case["stages"].items():
        times = f"{stage['ms']:.2f}", f"{stage['spread_ms']:.2f}", f"{stage['floor_ms']:.2f}"
        rows.append((name, *times, f"{stage['ms'] / stage['floor_ms']:.1f}" if stage["floor_ms"] else "-"))
    return "\n".join((title, table(rows), _work(case["work"]), _error(case["error"])))


def _work(work: dict) -> str:
    return (
        f"  work: {_count(work['visible'])} visible, {_count(work['pairs'])} pairs"
        f" ({_count(work['used_pairs'])} used), {_count(work['blocks'])} blocks ({_count(work['hit_blocks'])}"
        f" hit, {_count(work['hit_blocks_full'])} with F), {_count(work['evaluated'])} pixel pairs evaluated,"
        f" {_count(work['hits'])} hits, {_count(work['contributing'])} contributing"
    )


def _error(error: dict) -> str:
    return (
        f"  error: image {error['image_max']:.1e} max, {error['image_mean']:.1e} mean; F"
        f" {error['mask_max']:.1e}; gradients {error['grad_rel_l2']:.1e} (1 - cosine"
        f" {1 - error['grad_cosine']:.0e}); {error['nonfinite']} not finite; thresholds crossed in"
        f" {1e6 * error['crossed']:.0f} ppm of the pixels"
    )


def _knobs(knobs: list[dict]) -> str:
    rows: list[tuple[str, ...]] = [
        ("knob", "value", "forward ms", "x default", "step x default", "error max", "mean")
    ]
    for k in knobs:
        value = k["value"] + (" *" if k["default"] else "")
        times = f"{k['forward_ms']:.2f}", f"{k['ratio']:.3f}", f"{k['step_ratio']:.3f}"
        rows.append((k["knob"], value, *times, f"{k['image_max']:.1e}", f"{k['image_mean']:.1e}"))
    return "Knobs (* default):\n" + table(rows, 2)


def _skips(skips: list[dict]) -> str:
    rows: list[tuple[str, ...]] = [
        ("skip", "stage", "with ms", "without ms", "gain", "step gain", "image changes")
    ]
    for s in skips:
        step = f"{s['step_gain']:.2f}" if "step_gain" in s else "-"
        change = f"{s['image_max']:.1e}" if s["image_max"] is not None else "-"
        times = f"{s['on_ms']:.2f}", f"{s['off_ms']:.2f}", f"{s['gain']:.2f}"
        rows.append((s["skip"], s["stage"], *times, step, change))
    return "Skipped work:\n" + table(rows, 2)


def _scaling(scaling: list[dict]) -> str:
    rows: list[tuple[str, ...]] = [
        ("over", "Gaussians", "visible", "size", "forward ms", "ms per Mpixel", "ms per million")
    ]
    for s in scaling:
        counts = f"{s['count']:,}", f"{s['visible']:,}", f"{s['width']}x{s['height']}"
        names = "forward_ms", "ms_per_megapixel", "ms_per_million_gaussians"
        rows.append((s["axis"], *counts, *(f"{s[name]:.1f}" for name in names)))
    return "Scaling:\n" + table(rows)


def _cores(found: dict) -> str:
    entries = found["entries"]
    counts = list(entries[0]["speed_up"])
    shown = lambda values, form: [f"{values[one]:{form}}" if one in values else "" for one in counts]
    rows: list[tuple[str, ...]] = [
        ("what", "Gaussians", "size", "ms", "serial", "jobs", *(f"x {count}" for count in counts))
    ]
    for e in entries:
        cells = e["what"], f"{e['count']:,}", f"{e['width']}x{e['height']}", f"{e['ms']:.1f}"
        rows.append((*cells, f"{e['serial']:.2%}", str(e["jobs"]), *shown(e["speed_up"], ".2f")))
        rows.append(("  measured", *[""] * 5, *shown(e["measured"], ".2f")))
        rows.append(("  measured, ms", *[""] * 5, *shown(e["measured_ms"], ".1f")))
    rows.append(("multiply-adds alone", *[""] * 5, *shown(found["arithmetic"], ".2f")))
    where = f"{found['threads']} threads" + (f" on {found['cores']} cores" if found["cores"] else "")
    title = f"Speed-up at most, by the tasks of one thread, with so many threads ({where} here):"
    return f"{title}\n{table(rows)}"


def _interactive(i: dict) -> str:
    return (
        f"Orbiting around {i['count']:,} Gaussians at {i['width']} x {i['height']}, {i['threads']} threads:"
        f" {i['frames_per_second']:.1f} frames per second ({i['frame_ms']:.1f} ms, slowest"
        f" {i['slowest_ms']:.1f}; at rest {i['rest_ms']:.2f})"
    )


def _viewport(v: dict) -> str:
    return (
        f"In a viewport, {v['count']:,} Gaussians at {v['width']} x {v['height']}:"
        f" {v['frames_per_second']:.1f} frames per second of a {v['reduction']}th of the size"
        f" ({v['frame_ms']:.1f} ms, slowest {v['slowest_ms']:.1f}); exact {v['exact_ms']:.0f} ms after the"
        " camera stops"
    )
