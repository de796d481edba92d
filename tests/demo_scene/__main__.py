"""Command line: make the demo dataset, or leave it alone when it is already there."""

import argparse
import sys
from pathlib import Path

# Both `python -m tests.demo_scene` and `python tests/demo_scene` end up with the same package.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from demo_scene.dataset import Request, ensure


def main() -> int:
    parser = argparse.ArgumentParser(prog="demo_scene", description="Render the demo dataset.")
    parser.add_argument("out", type=Path, help="folder to create")
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--width", type=int, default=360, help="pixels; the height is 3/4 of it")
    parser.add_argument("--samples", type=int, default=8, help="per pixel, before denoising")
    parser.add_argument("--points", type=int, default=5000, help="sparse points aimed at")
    args = parser.parse_args()
    request = Request(args.views, args.width, args.samples, args.points)
    try:
        made = ensure(args.out, request)
    except (ValueError, ImportError, OSError) as error:
        print(f"demo_scene: {error}", file=sys.stderr)
        return 2
    print(f"{args.out}: {'written' if made else 'up to date'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
