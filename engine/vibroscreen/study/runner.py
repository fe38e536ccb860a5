"""Parts of a study, solved by whoever is given and kept as they come.

A folder holds `study.json`, what is studied, and `part-000000.parquet` and so on. A part is written
whole or not at all, so a run that was ended goes on where it stopped, and several may work at one
study (`part`). What is found does not depend on who solved it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING

from vibroscreen.circuit import solve_circuit_many
from vibroscreen.errors import InputError
from vibroscreen.study.plan import Study, fingerprint

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["collect", "keep", "run", "workers_of"]

CHUNK = 500  # designs of a part
NOTE = "study.json"


def run(
    study: Study,
    folder: Path,
    *,
    executor: Executor | None = None,
    part: tuple[int, int] = (1, 1),
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Solve what is not in the folder yet.

    executor: any of `concurrent.futures`, or of a cluster; without one parts are solved here, one
    after the other, on all cores. part: (k, n) solves every nth part from the kth on, for n runs
    that share a folder. progress is called with the designs done and of all of this run. Raises
    InputError for a folder of another study, one that another run writes into, or one that is full,
    and where the workers of the executor are gone.
    """
    k, n = part
    if not 1 <= k <= n:
        raise InputError(f"part = {k}/{n} is none: give k/n with k from 1 to n", "part")
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder, f"run-{k}-of-{n}.lock"):
        _note(study, folder)
        starts = range(0, study.count, CHUNK)
        own = [start for place, start in enumerate(starts) if place % n == k - 1]
        missing = [start for start in own if not _there(study, folder, start)]
        sizes = {start: _stop(study, start) - start for start in own}
        done = sum(sizes.values()) - sum(sizes[start] for start in missing)
        total = sum(sizes.values())
        if progress is not None:
            progress(done, total)
        with workers_of(folder):
            for start, frame in _solved(study, missing, executor):
                keep(frame, _path(folder, start))
                done += sizes[start]
                if progress is not None:
                    progress(done, total)


def collect(study: Study, folder: Path) -> pd.DataFrame:
    """All parts as one table, a row a design. Raises InputError for one that is not there."""
    import pandas as pd

    _note(study, folder)
    starts = range(0, study.count, CHUNK)
    missing = [start for start in starts if not _there(study, folder, start)]
    if missing:
        raise InputError(
            f"{folder} lacks {len(missing)} of {len(starts)} parts, the first is "
            f"{_path(folder, missing[0]).name}: run the study there again, it solves them",
            "folder",
        )
    frames = [pd.read_parquet(_path(folder, start)) for start in starts]
    table = pd.concat(frames, ignore_index=True)
    table.index.name = "design"
    return table


def solve_part(study: Study, start: int, stop: int, threads: int | None = None) -> pd.DataFrame:
    """Designs of a study: what was varied, in the units of its keys, and what came of it."""
    varied = {key: column[start:stop] for key, column in study.table().items()}
    solved = solve_circuit_many(study.fast, study.values(varied), threads=threads)
    frame = solved.frame()
    frame = frame.drop(columns=[name for name in study.names if name in frame])
    for place, (key, column) in enumerate(varied.items()):
        frame.insert(place, key, column)
    return frame


def _solved(
    study: Study, starts: list[int], executor: Executor | None
) -> Iterator[tuple[int, pd.DataFrame]]:
    """Parts as they come."""
    if executor is None:
        for start in starts:
            yield start, solve_part(study, start, _stop(study, start))
        return
    futures = {
        executor.submit(solve_part, study, start, _stop(study, start), 1): start for start in starts
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


@contextlib.contextmanager
def workers_of(folder: Path | None) -> Iterator[None]:
    """Say clearly that the workers of an executor are gone, and where one can go on."""
    try:
        yield
    except (BrokenExecutor, CancelledError) as error:
        kept = f": what they solved is in {folder}, it goes on from there" if folder else ""
        raise InputError(
            "executor has lost its workers, by an end of their process or of their cluster "
            f"({type(error).__name__}). Start them and run it again{kept}",
            "executor",
        ) from error


# --- the folder -----------------------------------------------------------------------------------
def _stop(study: Study, start: int) -> int:
    return min(start + CHUNK, study.count)


def _path(folder: Path, start: int) -> Path:
    return folder / f"part-{start // CHUNK:06d}.parquet"


def _there(study: Study, folder: Path, start: int) -> bool:
    """Whether a part is there and whole; one that is not is told of, and solved again."""
    path = _path(folder, start)
    if not path.exists():
        return False
    from pyarrow import ArrowException
    from pyarrow.parquet import read_metadata

    try:
        whole = bool(read_metadata(path).num_rows == _stop(study, start) - start)
    except (ArrowException, OSError):
        whole = False
    if not whole:
        warnings.warn(f"{path} is damaged: it is solved again", stacklevel=3)
    return whole


def keep(frame: pd.DataFrame, path: Path) -> None:
    """Write a table whole, or not at all. Raises InputError where there is no room."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        frame.to_parquet(draft)
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            kept = len(list(path.parent.glob("part-*.parquet")))
            raise InputError(
                f"{path.parent} has no room left: {kept} parts are kept. Make room and run it "
                "again, it goes on from there",
                "folder",
            ) from None
        raise


def _note(study: Study, folder: Path) -> None:
    """Say what is studied in a folder, or refuse one of another study."""
    path = folder / NOTE
    told = {"name": study.name, "fingerprint": fingerprint(study), "designs": study.count}
    if path.exists():
        try:
            known = json.loads(path.read_text(encoding="utf-8"))["fingerprint"]
        except (ValueError, KeyError, TypeError):
            known = None
        if known != fingerprint(study):
            raise InputError(
                f"{folder} holds another study, or an earlier state of this one: give another "
                f"folder, or remove that one",
                "folder",
            )
        return
    if any(folder.glob("part-*.parquet")):
        raise InputError(f"{folder} holds parts without {NOTE}: give another folder", "folder")
    draft = path.with_name(f".{NOTE}.{os.getpid()}")
    draft.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


@contextlib.contextmanager
def _alone(folder: Path, name: str) -> Iterator[None]:
    """Hold a folder against another run of the same part; the system lets go of what is killed."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / name, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            f"another run writes into {folder}: wait for its end, give another folder, or share "
            "the work (--part 1/2 and --part 2/2)",
            "folder",
        ) from None
    try:
        yield
    finally:
        lock.release()
