"""Gaudin's chance to pass an opening (eq. 5)."""

from vibroscreen.compiler.language import kernel


@kernel
def stop_coarse(size, closed, probability):
    """Let no size from `closed` [m] on pass; returns the number of sizes that are finer."""
    passing = size.size
    while passing > 0 and size[passing - 1] >= closed:
        passing -= 1
        probability[passing] = 0.0
    return passing


@kernel
def gaudin(size, fraction, scene, probability):
    """Gaudin: P = phi (1 - d/a) (s - d)/b for d < a, d < s, else 0 (paper, eq. 5: a = b = s).

    a, b: sides of the opening across and along the flow; s: what a falling grain sees of b.
    """
    across, seen = scene.across, scene.seen
    open_area = scene.open_area
    scale = open_area / (across * scene.along)
    for i in range(size.size):
        probability[i] = scale * max(0.0, across - size[i]) * max(0.0, seen - size[i])
