"""The criteria of `svrgs select` as options. Nothing heavy is imported here: the parser of the command line
reads this file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from ...system.option_kinds import BOX, COUNT, FLAG, PATH, RANGE, SHARE, SPHERE, TEXT, option

# criteria that need views
OF_VIEWS = ("contribution", "lowest_contribution", "removal_error", "lowest_removal_error", "seen_by")
RANKING = OF_VIEWS[:-1]  # those by which Gaussians are ranked, over all views
OF_ONE = ("box", "sphere", "opacity", "size", "color")  # criteria that judge each Gaussian by itself

# Of an option: its kind and default, its help text, then the rest.
# fmt: off


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """What Gaussians must fulfil to be selected: all criteria that are given. Coordinates and sizes are those
    of the file."""

    box: tuple | None = option(BOX, None, "inside the box between two opposite corners")
    sphere: tuple | None = option(
        SPHERE, None, "inside the sphere with this centre and radius", metavar="X,Y,Z,R"
    )
    opacity: tuple | None = option(
        RANGE, None, "opacity in this range, 0..1; either end of a range may be left out, as in ,0.1"
    )
    size: tuple | None = option(RANGE, None, "largest standard deviation in this range, in units of the file")
    color: tuple | None = option(
        SPHERE, None,
        "base colour, without what depends on the view, within a distance D of this one, display sRGB 0..1",
        metavar="R,G,B,D",
    )
    contribution: tuple | None = option(
        RANGE, None, "contribution in this range: the sum of alpha T over all pixels of the views"
    )
    lowest_contribution: float | None = option(
        SHARE, None, "this share of the Gaussians, those with the lowest contribution"
    )
    removal_error: tuple | None = option(
        RANGE, None,
        "removal error in this range: the squared error of the colours, summed over the views, if only this"
        " Gaussian is removed",
    )
    lowest_removal_error: float | None = option(
        SHARE, None, "this share of the Gaussians, those with the lowest removal error"
    )
    seen_by: str = option(
        TEXT, "",
        "seen by one of these views: all, train, test, or names and numbers of views with commas between",
        metavar="VIEWS",
    )
    floaters: bool = option(
        FLAG, False,
        "floaters: small groups of Gaussians apart from all others and, with at least 8 views, haze in front"
        " of the cameras",
    )

    def given(self) -> tuple[str, ...]:
        """Names of the criteria that are given."""
        return tuple(
            found.name for found in fields(Criteria) if getattr(self, found.name) not in (None, "", False)
        )


@dataclass(frozen=True, kw_only=True)
class SelectOptions(Criteria):
    """Options of `svrgs select`."""

    data: Path | None = option(
        PATH, None,
        "views: dataset, COLMAP model or transforms.json; photographs are not needed",
        metavar="DIR", former="colmap",
    )
    cameras: Path | None = option(
        PATH, None, "views: cameras.json of a 3DGS run, or transforms.json", metavar="JSON"
    )
    invert: bool = option(
        FLAG, False, "select all other Gaussians instead: with --out, the criteria then say what is deleted"
    )
    measure: bool = option(
        FLAG, False,
        "measure in the views how much each Gaussian is needed, and how sure its rank is; --out then holds it"
        " as columns",
    )
    force: bool = option(FLAG, False, "rank Gaussians also where the views see less than half of them")
    threads: int = option(
        COUNT, 0,
        "number of threads; the result does not depend on it",
        default_help="one per core",
    )
    out: Path | None = option(
        PATH, None,
        "splat file to write the selected Gaussians to",
        metavar="FILE", default_help="only counts are printed",
    )
