"""How well a screen separates: partition curve, cut size, ecart probable, recoveries.

All functions take the sizes of the classes (or of the nodes inside them) and the mass flow rates of
the two products by size, in any common unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.kernels.outputs import partition_size

if TYPE_CHECKING:  # the host of an FMU need not have it
    import pandas as pd

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Partition:
    """Part of each size that reports to the oversize, and the sizes read from it.

    cut_size: where half of the feed reports to the oversize [m]; ecart_probable: (d75 - d25)/2 [m].
    `crossed` is False where the curve does not reach 25, 50 or 75 per cent: the size of the end
    class stands in for what is not there.
    """

    size: Array
    to_oversize: Array
    cut_size: float
    ecart_probable: float
    crossed: bool

    def frame(self) -> pd.DataFrame:
        """Table of size [m] and part to the oversize [1]."""
        import pandas as pd

        return pd.DataFrame({"size_m": self.size, "to_oversize": self.to_oversize})


def partition(
    size: ArrayLike, undersize: ArrayLike, oversize: ArrayLike, aperture: float = np.inf
) -> Partition:
    """Partition curve between two products.

    size[n] in m, ascending; undersize[n], oversize[n] mass flow rates by size. Sizes that neither
    product holds are left out. Levels are interpolated linearly between neighbouring sizes, and
    up to the aperture [m], the largest, from which on nothing passes, if it is given.
    Raises ValueError if nothing flows.
    """
    sizes, fine, coarse = (np.asarray(x, dtype=float) for x in (size, undersize, oversize))
    total = fine + coarse
    there = total > 0.0
    if not there.any():
        raise ValueError("undersize and oversize are both empty: there is no partition curve")
    levels = np.array([partition_size(sizes, fine, coarse, x, aperture) for x in (0.25, 0.5, 0.75)])
    d25, d50, d75 = np.abs(levels)
    return Partition(
        sizes[there],
        coarse[there] / total[there],
        float(d50),
        float(0.5 * (d75 - d25)),
        bool((levels > 0.0).all()),
    )


def undersize_recovery(
    size: ArrayLike, feed: ArrayLike, undersize: ArrayLike, aperture: float
) -> float:
    """Undersize finer than the aperture [m] over the same in the feed [1]; nan without any."""
    finer = np.asarray(size, dtype=float) < aperture
    fed = float(np.asarray(feed, dtype=float)[finer].sum())
    return float(np.asarray(undersize, dtype=float)[finer].sum()) / fed if fed > 0.0 else np.nan


def oversize_recovery(
    size: ArrayLike, feed: ArrayLike, oversize: ArrayLike, aperture: float
) -> float:
    """Oversize not finer than the aperture [m] over the same in the feed [1]; nan without any."""
    coarser = np.asarray(size, dtype=float) >= aperture
    fed = float(np.asarray(feed, dtype=float)[coarser].sum())
    return float(np.asarray(oversize, dtype=float)[coarser].sum()) / fed if fed > 0.0 else np.nan


def misplaced_fines(size: ArrayLike, oversize: ArrayLike, aperture: float) -> float:
    """Mass fraction of the oversize that is finer than the aperture [m]; nan without oversize."""
    finer = np.asarray(size, dtype=float) < aperture
    mass = np.asarray(oversize, dtype=float)
    total = float(mass.sum())
    return float(mass[finer].sum()) / total if total > 0.0 else np.nan


def deck_efficiency(size: ArrayLike, feed: ArrayLike, passed: ArrayLike, aperture: float) -> float:
    """Efficiency of undersize removal of a deck [1]: of its feed finer than its aperture [m], what
    passed it; nan without any.

    passed[n]: what fell through the deck, also what leaves over a deck below it. The efficiency of
    the trade's sizing rules (VSMA; Karra, CIM Bulletin, April 1979) and of Wills, Mineral
    Processing Technology, "Industrial screening". In the engine: `outputs.write_separation`.
    """
    return undersize_recovery(size, feed, passed, aperture)


def screening_efficiency(
    size: ArrayLike, feed: ArrayLike, undersize: ArrayLike, oversize: ArrayLike, aperture: float
) -> float:
    """Overall efficiency: undersize recovery times oversize recovery [1] (Taggart, Wills)."""
    return undersize_recovery(size, feed, undersize, aperture) * oversize_recovery(
        size, feed, oversize, aperture
    )
