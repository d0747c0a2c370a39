"""Play the pairs: each with every arm, seed by seed, into one Parquet.

    python -m benchmarks.pairs.run --split development --seeds 20 --out pairs.parquet
    python -m benchmarks.pairs.run --family mazes --arms raw,guarded --seeds 5 --out mazes.parquet

A row is one arm of one pair with one seed. All arms of a pair have one total of steps, the source's
included (:func:`curricle.compare`); the defaults, whose sources take other steps, have their own.
``gain`` is the normalised area under the charged curve less that of learning from scratch, in
return; tables express it as a share of ``optimum - random_return``. A pair is stored as soon as it
is played, in OUT.parts/, so that a run that was killed goes on where it was. What other code or
other settings stored is not used.
"""

import argparse
import hashlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

import curricle as cr
from benchmarks.pairs import Pair, family_names, pairs
from benchmarks.pairs.arms import AGGREGATES, ARMS
from benchmarks.pairs.playing import play
from curricle.files import write_whole

ALL_ARMS = (*ARMS, *AGGREGATES)
DEPENDS = ("pair.py", "worlds.py", "arms.py", "playing.py", "families/*.py")
"""What a played pair depends on, beside the library."""


def code_digest() -> str:
    """Return a digest of the code that a played pair depends on."""
    here, library = Path(__file__).parent, Path(cr.__file__).parent
    files = [*library.rglob("*.py"), *(file for one in DEPENDS for file in here.glob(one))]
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(files):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def run(
    chosen: Sequence[Pair],
    arms: Sequence[str],
    seeds: int,
    out: Path,
    workers: int,
    report: Any = lambda text: None,
) -> None:
    """Play the pairs that are not stored yet, and write all of them to one Parquet."""
    parts = out.with_suffix(out.suffix + ".parts")
    parts.mkdir(parents=True, exist_ok=True)
    code = code_digest()
    files = {pair.name: parts / part_name(pair.name, arms, seeds, code) for pair in chosen}
    missing = [name for name, file in files.items() if not file.exists()]
    report(f"{len(chosen)} pairs, {len(chosen) - len(missing)} played before")
    if missing:
        with ProcessPoolExecutor(min(workers, len(missing))) as pool:
            for name, rows in _played(pool, missing, arms, seeds):
                _write(pa.Table.from_pylist(rows), files[name])
                report(f"{name}: {rows[0]['pair_seconds']:.1f} s")
    _write(pa.concat_tables([pq.read_table(file) for file in files.values()]), out)


def part_name(pair: str, arms: Sequence[str], seeds: int, code: str) -> str:
    """Return the name of the file of a played pair."""
    of = repr((pair, sorted(arms), seeds, code))
    return hashlib.blake2b(of.encode(), digest_size=12).hexdigest() + ".parquet"


def _played(
    pool: Executor, names: Sequence[str], arms: Sequence[str], seeds: int
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield each pair with its rows when it is played."""
    running = {pool.submit(play, name, arms, seeds): name for name in names}
    try:
        for future in as_completed(running):
            yield running[future], future.result()
    finally:
        for future in running:
            future.cancel()


def _write(table: pa.Table, path: Path) -> None:
    """Write a file that is whole or absent."""
    content = pa.BufferOutputStream()
    pq.write_table(table, content)
    write_whole(path, content.getvalue().to_pybytes())


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command's arguments."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.pairs.run", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--split", choices=["development", "verification"])
    parser.add_argument("--family", choices=family_names())
    parser.add_argument("--pair", action="append", help="one pair by name; may be repeated")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--arms", default=",".join(ALL_ARMS), help="scratch is always played")
    parser.add_argument("--out", type=Path, default=Path("pairs.parquet"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    given = parser.parse_args(arguments)
    given.arms = given.arms.split(",")
    unknown = [arm for arm in given.arms if arm not in ALL_ARMS]
    if unknown:
        parser.error(f"--arms must be of {', '.join(ALL_ARMS)}: got {unknown[0]}")
    given.pairs = [
        pair
        for pair in pairs(given.split, given.family)
        if given.pair is None or pair.name in given.pair
    ]
    if not given.pairs:
        parser.error("no pair is of that split, family and name")
    return given


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    given, begun = parsed(arguments), time.perf_counter()

    def report(text: str) -> None:
        print(f"{time.perf_counter() - begun:6.0f} s  {text}", file=sys.stderr, flush=True)

    run(given.pairs, given.arms, given.seeds, given.out, given.workers, report)


if __name__ == "__main__":
    main()
