"""Run the robot's loop in software and end with the verdict on its timing, for a CI job.

    python examples/sil_timing_in_ci.py --bundle build/bundle_1dof --out build/sil

Exit code 0: the loop kept its deadlines. 1: it missed some itself, or the supervisor stopped it.
2: an input cannot be used. 3: the machine was too busy to tell, so let the job try again. The job
keeps OUT/timing.xml, which is a JUnit report.
"""

import argparse
import sys
from pathlib import Path

import dropstitch

BUNDLE = Path(__file__).resolve().parents[1] / "docs/notebooks/bundle_1dof"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--bundle", type=Path, default=BUNDLE)
    parser.add_argument("--out", type=Path, default=Path("sil"))
    parser.add_argument("--line", choices=("socket", "pty", "virtual"), default="socket")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--miss-rate", type=float, default=0.01, help="to bound with 95 % (0.01)")
    args = parser.parse_args(argv)
    try:
        run = dropstitch.run_sil(
            args.bundle, args.out, line=args.line, seconds=args.seconds, miss_rate=args.miss_rate
        )
    except dropstitch.InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(run.text())
    print(f"results in {run.write()}")
    return run.timing.verdict.exit_code


if __name__ == "__main__":
    sys.exit(main())
