"""Random calls of every public function and of the terminal command: what is not right or clear.

    python -m benchmarks.fuzz.run --calls 10000 --seed 0

Every call has to end in a right result (shape, dtype, range, no argument changed, no warning), or
in an error that names the argument, within 10 s. Calls are made in a process of their own, so
that one that crashes or hangs is told, too. It ends with 1 if there was one that was not right;
the same call again: --only NAME NUMBER, beside the same seed.
"""

import argparse
import multiprocessing
import os
import sys
import traceback
from collections import Counter
from collections.abc import Iterator
from random import Random

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from pebble import ProcessExpired, ProcessPool

from benchmarks.fuzz.call import RECIPES, Call, random_call
from benchmarks.fuzz.terminal import terminal_call
from benchmarks.fuzz.verdict import LIMIT, Verdict, judged

TERMINAL = "the terminal command"
NAMES = (*RECIPES, TERMINAL)

_PATIENCE = 30 * LIMIT
"""s after which a call counts as hung; others may keep the machine busy."""

_TERMINAL_SHARE = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="NAME [NUMBER]")
    arguments = parser.parse_args()
    if arguments.only and len(arguments.only) > 1:
        name, number = arguments.only
        print(judged(name, int(number), call_of(name, int(number), arguments.seed)))
        return
    names = arguments.only or [*RECIPES, *[TERMINAL] * _TERMINAL_SHARE]
    plan = [(names[i % len(names)], i) for i in range(arguments.calls)]
    verdicts = []
    for verdict in all_verdicts(plan, arguments.seed):
        verdicts.append(verdict)
        if not verdict.good:
            print(f"{verdict.ended}: {verdict.name} {verdict.number} {verdict.told}"[:600])
            sys.stdout.flush()
    print(table(verdicts))
    sys.exit(not all(verdict.good for verdict in verdicts))


def call_of(name: str, number: int, seed: int) -> Call:
    """Return the call of a number: always the same."""
    rnd = Random(f"{seed}/{name}/{number}")
    return terminal_call(rnd) if name == TERMINAL else random_call(name, rnd)


def all_verdicts(plan: list[tuple[str, int]], seed: int) -> Iterator[Verdict]:
    """Make all calls, in a new process where one was lost."""
    spawned = multiprocessing.get_context("spawn")
    names = {name for name, _ in plan}
    with ProcessPool(1, initializer=_warm_up, initargs=(names, seed), context=spawned) as pool:
        made = [
            (name, number, pool.schedule(_verdict, (name, number, seed), timeout=_PATIENCE))
            for name, number in plan
        ]
        for name, number, future in made:
            try:
                yield future.result()
            except TimeoutError:
                yield Verdict(name, number, "hang", _PATIENCE)
            except ProcessExpired as lost:
                yield Verdict(name, number, "crash", 0.0, f"exit code {lost.exitcode}")


def _warm_up(names: set[str], seed: int) -> None:
    """Import and compile before time counts."""
    for name in names:
        for number in range(-3, 0):
            judged(name, number, call_of(name, number, seed))


def _verdict(name: str, number: int, seed: int) -> Verdict:
    try:
        return judged(name, number, call_of(name, number, seed))
    except Exception:
        return Verdict(name, number, "run.py failed", 0.0, traceback.format_exc())


def table(verdicts: list[Verdict]) -> str:
    """Return what was called and how it ended, and the slowest calls, as text."""
    counted = Counter((verdict.name, verdict.ended) for verdict in verdicts)
    called = Counter(verdict.name for verdict in verdicts)
    lines = ["| what was called | calls | results | clear errors | anything else | slowest s |"]
    lines.append("|---" * 6 + "|")
    for name in (name for name in NAMES if name in called):
        right, clear = counted[name, "result"], counted[name, "clear error"]
        slowest = max(v.seconds for v in verdicts if v.name == name)
        rest = called[name] - right - clear
        lines.append(f"| {name} | {called[name]} | {right} | {clear} | {rest} | {slowest:.2f} |")
    lines += ["", "The slowest calls:"]
    for verdict in sorted(verdicts, key=lambda v: -v.seconds)[:10]:
        lines.append(
            f"{verdict.seconds:.2f} s  {verdict.name} {verdict.number} {verdict.told}"[:200]
        )
    wrong = Counter(v.ended for v in verdicts if not v.good)
    lines += ["", f"{len(verdicts)} calls, not right or clear: {sum(wrong.values())} {dict(wrong)}"]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
