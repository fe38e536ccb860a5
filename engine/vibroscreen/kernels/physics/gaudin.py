"""Gaudin's chance to pass an opening (eq. 5)."""

from vibroscreen.compiler.language import kernel


@kernel
def stop_coarse(size, aperture, probability):
    """Let no size pass that is not below the aperture; returns the number of sizes that are."""
    passing = size.size
    while passing > 0 and size[passing - 1] >= aperture:
        passing -= 1
        probability[passing] = 0.0
    return passing


@kernel
def gaudin(size, fraction, scene, probability):
    """Gaudin: P = phi (1 - d/a)^2 for d < a, else 0 (paper, eq. 5)."""
    aperture = scene.aperture
    open_area = scene.open_area
    scale = open_area / (aperture * aperture)
    for i in range(size.size):
        free = max(0.0, aperture - size[i])
        probability[i] = scale * free * free
