"""Print what the pairs say: gains, portfolio, optimism, defaults, ways in, and the bars.

    python -m benchmarks.pairs.tables pairs.parquet [--split verification]

Gains are shares of the way from the random policy's return to the optimum, mean over seeds with
Student intervals at 95 %. Charged gains count the source's steps at the random policy's return;
weak ones do not count them. Losses are shares of what learning from scratch covers of that way (a
tenth of it at least). A bar is on the means; "shown" counts the pairs whose whole interval is
beyond it.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.pairs.arms import AGGREGATES, RAW, WAYS_IN
from benchmarks.pairs.results import Played, read

MOST_LOSS, LEAST_KEPT = 0.1, 0.8
PAYS_OR_TIES, TIE = 0.85, 0.05
SMALL = 0.01
"""Gain, as a share of the way, below which no share of it is taken."""
OPTIMISM = ("river-swim", "chain", "deep-sea")
KNOW_NOTHING = tuple(f"{RAW}, {one}" for one in ("placebo", "constant mean", "constant maximum"))
Lines = Iterator[str]


def families(pairs: Sequence[Played]) -> dict[str, list[Played]]:
    """Return the pairs by family."""
    found: dict[str, list[Played]] = {}
    for pair in pairs:
        found.setdefault(pair.facts["family"], []).append(pair)
    return found


def short(interval: object) -> str:
    """Return a mean and half its interval's width, such as +.53±.04."""
    low, high = interval.low, interval.high  # type: ignore[attr-defined]
    return f"{(low + high) / 2:+.2f}±{(high - low) / 2:.2f}"


def gains(pairs: Sequence[Played]) -> Lines:
    """Yield the charged gain of each arm in each pair."""
    arms = list(dict.fromkeys(arm for pair in pairs for arm in pair.arms if arm != "scratch"))
    arms = [arm for arm in arms if arm not in AGGREGATES]
    yield "Charged gains over scratch. base: covered by scratch; source: how far it learnt its task"
    heads = [arm.removeprefix(f"{RAW}, ").removeprefix("scratch, ")[:10] for arm in arms]
    yield f"{'':<46}{'base':>6}{'source':>8}" + "".join(f"{head:>12}" for head in heads)
    for name, members in families(pairs).items():
        yield f"{name} ({members[0].facts['split']})"
        for pair in members:
            cells = [short(pair.gain(arm)) if pair.has(arm) else "" for arm in arms]
            start = f"  {pair.label[:43]:<44}{pair.base():>6.2f}{pair.source_learnt:>8.2f}"
            yield start + "".join(f"{cell:>12}" for cell in cells)


def portfolio(pairs: Sequence[Played], arm: str = "guarded") -> Lines:
    """Yield the loss of the guarded learner, and the share of the raw gain that it keeps."""
    played = [pair for pair in pairs if pair.has(RAW, arm)]
    yield f"Portfolio, weak: loss of {RAW} and of {arm}, loss at the end; weak gain kept"
    over, shown, ends, kept = 0, 0, 0, list[float]()
    for pair in played:
        loss, raw, own = (
            pair.losses(arm, "weak_gain"),
            pair.gain(RAW, "weak_gain"),
            pair.gain(arm, "weak_gain"),
        )
        end = -pair.arms[arm]["weak_final_gain"].mean()
        end /= pair.way
        share = ""
        if raw.low > SMALL:
            kept.append(float(own.estimate / raw.estimate))
            share = f"keeps {kept[-1]:.0%}"
        over, shown = over + (loss.estimate > MOST_LOSS), shown + (loss.low > MOST_LOSS)
        ends += end > MOST_LOSS
        if loss.estimate > MOST_LOSS or share:
            before = pair.losses(RAW, "weak_gain")
            text = f"{short(before):>14}{short(loss):>14}{end:>8.2f}  {share}"
            yield f"  {pair.name[:50]:<52}{text}" + "  LOSES" * bool(loss.estimate > MOST_LOSS)
    hurt = sum(pair.losses(RAW, "weak_gain").estimate > MOST_LOSS for pair in played)
    mean = float(np.minimum(kept, 1.0).mean()) if kept else float("nan")
    yield bar(
        over == 0 and mean >= LEAST_KEPT,
        f"{arm} loses more than {MOST_LOSS:.0%} in {over} of {len(played)} pairs (shown in "
        f"{shown}; raw in {hurt}), ends that much lower in {ends}, and keeps {mean:.0%} of the "
        f"gain, at most all of it, on average of {len(kept)} pairs (bars: 0, {LEAST_KEPT:.0%})",
    )


def optimism(pairs: Sequence[Played]) -> Lines:
    """Yield, where the raw potential pays, what its strongest control without knowledge gains."""
    yield "Optimism: where raw pays, its gain, the strongest control that knows nothing, and words"
    named, right = 0, 0
    for pair in pairs:
        controls = [arm for arm in KNOW_NOTHING if pair.has(arm)]
        if not controls or not pair.has(RAW) or pair.gain(RAW).low <= 0:
            continue
        best = max(controls, key=lambda arm: pair.gains(arm).mean())
        over = pair.difference(RAW, best)
        yield (
            f"  {pair.name[:50]:<52}{short(pair.gain(RAW)):>12}{short(pair.gain(best)):>12} "
            f"{best.removeprefix(f'{RAW}, '):<17} {pair.words(RAW)}"
        )
        if pair.facts["family"] in OPTIMISM and over.high <= MOST_LOSS * pair.gain(RAW).estimate:
            named += 1
            right += "optimism" in pair.words(RAW)
    yield bar(
        named == right,
        f"of {named} pairs of {', '.join(OPTIMISM)} that pay without knowing more than a control "
        f"does, {right} are called optimism",
    )


def defaults(pairs: Sequence[Played], arm: str = "default") -> Lines:
    """Yield whether default settings pay, tie or lose in the sensible pairs.

    A tie is a loss that is not shown, or of at most a twentieth.
    """
    played = [pair for pair in pairs if pair.facts["sensible"] and pair.has(arm)]
    yield f"{arm}, sensible pairs, charged: what does not pay"
    counts, slight, much = {"pays": 0, "ties": 0, "loses": 0}, 0, 0
    for pair in played:
        gain, loss = pair.gain(arm), pair.losses(arm)
        shown = gain.high < 0
        tied = not shown or loss.estimate <= TIE
        said = "pays" if gain.low > 0 else "ties" if tied else "loses"
        counts[said] += 1
        slight += shown and tied
        much += loss.estimate > MOST_LOSS
        if said != "pays":
            yield f"  {pair.name[:50]:<52}{short(gain):>12} {said}, loss {loss.estimate:.0%}"
    good = (counts["pays"] + counts["ties"]) / max(1, len(played))
    said = ", ".join(f"{word} in {n}" for word, n in counts.items())
    yield bar(
        good >= PAYS_OR_TIES and much == 0,
        f"{arm} {said} of {len(played)} sensible pairs (a loss of at most {TIE:.0%} is a tie: "
        f"{slight} of these are shown): pays or ties in {good:.0%}, loses more than "
        f"{MOST_LOSS:.0%} in {much} (bars: {PAYS_OR_TIES:.0%}, 0)",
    )


def unguarded_defaults(pairs: Sequence[Played]) -> Lines:
    """Yield the same for the default settings without their portfolio."""
    yield from defaults(pairs, "unguarded default")


def ways_in(pairs: Sequence[Played]) -> Lines:
    """Yield the mean charged gain of each way in by family, over sensible pairs and over all."""
    ways = [way for way in WAYS_IN if all(pair.has(way) for pair in pairs)]
    yield "Ways in: mean charged gain, sensible pairs / all pairs; the last line counts best ways"
    yield f"{'':<16}" + "".join(f"{way:>16}" for way in ways)
    for name, members in [*families(pairs).items(), ("all", list(pairs))]:
        good = [pair for pair in members if pair.facts["sensible"]]
        cells = [
            f"{np.mean([p.gains(way).mean() for p in good]):+.2f} / "
            f"{np.mean([p.gains(way).mean() for p in members]):+.2f}"
            for way in ways
        ]
        yield f"  {name:<14}" + "".join(f"{cell:>16}" for cell in cells)
    best = [max(ways, key=lambda way: pair.gains(way).mean()) for pair in pairs] if ways else []
    yield f"  {'best in':<14}" + "".join(f"{best.count(way):>16}" for way in ways)
    several = [pair for pair in pairs if pair.has(*AGGREGATES)]
    for pair in several:
        cells = [f"{name} {short(pair.gain(name))}" for name in AGGREGATES]
        yield f"  {pair.name:<46}" + "  ".join(cells)


def bar(met: bool, text: str) -> str:
    """Return the sentence of a bar."""
    return f"{'MET' if met else 'NOT MET'}: {text}"


TABLES: dict[str, Callable[[Sequence[Played]], Lines]] = {
    "gains": gains,
    "portfolio": portfolio,
    "optimism": optimism,
    "default": defaults,
    "unguarded default": unguarded_defaults,
    "ways": ways_in,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.pairs.tables", description=__doc__.split("\n")[0]
    )
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--split", choices=["development", "verification"])
    parser.add_argument("--table", choices=list(TABLES), action="append", help="all by default")
    given = parser.parse_args(arguments)
    pairs = read(given.files, given.split)
    bars = []
    for name in given.table or TABLES:
        lines = list(TABLES[name](pairs))
        bars += [line for line in lines if line.startswith(("MET", "NOT MET"))]
        print("\n".join(lines), end="\n\n")
    print("Bars\n" + "\n".join(bars))


if __name__ == "__main__":
    main()
