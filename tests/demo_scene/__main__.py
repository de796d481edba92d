"""Command line: make a generated dataset, or leave it alone when it is already there."""

import argparse
import sys
from pathlib import Path

# Both `python -m tests.demo_scene` and `python tests/demo_scene` end up with the same package.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from demo_scene.dataset import Request, ensure
from demo_scene.scenes import SCENES


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="demo_scene", description="Render a generated scene as a COLMAP dataset."
    )
    parser.add_argument("out", type=Path, help="folder to create")
    scenes = "; ".join(f"{name}: {kind.about}" for name, kind in SCENES.items())
    parser.add_argument("--scene", choices=list(SCENES), default="plaza", help=f"{scenes} (default: plaza)")
    parser.add_argument("--views", type=int)
    parser.add_argument("--width", type=int, help="pixels; the height follows from the scene's format")
    parser.add_argument("--samples", type=int, help="per pixel, before denoising")
    parser.add_argument("--points", type=int, help="sparse points aimed at")
    args = parser.parse_args()
    try:
        request = Request.of(
            args.scene, views=args.views, width=args.width, samples=args.samples, points=args.points
        )
        made = ensure(args.out, request)
    except (ValueError, ImportError, OSError) as error:
        print(f"demo_scene: {error}", file=sys.stderr)
        return 2
    print(f"{args.out}: {'written' if made else 'up to date'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
