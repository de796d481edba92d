"""Numbers of bytes as text."""


def size_text(size: float) -> str:
    """Bytes in GB, MB or kB (powers of 1000), with one decimal: 44.0 MB."""
    unit, name = (1e9, "GB") if size >= 1e9 else (1e6, "MB") if size >= 1e5 else (1e3, "kB")
    return f"{size / unit:.1f} {name}"
